// Filters of the list of runs. The address stores them, for reload, links and history.

import { h } from "./dom.js";
import { choice, filterForm, searchField } from "./filters.js";
import { dayEnd, dayStart } from "./format.js";

/** Verdicts as filters name them, and their words. */
export const VERDICTS = [
  ["pass", "pass"],
  ["conditional_pass", "conditional pass"],
  ["conditional_fail", "conditional fail"],
  ["fail", "fail"],
  ["undecided", "undecided"],
  ["no_limits", "no limits"],
  ["noise", "residual within noise"],
  ["more_than_noise", "residual above noise"],
];
const CHOICES = {
  status: ["queued", "running", "paused", "completed", "failed", "aborted", "interrupted"],
  kind: ["calibration", "sweep", "verification", "static", "follow-up", "import"],
  verdict: VERDICTS,
};

/** A verdict in the words of the filter. */
export function verdictWords(verdict) {
  const key = verdict.answer === "no_limits" ? (verdict.left ?? verdict.answer) : verdict.answer;
  return VERDICTS.find(([value]) => value === key)[1];
}

/** `element`, `asked()` as the API's query, `isAny()`; `changed()` is called when a filter changes. */
export function runFilters(rigs, query, changed, signal) {
  const day = (id, key) => h("input", { id, type: "date", value: query.get(key) });
  const inputs = {
    q: ["Part of a serial number or note", searchField("filter-text", query.get("q"))],
    on: ["Rig", choice("filter-rig", rigs.map(({ name }) => name), query.get("on"))],
    status: ["Status", choice("filter-status", CHOICES.status, query.get("status"))],
    verdict: ["Verdict", choice("filter-verdict", CHOICES.verdict, query.get("verdict"))],
    kind: ["Kind", choice("filter-kind", CHOICES.kind, query.get("kind"))],
    from: ["From", day("filter-from", "from")],
    to: ["To", day("filter-to", "to")],
  };
  const { element, values } = filterForm("Filter runs", inputs, changed, signal);

  function asked() {
    const { on: rig, from, to, ...rest } = values();
    return { ...rest, ...(rig && { rig }), ...(from && { from: dayStart(from) }), ...(to && { to: dayEnd(to) }) };
  }

  return { element, asked, isAny: () => Object.keys(values()).length === 0 };
}
