// Amendments of a run after it was measured: the buttons at its head, each with a dialog.

import { post } from "./api.js";
import { askConfirmation, askReason } from "./ask.js";
import { button, field, h, runName } from "./dom.js";
import { may } from "./me.js";

/** The buttons for a run at `path`, ended or not. */
export function amendments(run, path, ended) {
  const offered = [
    may("operator") && ["note", "Add a note…", () => askNote(run, path)],
    ended && may("releaser") && ["move", "Correct the serial number…", () => askUnit(run, path)],
    ended && may("releaser") && !run.voided && ["void", "Void this run…", () => askVoid(run, path)],
    ended && may("releaser") && run.voided && ["unvoid", "Reinstate this run…", () => askUnvoid(run, path)],
  ];
  return h("div", { class: "buttons" }, offered.filter(Boolean).map(([id, text, ask]) => button(text, ask, { id })));
}

function askVoid(run, path) {
  return askReason(
    {
      title: `Void run ${runName(run.id)}?`,
      text: "The run is kept, struck through, and excluded from every comparison.",
      action: "Void the run",
    },
    (reason) => post(`${path}/void`, { reason }),
  );
}

function askUnvoid(run, path) {
  return askReason(
    {
      title: `Reinstate run ${runName(run.id)}?`,
      text: `It was voided: ${run.voided.reason}. Reinstated, it is part of comparisons again.`,
      action: "Reinstate the run",
      kind: "primary",
    },
    (reason) => post(`${path}/unvoid`, { reason }),
  );
}

function askUnit(run, path) {
  const serial = h("input", { id: "right-unit", required: true, maxlength: "100", autocomplete: "off" });
  return askReason(
    {
      title: `Correct the serial number of run ${runName(run.id)}?`,
      text:
        `Recorded as ${run.unit}. The run and its follow-ups move to the unit below; the audit log of both units ` +
        "records the move.",
      action: "Move the run",
      kind: "primary",
      before: field("right-unit", "Serial number", serial),
    },
    (reason) => post(`${path}/unit`, { unit: serial.value.trim(), reason }),
  );
}

function askNote(run, path) {
  const note = h("textarea", { id: "note", required: true, maxlength: "10000", rows: "4" });
  return askConfirmation(
    {
      title: `Add a note to run ${runName(run.id)}`,
      text: "The note is appended to earlier ones, with the time and your name if it is known.",
      action: "Add the note",
      before: [h("label", { for: "note" }, "Note"), note],
    },
    () => post(`${path}/note`, { note: note.value }),
  );
}

/** Excludes a pose from the result. */
export function askExclude(path, pose) {
  return askReason(
    {
      title: `Exclude pose ${pose.index}?`,
      text: "The pose is kept, struck through; the result is computed without it.",
      action: "Exclude the pose",
    },
    (reason) => post(`${path}/poses/${pose.index}/exclude`, { reason }),
  );
}

/** Includes it again. */
export function askInclude(path, pose) {
  return askReason(
    {
      title: `Include pose ${pose.index} again?`,
      text: `It was excluded: ${pose.excluded}. The result is computed with it.`,
      action: "Include the pose",
      kind: "primary",
    },
    (reason) => post(`${path}/poses/${pose.index}/include`, { reason }),
  );
}
