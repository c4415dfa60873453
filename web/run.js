// One run: live while it is in progress, with its result afterwards.

import { get, post, serviceError } from "./api.js";
import { amendments, askExclude, askInclude } from "./amend.js";
import { Chart } from "./charts.js";
import { DiagnosisPanel } from "./diagnosis.js";
import { errorLine, fill, h, keepingFocus, runName, tableBox } from "./dom.js";
import { knowEffects } from "./effects.js";
import { Fold } from "./fold.js";
import { isKnown, significant } from "./format.js";
import { hasNoHoming, wayOn } from "./interrupted.js";
import { LivePanel, TERMINAL } from "./live.js";
import { may } from "./me.js";
import { NextStep } from "./next.js";
import { PoseTable } from "./poses.js";
import { provenanceLists } from "./provenance.js";
import { answerOf, noResult, noResultAbout, resultDetails } from "./result.js";
import { downloads, faultLine, faultSummary, heading } from "./runhead.js";
import { placeField } from "./stageplace.js";
import { preferRig, stopsOnEscape } from "./stop.js";
import { follow } from "./stream.js";
import { Timeline } from "./timeline.js";

const RESIDUAL_EVERY_MS = 1000;
const NO_TIMES = "No readings with known times: none yet, or poses of a file without time_s.";

export async function runView({ root, parts: [id], signal }) {
  const path = `/api/runs/${encodeURIComponent(id)}`;
  const run = await get(path, signal);
  if (run.provenance.follow_up) await knowEffects(); // its head names them
  const page = new RunPage(path, run, signal);
  fill(root, page.element);
  await page.begin();
}

