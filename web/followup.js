// After an ambiguous diagnosis: the run that distinguishes the candidates, or why there is none.

import { serviceError } from "./api.js";
import { errorLine, h, held, runHref, runLink } from "./dom.js";
import { candidateWords } from "./effects.js";
import { duration, plural, significant } from "./format.js";
import { CANCELLED, LongWork } from "./longwork.js";

const DESIGN = {
  doing: "Designing the run. Nothing moves before the design is complete.",
  share: "it is done",
};
const UNDER_WAY = new Set(["queued", "running", "paused", "interrupted"]);

/** The follow-up runs, latest first, each with its outcome. */
export function followedBy(runs) {
  if (!runs.length) return null;
  return h(
    "div",
    { class: "follow-up", id: "followed-by" },
    h("h3", {}, "Follow-up runs"),
    runs.map((run) => h("p", { class: run.voided && "voided" }, runLink(run.id, "Run "), `: ${outcome(run)}`)),
  );
}

function outcome({ status, diagnosis, voided, error }) {
  if (voided) return "voided, without an answer.";
  if (UNDER_WAY.has(status)) return `${status}; its diagnosis will be of both runs together.`;
  if (status !== "completed") return `${status}, without an answer. ${error ?? ""}`;
  if (!diagnosis) return "completed; open it to diagnose both runs together.";
  const found = diagnosis.effects.map(({ name, verdict }) => `${candidateWords(name)} (${verdict})`);
  return `joint diagnosis of both runs: ${found.join(", ") || "no effect"}.`;
}

/** Whether a follow-up run exists already, so that no further one is offered. */
export function isAnswered(runs) {
  return runs.some(({ status, voided }) => !voided && (status === "completed" || UNDER_WAY.has(status)));
}

/** What a follow-up run is expected to show, and its button; `followers()` are the follow-up runs so far. */
export function followUpBox({ follow_up: planned }, path, followers, signal) {
  if (!planned) {
    return h(
      "div",
      { class: "follow-up", id: "no-follow-up" },
      h("h3", {}, "No run on this rig would distinguish them"),
      h("p", {}, "See “Remedy” of each effect below."),
    );
  }
  const address = `${path}/follow-up`;
  const error = errorLine("follow-up-error");
  const state = h("p", { id: "follow-up-told", class: "muted", role: "status", "aria-live": "polite" });
  const work = new LongWork("follow-up", DESIGN, signal);
  const button = h(
    "button",
    { id: "follow-up", type: "button", class: "primary", on: { click: () => begun(() => work.carryOut(address, {})) } },
    "Start the follow-up run",
  );
  const begun = async (carryOut) => {
    const release = held(button);
    error.say(null);
    state.textContent = "";
    try {
      const isDone = await carryOut();
      if (signal.aborted) return;
      let id = isDone && work.resultId;
      id ||= (await followers()).find(({ status }) => UNDER_WAY.has(status))?.id; // it had started by then
      if (id) location.hash = runHref(id);
      else state.textContent = CANCELLED;
    } catch (problem) {
      error.say(serviceError(problem));
    } finally {
      release();
    }
  };
  if (LongWork.isUnderWay(address)) begun(() => work.resume(address));
  return h(
    "div",
    { class: "follow-up" },
    h("h3", {}, `A follow-up run would distinguish ${planned.separates.map(candidateWords).join(" from ")}`),
    h("p", {}, expectation(planned)),
    error.element,
    h("div", { class: "buttons" }, button, state),
    work.element,
  );
}

function expectation({ separation_sigma: sigma, separation, deciding_poses: deciding, plan }) {
  const sweep = plan.elevations_deg.length;
  const poses = plural(sweep * plan.sweeps, "pose");
  const waits =
    plan.wait_s > 0 ? `, waiting ${duration(plan.wait_s)} before each of ${plan.sweeps} sweeps` : "";
  const confirming = (sweep - deciding) * plan.sweeps;
  const rest = confirming > 0 ? `${confirming} of them are held out to confirm the decision. ` : "";
  return (
    `${poses}${waits}, designed for an expected separation of ${significant(sigma, 2)} standard ` +
    `deviations (${significant(separation, 3)} in −2 log likelihood). ${rest}` +
    "The test is sequential: it ends as soon as one candidate is selected."
  );
}
