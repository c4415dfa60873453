// Whether the service is there: a banner while it is not, "calrig:back" to whoever wants to catch up, and
// "calrig:there" whenever it has answered.

const CALM_MS = 5000;
const WORRIED_MS = 1000;
const LOST =
  "Lost connection to the calrig service; retrying. " +
  "A run goes on without this page, but not without the service.";

let lost = false;
let timer;

/** Begins to watch; any request that gets no answer makes it look at once. */
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
    return false; // refused, reset or unresolved: all the same to the person at the page
  }
}
