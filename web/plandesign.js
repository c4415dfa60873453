// "Design a plan": the service designs the shortest plan for an uncertainty, and the form takes it.

import { ApiError, get } from "./api.js";
import { fill, h, headings, held, tableBox } from "./dom.js";
import { duration, plural, significant } from "./format.js";
import { LongWork } from "./longwork.js";

const ADDRESS = "/api/plans/design";
const WORDS = { doing: "Designing the plan.", share: "the designs are tried" };

/**
 * What is asked, and what comes of it. `of()` is rig, unit and the plan that is kept; `take(plan)` has the form take
 * one; `signal` is aborted when the view is left.
 */
export function planDesigner(of, take, signal) {
  const target = input("target_u_deg", "number", { step: "any", placeholder: "0.5" });
  const time = input("time_s", "number", { step: "any", placeholder: "as long as it takes" });
  const trace = input("trace", "checkbox", { checked: true });
  const sweep = input("may-sweep", "checkbox", { checked: true });
  const early = input("stop-early", "checkbox");
  const work = new LongWork("design", WORDS, signal);
  const answer = h("div", { id: "designed", role: "status", "aria-live": "polite" });
  const ask = h("button", { type: "button", id: "design", on: { click: () => design() } }, "Design the plan");
  const fields = h(
    "div",
    { class: "fields two" },
    h("div", { class: "field" }, h("label", { for: target.id }, "Expanded uncertainty wanted, °"), target),
    h("div", { class: "field" }, h("label", { for: time.id }, "Or: time available, s"), time),
    h("label", { for: trace.id, class: "check" }, trace, "Trace effects: poses enough to find and name them"),
    h("label", { for: sweep.id, class: "check" }, sweep, "Sweep without stopping where that is faster"),
    h("label", { for: early.id, class: "check" }, early, "Sequential stopping: end the run once the uncertainty is reached"),
  );
  fields.addEventListener("keydown", (event) => {
    if (event.key !== "Enter") return;
    event.preventDefault(); // of the form around it, that would start a run
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
        time_s: time.value === "" ? null : Number(time.value),
        trace: trace.checked,
        sweep: sweep.checked,
      }),
    );
  }

  async function answered(carriedOut) {
    if (ask.disabled) return; // it is being looked for
    const release = held(ask);
    fill(answer);
    try {
      if (await carriedOut()) {
        const said = work.answer ?? (await get(work.result, signal));
        fill(answer, shown(said), useIt(said.plan));
      } else if (!signal.aborted) fill(answer, h("p", { class: "muted" }, "Cancelled."));
    } catch (problem) {
      if (problem.name === "AbortError") return;
      if (!(problem instanceof ApiError)) throw problem;
      fill(answer, h("p", { id: "design-refused", class: "cautions" }, problem.message));
    } finally {
      release();
    }
  }

  function useIt(plan) {
    const use = () => {
      take(plan);
      fill(answer, h("p", { class: "muted" }, "The form below has this plan."));
      ask.focus(); // what was pressed is gone
    };
    return h(
      "div",
      { class: "buttons" },
      h("button", { type: "button", id: "use-plan", on: { click: use } }, "Use this plan"),
    );
  }

  if (LongWork.isUnderWay(ADDRESS)) answered(() => work.resume(ADDRESS));
  return h("div", { id: "plan-design" }, fields, h("div", { class: "buttons" }, ask), work.element, answer);
}

/** An input that belongs to no form: what is asked here is no part of the run. */
function input(id, type, props = {}) {
  return h("input", { id, type, form: "no-form", ...props });
}

function shown({ plan, expected, limit, suspects, says }) {
  const rows = [
    ...poses(plan),
    ["Time on the rig", `about ${duration(expected.duration_s)}`],
    ["Expanded uncertainty", significant(expected.expanded_uncertainty_deg, 3, "°")],
    ["Bias, standard error", significant(expected.bias_std_deg, 2, "°")],
    ["Lower bound of the time", duration(limit.duration_s)],
  ];
  return [
    h("dl", { class: "figures" }, rows.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value)))),
    suspects.length > 0 && tableBox("Detectable effects", tableOf(suspects)),
    h("ul", { class: "says" }, says.map((sentence) => h("li", {}, sentence))),
  ];
}

function poses({ kind, until, elevations_deg: elevations, dwell_s: dwell, sweeps, velocity_dps: velocity }) {
  const most = until ? " at most" : "";
  if (kind !== "sweep") return [["Poses", `${plural(elevations.length, "pose")} of ${dwell}\u00a0s${most}`]];
  return [
    ["Passes without stopping", `${sweeps}${most}`],
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
  return h(
    "tr",
    {},
    h("th", { scope: "row" }, title),
    h("td", { class: "number" }, rms === null ? "not shown" : significant(rms, 2, "°")),
    h("td", { class: "number" }, value === null ? "–" : significant(value, 2, unit ?? "")),
  );
}
