// Units compared: figures with standard errors, trends, residuals, and the spread against repeatability.

import { get } from "./api.js";
import { Chart, NONE_VALID } from "./charts.js";
import { card, dataTable, fill, h, NO_UNITS, numberCell, runLink, suspectTag, tableRow, unitLink } from "./dom.js";
import { correctionTitles, knowEffects } from "./effects.js";
import { day, isKnown, moment, plusMinus, range, significant } from "./format.js";
import { verdictWords } from "./runfilters.js";

const CHARTS = [
  ["residuals", "Residual of each unit's latest run, plain fit"],
  ["bias", "Bias over time, plain fit"],
  ["scale", "Scale over time, plain fit"],
  ["rms", "RMS error over time, plain fit"],
];

const COLOURS = 8;
const COLOUR_HINT =
  `Tick up to ${COLOURS} units to colour them in the charts; the others are grey. Without ticks the first ${COLOURS} ` +
  "of this table are coloured.";

export async function compareView({ root, query, signal }) {
  const picked = query.getAll("unit");
  const all = query.has("all");
  const units = await get("/api/units", signal);
  const heading = h("h1", {}, "Compare units");
  if (!picked.length && !all) return fill(root, heading, picker(units, picked));
  const asked = new URLSearchParams(picked.map((serial) => ["unit", serial]));
  const [comparison] = await Promise.all([get(`/api/compare?${asked}`, signal), knowEffects()]);
  const charts = CHARTS.map(([name, title]) => [name, new Chart(`compare-${name}`, title, { signal, empty: NONE_VALID })]);
  const draw = (chosen) => {
    const wanted = new URLSearchParams([...asked, ...chosen.map((serial) => ["chosen", serial])]);
    return Promise.all(charts.map(([name, chart]) => chart.load(`/api/compare/figures/${name}?${wanted}`)));
  };
  fill(
    root,
    heading,
    picker(units, picked),
    summary(comparison, draw),
    h("div", { class: "charts" }, charts.map(([, chart]) => chart.element)),
    everyRun(comparison.units),
  );
  await draw([]);
}

function picker(units, chosen) {
  if (!units.length) return h("p", { class: "card muted" }, NO_UNITS);
  const boxes = units.map(({ serial }) => h("input", { type: "checkbox", value: serial, checked: chosen.includes(serial) }));
  const labels = boxes.map((box) => h("label", {}, box, h("span", { class: "serial" }, box.value)));
  const form = h(
    "form",
    { class: "card", id: "pick" },
    h("fieldset", {}, h("legend", {}, "Units"), h("div", { class: "pick" }, labels)),
    h(
      "div",
      { class: "buttons" },
      h("button", { type: "submit", class: "primary" }, "Compare"),
      units.length > 1 && h("a", { href: "#/compare?all" }, "Compare all"),
    ),
  );
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const picked = boxes.filter((box) => box.checked).map((box) => `unit=${encodeURIComponent(box.value)}`);
    location.hash = picked.length ? `#/compare?${picked.join("&")}` : "#/compare";
  });
  return form;
}

function summary({ units, spread, repeatability }, draw) {
  const sorted = units.toSorted((a, b) => b.changed - a.changed || (a.p_value ?? 2) - (b.p_value ?? 2));
  const colours = units.length > COLOURS ? colourBoxes(sorted, draw) : new Map();
  const rows = sorted.map((one) => {
    const latest = one.runs.at(-1);
    return tableRow(
      [colours.get(one.unit), unitLink(one.unit), one.changed && tag("changed")],
      [
        largestChange(one),
        [day(one.due_at), one.overdue && tag("overdue")],
        ...(one.in_force ? inForceCells(one.in_force) : [h("td", { colspan: "5", class: "muted" }, "none in force")]),
        ...(latest ? runCells(latest) : [h("td", { colspan: "2", class: "muted" }, "no valid completed run")]),
        numberCell(one.runs.length.toLocaleString()),
        numberCell(isKnown(one.drift_deg_per_day) ? significant(one.drift_deg_per_day, 2, "°/day") : "–"),
      ],
      { "data-unit": one.unit },
    );
  });
  return card(
    "compare",
    "Calibration in force of each unit",
    h("p", { id: "compare-changed" }, h("strong", {}, repeatability.says)),
    colours.size > 0 && h("p", { class: "muted" }, COLOUR_HINT),
    dataTable("Units compared", ["Unit", "Change between runs", "Due", ...IN_FORCE, ...OF_RUN, "#Runs", "#Bias drift"], rows, {
      id: "compare-table",
      class: "dense",
    }),
    h(
      "div",
      { class: "spread", "data-testid": "spread" },
      spreadOf("Bias", spread.bias_deg, "°", repeatability.bias_deg),
      spreadOf("Scale", spread.scale, "", repeatability.scale),
    ),
    h("p", { class: "muted", id: "compare-rule" }, repeatability.rule),
  );
}

