// A run's events: from the beginning on a new page, from the last one after a lost connection.

const TYPES = ["state", "progress", "pose", "reading", "move_mismatch"];
const RETRY_MS = 2000;

/**
 * Follows a run until `signal` aborts or `stop()` is called. `on[type](data)` is called once per event, by the sequence
 * number in `id:`, however often the connection breaks.
 *
 * A browser opens six connections to a service for all its tabs. A hidden tab closes its own, so that a stop request
 * always finds one.
 */
export function follow(runId, on, signal) {
  let source;
  let retry;
  let seen = 0;
  let over = false;

  function open() {
    if (over || document.hidden) return;
    source = new EventSource(`/api/runs/${encodeURIComponent(runId)}/events`);
    for (const type of TYPES) source.addEventListener(type, receive);
    source.addEventListener("error", mend);
  }

  function receive(event) {
    const seq = Number(event.lastEventId);
    if (seq <= seen) return;
    seen = seq;
    on[event.type](JSON.parse(event.data));
  }

  // The browser reconnects by itself after a cut, with Last-Event-ID; after a refusal it gives up.
  function mend() {
    if (signal.aborted) return;
    window.dispatchEvent(new Event("calrig:lost"));
    if (source.readyState !== EventSource.CLOSED) return;
    clearTimeout(retry);
    retry = setTimeout(open, RETRY_MS);
  }

  function reopen() {
    clearTimeout(retry);
    source?.close();
    open();
  }

  function stop() {
    over = true;
    reopen();
  }

  signal.addEventListener("abort", stop);
  document.addEventListener("visibilitychange", reopen, { signal });
  open();
  return { stop };
}
