// Noise and filters: of a log from anybody's sensor, or of a run's samples.

import { get, post, remove } from "./api.js";
import { askConfirmation } from "./ask.js";
import { Chart } from "./charts.js";
import { errorLine, field, fill, h, headings, onSubmit, runHref, runLink, tableBox } from "./dom.js";
import { NOT_KNOWN, fixed, isKnown, moment, significant } from "./format.js";
import { CANCELLED, LongWork } from "./longwork.js";
import { may } from "./me.js";
import { logForm } from "./noisefile.js";

const STUDIES = "/api/log-studies";

/**
 * Without a run: a form for a file, one that records a log on a rig, and the files that were analysed; one of those
 * by `#/noise?study=ID`. With a run: what its samples say.
 */
export async function noiseView({ root, parts: [id], query, signal }) {
  if (id !== undefined) return ofRun(root, id, signal);
  if (query.has("study")) return ofStudy(root, query.get("study"), signal);
  const rigs = await get("/api/rigs", signal);
  const studies = h("div", {});
  const title = h("h2", { id: "studies-title" }, "Files analysed");
  const kept = h("section", { class: "card", id: "studies", "aria-labelledby": "studies-title" }, title, studies);
  const list = () => listStudies(studies, signal);
  const shown = h("div", { id: "noise-result", class: "run", "aria-live": "polite" });
  const found = (what, answer) => {
    fill(shown);
    if (answer) show(shown, answer, TABLES[what], signal);
    return answer && list();
  };
  const { form, resume } = logForm(found, signal);
  fill(root, h("h1", {}, "Noise and filters"), h("div", { class: "columns" }, form, rigForm(rigs)), shown, kept);
  resume();
  await list();
}

async function ofStudy(root, id, signal) {
  const path = `${STUDIES}/${encodeURIComponent(id)}`;
  const { study, noise, filters } = await get(path, signal);
  const shown = h("div", { id: "noise-result", class: "run" });
  const by = study.studied_by && ` by ${study.studied_by}`;
  const drop = h("button", { type: "button", id: "remove-study" }, "Remove this analysis…");
  drop.addEventListener("click", async () => {
    const question = { title: `Remove the analysis of ${study.file_name}?`, text: "It is gone for good.", action: "Remove it" };
    if (await askConfirmation(question, () => remove(path))) location.hash = "#/noise";
  });
  fill(
    root,
    h("h1", {}, `${KINDS[study.kind]} of ${study.file_name}`),
    h("p", { class: "muted" }, "Analysed ", moment(study.created_at), by, ". ", h("a", { href: "#/noise" }, "All analyses")),
    shown,
    may("operator") && h("p", {}, drop),
  );
  show(shown, noise ?? filters, TABLES[study.kind], signal);
}

const KINDS = { noise: "Noise", filters: "Filters" };

async function listStudies(place, signal) {
  const studies = await get(STUDIES, signal);
  const rows = studies.map(({ id, kind, file_name: file, created_at: at, studied_by: by }) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, h("a", { href: `#/noise?study=${encodeURIComponent(id)}` }, file)),
      h("td", {}, KINDS[kind]),
      h("td", {}, moment(at)),
      h("td", {}, by ?? "–"),
    ),
  );
  fill(
    place,
    rows.length
      ? tableBox("Files analysed", h("table", { id: "studies-table" }, headings("File", "Analysis", "When", "By"), h("tbody", {}, rows)))
      : h("p", { class: "muted" }, "None yet: what is found in a file is kept here, the file itself is not."),
  );
  place.hidden = false; // empty, it has no name
}

async function ofRun(root, id, signal) {
  const path = `/api/runs/${encodeURIComponent(id)}`;
  const run = await get(path, signal);
  const shown = h("div", { id: "noise-result", class: "run" });
  const still = run.plan?.kind === "static";
  const heading = still ? `Noise of unit ${run.unit}` : `Filters on unit ${run.unit}`;
  const what = still ? "noise" : "filters";
  const work = new LongWork("study", { doing: "Computing.", share: "it is done" }, signal);
  fill(root, h("h1", {}, heading), h("p", {}, runLink(id, "Run ")), work.element, shown);
  if (await work.compute(`${path}/${what}`)) {
    show(shown, work.answer ?? (await get(work.result, signal)), TABLES[what], signal);
  } else if (!signal.aborted) fill(shown, h("p", { class: "muted" }, CANCELLED));
}

