// A unit's history: due date, control chart, and changes from run to run.

import { get, serviceError } from "./api.js";
import { Chart } from "./charts.js";
import { attempt, card, dataTable, errorLine, fill, h, numberCell, runLink, statusPill } from "./dom.js";
import { fixed, isKnown, moment, plusMinus, significant } from "./format.js";
import { LongWork } from "./longwork.js";
import { may } from "./me.js";

const LEAST_P = 0.0001;
const SEARCH = { doing: "Diagnosing both runs together.", share: "the search" };

/** A card that loads itself, and again after two runs have been diagnosed together. */
export function unitHistory(serial, signal) {
  const path = `/api/units/${encodeURIComponent(serial)}`;
  const body = h("div");
  const error = errorLine("changes-error");
  const work = new LongWork("both", SEARCH, signal);
  const chart = new Chart("unit-chart", "Control chart: bias and scale since the unit last changed", { low: true, signal });
  const element = card("changes", "Changes between runs", error.element, work.element, body);

  async function read() {
    const [unit, changes] = await Promise.all([get(path, signal), get(`${path}/changes`, signal)]);
    const rows = changes.toReversed().map((change) => row(change, diagnoseBoth));
    const drawn = changes.some((change) => isKnown(change.signal));
    fill(
      body,
      due(unit),
      rows.length
        ? dataTable("Changes", HEADINGS, rows, { id: "changes-table" })
        : h("p", { class: "muted" }, "Changes are evaluated from two valid calibrations on."),
      drawn && chart.element,
    );
    if (drawn) await chart.load(`${path}/figures/chart`);
  }

  const say = (problem) => error.say(serviceError(problem, signal));

  function diagnoseBoth({ from, to }) {
    const address = `/api/runs/${encodeURIComponent(to)}/diagnosis`;
    return attempt(body.querySelectorAll("button"), error, async () => {
      if (await work.carryOut(address, { runs: [from] })) await read();
    });
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

const HEADINGS = ["From run", "To run", "Verdict", "Statement", "#Days", "#Bias", "#Scale", "#p"];
const WORDS = { changed: "changed", unchanged: "unchanged", not_known: "not known" };

function pValue(p) {
  if (!isKnown(p)) return "–";
  return p < LEAST_P ? `< ${LEAST_P}` : significant(p, 2);
}

function row(change, diagnoseBoth) {
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
    numberCell(fixed(change.days, change.days < 10 ? 1 : 0)),
    numberCell(plusMinus(change.bias_deg, change.bias_std_deg, "°")),
    numberCell(plusMinus(change.scale, change.scale_std)),
    numberCell(pValue(change.p_value)),
  );
}
