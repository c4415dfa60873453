// The page on paper: its own stylesheet, and charts that shrink as a whole and take their own size again afterwards.

import { h } from "./dom.js";

const charts = () => document.querySelectorAll(".plot .main-svg");

window.addEventListener("beforeprint", () => {
  for (const svg of charts()) {
    svg.setAttribute("viewBox", `0 0 ${svg.getAttribute("width")} ${svg.getAttribute("height")}`);
  }
});
window.addEventListener("afterprint", () => {
  for (const svg of charts()) svg.removeAttribute("viewBox");
});
document.head.append(h("link", { rel: "stylesheet", media: "print", href: new URL("./print.css", import.meta.url).href }));
