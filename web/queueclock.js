// A timer in a worker: browsers throttle the timers of a hidden page to one per minute, but not those of its workers.

let timer;

addEventListener("message", ({ data: afterMs }) => {
  clearTimeout(timer);
  timer = setTimeout(() => postMessage(null), afterMs);
});
