// Polls the rigs and their states for all views that show them.

import { get } from "./api.js";

const REFRESH_MS = 3000;

const listeners = new Set();
let latest = null;
let timer;

/** Calls `listener(rigs)` with the latest rigs and after every change, until `signal` aborts. */
export function onRigs(listener, signal) {
  listeners.add(listener);
  signal?.addEventListener("abort", () => listeners.delete(listener));
  if (latest) listener(latest);
}

/** Polls at once, then periodically while the page is visible, until a login is needed. */
export async function watchRigs() {
  clearTimeout(timer);
  try {
    if (!document.hidden || !latest) take(await get("/api/rigs"));
  } catch (error) {
    if (error.status === undefined) throw error; // the banner or the login reports it
    if (error.status === 401) return;
  }
  clearTimeout(timer);
  timer = setTimeout(watchRigs, REFRESH_MS);
}

/** Takes rigs that a view has read, and delays the next poll. */
export function rigsAre(rigs) {
  clearTimeout(timer);
  timer = setTimeout(watchRigs, REFRESH_MS);
  take(rigs);
}

/** A key that changes with the rigs, but not with the time at which their bench was last seen. */
export function standing(rigs) {
  return JSON.stringify(rigs.map((rig) => ({ ...rig, last_seen_at: null })));
}

function take(rigs) {
  if (latest && standing(rigs) === standing(latest)) return;
  latest = rigs;
  for (const listener of listeners) listener(rigs);
}
