// Which view is shown: one hash route each, one AbortSignal each, aborted when the person goes elsewhere.

import { fill, h } from "./dom.js";
import { watchHealth } from "./health.js";
import { startView } from "./start.js";
import { runView } from "./run.js";
import { unitsView, unitView } from "./units.js";
import { compareView } from "./compare.js";
import { importView } from "./import.js";
import { noiseView } from "./noise.js";

const ROUTES = [
  [/^\/$/, startView],
  [/^\/runs\/([^/]+)$/, runView],
  [/^\/units$/, unitsView],
  [/^\/units\/([^/]+)$/, unitView],
  [/^\/compare$/, compareView],
  [/^\/import$/, importView],
  [/^\/noise$/, noiseView],
  [/^\/noise\/([^/]+)$/, noiseView],
];

const root = document.getElementById("view");
let leaving = new AbortController();

async function show({ focus }) {
  leaving.abort();
  leaving = new AbortController();
  const { signal } = leaving;
  const [path, query] = (location.hash.slice(1) || "/").split("?", 2);
  markCurrent(path);
  try {
    const [view, parts] = match(path);
    await view({ root, parts, query: new URLSearchParams(query), signal });
  } catch (error) {
    if (signal.aborted) return;
    fill(root, h("h1", {}, "This cannot be shown"), h("p", { class: "error", role: "alert" }, error.message));
    if (error.status === 0)
      window.addEventListener("calrig:back", () => show({ focus: false }), { once: true, signal });
    else if (error.status === undefined) throw error; // a fault of this page's own: its trace stays visible
  }
  if (signal.aborted) return;
  const title = root.querySelector("h1");
  document.title = title ? `${title.textContent} · calrig` : "calrig";
  // Whoever has begun to use the view while it loaded keeps the focus.
  if (focus && !root.contains(document.activeElement)) root.focus({ preventScroll: true });
}

function match(path) {
  for (const [pattern, view] of ROUTES) {
    const found = pattern.exec(path);
    if (found) return [view, found.slice(1).map(decoded)];
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
watchHealth(document.getElementById("banner"));
show({ focus: false });
