// Filters of the list of runs. The address stores them, for reload, links and history.

import { field, h, select } from "./dom.js";
import { dayEnd, dayStart } from "./format.js";

const CHOICES = {
  status: ["queued", "running", "paused", "completed", "failed", "aborted", "interrupted"],
  kind: ["calibration", "sweep", "verification", "static", "follow-up", "import"],
  verdict: [
    ["pass", "pass"],
    ["conditional_pass", "conditional pass"],
    ["conditional_fail", "conditional fail"],
    ["fail", "fail"],
    ["undecided", "undecided"],
    ["no_limits", "no limits"],
    ["noise", "residual within noise"],
    ["more_than_noise", "residual above noise"],
  ],
};
const TYPING_MS = 250;

/** A verdict in the words of the filter. */
export function verdictWords(verdict) {
  const key = verdict.answer === "no_limits" ? (verdict.left ?? verdict.answer) : verdict.answer;
  return CHOICES.verdict.find(([value]) => value === key)[1];
}

/** `element`, `asked()` as the API's query, `isAny()`; `changed()` is called when a filter changes. */
export function runFilters(rigs, query, changed, signal) {
  const choice = (id, key, options) => select({ id }, [["", "any"], ...options], query.get(key));
  const day = (id, key) => h("input", { id, type: "date", value: query.get(key) });
  const text = h("input", {
    id: "filter-text",
    type: "search",
    autocomplete: "off",
    spellcheck: "false",
    maxlength: "200",
    placeholder: "any",
    value: query.get("q"),
  });
  const inputs = {
    q: text,
    on: choice("filter-rig", "on", rigs.map(({ name }) => name)),
    status: choice("filter-status", "status", CHOICES.status),
    verdict: choice("filter-verdict", "verdict", CHOICES.verdict),
    kind: choice("filter-kind", "kind", CHOICES.kind),
    from: day("filter-from", "from"),
    to: day("filter-to", "to"),
  };
  const titles = {
    q: "Part of a serial number or note",
    on: "Rig",
    status: "Status",
    verdict: "Verdict",
    kind: "Kind",
    from: "From",
    to: "To",
  };
  const values = () => Object.entries(inputs).flatMap(([key, { value }]) => (value.trim() ? [[key, value.trim()]] : []));

  /** Stores the filters in the address, without a history entry for each letter. */
  function keep() {
    const [path, old] = (location.hash || "#/").split("?", 2);
    const all = new URLSearchParams(old);
    for (const key of Object.keys(inputs)) all.delete(key);
    for (const [key, value] of values()) all.set(key, value);
    history.replaceState(history.state, "", path + (all.size ? `?${all}` : ""));
  }

  function asked() {
    const { on: rig, from, to, ...rest } = Object.fromEntries(values());
    return { ...rest, ...(rig && { rig }), ...(from && { from: dayStart(from) }), ...(to && { to: dayEnd(to) }) };
  }

  let timer;
  const element = h(
    "form",
    { class: "filters", role: "search", "aria-label": "Filter runs" },
    Object.entries(inputs).map(([key, input]) => field(input.id, titles[key], input)),
  );
  element.addEventListener("submit", (event) => event.preventDefault());
  element.addEventListener("input", ({ target }) => {
    clearTimeout(timer);
    keep();
    if (target === text) timer = setTimeout(changed, TYPING_MS);
    else changed();
  });
  signal.addEventListener("abort", () => clearTimeout(timer));
  return { element, asked, isAny: () => values().length === 0 };
}
