// After an ambiguous diagnosis: the run that distinguishes the candidates, or why there is none.

import { serviceError } from "./api.js";
import { errorLine, h, held, runHref, runLink } from "./dom.js";
import { candidateWords } from "./effects.js";
import { duration, fixed, plural, significant } from "./format.js";
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
  const words = ({ name, verdict }) => `${candidateWords(name, diagnosis.reference)} (${verdict})`;
  const found = diagnosis.effects.map(words);
  return `joint diagnosis of both runs: ${found.join(", ") || "no effect"}.`;
}

/** Whether a follow-up run exists already, so that no further one is offered. */
export function isAnswered(runs) {
  return runs.some(({ status, voided }) => !voided && (status === "completed" || UNDER_WAY.has(status)));
}

/**
 * Which effect of a diagnosis a follow-up run decides: the first ambiguous one, but no change between runs, and none
 * whose candidates are one correction.
 */
export function decidedEffect({ effects }) {
  return effects.find(({ verdict, changed, corrects }) => verdict === "ambiguous" && !changed && !corrects);
}

/** What a follow-up run does and is expected to show, and its button; `followers()` are the follow-up runs so far. */
export function followUpBox({ follow_up: planned, reference }, path, followers, signal) {
  if (!planned)
    return h("p", { class: "follow-up", id: "no-follow-up" }, "No run on this rig would distinguish them: see the remedy.");
  const address = `${path}/follow-up`;
  const error = errorLine("follow-up-error");
  const state = h("p", { id: "follow-up-told", class: "muted", role: "status", "aria-live": "polite" });
  const work = new LongWork("follow-up", DESIGN, signal);
  const button = h(
    "button",
    { id: "follow-up", type: "button", on: { click: () => begun(() => work.carryOut(address, {})) } },
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
    h("div", {}, h("p", {}, motion(planned, reference)), h("p", { class: "muted" }, expectation(planned)), error.element, state, work.element),
    button,
  );
}

/** What the stage will do: said before it does. */
function motion({ separates, plan }, reference) {
  const ends = [Math.min(...plan.elevations_deg), Math.max(...plan.elevations_deg)].map((end) => fixed(end, 1, "°"));
  const poses = plural(plan.elevations_deg.length * plan.sweeps, "pose");
  const waits = plan.wait_s > 0 ? `, with a wait of ${duration(plan.wait_s)} before each of ${plan.sweeps} sweeps` : "";
  const names = separates.map((name) => candidateWords(name, reference)).join(" from ");
  return `A follow-up run distinguishes ${names}. It moves the stage from ${ends.join(" to ")}: ${poses}${waits}.`;
}

function expectation({ separation_sigma: sigma, separation, deciding_poses: deciding, plan }) {
  const confirming = (plan.elevations_deg.length - deciding) * plan.sweeps;
  const rest = confirming > 0 ? ` ${plural(confirming, "pose")} of them confirm the decision.` : "";
  return (
    `Expected separation: ${significant(sigma, 2)} standard deviations (${significant(separation, 3)} in −2 log ` +
    `likelihood).${rest} It ends as soon as one candidate is selected.`
  );
}
