// An ambiguous diagnosis leads here: the run that separates the suspects, or why there is none.

import { post } from "./api.js";
import { errorLine, h, runHref } from "./dom.js";
import { candidateWords } from "./effects.js";
import { duration, plural, significant } from "./format.js";

export function followUpBox({ follow_up: planned }, path) {
  if (!planned) {
    return h(
      "div",
      { class: "follow-up", id: "no-follow-up" },
      h("h3", {}, "No run on this rig would tell them apart"),
      h("p", {}, "What a person would have to do is said below."),
    );
  }
  const error = errorLine("follow-up-error");
  const state = h("p", { class: "muted", role: "status", "aria-live": "polite" });
  const button = h(
    "button",
    { id: "follow-up", type: "button", class: "primary" },
    "Run the separating experiment",
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
    h("h3", {}, `One more run would separate ${planned.separates.map(candidateWords).join(" from ")}`),
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
  const rest = confirming > 0 ? `${confirming} of them only confirm what the others decide. ` : "";
  return (
    `${poses}${waits}, chosen so that the suspects are expected to lie ${significant(sigma, 2)} standard ` +
    `deviations apart (${significant(separation, 3)} in −2 log likelihood). ${rest}` +
    "It stops deciding as soon as one of them leads clearly."
  );
}
