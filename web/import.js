// Imports a CSV file of poses measured elsewhere as a run.

import { get } from "./api.js";
import { card, errorLine, field, fill, h, onSubmit, runHref, select, serialInput } from "./dom.js";
import { CANCELLED, LongWork } from "./longwork.js";

const ADDRESS = "/api/imports";
const WORDS = { doing: "The service reads the file and fits its poses.", share: "it is done" };
const KINDS = [
  ["", "as stated, else harmonic"],
  ["setting", "each pose anew"],
  ["harmonic", "smooth error of the rotation"],
  ["common", "common to all poses"],
];
const REFERENCE_HINT =
  "Standard uncertainty (k = 1) of the reference angles. Default: that of the file, else of the rig. Without it, U is unknown.";

export async function importView({ root, signal }) {
  const rigs = await get("/api/rigs", signal);
  const file = h("input", {
    id: "file",
    type: "file",
    accept: ".csv,text/csv",
    required: true,
    "aria-describedby": "import-help",
  });
  const unit = serialInput();
  const rig = select({ id: "rig" }, [["", "no rig of this service"], ...rigs.map(({ name }) => name)]);
  const std = h("input", { id: "reference-std", type: "number", min: "0", step: "any", "aria-describedby": "reference-hint" });
  const kind = select({ id: "reference-kind" }, KINDS);
  const certificate = h("input", { id: "reference-certificate", maxlength: "100" });
  const error = errorLine("import-error");
  const work = new LongWork("import", WORDS, signal);
  const state = h("p", { id: "import-told", class: "muted", role: "status" });
  const submit = h("button", { id: "import", type: "submit", class: "primary" }, "Import");
  const form = h(
    "form",
    { class: "card start" },
    field("file", "CSV file", file),
    h("div", { class: "fields two" }, field("unit", "Serial number", unit), field("rig", "Measured on rig", rig)),
    h(
      "div",
      { class: "fields two" },
      field("reference-std", "Reference uncertainty (°)", std),
      field("reference-kind", "Kind of reference error", kind),
    ),
    field("reference-certificate", "Reference certificate (number)", certificate),
    h("p", { class: "muted", id: "reference-hint" }, REFERENCE_HINT),
    work.element,
    error.element,
    h("div", { class: "buttons" }, submit, state),
  );
  const carryOut = async (begun) => {
    state.textContent = "";
    if (await begun) location.hash = runHref(work.resultId);
    else if (!signal.aborted) state.textContent = CANCELLED;
  };
  onSubmit(form, submit, error, () => {
    const body = new FormData();
    body.set("file", file.files[0]);
    body.set("unit", unit.value);
    if (rig.value) body.set("rig", rig.value);
    if (std.value) body.set("reference_std_deg", std.value);
    if (kind.value) body.set("reference_kind", kind.value);
    if (certificate.value) body.set("reference_certificate", certificate.value);
    return carryOut(work.send(ADDRESS, body));
  });
  for (const input of [file, unit, rig, std, kind, certificate]) input.addEventListener("input", () => error.say(null));
  fill(root, h("h1", {}, "Import measured poses"), form, help());
  work.resumeWith(ADDRESS, submit, error, carryOut);
}

const OPTIONAL = [
  "pass",
  "approach",
  "time_s",
  "temperature_c",
  "stage_deg",
  "reading_std_deg",
  "reading_stderr_deg",
  "n_samples",
  "accel_x_g",
  "reference_std_deg",
  "reference_kind",
];

function help() {
  const code = (text) => h("code", {}, text);
  const required = [code("target_deg"), " and ", code("reading_deg"), " are required."];
  const optional = OPTIONAL.map((name) => [code(name), ", "]);
  return card(
    "import-help",
    "File format",
    h("p", {}, "One row per pose, comma-separated, with a header row and decimal points. ", required),
    h("p", {}, "Optional: ", optional, "… Any other numeric column is stored as a covariate."),
    h("p", { class: "muted" }, "A file with an error is rejected as a whole, naming line and column."),
  );
}
