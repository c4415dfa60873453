// The diagnosis of a run's residual: a line for each effect found, and folded below them how well they explain it.

import { get, serviceError } from "./api.js";
import { Chart } from "./charts.js";
import { errorLine, figureList, fill, h, held, keepingFocus, paragraphs, runName, warningBox } from "./dom.js";
import { Fold, keepingFolds } from "./fold.js";
import { plural, significant } from "./format.js";
import { CANCELLED, LongWork } from "./longwork.js";
import { Together } from "./together.js";

const SEARCH = {
  doing: "Searching all poses for effects, then once more for each fold of the cross-validation.",
  share: "the searches are done",
};

/**
 * Below a run's result. `show(run)` whenever the run has changed; `reread()` is called when it has here. The button is
 * in its head, or where `lend()` puts it while it is the next step.
 */
export class DiagnosisPanel {
  constructor(path, signal, reread) {
    this.path = path;
    this.signal = signal;
    this.reread = reread;
    this.button = h("button", { id: "diagnose", type: "button", on: { click: () => this.#ask() } });
    this.state = h("p", { id: "diagnosis-state", class: "muted", role: "status", "aria-live": "polite" });
    this.work = new LongWork("diagnosis", SEARCH, signal);
    this.together = new Together(signal);
    this.error = errorLine("diagnosis-error");
    this.found = h("div", { id: "diagnosis-found" });
    this.head = h("div", { class: "diagnosis-head" }, h("h2", { id: "diagnosis-title" }, "Diagnosis"), this.button);
    this.element = h(
      "section",
      { class: "card diagnosis", id: "diagnosis", "aria-labelledby": "diagnosis-title", hidden: true },
      this.head,
      this.state,
      this.work.element,
      this.error.element,
      this.found,
      this.together.element,
    );
  }

  show(run) {
    this.run = run;
    this.element.hidden = !run.result;
    this.together.show(run);
    if (!this.isBusy) this.#ready();
    if (!this.isBusy && LongWork.isUnderWay(this.#address)) this.#diagnose(() => this.work.resume(this.#address));
    const found = JSON.stringify(run.diagnosis);
    if (!run.diagnosis || found === this.shown) return;
    this.shown = found;
    this.#draw(run.diagnosis).catch((error) => this.error.say(serviceError(error, this.signal)));
  }

  #ready() {
    this.button.textContent = this.run.diagnosis ? "Diagnose again" : "Diagnose";
    this.state.textContent = isOutdated(this.run)
      ? `Outdated: this diagnosis used ${this.run.diagnosis.n_poses} poses, ${this.run.result.n_poses} are included ` +
        "now. Diagnose again."
      : "";
  }

  /** The button, for another place; without one it returns to the head. */
  lend(place = this.head) {
    this.button.classList.toggle("primary", place !== this.head);
    if (this.button.parentElement !== place) keepingFocus(document.body, () => place.append(this.button));
  }

  get #address() {
    return `${this.path}/diagnosis`;
  }

  #ask() {
    return this.#diagnose(() => this.work.carryOut(this.#address, { runs: [...this.together.chosen] }));
  }

  async #diagnose(carryOut) {
    this.error.say(null);
    this.isBusy = true;
    const release = held(this.button);
    this.state.textContent = "";
    let says = "";
    try {
      if (await carryOut()) await this.reread(true); // its verdict has changed with it
      else says = CANCELLED;
    } catch (error) {
      this.error.say(serviceError(error));
    } finally {
      this.isBusy = false;
      release();
      this.#ready();
      this.state.textContent = says || this.state.textContent;
    }
  }

  async #draw(diagnosis) {
    const shown = this.shown;
    const asked = new URLSearchParams({ follows: this.run.id });
    const following = async () => (await get(`/api/runs?${asked}`, this.signal)).items;
    const [followers, { effectCard }, { decidedEffect, followUpBox, followedBy, isAnswered }] = await Promise.all([
      following(),
      import("./effect.js"), // these with the first diagnosis that is shown
      import("./followup.js"),
      import("./effects.js").then(({ knowEffects }) => knowEffects()),
    ]);
    if (this.shown !== shown || this.signal.aborted) return;
    this.drawn?.abort();
    this.drawn = new AbortController();
    const signal = AbortSignal.any([this.signal, this.drawn.signal]);
    const decided = isAnswered(followers) ? null : decidedEffect(diagnosis);
    const effects = diagnosis.effects.map((effect, k) =>
      effectCard(effect, k, this, effect === decided && followUpBox(diagnosis, this.path, following, signal), signal),
    );
    const drawn = [
      !effects.length && h("p", { "data-testid": "nothing-found" }, `${diagnosis.says?.[0] ?? NOT_JUDGED}.`),
      effects,
      followedBy(followers),
      this.#details(diagnosis, signal),
    ];
    keepingFocus(this.found, () => keepingFolds(this.found, () => fill(this.found, drawn)));
  }

