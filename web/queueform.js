// The form of a new batch: serial numbers, rigs, plan, operator and note.

import { get, post } from "./api.js";
import { errorLine, field, h, onSubmit, select } from "./dom.js";
import { plural } from "./format.js";
import { planForm } from "./plan.js";
import { asRead, readerTypesInto } from "./queuekeys.js";

const OPERATOR_KEY = "calrig.operator";
const UNITS_KEY = "calrig.queue-units"; // not sent yet: they survive a reload

/** Adds a serial number to the form of the next batch. */
export function keepForNext(serial) {
  sessionStorage.setItem(UNITS_KEY, [...lines(sessionStorage.getItem(UNITS_KEY) ?? ""), serial, ""].join("\n"));
}

/** `last` is the previous batch or null: its rigs and plan are the defaults. */
export async function listForm(last, signal) {
  const rigs = await get("/api/rigs", signal);
  const units = h("textarea", { id: "units", rows: "10", spellcheck: "false", autocomplete: "off" });
  units.value = sessionStorage.getItem(UNITS_KEY);
  const file = h("input", { id: "csv", type: "file", accept: ".csv,text/csv,text/plain" });
  const skipped = h("p", { id: "csv-says", class: "muted", role: "status", "aria-live": "polite" });
  const count = h("p", { id: "units-count", class: "muted", "aria-live": "polite" }, "Scan or paste, one per line.");
  const isUsed = (name, k) => (last ? last.rigs.some((rig) => rig.name === name) : k === 0);
  const ticks = rigs.map(({ name }, k) =>
    h("input", { type: "checkbox", name: "rigs", value: name, id: `rig-${name}`, checked: isUsed(name, k) }),
  );
  const operator = h("input", { id: "operator", type: "text", autocomplete: "name", value: localStorage.getItem(OPERATOR_KEY) });
  const note = h("input", { id: "note", type: "text", autocomplete: "off" });
  const ways = [
    ["end", "measure it again at the end"],
    ["follow_up", "diagnose it while it is mounted"],
  ];
  const failed = select({ id: "failed" }, ways, last?.failed);
  const chosen = () => ticks.filter(({ checked }) => checked).map(({ value }) => value);
  const plan = planForm(() => ({ rig: chosen()[0] ?? null, unit: "" }), signal);
  if (["calibration", "sweep"].includes(last?.plan.kind)) plan.take(last.plan); // the form has no other kinds
  const error = errorLine("queue-form-error");
  const make = h("button", { id: "make-list", type: "submit", class: "primary" }, "Start the batch");
  const labels = ticks.map((tick) => h("label", { for: tick.id }, tick, tick.value));
  const form = h(
    "form",
    { class: "card start" },
    field("units", "Serial numbers, one per line", units),
    count,
    field("csv", "or CSV file (column “unit” or “serial”, else the first)", file),
    skipped,
    h("fieldset", {}, h("legend", {}, "Rigs in parallel"), h("div", { class: "choice" }, labels)),
    field("failed", "If a unit fails", failed),
    plan.element,
    error.element,
    h("div", { class: "buttons" }, make),
    h(
      "details",
      {},
      h("summary", {}, "Operator, note"),
      h("div", { class: "fields two" }, field("operator", "Operator (optional)", operator), field("note", "Note (optional)", note)),
    ),
  );
  const counted = () => {
    sessionStorage.setItem(UNITS_KEY, units.value);
    const serials = lines(units.value);
    const different = new Set(serials).size;
    count.textContent = `${plural(different, "unit")}${different < serials.length ? "; duplicates are measured once" : ""}`;
  };
  if (units.value) counted();
  units.addEventListener("input", counted);
  readerTypesInto(units, signal);
  for (const tick of ticks) tick.addEventListener("change", () => plan.estimate());
  file.addEventListener("change", async () => {
    error.say(null);
    skipped.textContent = "";
    const [table] = file.files;
    if (!table) return;
    try {
      const { units: serials, left_out: empty } = await post("/api/batches/read", { csv: await text(table) }, signal);
      units.value = [...lines(units.value), ...serials, ""].join("\n"); // the next scan begins a new line
      const without = empty ? `; ${plural(empty, "row")} without one skipped` : "";
      skipped.textContent = `${table.name}: ${plural(serials.length, "serial number")} added above${without}.`;
      counted();
    } catch (problem) {
      error.say(problem);
    }
    file.value = ""; // so that it can be chosen again
  });
  const begin = async () => {
    localStorage.setItem(OPERATOR_KEY, operator.value);
    const { id } = await post("/api/batches", {
      units: lines(units.value),
      rigs: chosen(),
      plan: plan.value(),
      operator: operator.value || null,
      note: note.value || null,
      failed: failed.value,
    });
    sessionStorage.removeItem(UNITS_KEY);
    location.hash = `#/queue/${encodeURIComponent(id)}`;
  };
  onSubmit(form, make, error, () => plan.begin(begin));
  setTimeout(() => units.focus());
  return form;
}

/** Decodes a file: UTF-8, UTF-16 with a byte order mark, else Windows-1252 of older spreadsheets. */
async function text(file) {
  const bytes = await file.arrayBuffer();
  const [first, second] = new Uint8Array(bytes);
  if (first === 0xff && second === 0xfe) return new TextDecoder("utf-16le").decode(bytes);
  try {
    return new TextDecoder("utf-8", { fatal: true }).decode(bytes);
  } catch {
    return new TextDecoder("windows-1252").decode(bytes);
  }
}

function lines(text) {
  return text
    .split(/\r?\n/)
    .map(asRead)
    .filter(Boolean);
}