class RunPage {
  constructor(path, run, signal) {
    this.path = path;
    this.signal = signal;
    this.nStates = 0; // that the stream has told
    this.header = h("div", { class: "run-head" });
    this.error = errorLine("run-error");
    this.place = placeField(); // one for all redraws, which keep what was typed
    this.spoken = h("p", { class: "for-screen-readers", "aria-live": "polite" });
    const announce = (text) => (this.spoken.textContent = text);
    this.mismatches = h("section", { id: "mismatches", class: "card", role: "alert", hidden: true });
    this.live = new LivePanel((verb) => this.#ask(verb), announce);
    this.answer = h("div");
    this.diagnosis = new DiagnosisPanel(path, signal, (isStep) => this.#reread(isStep));
    this.next = new NextStep(path, signal, this.diagnosis, () => this.#amended(true));
    this.figures = h("div");
    this.resultFold = new Fold("result", "Figures and verdict", this.figures);
    this.result = h(
      "section",
      { id: "result", class: "card", "aria-label": "Result", hidden: true },
      this.answer,
      this.next.element,
      this.resultFold.element,
    );
    this.timelineChart = new Chart("timeline", "Stage and reading against time", { signal, empty: NO_TIMES });
    this.plain = h("input", { type: "checkbox", id: "plain-fit", on: { change: () => this.#otherFit() } });
    this.plainField = h("label", { class: "toggle", hidden: true }, this.plain, " Plain fit of bias and scale");
    this.residualChart = new Chart("residual", "Residual of each pose", {
      tall: true,
      signal,
      empty: "No pose has been measured.",
      beside: this.plainField,
    });
    this.poses = new PoseTable(
      (pose) => askExclude(path, pose),
      (pose) => askInclude(path, pose),
    );
    this.posesFold = new Fold("poses", "Poses", tableBox("Poses", this.poses.element));
    const charts = h("div", { class: "charts" }, this.timelineChart.element, this.residualChart.element);
    this.chartsFold = new Fold("charts", "Charts", charts);
    this.chartsFold.say("residual of each pose; stage and reading against time");
    this.chartsFold.onOpen(() => this.#drawCharts(), signal);
    this.faults = h("div", { id: "faults" });
    this.faultsFold = new Fold("faults", "Faults", this.faults);
    this.files = h("div");
    this.amending = h("div");
    this.amendFold = new Fold("amend", "Amend", this.amending);
    this.amendFold.say("note, serial number, void");
    this.origin = h("div");
    const filesFold = new Fold("files", "Downloads", this.files);
    filesFold.say("poses, raw samples, further analysis");
    const originFold = new Fold("origin", "Plan and provenance", this.origin);
    originFold.say("settings, versions, instruments");
    this.ofPoses = [this.residualChart.element, this.posesFold.element];
    this.element = h(
      "div",
      { class: "run" },
      this.header,
      this.error.element,
      this.mismatches,
      this.live.element,
      this.result,
      this.diagnosis.element,
      h(
        "section",
        { class: "card folds", "aria-label": "Details" },
        [this.chartsFold, this.posesFold, this.faultsFold, filesFold, this.amendFold, originFold].map(({ element }) => element),
      ),
      this.spoken,
    );
    signal.addEventListener("abort", () => clearTimeout(this.timer));
    stopsOnEscape(() => (this.run.rig && (!this.ended || this.isGoingOn) ? [this.run.rig] : []), signal);
    window.addEventListener("calrig:done", () => this.#amended(), { signal });
    this.#show(run);
    preferRig(run.rig);
  }

  async begin() {
    if (this.ended) return this.#showMeasured();
    const figure = await get(`${this.path}/figures/timeline`, this.signal);
    const timeline = new Timeline(this.timelineChart, figure, this.signal);
    const mismatches = new Map();
    const stream = follow(
      this.run.id,
      {
        state: async ({ status, error }) => {
          this.nStates += 1;
          if (status === "queued") return this.#readQueued();
          this.#show({ ...this.run, status, error, held: false });
          if (!TERMINAL.has(status)) return;
          if (status !== "interrupted") stream.stop(); // an interrupted run may have been resumed
          await this.#caughtUp(stream, timeline);
        },
        progress: (progress) => {
          this.run = { ...this.run, progress };
          this.live.progress(progress);
          return this.#wait(progress.waiting_for);
        },
        pose: (pose) => {
          this.poses.show([pose], false);
          this.#countPoses();
          this.#residualSoon();
        },
        move_mismatch: ({ index, says }) => {
          mismatches.set(index, h("p", {}, h("strong", {}, "Move mismatch. "), says));
          this.mismatches.hidden = false;
          fill(this.mismatches, [...mismatches.values()]);
        },
        reading: (reading) => {
          timeline.add(reading);
          this.live.reading(reading);
          this.waiting?.reading(reading);
        },
      },
      this.signal,
    );
    window.addEventListener("calrig:back", () => this.#caughtUp(stream, timeline), { signal: this.signal });
    const look = () => this.run.status === "queued" && !document.hidden && this.#readQueued();
    window.addEventListener("calrig:there", look, { signal: this.signal });
  }

  /** Reads a queued run, unless it begins meanwhile: what keeps it waiting at a centre changes without an event. */
  async #readQueued() {
    const { nStates } = this;
    try {
      const run = await get(this.path, this.signal);
      const isNews = ["status", "error", "held"].some((name) => run[name] !== this.run[name]);
      if (nStates === this.nStates && isNews) this.#show(run);
    } catch (error) {
      this.#say(error);
    }
  }

  /** Reads the run after its end, or after a lost connection; closes the stream if it has ended. */
  async #caughtUp(stream, timeline) {
    this.error.say(null); // and not after the answer: by then something else may have been refused
    try {
      await this.#reread(true);
      if (!this.ended) return;
      stream.stop();
      timeline.stop();
      await this.#showMeasured();
    } catch (error) {
      this.#say(error);
    }
  }

  get ended() {
    return TERMINAL.has(this.run.status);
  }

  #show(run) {
    const before = this.run;
    if (before && before.status !== run.status) this.spoken.textContent = `Run ${runName(run.id)} is ${run.status}`;
    this.run = run;
    for (const part of this.ofPoses) part.hidden = run.plan?.kind === "static";
    keepingFocus(this.element, () => this.#draw(run));
    const { ended } = this;
    if (before && TERMINAL.has(before.status) === ended) return;
    for (const fold of [this.chartsFold, this.posesFold]) fold.open(!ended); // what is measured now is watched
  }

  #draw(run) {
    fill(
      this.header,
      heading(run),
      wayOn(run, this.place, (verb) => this.#goOn(verb)),
    );
    this.live.show(run);
    this.#wait(this.ended ? null : run.progress.waiting_for);
    const axis = run.plan?.mount_axis ?? run.provenance?.mount_axis ?? "x";
    const forSolve = !run.result && run.status === "completed" && axis !== "x";
    const isWithout = !run.result && ["failed", "aborted"].includes(run.status);
    this.result.hidden = !run.result && !isWithout && run.status !== "completed";
    this.resultFold.element.hidden = !run.result;
    this.plainField.hidden = !isKnown(run.result?.rms_with_effects_deg);
    if (this.plainField.hidden) this.plain.checked = false;
    fill(this.answer, run.result ? answerOf(run) : isWithout ? noResult(run) : forSolve && noResultAbout(axis));
    fill(this.figures, run.result && resultDetails(run));
    this.resultFold.say(run.result && figuresLine(run.result));
    if (this.ended) {
      this.diagnosis.show(run);
      this.next.show(run);
    }
    this.#showFaults(run.faults);
    fill(this.files, downloads(run, this.path), this.ended && run.plan && run.plan.kind !== "static" && studyLink(run));
    const offered = amendments(run, this.path, this.ended);
    this.amendFold.element.hidden = !offered.hasChildNodes();
    fill(this.amending, offered);
    fill(this.origin, provenanceLists(run));
  }

  #showFaults(faults) {
    fill(this.faults, faultLine(faults));
    this.faultsFold.say(faultSummary(faults));
  }

  /** Shows what the run waits for the operator to do; the card is loaded when first needed. */
  async #wait(asked) {
    this.live.waits(Boolean(asked));
    try {
      if (asked) await (this.asking ??= this.#waitingCard());
    } catch (error) {
      this.#say(error);
    }
    this.waiting?.show(this.ended ? null : this.run.progress.waiting_for);
  }

  async #waitingCard() {
    const [{ WaitingCard }, rigs] = await Promise.all([import("./waiting.js"), get("/api/rigs", this.signal)]);
    const clamp = rigs.some(({ name, clamp }) => name === this.run.rig && clamp);
    this.waiting = new WaitingCard(this.run.rig, (verb) => post(`${this.path}/${verb}`), clamp && may("operator"));
    this.live.element.before(this.waiting.element);
  }

  async #showMeasured() {
    clearTimeout(this.timer);
    const [poses] = await Promise.all([
      get(`${this.path}/poses${this.#fit}`, this.signal),
      this.chartsFold.isOpen && this.#drawCharts(),
    ]);
    this.poses.show(poses, !this.run.voided && may("operator"));
    this.#countPoses();
    const excluded = poses.filter((pose) => pose.excluded).length;
    this.posesFold.say(excluded ? `${excluded} excluded` : "angles, readings and residuals; exclude a pose");
  }

  /** Of a live run the timeline draws itself. */
  #drawCharts() {
    return Promise.all([
      this.run.plan?.kind !== "static" && this.residualChart.load(`${this.path}/figures/residual${this.#fit}`),
      this.ended && this.timelineChart.load(`${this.path}/figures/timeline`),
    ]);
  }

  /** Which residuals are shown: those that the verdict judges, or by bias and scale alone. */
  get #fit() {
    return this.plain.checked ? "?fit=plain" : "";
  }

  async #otherFit() {
    try {
      await this.#showMeasured();
    } catch (error) {
      this.#say(error);
    }
  }

  #countPoses() {
    this.posesFold.title.textContent = `Poses (${this.poses.size})`;
  }

