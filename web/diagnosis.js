// The diagnosis of a run's residual: the button, the effects found, and their remedies.

import { get, serviceError } from "./api.js";
import { Chart } from "./charts.js";
import { errorLine, figureList, fill, h, held, paragraphs, runName, warningBox } from "./dom.js";
import { plural, significant } from "./format.js";
import { CANCELLED, LongWork } from "./longwork.js";
import { Together } from "./together.js";

const SEARCH = {
  doing: "Searching all poses for effects, then once more for each fold of the cross-validation.",
  share: "the searches are done",
};

/** Below a run's result. `show(run)` whenever the run has changed; `reread()` is called when it has here. */
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
    this.element = h(
      "section",
      { class: "card diagnosis", id: "diagnosis", "aria-labelledby": "diagnosis-title", hidden: true },
      h("div", { class: "diagnosis-head" }, h("h2", { id: "diagnosis-title" }, "Diagnosis"), this.button),
      this.state,
      this.work.element,
      this.together.element,
      this.error.element,
      this.found,
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
    this.button.classList.toggle("primary", !this.run.diagnosis);
    this.state.textContent = this.run.diagnosis
      ? outdated(this.run)
      : "Searches a catalogue of physical effects for causes of the residual. Reports the RMS error before and after " +
        "on held-out poses (cross-validation). Takes a few seconds.";
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
      if (await carryOut()) await this.reread(); // its verdict has changed with it
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
    const [followers, { effectCard }, { followUpBox, followedBy, isAnswered }] = await Promise.all([
      following(),
      import("./effect.js"), // these with the first diagnosis that is shown
      import("./followup.js"),
      import("./effects.js").then(({ knowEffects }) => knowEffects()),
    ]);
    if (this.shown !== shown || this.signal.aborted) return;
    this.drawn?.abort();
    this.drawn = new AbortController();
    const signal = AbortSignal.any([this.signal, this.drawn.signal]);
    const bars = new Chart("before-after", "RMS error on held-out poses", { low: true, signal });
    const effects = diagnosis.effects.map((effect, k) => effectCard(effect, k, this, signal));
    fill(
      this.found,
      h("div", { class: "columns outcome" }, summary(diagnosis), bars.element),
      followedBy(followers),
      diagnosis.verdict === "ambiguous" &&
        !isAnswered(followers) &&
        followUpBox(diagnosis, this.path, following, signal),
      effects.map(({ element }) => element),
      warningBox(diagnosis.warnings, "diagnosis-warnings"),
      this.run.rig && commonError(this.run.rig, signal),
    );
    bars.load(`${this.path}/figures/diagnosis`);
    effects.forEach(({ chart }, k) => chart.load(`${this.path}/figures/effect-${k}`));
  }
}

function outdated({ diagnosis, result }) {
  return diagnosis.runs.length === 1 && diagnosis.n_poses > result.n_poses
    ? `Outdated: this diagnosis used ${diagnosis.n_poses} poses, ${result.n_poses} are included now. Diagnose again.`
    : "";
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
  const folded = h("details", { "data-testid": "error-map-details" }, title, body);
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