const tag = (text) => h("span", { class: "tag warns" }, text);

/** The largest change between successive runs, in full if it exceeds repeatability. */
function largestChange({ change, changed }) {
  if (!change) return "not known yet";
  if (changed) return h("td", { class: "wrap" }, change.says);
  return h("td", { title: change.says }, change.verdict === "unchanged" ? "unchanged" : "not known yet");
}

/** A checkbox for each unit, by serial; at most as many as there are colours can be ticked. */
function colourBoxes(units, draw) {
  const boxes = units.map(({ unit }) =>
    h("input", { type: "checkbox", value: unit, "aria-label": `${unit} in colour`, class: "colour" }),
  );
  const choose = () => {
    const ticked = boxes.filter((box) => box.checked);
    for (const box of boxes) box.disabled = ticked.length >= COLOURS && !box.checked;
    draw(ticked.map((box) => box.value));
  };
  for (const box of boxes) box.addEventListener("change", choose);
  return new Map(boxes.map((box) => [box.value, box]));
}

const IN_FORCE = ["#Revision in force", "Verdict", "#Bias", "#Scale", "#RMS error, calibrated"];

function inForceCells(one) {
  return [
    h("td", { title: correctionTitles(one.effects).join(", ") || "no effects" }, one.revision),
    h("td", {}, verdictWords(one)),
    numberCell(isKnown(one.bias_deg) ? plusMinus(one.bias_deg, one.bias_std_deg, "°") : "–"),
    numberCell(plusMinus(one.scale, one.scale_std)),
    numberCell(significant(one.rms_deg, 3, "°")),
  ];
}

const OF_RUN = ["Latest run", "#RMS error, raw"];

function runCells(run) {
  return [
    h("td", {}, day(run.finished_at)),
    numberCell(significant(run.rms_raw_deg, 3, "°")),
  ];
}

const FIGURES = ["Finished", "#Bias, plain fit", "#Scale, plain fit", "#RMS error, raw", "#RMS error, plain fit", "#Temperature"];

function figureCells(run) {
  return [
    h("td", {}, moment(run.finished_at)),
    numberCell(plusMinus(run.bias_deg, run.bias_std_deg, "°")),
    numberCell(plusMinus(run.scale, run.scale_std)),
    numberCell(significant(run.rms_raw_deg, 3, "°")),
    numberCell(significant(run.rms_calibrated_deg, 3, "°")),
    numberCell(range(run.temperature_c?.min, run.temperature_c?.max, 1, "°C")),
  ];
}

const NEGLIGIBLE = 0.1; // of the larger other component: below it, a component adds less than 0.5 % to the total

function spreadOf(name, { between_units_std: between, within_unit_std: within, says }, unit, repeats) {
  const others = Math.max(repeats?.day_std ?? 0, within ?? 0);
  const isNegligible = repeats && repeats.reclamping_std < NEGLIGIBLE * others;
  const remounting = isNegligible ? "negligible" : significant(repeats?.reclamping_std, 2, unit);
  return h(
    "div",
    {},
    h("h3", {}, `${name}: spread and repeatability`),
    h(
      "p",
      {},
      `Standard deviation between units ${significant(between, 2, unit)}, `,
      `repeatability within one unit ${significant(within, 2, unit)}.`,
    ),
    repeats &&
      h(
        "p",
        {},
        `Remounting: ${remounting}`,
        isKnown(repeats.day_std) && `; day to day: ${significant(repeats.day_std, 2, unit)}`,
        " (over all units).",
      ),
    h("p", { class: "muted" }, says),
  );
}

function everyRun(units) {
  const row = (unit, run) => tableRow(unitLink(unit), [[runLink(run.run_id), suspectTag(run.suspect)], ...figureCells(run)]);
  const rows = units.flatMap(({ unit, runs }) => runs.toReversed().map((run) => row(unit, run)));
  return h(
    "details",
    { class: "card" },
    h("summary", {}, `Valid runs (${rows.length})`),
    dataTable("All runs", ["Unit", "Run", ...FIGURES], rows),
  );
}
