// A run that was interrupted: what is told of it afterwards, and the way on while it lies there.

import { h } from "./dom.js";
import { fixed, isKnown, moment, plural } from "./format.js";

/** A line for each time the run was resumed. */
export function interruptions(run) {
  return (run.provenance.interruptions ?? []).map((told) =>
    h(
      "p",
      { class: "interruption" },
      `Interrupted after ${plural(told.after_poses, "pose")}, resumed `,
      moment(told.resumed_at ?? told.taken_up_at), // the latter in older runs
      told.measured_again && `; ${measuredAgain(told.measured_again)}`,
    ),
  );
}

/** Runs of an older calrig do not say the difference, only both readings. */
function measuredAgain({ target_deg, before_deg, after_deg, difference_deg, difference_std_deg }) {
  const chance = difference_std_deg === null ? "" : ` (± ${fixed(difference_std_deg, 3, "°")})`;
  const difference = isKnown(difference_deg)
    ? `difference ${fixed(difference_deg, 3, "°")}`
    : `${fixed(before_deg, 3, "°")} before and ${fixed(after_deg, 3, "°")} after`;
  return `repeated pose at ${fixed(target_deg, 1, "°")}: ${difference}${chance}`;
}

/** Buttons for a run that lies interrupted; `ask(verb)` posts resume or abort, `place` is a `placeField`. */
export function wayOn(run, place, ask) {
  const button = (id, verb, text) => h("button", { id, type: "button", on: { click: () => ask(verb) } }, text);
  if (run.status === "queued" && run.error) return h("div", { class: "buttons" }, button("go-held", "resume", "Go"));
  if (run.status !== "interrupted") return null;
  return h(
    "section",
    { class: "card", "aria-label": "Interrupted" },
    h(
      "p",
      {},
      "Every measured pose is kept. Leave unit and stage as they are and resume the run: the last pose is " +
        "measured again to check that nothing has moved.",
    ),
    hasNoHoming(run) && [
      h(
        "p",
        { id: "stage-at-why", class: "muted" },
        "This stage has no homing. If it was moving when the run was interrupted, or has been turned since, enter " +
          "its elevation.",
      ),
      place.element,
    ],
    h(
      "div",
      { class: "buttons" },
      button("resume-interrupted", "resume", "Resume the run"),
      button("end-interrupted", "abort", "End the run"),
      h("p", { id: "going-on", class: "muted", role: "status" }),
    ),
  );
}

/** Whether somebody may have to say where the stage of a run stands. */
export function hasNoHoming(run) {
  return run.provenance?.stage?.homes === false;
}
