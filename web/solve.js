// The form of a joint solution of stage, mounts and units, and the earlier solutions.

import { get } from "./api.js";
import { dataTable, errorLine, field, fill, h, numberCell, onSubmit, runLink, select, tableRow, unitLink } from "./dom.js";
import { moment, plural, significant } from "./format.js";
import { CANCELLED, LongWork } from "./longwork.js";
import { may } from "./me.js";

const ADDRESS = "/api/solve";
const LISTED = 100;
const WORDS = {
  doing: "Fitting stage map, mounting angles and unit errors: once on all poses, once for each held-out segment.",
  share: "it is done",
};

export async function solveView({ root, query, signal }) {
  const rigs = await get("/api/rigs", signal);
  const form = new SolveForm(rigs, query, signal);
  await form.show();
  fill(root, h("h1", {}, "Separate errors of stage and units"), intro(), form.element, form.earlier);
  form.resume();
}

function intro() {
  return h(
    "p",
    { class: "muted prose" },
    "Clamp a unit at several angles and take a run at each. Errors of the stage follow its dial, errors of the unit ",
    "follow the clamp. A joint fit with gravity as the reference separates them.",
  );
}

class SolveForm {
  constructor(rigs, query, signal) {
    this.signal = signal;
    this.wanted = { runs: query.getAll("run"), unit: query.get("unit") };
    const named = query.get("rig") ?? rigs[0]?.name;
    const names = rigs.map(({ name }) => name);
    if (named && !names.includes(named)) names.push(named); // runs of a rig that is no longer configured
    this.rig = select({ id: "solve-rig" }, [...names, ["", "none: files without a rig"]], named);
    this.linear = h("input", { type: "checkbox", id: "solve-linear" });
    const periods = { id: "solve-periods", name: "periods_deg", type: "text", autocomplete: "off", placeholder: "none" };
    this.periods = h("input", periods);
    this.says = h("p", { id: "solve-suggestion", class: "muted", "aria-live": "polite" });
    this.rows = h("div", { id: "solve-runs" });
    this.error = errorLine("solve-error");
    this.button = h("button", { id: "solve", type: "submit", class: "primary" }, "Solve");
    this.work = new LongWork("solve", WORDS, signal);
    this.earlier = h("section", { class: "card", "aria-labelledby": "earlier-title" });
    this.element = this.#form();
    this.rig.addEventListener("change", () => this.show().catch((problem) => this.error.say(problem)));
  }

