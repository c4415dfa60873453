// Noise and filter analysis of a run's samples or of a log file, which a form sends.

import { get, post, remove } from "./api.js";
import { confirmButton } from "./ask.js";
import { Chart } from "./charts.js";
import {
  bullets,
  card,
  dataTable,
  errorLine,
  field,
  fill,
  h,
  numberCell,
  onSubmit,
  runHref,
  runLink,
  select,
  serialInput,
  tableRow,
} from "./dom.js";
import { fixed, moment, NOT_KNOWN, significant } from "./format.js";
import { CANCELLED, LongWork } from "./longwork.js";
import { may } from "./me.js";

const STUDIES = "/api/log-studies";

/**
 * Without a run: a form for a file, one that records a log on a rig, and the files analysed; `#/noise?study=ID` shows
 * one of these. With a run: the analysis of its samples.
 */
export async function noiseView({ root, parts: [id], query, signal }) {
  if (id !== undefined) return ofRun(root, id, signal);
  if (query.has("study")) return ofStudy(root, query.get("study"), signal);
  const rigs = await get("/api/rigs", signal);
  const studies = h("div", {});
  const list = () => listStudies(studies, signal);
  const shown = h("div", { id: "noise-result", class: "run", "aria-live": "polite" });
  const found = (what, answer) => {
    fill(shown);
    if (answer) show(shown, answer, TABLES[what], signal);
    return answer && list();
  };
  const { form, resume } = logForm(found, signal);
  fill(root, h("h1", {}, "Noise and filters"), h("div", { class: "columns" }, form, rigForm(rigs)), shown, card("studies", "Files analysed", studies));
  resume();
  await list();
}

async function ofStudy(root, id, signal) {
  const path = `${STUDIES}/${encodeURIComponent(id)}`;
  const { study, noise, filters } = await get(path, signal);
  const shown = h("div", { id: "noise-result", class: "run" });
  const by = study.studied_by && ` by ${study.studied_by}`;
  const title = `Remove the analysis of ${study.file_name}?`;
  const question = { title, text: "It is deleted permanently.", action: "Remove" };
  const leave = () => (location.hash = "#/noise");
  const drop = confirmButton("Remove this analysis…", question, () => remove(path), leave, { id: "remove-study" });
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
    tableRow(h("a", { href: `#/noise?study=${encodeURIComponent(id)}` }, file), [KINDS[kind], moment(at), by ?? "–"]),
  );
  const table = dataTable("Files analysed", ["File", "Analysis", "When", "By"], rows, { id: "studies-table" });
  fill(place, rows.length ? table : h("p", { class: "muted" }, "None yet. Analyse a file above. Results are stored here, the files are not."));
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
    show(shown, await work.document(), TABLES[what], signal);
  } else if (!signal.aborted) fill(shown, h("p", { class: "muted" }, CANCELLED));
}

function rigForm(rigs) {
  const rig = select({ id: "rig" }, rigs.map(({ name }) => name));
  const unit = serialInput();
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
    field("unit", "Serial number", unit),
    h("div", { class: "fields two" }, field("rig", "Rig", rig), field("minutes", "Duration, min", minutes)),
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
  const charts = figures.map(({ caption }, k) => new Chart(`noise-${k}`, caption, { tall: true, signal }));
  fill(
    place,
    card("summary", "Summary", bullets(report.summary)),
    h("section", { class: "card" }, table(answer)),
    h("div", { class: "charts" }, charts.map(({ element }) => element)),
  );
  charts.forEach((chart, k) => chart.draw(figures[k].figure));
}

const TABLES = { noise: noiseTable, filters: filterTable };
const numbersRow = (head, values) => tableRow(head, values.map(numberCell));

