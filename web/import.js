// A CSV of poses measured elsewhere becomes a run.

import { get } from "./api.js";
import { errorLine, field, fill, h, onSubmit, runHref } from "./dom.js";
import { CANCELLED, LongWork } from "./longwork.js";

const ADDRESS = "/api/imports";
const WORDS = { doing: "The service reads the file and fits its poses.", share: "it is done" };

export async function importView({ root, signal }) {
  const rigs = await get("/api/rigs", signal);
  const file = h("input", {
    id: "file",
    type: "file",
    accept: ".csv,text/csv",
    required: true,
    "aria-describedby": "import-help",
  });
  const unit = h("input", {
    id: "unit",
    type: "text",
    required: true,
    autocomplete: "off",
    spellcheck: "false",
  });
  const rig = h(
    "select",
    { id: "rig" },
    h("option", { value: "" }, "not on a rig of this service"),
    rigs.map(({ name }) => h("option", { value: name }, name)),
  );
  const error = errorLine("import-error");
  const work = new LongWork("import", WORDS, signal);
  const told = h("p", { id: "import-told", class: "muted", role: "status" });
  const submit = h("button", { id: "import", type: "submit", class: "primary" }, "Import");
  const form = h(
    "form",
    { class: "card start" },
    field("file", "CSV file", file),
    h(
      "div",
      { class: "fields two" },
      field("unit", "Unit's serial number", unit),
      field("rig", "Measured on rig", rig),
    ),
    work.element,
    error.element,
    h("div", { class: "buttons" }, submit, told),
  );
  const carryOut = async (begun) => {
    told.textContent = "";
    if (await begun) location.hash = runHref(work.answer?.id ?? work.result.split("/").at(-1));
    else if (!signal.aborted) told.textContent = CANCELLED;
  };
  onSubmit(form, submit, error, () => {
    const body = new FormData();
    body.set("file", file.files[0]);
    body.set("unit", unit.value);
    if (rig.value) body.set("rig", rig.value);
    return carryOut(work.send(ADDRESS, body));
  });
  for (const input of [file, unit, rig]) input.addEventListener("input", () => error.say(null));
  fill(root, h("h1", {}, "Import measured poses"), form, help());
  if (!LongWork.isUnderWay(ADDRESS)) return;
  submit.disabled = true;
  carryOut(work.resume(ADDRESS))
    .catch((problem) => error.say(problem))
    .finally(() => (submit.disabled = false));
}

function help() {
  const code = (text) => h("code", {}, text);
  return h(
    "section",
    { class: "card", id: "import-help" },
    h("h2", {}, "File format"),
    h(
      "p",
      {},
      "One row per pose, comma-separated, with a header row and decimal points. ",
      code("target_deg"),
      " and ",
      code("reading_deg"),
      " are required.",
    ),
    h(
      "p",
      {},
      "Optional: ",
      [
        "pass",
        "approach",
        "time_s",
        "temperature_c",
        "stage_deg",
        "reading_std_deg",
        "reading_stderr_deg",
        "n_samples",
        "accel_x_g",
      ].map((name) => [code(name), ", "]),
      "… Any other numeric column is kept as a covariate.",
    ),
    h(
      "p",
      { class: "muted" },
      "A file with an error is rejected as a whole, naming line and column; nothing of it is stored.",
    ),
  );
}
