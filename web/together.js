// A folded list of other runs of the unit, to be diagnosed together with this one.

import { get, serviceError } from "./api.js";
import { fill, h, runName } from "./dom.js";
import { moment, plural } from "./format.js";

const LISTED = 100;

/** `chosen` holds the ids. `show(run)` whenever the run has changed. */
export class Together {
  constructor(signal) {
    this.signal = signal;
    this.summary = h("summary");
    this.body = h("div");
    this.element = h("details", { id: "together" }, this.summary, this.body);
    this.element.addEventListener("toggle", () => this.element.open && this.#list());
  }

  show(run) {
    this.run = run;
    this.chosen ??= new Set(run.diagnosis?.runs.filter((id) => id !== run.id));
    this.#count();
  }

  #count() {
    const count = this.chosen.size;
    this.summary.textContent = `Diagnose together with ${count ? plural(count, "more run") : "…"}`;
  }

  /** Reads the runs each time it is opened. */
  async #list() {
    const asked = new URLSearchParams({ unit: this.run.unit, status: "completed", limit: LISTED });
    try {
      const { items, next_cursor: more } = await get(`/api/runs?${asked}`, this.signal);
      const followed = chain(this.run, items);
      const others = items.filter((one) => one.id !== this.run.id && one.result && !one.voided);
      const boxes = others.map((one) => this.#box(one, followed.has(one.id)));
      if (!boxes.length) return fill(this.body, h("p", { class: "muted" }, "No other completed run of this unit."));
      const legend = h("legend", { class: "for-screen-readers" }, "Completed runs of this unit");
      fill(
        this.body,
        h("fieldset", {}, legend, h("div", { class: "pick" }, boxes)),
        more && h("p", { class: "muted" }, `These are among the ${LISTED} newest runs of the unit.`),
      );
    } catch (error) {
      fill(this.body, h("p", { class: "error", role: "alert" }, serviceError(error, this.signal)?.message));
    }
  }

  /** A run that this one follows is always included: its box cannot be cleared. */
  #box(run, isFollowed) {
    const box = h("input", {
      type: "checkbox",
      value: run.id,
      checked: isFollowed || this.chosen.has(run.id),
      disabled: isFollowed,
    });
    box.addEventListener("change", () => {
      if (box.checked) this.chosen.add(run.id);
      else this.chosen.delete(run.id);
      this.#count();
    });
    const poses = plural(run.result.n_poses, "pose");
    const words = [`Run ${runName(run.id)}, `, moment(run.finished_at), `, ${poses}`, isFollowed && ", followed on"];
    return h("label", {}, box, h("span", {}, words));
  }
}

/** The ids of the runs that a run follows, as far as they are listed. */
function chain(run, listed) {
  const known = new Map(listed.map((one) => [one.id, one]));
  const found = new Set();
  for (let id = run.follows; id && !found.has(id); id = known.get(id)?.follows) found.add(id);
  return found;
}
