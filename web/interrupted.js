// A run that was interrupted: what is told of it afterwards, and the way on while it lies there.

import { h } from "./dom.js";
import { fixed, moment, plural } from "./format.js";

/** A line for each time the run was taken up again. */
export function interruptions(run) {
  return (run.provenance.interruptions ?? []).map((told) =>
    h(
      "p",
      { class: "interruption" },
      `Interrupted after ${plural(told.after_poses, "pose")}, taken up again `,
      moment(told.taken_up_at),
      told.measured_again && `; ${measuredAgain(told.measured_again)}`,
    ),
  );
}

function measuredAgain({ target_deg, before_deg, after_deg, difference_std_deg }) {
  const chance = difference_std_deg === null ? "" : ` (± ${fixed(difference_std_deg, 3, "°")})`;
  const turned_deg = ((after_deg - before_deg + 540) % 360) - 180;
  return `at ${fixed(target_deg, 1, "°")} the unit then read ${fixed(turned_deg, 3, "°")} more${chance}`;
}

/** Buttons for a run that lies interrupted; `ask(verb)` posts resume or abort. */
export function wayOn(run, ask) {
  if (run.status !== "interrupted") return null;
  const button = (id, verb, text) => h("button", { id, type: "button", on: { click: () => ask(verb) } }, text);
  return h(
    "section",
    { class: "card", "aria-label": "Interrupted" },
    h(
      "p",
      {},
      "Every pose that was announced is kept. Leave unit and stage as they are, and take the run up again: " +
        "the last pose is measured once more to see that nothing moved.",
    ),
    h(
      "div",
      { class: "buttons" },
      button("take-up", "resume", "Take it up again"),
      button("leave", "abort", "Leave it at that"),
    ),
  );
}
