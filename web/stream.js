// A run's events: replayed from the beginning on a fresh page, from where it was on a lost line.

const TYPES = ["state", "progress", "pose", "reading", "move_mismatch"];
const RETRY_MS = 2000;

/**
 * Follows a run until `signal` aborts or `stop()` is called. `on[type](data)` is called once an event,
 * however often the line breaks: the sequence number in `id:` tells what was there before.
 *
 * A browser grants a service six connections for all its tabs. A tab that nobody sees lets its own go, so that
 * many of them never keep a stop from getting through.
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
