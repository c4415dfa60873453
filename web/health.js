// Whether the service answers: a banner while it does not, the event "calrig:back" when it does again, and
// "calrig:there" after every answer.

const CALM_MS = 5000;
const WORRIED_MS = 1000;
const LOST =
  "Lost connection to the calrig service; retrying. " +
  "A run continues without this page, but not without the service.";

let lost = false;
let timer;

/** Watches the service; a request without an answer triggers a check at once. */
export function watchHealth(banner) {
  window.addEventListener("calrig:lost", () => check(banner));
  timer = setTimeout(check, CALM_MS, banner);
}

async function check(banner) {
  clearTimeout(timer);
  const alive = await answers();
  if (alive !== !lost) {
    lost = !alive;
    banner.hidden = alive;
    banner.textContent = alive ? "" : LOST;
    if (alive) window.dispatchEvent(new Event("calrig:back"));
  }
  if (alive) window.dispatchEvent(new Event("calrig:there"));
  clearTimeout(timer);
  timer = setTimeout(check, lost ? WORRIED_MS : CALM_MS, banner);
}

async function answers() {
  try {
    return (await fetch("/api/health", { cache: "no-store" })).ok;
  } catch {
    return false; // refused, reset or unresolved
  }
}
