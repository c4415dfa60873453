// The rigs and what they are doing, looked at every few seconds for all who show them.

import { get } from "./api.js";

const REFRESH_MS = 3000;

const listeners = new Set();
let latest = null;
let timer;

/** Calls `listener(rigs)` with what is known and whenever it has changed, until `signal` aborts. */
export function onRigs(listener, signal) {
  listeners.add(listener);
  signal?.addEventListener("abort", () => listeners.delete(listener));
  if (latest) listener(latest);
}

/** Looks at once, then every few seconds while the page is seen, until the next login. */
export async function watchRigs() {
  clearTimeout(timer);
  try {
    if (!document.hidden || !latest) await look();
  } catch (error) {
    if (error.status === undefined) throw error; // the banner or the login tells the rest
    if (error.status === 401) return;
  }
  clearTimeout(timer);
  timer = setTimeout(watchRigs, REFRESH_MS);
}

/** Somebody has looked already: nobody needs to for a while. */
export function rigsAre(rigs) {
  clearTimeout(timer);
  timer = setTimeout(watchRigs, REFRESH_MS);
  take(rigs);
}

/** What tells whether rigs have changed: that their bench was seen again is no news. */
export function standing(rigs) {
  return JSON.stringify(rigs.map((rig) => ({ ...rig, last_seen_at: null })));
}

async function look() {
  take(await get("/api/rigs"));
}

function take(rigs) {
  if (latest && standing(rigs) === standing(latest)) return;
  latest = rigs;
  for (const listener of listeners) listener(rigs);
}
