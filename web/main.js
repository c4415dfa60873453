// The router: one hash route and one AbortSignal per view, aborted when the view is left.

import { fill, h, visible } from "./dom.js";
import { timeZone } from "./format.js";
import { watchHealth } from "./health.js";
import { loginState, loginView, logOut } from "./login.js";
import { iAm, may } from "./me.js";
import { onRigs, watchRigs } from "./rigs.js";
import { startView } from "./start.js";
import { preferRig, stopButtons } from "./stop.js";

/** Routes and their views; a module is fetched when its first view is opened. */
const ROUTES = [
  [/^\/$/, startView],
  [/^\/runs\/([^/]+)$/, async (shown) => (await import("./run.js")).runView(shown)],
  [/^\/units$/, async (shown) => (await import("./unitlist.js")).unitsView(shown)],
  [/^\/units\/([^/]+)$/, async (shown) => (await import("./units.js")).unitView(shown)],
  [/^\/compare$/, async (shown) => (await import("./compare.js")).compareView(shown)],
  [/^\/limits$/, async (shown) => (await import("./limits.js")).limitsView(shown)],
  [/^\/benches$/, async (shown) => (await import("./benches.js")).benchesView(shown)],
  [/^\/rigs\/([^/]+)$/, async (shown) => (await import("./rig.js")).rigView(shown)],
  [/^\/solve$/, async (shown) => (await import("./solve.js")).solveView(shown)],
  [/^\/solve\/([^/]+)$/, async (shown) => (await import("./solution.js")).solutionView(shown)],
  [/^\/queue(?:\/([^/]+))?$/, async (shown) => (await import("./queue.js")).queueView(shown)],
  [/^\/import$/, async (shown) => (await import("./import.js")).importView(shown)],
  [/^\/trail$/, async (shown) => (await import("./trail.js")).trailView(shown)],
  [/^\/users$/, async (shown) => (await import("./users.js")).usersView(shown)],
  [/^\/noise(?:\/([^/]+))?$/, async (shown) => (await import("./noise.js")).noiseView(shown)],
];

const root = document.getElementById("view");
const stop = document.getElementById("stop");
const leave = document.getElementById("log-out");
const name = document.getElementById("who");
const benches = document.getElementById("benches-link");
const users = document.getElementById("users-link");
let leaving = new AbortController();
let locked = false;

async function show({ focus }) {
  if (locked) return;
  leaving.abort();
  leaving = new AbortController();
  const { signal } = leaving;
  const [path, query] = (location.hash.slice(1) || "/").split("?", 2);
  markCurrent(path);
  preferRig(null);
  try {
    const [view, parts] = match(path);
    await view({ root, parts, query: new URLSearchParams(query), signal });
  } catch (error) {
    if (signal.aborted) return;
    fill(root, h("h1", {}, "This page cannot be shown"), h("p", { class: "error", role: "alert" }, error.message));
    if (error.status === 0)
      window.addEventListener("calrig:back", () => show({ focus: false }), { once: true, signal });
    else if (error.status === undefined) throw error; // a fault of this page: its trace stays visible
  }
  if (signal.aborted) return;
  const title = root.querySelector("h1");
  document.title = title ? `${title.textContent} · calrig` : "calrig";
  // A view that is already in use while it loads keeps the focus.
  if (focus && !root.contains(document.activeElement)) root.focus({ preventScroll: true });
}

function match(path) {
  for (const [pattern, view] of ROUTES) {
    const found = pattern.exec(path);
    if (found) return [view, found.slice(1).map((part) => part && decoded(part))];
  }
  throw Object.assign(new Error(`There is no page ${path}.`), { status: 404 });
}

function decoded(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return part; // typed by hand, with a bare %
  }
}

function markCurrent(path) {
  for (const link of document.querySelectorAll(".top nav a")) {
    const target = link.getAttribute("href").slice(1);
    const here = target === "/" ? path === "/" || path.startsWith("/runs") : path.startsWith(target);
    if (here) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
}

window.addEventListener("hashchange", () => {
  if (!location.hash || location.hash.startsWith("#/")) {
    window.scrollTo(0, 0);
    show({ focus: true });
  }
});
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault(); // the hash is the router's
  root.focus();
});

/** Shows the login if it is needed, else the view of the address. */
async function begin() {
  try {
    const login = await loginState();
    if (login.needed && !login.logged_in) return lock();
    iAm(login);
    leave.hidden = !login.session;
    name.textContent = login.name ? visible(`${login.name} (${login.role})`) : "";
    users.hidden = !may("admin");
  } catch (error) {
    if (error.status === undefined) throw error; // the view below and the banner report it
  }
  stop.hidden = false;
  watchRigs();
  show({ focus: false });
}

/** Shows the login in place of the view, at the start or after a session has expired. */
function lock() {
  if (locked) return;
  locked = true;
  leaving.abort();
  stop.hidden = true;
  leave.hidden = true;
  name.textContent = "";
  users.hidden = true;
  document.title = "Log in · calrig";
  loginView(root, () => {
    locked = false;
    begin();
  });
}

window.addEventListener("calrig:login", lock);
leave.addEventListener("click", async () => {
  await logOut();
  lock();
});
document.getElementById("zone").textContent = `Times are in ${timeZone()}.`;
watchHealth(document.getElementById("banner"));
onRigs((rigs) => (benches.hidden = !rigs.some(({ bench }) => bench)));
stopButtons(stop, document.getElementById("stop-line"));
begin();
