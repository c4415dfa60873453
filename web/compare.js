// Units side by side: figures with their errors, over time, residuals overlaid, and what the spread means.

import { get } from "./api.js";
import { Chart } from "./charts.js";
import { fill, h, headings, runLink, suspectTag, tableBox, unitLink } from "./dom.js";
import { isKnown, moment, plural, plusMinus, range, significant } from "./format.js";

const CHARTS = [
  ["residuals", "Calibrated residual of each unit's latest run"],
  ["bias", "Bias over time"],
  ["scale", "Scale over time"],
  ["rms", "RMS error, calibrated, over time"],
];

const COLOURS = 8;
const NONE_COUNT = "No completed calibration that counts: nothing is drawn of other runs, or of voided ones.";

export async function compareView({ root, query, signal }) {
  const picked = query.getAll("unit");
  const all = query.has("all");
  const units = await get("/api/units", signal);
  const heading = h("h1", {}, "Compare units");
  if (!picked.length && !all) return fill(root, heading, picker(units, picked));
  const asked = new URLSearchParams(picked.map((serial) => ["unit", serial]));
  const comparison = await get(`/api/compare?${asked}`, signal);
  const charts = CHARTS.map(([name, title]) => [name, new Chart(`compare-${name}`, title, { signal, empty: NONE_COUNT })]);
  const draw = (chosen) => {
    const wanted = new URLSearchParams([...asked, ...chosen.map((serial) => ["chosen", serial])]);
    return Promise.all(charts.map(([name, chart]) => chart.load(`/api/compare/figures/${name}?${wanted}`)));
  };
  fill(
    root,
    heading,
    picker(units, picked),
    summary(comparison, draw),
    h(
      "div",
      { class: "charts" },
      charts.map(([, chart]) => chart.element),
    ),
    everyRun(comparison.units),
  );
  await draw([]);
}

function picker(units, chosen) {
  if (!units.length)
    return h("p", { class: "card muted" }, "No unit yet: a unit appears with its first run.");
  const boxes = units.map(({ serial }) =>
    h("input", { type: "checkbox", value: serial, checked: chosen.includes(serial) }),
  );
  const form = h(
    "form",
    { class: "card", id: "pick" },
    h(
      "fieldset",
      {},
      h("legend", {}, "Units"),
      h(
        "div",
        { class: "pick" },
        boxes.map((box) => h("label", {}, box, h("span", { class: "serial" }, box.value))),
      ),
    ),
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
    return h(
      "tr",
      { "data-unit": one.unit },
      h("th", { scope: "row" }, colours.get(one.unit), unitLink(one.unit), one.changed && h("span", { class: "tag warns" }, "changed")),
      largestChange(one),
      h("td", {}, one.due_at ? moment(one.due_at) : "–", one.overdue && h("span", { class: "tag warns" }, "overdue")),
      latest
        ? figureCells(latest)
        : h("td", { colspan: "6", class: "muted" }, "no completed run that counts"),
      h("td", { class: "number" }, one.runs.length.toLocaleString()),
      h("td", { class: "number" }, isKnown(one.drift_deg_per_day) ? significant(one.drift_deg_per_day, 2, "°/day") : "–"),
    );
  });
  return h(
    "section",
    { class: "card", "aria-labelledby": "compare-title" },
    h("h2", { id: "compare-title" }, "Each unit's latest run"),
    h("p", { id: "compare-changed" }, h("strong", {}, repeatability.says)),
    colours.size > 0 &&
      h(
        "p",
        { class: "muted" },
        `The charts have ${COLOURS} colours: tick the units that are to have one, all others are grey. Before you do, `,
        "the first of this table have them.",
      ),
    tableBox(
      "Units compared",
      h(
        "table",
        { id: "compare-table" },
        headings("Unit", "Change between runs", "Due", ...FIGURES, "#Runs", "#Bias drift"),
        h("tbody", {}, rows),
      ),
    ),
    h(
      "div",
      { class: "spread", "data-testid": "spread" },
      spreadOf("Bias", spread.bias_deg, "°", repeatability.bias_deg),
      spreadOf("Scale", spread.scale, "", repeatability.scale),
    ),
    h("p", { class: "muted", id: "compare-rule" }, repeatability.rule),
  );
}

/** What changed most from one run to the next, in full where it is more than repeatability. */
function largestChange({ change, changed }) {
  if (!change) return h("td", {}, "–");
  if (changed) return h("td", { class: "wrap" }, change.says);
  return h("td", { title: change.says }, change.verdict === "unchanged" ? "repeats" : "not known yet");
}

/** A box for each unit by serial; no more than there are colours can be ticked. */
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

const FIGURES = ["Finished", "#Bias", "#Scale", "#RMS error, raw", "#RMS error, calibrated", "#Temperature"];

function figureCells(run) {
  const number = (text) => h("td", { class: "number" }, text);
  return [
    h("td", {}, moment(run.finished_at)),
    number(plusMinus(run.bias_deg, run.bias_std_deg, "°")),
    number(plusMinus(run.scale, run.scale_std)),
    number(significant(run.rms_raw_deg, 3, "°")),
    number(significant(run.rms_calibrated_deg, 3, "°")),
    number(range(run.temperature_c?.min, run.temperature_c?.max, 1, "°C")),
  ];
}

function spreadOf(name, { between_units_std: between, within_unit_std: within, says }, unit, repeats) {
  return h(
    "div",
    {},
    h("h3", {}, `${name}: spread of the units and repeatability`),
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
        `Re-clamping adds ${significant(repeats.reclamping_std, 2, unit)}`,
        isKnown(repeats.day_std) && `, the day ${significant(repeats.day_std, 2, unit)}`,
        " (over all units).",
      ),
    h("p", { class: "muted" }, says),
  );
}

function everyRun(units) {
  const rows = units.flatMap(({ unit, runs }) =>
    runs
      .toReversed()
      .map((run) =>
        h(
          "tr",
          {},
          h("th", { scope: "row" }, unitLink(unit)),
          h("td", {}, runLink(run.run_id), suspectTag(run.suspect)),
          figureCells(run),
        ),
      ),
  );
  return h(
    "details",
    { class: "card" },
    h("summary", {}, `All ${plural(rows.length, "run")} that count`),
    tableBox("All runs", h("table", {}, headings("Unit", "Run", ...FIGURES), h("tbody", {}, rows))),
  );
}