  #residualSoon() {
    this.timer ??= setTimeout(async () => {
      await Promise.all([this.chartsFold.isOpen && this.#drawCharts(), this.#faultsNow()]);
      this.timer = undefined;
    }, RESIDUAL_EVERY_MS);
  }

  async #faultsNow() {
    try {
      const { faults } = await get(this.path, this.signal);
      this.#showFaults(faults);
    } catch (error) {
      this.#say(error);
    }
  }

  #say(error) {
    this.error.say(serviceError(error, this.signal));
  }

  async #ask(verb) {
    this.error.say(null);
    try {
      await post(`${this.path}/${verb}`); // the stream reports the result, before or after this answer
      this.live.hold(verb === "pause");
    } catch (error) {
      this.#say(error);
    }
  }

  /** Resumes an interrupted or held run and follows it, or ends it. */
  async #goOn(verb) {
    if (this.isGoingOn) return;
    this.error.say(null);
    const state = document.getElementById("going-on");
    if (state) state.textContent = verb === "resume" ? "Checking rig, board and stage…" : "";
    const { ended } = this;
    const stage_at_deg = this.place.value();
    this.place.put(null); // the stage moves, so the position is valid for this resumption only
    this.isGoingOn = true;
    try {
      const body = verb === "resume" && hasNoHoming(this.run) ? { stage_at_deg } : {};
      this.#show(await post(`${this.path}/${verb}`, body));
    } catch (error) {
      if (state) state.textContent = "";
      if (this.place.value() === null) this.place.put(stage_at_deg);
      return this.#say(error);
    } finally {
      this.isGoingOn = false;
    }
    if (ended) await this.#follow(); // a held run is followed already
  }

  async #follow() {
    try {
      await this.begin();
    } catch (error) {
      this.#say(error);
    }
  }

  /** After something was accepted, excluded or voided. */
  async #amended(isStep = false) {
    try {
      await this.#reread(isStep);
      await this.#showMeasured();
    } catch (error) {
      this.#say(error);
    }
  }

  /** Reads the run; `isStep`: a step is done, and the button of the next one gets the focus. */
  async #reread(isStep = false) {
    this.#show(await get(this.path, this.signal));
    if (isStep) this.next.focus();
  }
}

function studyLink(run) {
  return h("a", { id: "study", href: `#/noise/${encodeURIComponent(run.id)}` }, "Filter comparison on this run");
}

function figuresLine({ rms_raw_deg: raw, noise_deg: noise }) {
  return `RMS error ${significant(raw, 3, "°")} raw, standard error of a reading ${significant(noise, 2, "°")}`;
}
