// "Design a plan": the service designs the shortest plan for an uncertainty; the form can take it over.

import { serviceError } from "./api.js";
import { bullets, field, figureList, fill, h, headings, held, numberCell, tableBox, tableRow } from "./dom.js";
import { duration, plural, significant } from "./format.js";
import { LongWork } from "./longwork.js";

const ADDRESS = "/api/plans/design";
const WORDS = { doing: "Designing the plan.", share: "the designs are tried" };

/**
 * The request for a design and its result. `of()` is rig, unit and current plan; `take(plan)` fills the form with the
 * designed one; `pace()` is the seconds on the wall for one of the rig's clock; `signal` aborts when the view is left.
 */
export function planDesigner(of, take, pace, signal) {
  const target = input("target_u_deg", "number", { step: "any", placeholder: "0.5" });
  const time = input("time_s", "number", { step: "any", placeholder: "no limit" });
  const trace = input("trace", "checkbox", { checked: true });
  const sweep = input("may-sweep", "checkbox", { checked: true });
  const early = input("stop-early", "checkbox");
  const work = new LongWork("design", WORDS, signal);
  const answer = h("div", { id: "designed", role: "status", "aria-live": "polite" });
  const ask = h("button", { type: "button", id: "design", on: { click: () => design() } }, "Design the plan");
  const fields = h(
    "div",
    { class: "fields two" },
    field(target.id, "Target expanded uncertainty, °", target),
    field(time.id, "or available time, s", time),
    check(trace, "Trace effects", "Enough poses to find and name physical effects."),
    check(sweep, "Allow continuous sweeps", "Used where they are faster."),
    check(early, "Sequential stopping", "Ends the run when it reaches the target uncertainty."),
  );
  fields.addEventListener("keydown", (event) => {
    if (event.key !== "Enter") return;
    event.preventDefault(); // in the surrounding form it would start a run
    design();
  });
  fields.addEventListener("input", () => {
    early.disabled = time.value !== "";
    fill(answer);
  });

  function design() {
    const wanted = target.value === "" ? null : Number(target.value);
    const stops = early.checked && !early.disabled && wanted !== null;
    return answered(() =>
      work.carryOut(ADDRESS, {
        ...of(),
        target_u_deg: wanted,
        until: stops ? { expanded_uncertainty_deg: wanted } : null,
        time_s: time.value === "" ? null : Number(time.value) / pace(),
        trace: trace.checked,
        sweep: sweep.checked,
      }),
    );
  }

  async function answered(carriedOut) {
    if (ask.disabled) return; // in progress
    const release = held(ask);
    fill(answer);
    try {
      if (await carriedOut()) {
        const designed = await work.document();
        fill(answer, shown(designed, pace()), useIt(designed.plan));
      } else if (!signal.aborted) fill(answer, h("p", { class: "muted" }, "Cancelled."));
    } catch (problem) {
      if (problem.name === "AbortError") return;
      fill(answer, h("p", { id: "design-refused", class: "cautions" }, serviceError(problem).message));
    } finally {
      release();
    }
  }

  function useIt(plan) {
    const use = () => {
      take(plan);
      fill(answer, h("p", { class: "muted" }, "Plan entered in the form below."));
      ask.focus(); // the pressed button is gone
    };
    const button = h("button", { type: "button", id: "use-plan", on: { click: use } }, "Use this plan");
    return h("div", { class: "buttons" }, button);
  }

  if (LongWork.isUnderWay(ADDRESS)) answered(() => work.resume(ADDRESS));
  return h("div", { id: "plan-design" }, fields, h("div", { class: "buttons" }, ask), work.element, answer);
}

/** An input outside the surrounding form, which describes the run. */
function input(id, type, props = {}) {
  return h("input", { id, type, form: "no-form", ...props });
}

/** A checkbox with its label and a hint. */
function check(box, label, hint) {
  return h("div", {}, h("label", { for: box.id, class: "check" }, box, label), h("small", { class: "muted" }, hint));
}

function shown({ plan, expected, limit, suspects, says }, pace) {
  const rows = [
    ...poses(plan),
    ["Time on the rig", `about ${duration(pace * expected.duration_s)}`],
    ["Expanded uncertainty", significant(expected.expanded_uncertainty_deg, 3, "°")],
    ["Bias, standard error", significant(expected.bias_std_deg, 2, "°")],
    ["Lower bound of the time", duration(pace * limit.duration_s)],
  ];
  return [
    figureList(rows),
    suspects.length > 0 && tableBox("Detectable effects", tableOf(suspects)),
    bullets(says, { class: "says" }),
  ];
}

function poses({ kind, until, elevations_deg: elevations, dwell_s: dwell, sweeps, velocity_dps: velocity }) {
  const most = until ? " at most" : "";
  if (kind !== "sweep") return [["Poses", `${plural(elevations.length, "pose")} of ${dwell}\u00a0s${most}`]];
  return [
    ["Continuous traverses", `${sweeps}${most}`],
    ["Velocity", significant(velocity, 3, "°/s")],
    ["Time per pose", `${dwell}\u00a0s`],
  ];
}

function tableOf(suspects) {
  return h(
    "table",
    { id: "design-suspects" },
    h("caption", {}, "Smallest effects detected with a power of 80 %"),
    headings("Effect", "#Residual, RMS", "#Parameter"),
    h("tbody", {}, suspects.map(row)),
  );
}

function row({ title, rms_deg: rms, value, unit }) {
  return tableRow(title, [
    numberCell(rms === null ? "undetected" : significant(rms, 2, "°")),
    numberCell(value === null ? "–" : significant(value, 2, unit ?? "")),
  ]);
}
