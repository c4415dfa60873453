// Tracing what bias and scale leave of a run: the button, what was found, and what to do about it.

import { ApiError, get, post } from "./api.js";
import { Chart } from "./charts.js";
import { errorLine, fill, h } from "./dom.js";
import { effectCard } from "./effect.js";
import { candidateWords, effectTitle, knowEffects } from "./effects.js";
import { followUpBox } from "./followup.js";
import { plural, significant } from "./format.js";
import { Together } from "./together.js";

const AS_NOISE = 1.5;

/** Below a run's result. `show(run)` whenever the run has changed. */
export class DiagnosisPanel {
  constructor(path, signal) {
    this.path = path;
    this.signal = signal;
    this.button = h("button", { id: "diagnose", type: "button", on: { click: () => this.#trace() } });
    this.state = h("p", { id: "diagnosis-state", class: "muted", role: "status", "aria-live": "polite" });
    this.together = new Together(signal);
    this.error = errorLine("diagnosis-error");
    this.found = h("div", { id: "diagnosis-found" });
    this.element = h(
      "section",
      { class: "card diagnosis", id: "diagnosis", "aria-labelledby": "diagnosis-title", hidden: true },
      h(
        "div",
        { class: "diagnosis-head" },
        h("h2", { id: "diagnosis-title" }, "Trace the residual"),
        this.button,
      ),
      this.state,
      this.together.element,
      this.error.element,
      this.found,
    );
  }

  show(run) {
    this.run = run;
    this.element.hidden = !run.result;
    this.together.show(run);
    this.#ready();
    if (run.diagnosis && run.diagnosis !== this.shown) {
      this.#draw(run.diagnosis).catch((error) => {
        if (!(error instanceof ApiError)) throw error;
        this.error.say(error);
      });
    }
  }

  #ready() {
    this.button.textContent = this.run.diagnosis ? "Trace again" : "Trace the residual";
    this.button.classList.toggle("primary", !this.run.diagnosis);
    this.state.textContent = this.run.diagnosis
      ? outdated(this.run)
      : "Looks for what bias and scale do not explain in a catalogue of physical effects, and measures the " +
        "error before and after on poses that the search had not seen. Takes a few seconds.";
  }

  async #trace() {
    this.error.say(null);
    this.button.disabled = true;
    this.element.setAttribute("aria-busy", "true");
    this.state.textContent = "Tracing: the whole search, then once more for each fold of unseen poses…";
    try {
      const diagnosis = await post(`${this.path}/diagnosis`, { runs: [...this.together.chosen] });
      this.run = { ...this.run, diagnosis };
      await this.#draw(diagnosis);
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      this.error.say(error);
    } finally {
      this.button.disabled = false;
      this.element.removeAttribute("aria-busy");
      this.#ready();
    }
  }

  async #draw(diagnosis) {
    this.shown = diagnosis;
    await knowEffects();
    if (this.shown !== diagnosis || this.signal.aborted) return;
    this.drawn?.abort();
    this.drawn = new AbortController();
    const signal = AbortSignal.any([this.signal, this.drawn.signal]);
    const bars = new Chart("before-after", "Error on poses not seen", { low: true, signal });
    const effects = diagnosis.effects.map((effect, k) => effectCard(effect, k, this, signal));
    fill(
      this.found,
      h("div", { class: "columns outcome" }, summary(diagnosis, this.run), bars.element),
      diagnosis.verdict === "ambiguous" && followUpBox(diagnosis, this.path),
      effects.map(({ element }) => element),
      diagnosis.warnings.length > 0 && warnings(diagnosis.warnings),
      this.run.rig && commonError(this.run.rig, signal),
    );
    bars.load(`${this.path}/figures/diagnosis`);
    effects.forEach(({ chart }, k) => chart.load(`${this.path}/figures/effect-${k}`));
  }
}

function outdated({ diagnosis, result }) {
  return diagnosis.runs.length === 1 && diagnosis.n_poses > result.n_poses
    ? `Poses were excluded since: this is of ${diagnosis.n_poses}, ${result.n_poses} count now. Trace again.`
    : "";
}

function summary(diagnosis, run) {
  const { base, final, noise, held_out: unseen, confirmed_by: fresh } = diagnosis;
  const rows = [
    ["Before, bias and scale", significant(base.held_out_rms_deg, 3, "°")],
    ["After", significant(final.held_out_rms_deg, 3, "°")],
    ["Noise floor", significant(noise.floor_deg, 3, "°")],
  ];
  if (fresh) {
    rows.push(["Fresh run, before", significant(fresh.before_rms_deg, 3, "°")]);
    rows.push(["Fresh run, after", significant(fresh.after_rms_deg, 3, "°")]);
  }
  return h(
    "div",
    {},
    h("div", { class: `verdict ${grade(diagnosis)}`, "data-testid": "diagnosis-verdict" }, [
      h("p", { class: "headline" }, headline(diagnosis)),
      h("p", {}, judged(diagnosis)),
      fresh && h("p", { id: "confirmed" }, confirmation(fresh, run)),
    ]),
    h(
      "dl",
      { class: "figures", id: "before-after" },
      rows.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value))),
    ),
    h(
      "p",
      { class: "muted" },
      `RMS over ${plural(unseen.n_poses, "pose")} of ${diagnosis.runs.length > 1 ? "runs" : "run"} `,
      `${diagnosis.runs.join(", ")}, each predicted once by a search and a fit that never saw it `,
      `(${unseen.how}).`,
    ),
    h("p", { class: "model" }, diagnosis.final.model),
  );
}

