// What the list of runs is narrowed to. The address keeps it, for a reload, a link, and the way back.

import { field, h } from "./dom.js";
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
    ["noise", "only noise left"],
    ["more_than_noise", "more than noise left"],
  ],
};
const TYPING_MS = 250;

/** A verdict in as few words as it is sought by. */
export function verdictWords(verdict) {
  const said = verdict.answer === "no_limits" ? (verdict.left ?? verdict.answer) : verdict.answer;
  return CHOICES.verdict.find(([value]) => value === said)[1];
}

/** `element`, `asked()` as the API's query, `isAny()`; `changed()` is called when somebody wants others. */
export function runFilters(rigs, query, changed, signal) {
  const select = (id, key, choices) => {
    const known = choices.map((one) => (Array.isArray(one) ? one : [one, one]));
    const options = known.map(([value, text]) => h("option", { value, selected: value === query.get(key) }, text));
    return h("select", { id }, h("option", { value: "" }, "any"), options);
  };
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
    on: select("filter-rig", "on", rigs.map(({ name }) => name)),
    status: select("filter-status", "status", CHOICES.status),
    verdict: select("filter-verdict", "verdict", CHOICES.verdict),
    kind: select("filter-kind", "kind", CHOICES.kind),
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
  const said = () => Object.entries(inputs).flatMap(([key, { value }]) => (value.trim() ? [[key, value.trim()]] : []));

  /** In the address, beside what else is there, and without a step back for each letter. */
  function keep() {
    const [path, old] = (location.hash || "#/").split("?", 2);
    const all = new URLSearchParams(old);
    for (const key of Object.keys(inputs)) all.delete(key);
    for (const [key, value] of said()) all.set(key, value);
    history.replaceState(history.state, "", path + (all.size ? `?${all}` : ""));
  }

  function asked() {
    const found = Object.fromEntries(said());
    const { on: rig, from, to, ...rest } = found;
    return {
      ...rest,
      ...(rig && { rig }),
      ...(from && { from: dayStart(from) }),
      ...(to && { to: dayEnd(to) }),
    };
  }

  let timer;
  const element = h(
    "form",
    { class: "filters", role: "search", "aria-label": "Which runs are listed" },
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
  return { element, asked, isAny: () => said().length === 0 };
}
