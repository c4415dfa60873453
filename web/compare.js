// Units side by side: figures with their errors, over time, residuals overlaid, and what the spread means.

import { get } from "./api.js";
import { Chart } from "./charts.js";
import { fill, h, headings, runHref, tableBox, unitLink } from "./dom.js";
import { isKnown, moment, plural, plusMinus, range, significant } from "./format.js";

const CHARTS = [
  ["residuals", "Calibrated residual of each unit's latest run"],
  ["bias", "Bias over time"],
  ["scale", "Scale over time"],
  ["rms", "RMS error, calibrated, over time"],
];

export async function compareView({ root, query, signal }) {
  const chosen = query.getAll("unit");
  const units = await get("/api/units", signal);
  const heading = h("h1", {}, "Compare units");
  if (!chosen.length) return fill(root, heading, picker(units, chosen));
  const asked = new URLSearchParams(chosen.map((serial) => ["unit", serial]));
  const comparison = await get(`/api/compare?${asked}`, signal);
  const charts = CHARTS.map(([name, title]) => [name, new Chart(`compare-${name}`, title, { signal })]);
  fill(
    root,
    heading,
    picker(units, chosen),
    summary(comparison),
    h(
      "div",
      { class: "charts" },
      charts.map(([, chart]) => chart.element),
    ),
    everyRun(comparison.units),
  );
  await Promise.all(charts.map(([name, chart]) => chart.load(`/api/compare/figures/${name}?${asked}`)));
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
    h("div", { class: "buttons" }, h("button", { type: "submit", class: "primary" }, "Compare")),
  );
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const picked = boxes.filter((box) => box.checked).map((box) => `unit=${encodeURIComponent(box.value)}`);
    location.hash = picked.length ? `#/compare?${picked.join("&")}` : "#/compare";
  });
  return form;
}

function summary({ units, spread }) {
  const rows = units.map(({ unit, runs, drift_deg_per_day: drift }) => {
    const latest = runs.at(-1);
    return h(
      "tr",
      { "data-unit": unit },
      h("th", { scope: "row" }, unitLink(unit)),
      latest
        ? figureCells(latest)
        : h("td", { colspan: "6", class: "muted" }, "no completed run that counts"),
      h("td", { class: "number" }, runs.length.toLocaleString()),
      h("td", { class: "number" }, isKnown(drift) ? significant(drift, 2, "°/day") : "–"),
    );
  });
  return h(
    "section",
    { class: "card", "aria-labelledby": "compare-title" },
    h("h2", { id: "compare-title" }, "Each unit's latest run"),
    tableBox(
      "Units compared",
      h(
        "table",
        { id: "compare-table" },
        headings("Unit", ...FIGURES, "#Runs", "#Bias drift"),
        h("tbody", {}, rows),
      ),
    ),
    h(
      "div",
      { class: "spread", "data-testid": "spread" },
      spreadOf("Bias", spread.bias_deg, "°"),
      spreadOf("Scale", spread.scale, ""),
    ),
  );
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

function spreadOf(name, { between_units_std: between, within_unit_std: within, says }, unit) {
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
          h("td", {}, h("a", { href: runHref(run.run_id) }, run.run_id)),
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
