// An ambiguous diagnosis leads here: the run that separates the suspects, or why there is none.

import { post } from "./api.js";
import { errorLine, h, runHref, runLink } from "./dom.js";
import { candidateWords } from "./effects.js";
import { duration, plural, significant } from "./format.js";

const UNDER_WAY = new Set(["queued", "running", "paused", "interrupted"]);

/** The runs that followed one up, the latest first: what each has come to, by its own diagnosis. */
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
  if (voided) return "voided, so that it answers nothing.";
  if (UNDER_WAY.has(status)) return `${status}; its diagnosis will be of both runs together.`;
  if (status !== "completed") return `${status}, so that it answers nothing. ${error ?? ""}`;
  if (!diagnosis) return "completed; its diagnosis, of both runs together, is still to be made there.";
  const found = diagnosis.effects.map(({ name, verdict }) => `${candidateWords(name)} (${verdict})`);
  return `both runs together say: ${found.join(", ") || "no effect"}.`;
}

/** Whether the question that the diagnosis left has been asked already, so that it is not to be asked again. */
export function isAnswered(runs) {
  return runs.some(({ status, voided }) => !voided && (status === "completed" || UNDER_WAY.has(status)));
}

export function followUpBox({ follow_up: planned }, path) {
  if (!planned) {
    return h(
      "div",
      { class: "follow-up", id: "no-follow-up" },
      h("h3", {}, "No run on this rig would distinguish them"),
      h("p", {}, "See “Remedy” of each effect below."),
    );
  }
  const error = errorLine("follow-up-error");
  const state = h("p", { class: "muted", role: "status", "aria-live": "polite" });
  const button = h(
    "button",
    { id: "follow-up", type: "button", class: "primary" },
    "Start the follow-up run",
  );
  button.addEventListener("click", async () => {
    button.disabled = true;
    error.say(null);
    state.textContent = "Designing the run, pose by pose…";
    try {
      const { id } = await post(`${path}/follow-up`);
      location.hash = runHref(id);
    } catch (problem) {
      error.say(problem);
    } finally {
      state.textContent = "";
      button.disabled = false;
    }
  });
  return h(
    "div",
    { class: "follow-up" },
    h("h3", {}, `A follow-up run would distinguish ${planned.separates.map(candidateWords).join(" from ")}`),
    h("p", {}, expectation(planned)),
    error.element,
    h("div", { class: "buttons" }, button, state),
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
    "The test is sequential: it ends as soon as one of them is decided for."
  );
}