function noiseTable({ report: { channels }, stated }) {
  const rows = Object.entries(channels).map(([name, channel]) =>
    numbersRow(name, [
      ...[channel.adf_slope, channel.psd_slope].map((slope) => fixed(slope, 2)),
      significant(channel.std, 3),
      ...[stated[name].white, stated[name].flicker].map((one) => one ?? NOT_KNOWN),
      channel.lines.map(({ frequency_hz }) => `${significant(frequency_hz, 3)}\u00a0Hz`).join(", ") || "none",
      channel.colour ?? NOT_KNOWN,
    ]),
  );
  const slopes = ["#Slope of Allan deviation", "#Slope of PSD"];
  const sizes = ["#Standard deviation", "#White noise, density", "#Bias instability"];
  const names = ["Channel", ...slopes, ...sizes, "#Spectral lines", "#Noise colour"];
  return dataTable("Noise by channel", names, rows, { id: "noise" });
}

function filterTable({ report: { filters } }) {
  const rows = filters.map((filter) =>
    numbersRow(filter.label, [
      fixed(filter.jitter_deg, 4, "°"),
      fixed(filter.lag_ms, 1, "ms"),
      fixed(filter.largest_offset_deg, 3, "°"),
      filter.causal ? "yes" : "no",
    ]),
  );
  const names = ["Filter", "#Jitter in 100 ms", "#Lag", "#Largest offset", "#Causal"];
  return dataTable("Filters", names, rows, { id: "filters" });
}

const ADDRESSES = { noise: "/api/noise", filters: "/api/filters" };
const WORDS = { doing: "The service reads the log and analyses it.", share: "it is done" };

/**
 * `found(what, answer)` is called with the analysis of a log, null while there is none. `resume()` continues what was
 * requested before the view was left.
 */
function logForm(found, signal) {
  const file = h("input", { id: "log", type: "file", accept: ".csv,text/csv", required: true });
  const choices = [
    ["noise", "noise (static log)"],
    ["filters", "filters (log with rest and rotation)"],
  ];
  const what = select({ id: "what" }, choices);
  const number = ([id, name]) => h("input", { id, name, type: "number", min: "0", step: "any", inputmode: "decimal" });
  const [rate, accel, gyro] = [
    ["rate", "rate_hz"],
    ["accel-range", "accel_range_g"],
    ["gyro-range", "gyro_range_dps"],
  ].map(number);
  const error = errorLine("noise-error");
  const work = new LongWork("log", WORDS, signal);
  const state = h("p", { id: "log-told", class: "muted", role: "status" });
  const submit = h("button", { id: "analyse", type: "submit", class: "primary" }, "Analyse");
  const form = h(
    "form",
    { class: "card start", "aria-labelledby": "file-title" },
    h("h2", { id: "file-title" }, "Analyse a log file"),
    field("log", "CSV file, one row per sample", file),
    h(
      "div",
      { class: "fields two" },
      field("what", "Analysis", what),
      field("rate", "Sample rate, Hz (if there is no time_s)", rate),
      field("accel-range", "Accelerometer full scale, g (raw counts)", accel),
      field("gyro-range", "Gyro full scale, °/s (raw counts)", gyro),
    ),
    work.element,
    error.element,
    h("div", { class: "buttons" }, submit, state),
  );

  async function carryOut(study, begun) {
    state.textContent = "";
    if (await begun) return found(study, await work.document());
    if (!signal.aborted) state.textContent = CANCELLED;
  }

  function send() {
    found(what.value, null);
    const body = new FormData();
    body.set("file", file.files[0]);
    for (const input of [rate, accel, gyro]) if (input.value) body.set(input.name, input.value);
    return carryOut(what.value, work.send(ADDRESSES[what.value], body));
  }

  function resume() {
    const study = Object.keys(ADDRESSES).find((name) => LongWork.isUnderWay(ADDRESSES[name]));
    if (study) work.resumeWith(ADDRESSES[study], submit, error, (begun) => carryOut(study, begun));
  }

  onSubmit(form, submit, error, send);
  return { form, resume };
}
