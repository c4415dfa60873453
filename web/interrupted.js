// A run that ended early: its interruptions in the run's head, and the buttons that continue it, end it or start it again.

import { button, h, runHref, runName, unitHref } from "./dom.js";
import { fixed, isKnown, moment, plural } from "./format.js";
import { may } from "./me.js";

/** A line for each time the run was resumed. */
export function interruptions(run) {
  return (run.provenance.interruptions ?? []).map((one) =>
    h(
      "p",
      { class: "interruption" },
      `Interrupted after ${plural(one.after_poses, "pose")}, resumed `,
      moment(one.resumed_at ?? one.taken_up_at), // the latter in older runs
      one.measured_again && `; ${measuredAgain(one.measured_again)}`,
    ),
  );
}

/** Runs of earlier versions have both readings, but not their difference. */
function measuredAgain({ target_deg, before_deg, after_deg, difference_deg, difference_std_deg }) {
  const chance = difference_std_deg === null ? "" : ` (± ${fixed(difference_std_deg, 3, "°")})`;
  const difference = isKnown(difference_deg)
    ? `difference ${fixed(difference_deg, 3, "°")}`
    : `${fixed(before_deg, 3, "°")} before and ${fixed(after_deg, 3, "°")} after`;
  return `repeated pose at ${fixed(target_deg, 1, "°")}: ${difference}${chance}`;
}

/**
 * Buttons for a run that did not complete; `ask(verb)` posts resume or abort of an interrupted one, `place` is a
 * `placeField`.
 */
export function wayOn(run, place, ask) {
  const verbButton = (id, verb, text) => button(text, () => ask(verb), { id });
  if (run.held) return h("div", { class: "buttons" }, verbButton("go-held", "resume", "Continue"));
  if (["failed", "aborted"].includes(run.status)) return startAgain(run);
  if (run.status !== "interrupted") return null;
  return h(
    "section",
    { class: "card", "aria-label": "Interrupted" },
    h(
      "p",
      {},
      "All measured poses are kept. Leave unit and stage as they are and resume the run: calrig measures the last " +
        "pose again to check that nothing has moved.",
    ),
    hasNoHoming(run) && [
      h(
        "p",
        { id: "stage-at-why", class: "muted" },
        "This stage has no homing. If it was moving when the run was interrupted, or has been rotated since, enter " +
          "its elevation.",
      ),
      place.element,
    ],
    h(
      "div",
      { class: "buttons" },
      verbButton("resume-interrupted", "resume", "Resume the run"),
      verbButton("end-interrupted", "abort", "End the run"),
      h("p", { id: "going-on", class: "muted", role: "status" }),
    ),
  );
}

/** A link to where such a run is started again: the form with its unit, rig and plan. */
function startAgain({ id, unit, plan, follows }) {
  if (!plan || !may("operator")) return null;
  const link = (href, text) => h("p", {}, h("a", { id: "start-again", class: "button", href }, text));
  if (follows) return link(runHref(follows), `Design it again from run ${runName(follows)}`);
  if (plan.kind === "static") return link("#/noise", "Record again");
  if (plan.kind === "verification") return link(unitHref(unit), "Verify again");
  return link(`#/?again=${encodeURIComponent(id)}`, "Start again");
}

/** Whether the position of the run's stage may have to be entered. */
export function hasNoHoming(run) {
  return run.provenance?.stage?.homes === false;
}
