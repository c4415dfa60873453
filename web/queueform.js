// A new list: serials scanned, pasted or from a file; rigs, plan, operator and note stay for all of them.

import { get, post } from "./api.js";
import { errorLine, field, h, onSubmit } from "./dom.js";
import { plural } from "./format.js";
import { planForm } from "./plan.js";
import { asRead, readerTypesInto } from "./queuekeys.js";

const OPERATOR_KEY = "calrig.operator";
const UNITS_KEY = "calrig.queue-units"; // scanned and not sent yet: a reload and the way back keep them

/** Has a serial stand in the form of the next list, beside what does. */
export function keepForNext(serial) {
  sessionStorage.setItem(UNITS_KEY, [...lines(sessionStorage.getItem(UNITS_KEY) ?? ""), serial, ""].join("\n"));
}

/** `last` is the list made before, null without one: rigs and plan are those until somebody says otherwise. */
export async function listForm(last, signal) {
  const rigs = await get("/api/rigs", signal);
  const units = h("textarea", { id: "units", rows: "10", spellcheck: "false", autocomplete: "off" });
  units.value = sessionStorage.getItem(UNITS_KEY);
  const file = h("input", { id: "csv", type: "file", accept: ".csv,text/csv,text/plain" });
  const skipped = h("p", { id: "csv-says", class: "muted", role: "status", "aria-live": "polite" });
  const count = h("p", { id: "units-count", class: "muted", "aria-live": "polite" }, "Scan or paste: one a line.");
  const ticks = rigs.map(({ name }, k) => h("input", { type: "checkbox", name: "rigs", value: name, id: `rig-${name}`, checked: last ? last.rigs.some((rig) => rig.name === name) : k === 0 }));
  const operator = h("input", { id: "operator", type: "text", autocomplete: "name", value: localStorage.getItem(OPERATOR_KEY) });
  const note = h("input", { id: "note", type: "text", autocomplete: "off" });
  const failed = h(
    "select",
    { id: "failed" },
    h("option", { value: "end" }, "measure it once more at the end"),
    h("option", { value: "follow_up" }, "find out why, while it is mounted"),
  );
  const chosen = () => ticks.filter(({ checked }) => checked).map(({ value }) => value);
  const plan = planForm(() => ({ rig: chosen()[0] ?? null, unit: "" }), signal);
  if (last) failed.value = last.failed;
  if (["calibration", "sweep"].includes(last?.plan.kind)) plan.take(last.plan); // of no other kind has the form words
  const error = errorLine("queue-form-error");
  const make = h("button", { id: "make-list", type: "submit", class: "primary" }, "Begin the list");
  const form = h(
    "form",
    { class: "card start" },
    field("units", "Serial numbers, one a line", units),
    count,
    field("csv", "or from a CSV: its column “unit” or “serial”, else the first", file),
    skipped,
    h("fieldset", {}, h("legend", {}, "Rigs, side by side"), h("div", { class: "choice" }, ticks.map((tick) => h("label", { for: tick.id }, tick, tick.value)))),
    h("div", { class: "fields two" }, field("operator", "Operator (optional)", operator), field("note", "Note (optional)", note), field("failed", "A unit that fails", failed)),
    plan.designer,
    plan.element,
    error.element,
    h("div", { class: "buttons" }, make),
  );
  const counted = () => {
    sessionStorage.setItem(UNITS_KEY, units.value);
    const serials = lines(units.value);
    const different = new Set(serials).size;
    count.textContent = `${plural(different, "unit")}${different < serials.length ? ", some named twice: each has one turn" : ""}`;
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
      units.value = [...lines(units.value), ...serials, ""].join("\n"); // what is scanned next has a line of its own
      skipped.textContent = `${table.name}: ${plural(serials.length, "serial")} added above${empty ? `; ${plural(empty, "row")} without one left out` : ""}.`;
      counted();
    } catch (problem) {
      error.say(problem);
    }
    file.value = ""; // it has been read, and may be chosen again
  });
  onSubmit(form, make, error, async () => {
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
  });
  setTimeout(() => units.focus());
  return form;
}

/** A file as text: UTF-8 or UTF-16 by its mark, else what older spreadsheets write. */
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
