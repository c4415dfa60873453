// Stage, mounts and units solved together: which runs of a rig, and the solutions that there are.

import { get } from "./api.js";
import { errorLine, field, fill, h, headings, onSubmit, runLink, tableBox, unitLink } from "./dom.js";
import { moment, significant } from "./format.js";
import { CANCELLED, LongWork } from "./longwork.js";
import { may } from "./me.js";
import { anglesOf, suggested } from "./solveruns.js";

const ADDRESS = "/api/solve";
const LISTED = 100;
const WORDS = {
  doing: "Solving for the stage's map, the mounts and the units, once for all poses and once for each stretch left out.",
  share: "it is done",
};

export async function solveView({ root, query, signal }) {
  const rigs = await get("/api/rigs", signal);
  const form = new SolveForm(rigs, query, signal);
  await form.show();
  fill(root, h("h1", {}, "Solve stage and units together"), intro(), form.element, form.earlier);
  form.resume();
}

function intro() {
  return h(
    "p",
    { class: "muted prose" },
    "Clamp a unit at several angles, take a run at each: what the stage does wrong turns with its dial, what the unit ",
    "does wrong turns with the clamp. Solved jointly, with gravity as the reference, the two errors are separated.",
  );
}

class SolveForm {
  constructor(rigs, query, signal) {
    this.signal = signal;
    this.wanted = { runs: query.getAll("run"), unit: query.get("unit") };
    const named = query.get("rig") ?? rigs[0]?.name;
    const names = rigs.map(({ name }) => name);
    if (named && !names.includes(named)) names.push(named); // of runs that are here, on a rig that is not
    const choice = (name, text) => h("option", { value: name, selected: name === named }, text);
    this.rig = h("select", { id: "solve-rig" }, names.map((name) => choice(name, name)), choice("", "none: files without a rig"));
    this.linear = h("input", { type: "checkbox", id: "solve-linear" });
    this.periods = h("input", { id: "solve-periods", name: "periods_deg", type: "text", autocomplete: "off", placeholder: "none known" });
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
      h(
        "div",
        { class: "choice" },
        h("label", {}, this.linear, "I state that these units have no quadratic and no cubic terms"),
      ),
      field("solve-periods", "Known periods of gears, ° of the dial, separated by commas", this.periods),
      this.work.element,
      this.error.element,
      may("operator") && h("div", { class: "buttons" }, this.button),
    );
    onSubmit(form, this.button, this.error, () => this.#carryOut(() => this.work.carryOut(ADDRESS, this.#body())));
    return form;
  }

  #choices() {
    const tick = (text, isWanted) =>
      h("button", { type: "button", class: "small", on: { click: () => this.#tick(isWanted) } }, text);
    return h("p", { class: "buttons ticks" }, tick("All", () => true), tick("None", () => false));
  }

  /** Goes on with what was asked for before the person went elsewhere. */
  resume() {
    if (!LongWork.isUnderWay(ADDRESS)) return;
    this.button.disabled = true;
    this.#carryOut(() => this.work.resume(ADDRESS))
      .catch((problem) => this.error.say(problem))
      .finally(() => (this.button.disabled = false));
  }

  /** The runs and the solutions of the rig that is chosen. */
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
    const { ids, says } = suggested(runs, this.wanted);
    fill(this.says, says, more && ` These are among the ${LISTED} newest completed runs.`);
    fill(this.rows, runs.length > 0 && tableBox("Runs to solve", runTable(runs)));
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
    if (!runs.length) throw new Error("Tick the runs that are to be solved.");
    const periods = this.periods.value.split(/[\s,;]+/).filter(Boolean).map(Number);
    return { rig: this.rig.value || null, runs, linear: this.linear.checked, periods_deg: periods };
  }

  async #carryOut(work) {
    if (!(await work())) return this.signal.aborted || fill(this.says, CANCELLED);
    location.hash = `#/solve/${this.work.answer?.id ?? this.work.result.split("/").at(-1)}`;
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
      h("td", {}, anglesOf(run)?.map((angle) => `${angle}°`).join(", ") ?? "as its file says"),
      h("td", { class: "number" }, run.result.n_poses),
      h("td", {}, moment(run.finished_at)),
    ),
  );
  const head = headings("Take", "Run", "Unit", "Clamped at", "#Poses", "Finished");
  return h("table", {}, head, h("tbody", {}, rows));
}

function earlier(solutions) {
  if (!solutions.length) return h("p", { class: "muted" }, "None yet.");
  const rows = solutions.map((one) =>
    h(
      "tr",
      { "data-solution": one.id },
      h("th", { scope: "row" }, h("a", { href: `#/solve/${one.id}` }, moment(one.created_at)), one.by && ` by ${one.by}`),
      h("td", {}, one.units.slice(0, 3).map((serial, k) => [k > 0 && ", ", unitLink(serial)]), one.units.length > 3 && ` and ${one.units.length - 3} more`),
      h("td", { class: "number" }, one.runs.length),
      h("td", {}, one.separable ? "yes" : "no"),
      h("td", { class: "number" }, significant(one.before.held_out_rms_deg, 3, "°")),
      h("td", { class: "number" }, significant(one.final.held_out_rms_deg, 3, "°")),
    ),
  );
  const head = headings("Solved", "Units", "#Runs", "Separable", "#RMS without map", "#RMS with map");
  return tableBox("Earlier solutions", h("table", { id: "solutions-table" }, head, h("tbody", {}, rows)));
}