  #details(diagnosis, signal) {
    const bars = new Chart("before-after", "RMS error on held-out poses", { low: true, signal });
    const fold = new Fold(
      "diagnosis",
      "Details of the diagnosis",
      h("div", { class: "columns outcome" }, summary(diagnosis), bars.element),
      warningBox(diagnosis.warnings, "diagnosis-warnings"),
      this.run.rig && commonError(this.run.rig, signal),
    );
    const [before, after] = [diagnosis.base, diagnosis.final].map((one) => significant(one.held_out_rms_deg, 3, "°"));
    const warnings = diagnosis.warnings.length > 0 && `, ${plural(diagnosis.warnings.length, "warning")}`;
    fold.say(`held-out RMS error ${before} before, ${after} with effects`, warnings);
    fold.onOpen(() => bars.load(`${this.path}/figures/diagnosis`), signal);
    return fold.element;
  }
}

/** Whether poses were excluded since. */
export function isOutdated({ diagnosis, result }) {
  return Boolean(diagnosis) && diagnosis.runs.length === 1 && diagnosis.n_poses > result.n_poses;
}

const NOT_JUDGED = "Diagnosed by an earlier version of calrig: diagnose again for a verdict";

function summary(diagnosis) {
  const { base, final, noise, held_out: heldOut, confirmed_by: fresh } = diagnosis;
  const rows = [
    ["Held-out RMS, bias and scale only", significant(base.held_out_rms_deg, 3, "°")],
    ["Held-out RMS, with effects", significant(final.held_out_rms_deg, 3, "°")],
    ["In held-out blocks, bias and scale only", significant(base.blocked_rms_deg, 3, "°")],
    ["In held-out blocks, with effects", significant(final.blocked_rms_deg, 3, "°")],
    ["Noise floor", significant(noise.floor_deg, 3, "°")],
  ];
  if (fresh) {
    rows.push(["Confirmation, before", significant(fresh.before_rms_deg, 3, "°")]);
    rows.push(["Confirmation, after", significant(fresh.after_rms_deg, 3, "°")]);
  }
  const [headline = NOT_JUDGED, ...sentences] = diagnosis.says ?? [];
  return h(
    "div",
    {},
    h("div", { class: `verdict ${diagnosis.grade ?? "unknown"}`, "data-testid": "diagnosis-verdict" }, [
      h("p", { class: "headline" }, headline),
      paragraphs(sentences),
    ]),
    figureList(rows, { id: "before-after" }),
    h(
      "p",
      { class: "muted" },
      `Cross-validation over ${plural(heldOut.n_poses, "pose")} of `,
      `${diagnosis.runs.length > 1 ? "runs" : "run"} ${diagnosis.runs.map(runName).join(", ")}: search and fit were repeated `,
      `without the poses they predict; for blocks, the fit alone (${heldOut.how}).`,
    ),
    h("p", { class: "model" }, diagnosis.final.model),
  );
}

/** The rig's error map, read when the user opens it. */
function commonError(rig, signal) {
  const body = h("div", { id: "error-map" });
  const title = h("summary", {}, `Error map of rig ${rig}`);
  const folded = h("details", { "data-fold": "error-map", "data-testid": "error-map-details" }, title, body);
  folded.addEventListener("toggle", () => folded.open && !body.hasChildNodes() && show(), { signal });
  return folded;

  async function show() {
    const path = `/api/rigs/${encodeURIComponent(rig)}`;
    try {
      const map = await get(`${path}/error-map`, signal);
      const says = h("p", { class: "muted" }, map.says);
      if (!map.stage_deg.length) return fill(body, says);
      const title = `Stage error, from ${plural(map.units, "unit")}`;
      const chart = new Chart("error-map-chart", title, { low: true, signal });
      fill(body, chart.element, says);
      await chart.load(`${path}/figures/error-map`);
    } catch (error) {
      fill(body, h("p", { class: "error", role: "alert" }, serviceError(error, signal)?.message));
    }
  }
}
