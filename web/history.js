// What a unit's runs tell together: when it is due, its control chart, what changed from run to run.

import { ApiError, get } from "./api.js";
import { Chart } from "./charts.js";
import { errorLine, fill, h, headings, held, runLink, statusPill, tableBox } from "./dom.js";
import { fixed, isKnown, moment, plusMinus, significant } from "./format.js";
import { LongWork } from "./longwork.js";
import { may } from "./me.js";

const LEAST_P = 0.0001;
const SEARCH = { doing: "Diagnosing both runs together.", share: "the search" };

/** A card that reads itself, and anew whenever two runs have been diagnosed together. */
export function unitHistory(serial, signal) {
  const path = `/api/units/${encodeURIComponent(serial)}`;
  const body = h("div");
  const error = errorLine("changes-error");
  const work = new LongWork("both", SEARCH, signal);
  const chart = new Chart("unit-chart", "Control chart: bias and scale since the unit last changed", { low: true, signal });
  const element = h(
    "section",
    { class: "card", id: "changes", "aria-labelledby": "changes-title" },
    h("h2", { id: "changes-title" }, "Changes between runs"),
    error.element,
    work.element,
    body,
  );

  async function read() {
    const [unit, changes] = await Promise.all([get(path, signal), get(`${path}/changes`, signal)]);
    const rows = changes.toReversed().map((change) => row(change, diagnoseBoth));
    const drawn = changes.some(({ signal: told }) => isKnown(told));
    fill(
      body,
      due(unit),
      rows.length
        ? tableBox("Changes", h("table", { id: "changes-table" }, HEADINGS(), h("tbody", {}, rows)))
        : h("p", { class: "muted" }, "Two calibrations that count are needed to tell what changed between them."),
      drawn && chart.element,
    );
    if (drawn) await chart.load(`${path}/figures/chart`);
  }

  async function diagnoseBoth({ from, to }) {
    const release = held(...body.querySelectorAll("button"));
    error.say(null);
    try {
      if (await work.carryOut(`/api/runs/${encodeURIComponent(to)}/diagnosis`, { runs: [from] })) await read();
    } catch (problem) {
      say(problem);
    } finally {
      release();
    }
  }

  function say(problem) {
    if (signal?.aborted) return;
    if (!(problem instanceof ApiError)) throw problem;
    error.say(problem);
  }

  read().catch(say);
  return element;
}

function due({ due_at: at, overdue, due_says: says }) {
  return h(
    "p",
    { id: "due" },
    h("strong", {}, "Due: "),
    at ? moment(at) : "not known",
    overdue && h("span", { class: "tag warns" }, "overdue"),
    `: ${says}`,
  );
}

const HEADINGS = () => headings("From run", "To run", "Verdict", "Statement", "#Days", "#Bias", "#Scale", "#p");
const WORDS = { changed: "changed", unchanged: "repeats", not_known: "not known" };

function pValue(p) {
  if (!isKnown(p)) return "–";
  return p < LEAST_P ? `< ${LEAST_P}` : significant(p, 2);
}

function row(change, diagnoseBoth) {
  const number = (text) => h("td", { class: "number" }, text);
  const link = (id) => h("td", {}, runLink(id));
  const untraced = change.verdict === "changed" && change.effects === null && may("operator");
  const button = untraced && h("button", { type: "button" }, "Diagnose both");
  if (button) button.addEventListener("click", () => diagnoseBoth(change));
  return h(
    "tr",
    { "data-to": change.to },
    link(change.from),
    link(change.to),
    h(
      "td",
      { class: "plain" },
      statusPill(WORDS[change.verdict]),
      change.signal && h("span", { class: "tag warns", title: "The control chart signals at this run." }, "chart"),
    ),
    h("td", { class: "wrap" }, change.says, button && h("div", { class: "buttons" }, button)),
    number(fixed(change.days, change.days < 10 ? 1 : 0)),
    number(plusMinus(change.bias_deg, change.bias_std_deg, "°")),
    number(plusMinus(change.scale, change.scale_std)),
    number(pValue(change.p_value)),
  );
}
