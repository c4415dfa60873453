// Charts on paper: they shrink as a whole, and take their own size again afterwards.

const charts = () => document.querySelectorAll(".plot .main-svg");

window.addEventListener("beforeprint", () => {
  for (const svg of charts()) {
    svg.setAttribute("viewBox", `0 0 ${svg.getAttribute("width")} ${svg.getAttribute("height")}`);
  }
});
window.addEventListener("afterprint", () => {
  for (const svg of charts()) svg.removeAttribute("viewBox");
});