function rigForm(rigs) {
  const rig = h(
    "select",
    { id: "rig" },
    rigs.map(({ name }) => h("option", { value: name }, name)),
  );
  const unit = h("input", {
    id: "unit",
    type: "text",
    required: true,
    autocomplete: "off",
    spellcheck: "false",
  });
  const minutes = h("input", {
    id: "minutes",
    type: "number",
    min: "0.1",
    max: "1440",
    step: "any",
    value: "10",
    required: true,
  });
  const error = errorLine("static-error");
  const start = h("button", { id: "keep-log", type: "submit", class: "primary" }, "Record the log");
  const form = h(
    "form",
    { class: "card start", "aria-labelledby": "rig-title" },
    h("h2", { id: "rig-title" }, "Record a static log"),
    h("p", { class: "muted" }, "The stage does not move while the log is recorded."),
    field("unit", "Unit's serial number", unit),
    h(
      "div",
      { class: "fields two" },
      field("rig", "Rig", rig),
      field("minutes", "Duration, min", minutes),
    ),
    error.element,
    h("div", { class: "buttons" }, start),
  );
  onSubmit(form, start, error, async () => {
    const plan = { kind: "static", dwell_s: 60 * Number(minutes.value) };
    const run = await post("/api/runs", { rig: rig.value || null, unit: unit.value, plan });
    location.hash = runHref(run.id);
  });
  return form;
}

function show(place, answer, table, signal) {
  const { report, figures } = answer;
  const charts = figures.map(({ caption, figure }, k) => [
    new Chart(`noise-${k}`, caption, { tall: true, signal }),
    figure,
  ]);
  fill(
    place,
    h(
      "section",
      { class: "card", id: "summary", "aria-label": "Summary" },
      h("h2", {}, "Summary"),
      h(
        "ul",
        {},
        report.summary.map((sentence) => h("li", {}, sentence)),
      ),
    ),
    h("section", { class: "card" }, table(answer)),
    h(
      "div",
      { class: "charts" },
      charts.map(([chart]) => chart.element),
    ),
  );
  for (const [chart, figure] of charts) chart.draw(figure);
}

const TABLES = { noise: noiseTable, filters: filterTable };
const told = (value, words) => (isKnown(value) ? words(value) : NOT_KNOWN);
const cell = (text) => h("td", { class: "number" }, text);

function noiseTable({ report: { channels }, stated }) {
  const rows = Object.entries(channels).map(([name, channel]) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, name),
      [channel.adf_slope, channel.psd_slope].map((slope) => cell(told(slope, (value) => fixed(value, 2)))),
      cell(significant(channel.std, 3)),
      [stated[name].white, stated[name].flicker].map((one) => cell(one ?? NOT_KNOWN)),
      cell(channel.lines.map(({ frequency_hz }) => `${significant(frequency_hz, 3)}\u00a0Hz`).join(", ") || "none"),
      cell(told(channel.colour, String)),
    ),
  );
  const names = [
    "Channel",
    "#Slope of Allan deviation",
    "#Slope of PSD",
    "#Standard deviation",
    "#White noise, density",
    "#Bias instability",
    "#Spectral lines",
    "#Noise colour",
  ];
  return tableBox("Noise by channel", h("table", { id: "noise" }, headings(...names), h("tbody", {}, rows)));
}

function filterTable({ report: { filters } }) {
  const rows = filters.map((filter) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, filter.label),
      cell(told(filter.jitter_deg, (value) => fixed(value, 4, "°"))),
      cell(told(filter.lag_ms, (value) => fixed(value, 1, "ms"))),
      cell(told(filter.largest_offset_deg, (value) => fixed(value, 3, "°"))),
      cell(filter.causal ? "yes" : "no"),
    ),
  );
  const names = ["Filter", "#Jitter in 100 ms", "#Lag", "#Largest offset", "#Causal"];
  return tableBox("Filters", h("table", { id: "filters" }, headings(...names), h("tbody", {}, rows)));
}