  #form() {
    const form = h(
      "form",
      { class: "card start" },
      field("solve-rig", "Rig", this.rig),
      h("fieldset", {}, h("legend", {}, "Runs"), this.says, this.#choices(), this.rows),
      h("div", { class: "choice" }, h("label", {}, this.linear, "Units without quadratic and cubic terms")),
      field("solve-periods", "Known gear periods, ° of the dial, comma-separated", this.periods),
      this.work.element,
      this.error.element,
      may("operator") && h("div", { class: "buttons" }, this.button),
    );
    onSubmit(form, this.button, this.error, () => this.#carryOut(this.work.carryOut(ADDRESS, this.#body())));
    return form;
  }

  #choices() {
    const tick = (text, isWanted) =>
      h("button", { type: "button", class: "small", on: { click: () => this.#tick(isWanted) } }, text);
    return h("p", { class: "buttons ticks" }, tick("All", () => true), tick("None", () => false));
  }

  /** Continues what was requested before the view was left. */
  resume() {
    this.work.resumeWith(ADDRESS, this.button, this.error, (begun) => this.#carryOut(begun));
  }

  /** Shows the runs and the solutions of the selected rig. */
  async show() {
    const rig = this.rig.value;
    const isHere = (one) => (one.rig ?? "") === rig;
    const ofRig = rig ? { rig } : {};
    const [{ items, next_cursor: more }, solutions] = await Promise.all([
      get(`/api/runs?${new URLSearchParams({ ...ofRig, status: "completed", limit: LISTED })}`, this.signal),
      get(`${ADDRESS}?${new URLSearchParams(ofRig)}`, this.signal),
    ]);
    if (rig !== this.rig.value) return;
    const runs = items.filter((run) => run.result && !run.voided && isHere(run));
    const { ids, says, unit } = suggested(runs, this.wanted);
    const mounts = new URLSearchParams({ mounts: "0,120,240", rig, ...(unit && { unit }) });
    const start = rig && !ids.length && h("a", { id: "solve-mounts", href: `#/?${mounts}` }, "Start a run with three mounts");
    fill(this.says, says, start && [" ", start, "."], more && ` These are among the ${LISTED} newest completed runs.`);
    fill(this.rows, runs.length > 0 && runTable(runs));
    this.#tick((id) => ids.includes(id));
    this.wanted = { runs: [], unit: null }; // of the rig that the address named
    fill(this.earlier, h("h2", { id: "earlier-title" }, rig ? `Solutions of rig ${rig}` : "Solutions"), earlier(solutions.filter(isHere)));
  }

  get #boxes() {
    return [...this.rows.querySelectorAll("input")];
  }

  #tick(isWanted) {
    for (const box of this.#boxes) box.checked = isWanted(box.value);
  }

  #body() {
    const runs = this.#boxes.filter(({ checked }) => checked).map(({ value }) => value);
    if (!runs.length) throw new Error("Tick at least one run.");
    const periods = this.periods.value.split(/[\s,;]+/).filter(Boolean).map(Number);
    return { rig: this.rig.value || null, runs, linear: this.linear.checked, periods_deg: periods };
  }

  async #carryOut(work) {
    if (!(await work)) return this.signal.aborted || fill(this.says, CANCELLED);
    location.hash = `#/solve/${this.work.resultId}`;
  }
}

function runTable(runs) {
  const rows = runs.map((run) =>
    h(
      "tr",
      { "data-run": run.id },
      h("td", {}, h("input", { type: "checkbox", value: run.id, "aria-label": `Run ${run.id} of unit ${run.unit}` })),
      h("th", { scope: "row" }, runLink(run.id)),
      h("td", {}, unitLink(run.unit)),
      h("td", {}, anglesOf(run)?.map((angle) => `${angle}°`).join(", ") ?? "from the file"),
      numberCell(run.result.n_poses),
      h("td", {}, moment(run.finished_at)),
    ),
  );
  return dataTable("Runs to solve", ["Use", "Run", "Unit", "Mounting angles", "#Poses", "Finished"], rows);
}

function earlier(solutions) {
  if (!solutions.length) return h("p", { class: "muted" }, "No solution yet. Tick runs above and press Solve.");
  const rows = solutions.map((one) =>
    tableRow(
      [h("a", { href: `#/solve/${one.id}` }, moment(one.created_at)), one.by && ` by ${one.by}`],
      [
        unitsOf(one),
        numberCell(one.runs.length),
        one.separable ? "yes" : "no",
        ...[one.before, one.final].map(({ held_out_rms_deg: rms }) => numberCell(significant(rms, 3, "°"))),
      ],
      { "data-solution": one.id },
    ),
  );
  const names = ["Solved", "Units", "#Runs", "Separable", "#RMS without map", "#RMS with map"];
  return dataTable("Earlier solutions", names, rows, { id: "solutions-table" });
}

function unitsOf({ units }) {
  const links = units.slice(0, 3).map((serial, k) => [k > 0 && ", ", unitLink(serial)]);
  return [links, units.length > 3 && ` and ${units.length - 3} more`];
}

/** The mounting angles in a run's plan; null for an import, whose poses have them. */
function anglesOf({ plan }) {
  return plan && (plan.mounts_deg ?? [0]);
}

/** The ids to tick and the reason: those that the address names, else those of the unit with the most mounts. */
function suggested(runs, { runs: named, unit }) {
  if (!runs.length) return { ids: [], says: "No valid completed run here yet. Calibrate a unit at two or more mounting angles." };
  if (named.length) {
    const ids = named.filter((id) => runs.some((run) => run.id === id));
    const missing = named.length - ids.length;
    return { ids, says: missing ? `${plural(missing, "requested run")} cannot be used.` : "" };
  }
  if (unit) return { ids: of(runs, unit), says: `All runs of unit ${unit} are ticked.` };
  const best = ranked(runs)[0];
  if (best.mounts > 1)
    return { ids: of(runs, best.unit), says: `Suggested: unit ${best.unit} (${best.words}).` };
  const says =
    "No unit was clamped at several angles. With one mount, stage and unit are separable only if the unit is stated to " +
    "be linear. Measure one unit clamped at 0°, 120° and 240°.";
  return { ids: [], says, unit: best.unit };
}

function of(runs, unit) {
  return runs.filter((run) => run.unit === unit).map(({ id }) => id);
}

/** Units by number of mounts, most first: angles of the plans, and files, which may have one each. */
function ranked(runs) {
  const units = new Map();
  for (const run of runs) {
    const one = units.get(run.unit) ?? { unit: run.unit, angles: new Set(), files: 0 };
    const angles = anglesOf(run);
    if (angles) angles.forEach((angle) => one.angles.add(angle));
    else one.files += 1;
    units.set(run.unit, one);
  }
  const counted = [...units.values()].map(({ unit, angles, files }) => {
    const planned = angles.size > 0 && `clamped at ${[...angles].map((angle) => `${angle}°`).join(", ")}`;
    const read = files > 0 && `${plural(files, "file")}, possibly each at another angle`;
    return { unit, words: [planned, read].filter(Boolean).join("; "), mounts: angles.size + files };
  });
  return counted.sort((a, b) => b.mounts - a.mounts);
}