function confirmation({ run_id: id, before_rms_deg: before, after_rms_deg: after }, run) {
  const decided = run.provenance.follow_up?.decided_on?.length;
  const poses = decided ? ` (${plural(decided, "pose")} decided)` : "";
  const figures = `${significant(before, 3, "°")} before and ${significant(after, 3, "°")} after`;
  return (
    `${after < before ? "Confirmed" : "Not confirmed"} by poses of run ${id} that did not serve to ` +
    `decide${poses}: ${figures}.`
  );
}

/** A name is good news only where the error on poses not seen has fallen with it. */
function grade({ verdict, base, final, confirmed_by: fresh }) {
  if (verdict === "nothing") return "unknown";
  const fell = final.held_out_rms_deg === null || final.held_out_rms_deg < base.held_out_rms_deg;
  const confirmed = !fresh || fresh.after_rms_deg < fresh.before_rms_deg;
  return verdict === "named" && fell && confirmed ? "good" : "fair";
}

function headline({ verdict, effects }) {
  if (verdict === "nothing") return "Nothing found: what is left looks like noise";
  const named = titles(effects, "named");
  if (verdict === "named") return `Traced to: ${named}`;
  const besides = named && `. Named beside it: ${named}`;
  const unnamed = titles(effects, "unnamed");
  if (verdict === "unnamed") return `Found, without a name: ${unnamed}${besides}`;
  const also = unnamed && `. Without a name: ${unnamed}`;
  const suspects = effects
    .filter((effect) => effect.verdict === "ambiguous")
    .map(({ name, confusable_with: others }) => [name, ...others].map(candidateWords).join(" or "));
  return `Something is there, and these poses cannot tell what: ${suspects.join("; ")}${also}${besides}`;
}

function titles(effects, verdict) {
  const chosen = effects.filter((effect) => effect.verdict === verdict).map(effectTitle);
  return chosen.map((title) => title[0].toLowerCase() + title.slice(1)).join(", ");
}

/** "After" against the noise floor, in words. */
function judged({ base, final, noise, effects }) {
  const [before, after, floor] = [base.held_out_rms_deg, final.held_out_rms_deg, noise.floor_deg];
  if (after === null) return "The error on unseen poses was not measured.";
  if (effects.length && after >= before)
    return (
      "The error on poses not seen has not fallen: with so few poses the search does not find the same in " +
      "every fold."
    );
  const figure = effects.length ? after : before;
  if (!floor) return "How much of what is left is noise is not known: these poses carry no standard errors.";
  const ratio = figure / floor;
  const times = `${significant(ratio, 2)} times a reading's own standard error`;
  if (ratio <= AS_NOISE) return `What is left is ${times}: about what noise leaves.`;
  return `What is left is ${times}: more than noise within the dwells, and nothing more that could be traced.`;
}

function warnings(sentences) {
  return h(
    "div",
    { class: "cautions", "data-testid": "diagnosis-warnings" },
    h("h3", {}, "To be kept in mind"),
    h(
      "ul",
      {},
      sentences.map((sentence) => h("li", {}, sentence)),
    ),
  );
}

/** The rig's error map, looked up when somebody opens it. */
function commonError(rig, signal) {
  const body = h("div", { id: "error-map" });
  const folded = h(
    "details",
    { "data-testid": "error-map-details" },
    h("summary", {}, `What every unit on rig ${rig} has in common`),
    body,
  );
  folded.addEventListener("toggle", () => folded.open && !body.hasChildNodes() && show(), { signal });
  return folded;

  async function show() {
    const path = `/api/rigs/${encodeURIComponent(rig)}`;
    try {
      const map = await get(`${path}/error-map`, signal);
      if (!map.stage_deg.length) return fill(body, h("p", { class: "muted" }, tooFew(map.units)));
      const title = `Common error of ${plural(map.units, "unit")}`;
      const chart = new Chart("error-map-chart", title, { low: true, signal });
      fill(body, chart.element, h("p", { class: "muted" }, `Mind that ${map.caveat}.`));
      await chart.load(`${path}/figures/error-map`);
    } catch (error) {
      if (signal.aborted) return;
      if (!(error instanceof ApiError)) throw error;
      fill(body, h("p", { class: "error", role: "alert" }, error.message));
    }
  }
}

function tooFew(units) {
  return (
    `Not known yet: it takes calibrations of three units on this rig over the same elevations, and there ` +
    `${units === 1 ? "is one" : `are ${units}`}.`
  );
}
