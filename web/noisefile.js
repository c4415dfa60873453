// The form that sends a log file, with progress and cancellation.

import { errorLine, field, h, onSubmit, select } from "./dom.js";
import { CANCELLED, LongWork } from "./longwork.js";

const ADDRESSES = { noise: "/api/noise", filters: "/api/filters" };
const WORDS = { doing: "The service reads the log and analyses it.", share: "it is done" };

/**
 * `found(what, answer)` is called with the analysis of a log, null while there is none. `resume()` continues what was
 * requested before the view was left.
 */
export function logForm(found, signal) {
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
