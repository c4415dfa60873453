// A timer that a browser does not hold back in a tab that nobody sees, as it does a page's own to once a minute.

let timer;

addEventListener("message", ({ data: afterMs }) => {
  clearTimeout(timer);
  timer = setTimeout(() => postMessage(null), afterMs);
});
