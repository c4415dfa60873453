// The plan as a form: the usual fields in sight, the rest folded; how many poses and how long.

import { ApiError, post } from "./api.js";
import { fill, h, markWrong } from "./dom.js";
import { duration, plural } from "./format.js";
import { mountFields, numbers } from "./mounts.js";

const TYPING_MS = 250; // the service is not asked for what is half typed

const RANGE = [
  field("start_deg", "From", "°", -60),
  field("stop_deg", "To", "°", 60),
  field("step_deg", "Step", "°", 10),
];
const USUAL = [
  field("sweeps", "Sweeps", "", 4, { whole: true }),
  field("settle_s", "Settling time", "s", 1),
  field("dwell_s", "Dwell time", "s", 2),
];
const ADVANCED = [
  field("jitter_deg", "Jitter of each elevation, ±", "°", 0),
  field("rate_hz", "Sample rate", "Hz", 200, { whole: true }),
  field("target_std_deg", "Dwell until standard error", "°", null, { hint: "fixed dwell" }),
  field("expanded_uncertainty_deg", "Stop at expanded uncertainty", "°", null, { hint: "whole plan" }),
  field("velocity_dps", "Stage velocity", "°/s", null, { hint: "stage default" }),
  field("wait_s", "Wait before each sweep", "s", 0),
  field("wait_temperature_c", "Wait for temperature", "°C", null, { hint: "do not wait" }),
  field("seed", "Seed", "", 0, { whole: true }),
];
const ORDERS = [
  ["sweep", "Up, then down"],
  ["random", "Random"],
  ["given", "As given"],
];

function field(name, label, unit, value, { whole = false, hint = null } = {}) {
  return { name, label, unit, value, whole, hint };
}

/**
 * The form's fieldset: `value()` is the plan it says, `estimate()` tells anew how much it is, and what is known of it
 * before it begins, for the rig and unit of `of()`. `signal` is aborted when the view is left.
 */
export function planForm(of, signal) {
  const inputs = new Map();
  const make = (spec) => labelled(spec, inputs);
  const asRange = radio("range", "Range", true);
  const asList = radio("list", "List", false);
  const asTurns = radio("turns", "Sweep, without stopping", false);
  const list = h("input", {
    id: "elevations_deg",
    type: "text",
    inputmode: "text",
    placeholder: "−60, −20, 0, 20, 60",
  });
  const order = h(
    "select",
    { id: "order" },
    ORDERS.map(([value, label]) => h("option", { value }, label)),
  );
  const summary = h("p", { id: "plan-summary", class: "summary", "aria-live": "polite" });
  const cautions = h("div", { id: "plan-warnings", class: "cautions", role: "status", hidden: true });
  const range = h("div", { class: "fields three" }, RANGE.map(make));
  const given = h(
    "div",
    { class: "field", hidden: true },
    h("label", { for: "elevations_deg" }, "Elevations, °, in any order"),
    list,
  );
  const advanced = h(
    "details",
    {},
    h("summary", {}, "More settings"),
    h("div", { class: "fields two" }, ADVANCED.map(make)),
  );
  const mounts = mountFields();
  const element = h(
    "fieldset",
    { id: "plan" },
    h("legend", {}, "Plan"),
    h(
      "div",
      { class: "choice", role: "radiogroup", "aria-label": "Elevations" },
      asRange.element,
      asList.element,
      asTurns.element,
    ),
    range,
    given,
    h(
      "div",
      { class: "fields four" },
      h("div", { class: "field" }, h("label", { for: "order" }, "Order"), order),
      USUAL.map(make),
    ),
    mounts.element,
    advanced,
    summary,
    cautions,
  );

  function value() {
    let plan = asTurns.input.checked ? { kind: "sweep", order: "sweep" } : { order: order.value, ...mounts.value() };
    for (const spec of [...(asList.input.checked ? [] : RANGE), ...USUAL, ...ADVANCED]) {
      plan[spec.name] = number(inputs.get(spec.name));
    }
    const { expanded_uncertainty_deg: wanted, ...rest } = plan;
    plan = { ...rest, until: wanted === null ? null : { expanded_uncertainty_deg: wanted } };
    if (asList.input.checked) plan.elevations_deg = numbers(list.value);
    return plan;
  }

  let hadSeveral = false;

  function refresh() {
    range.hidden = asList.input.checked;
    given.hidden = !asList.input.checked;
    for (const spec of RANGE) inputs.get(spec.name).disabled = asList.input.checked;
    list.required = asList.input.checked;
    order.disabled = mounts.element.hidden = asTurns.input.checked;
    jitterForMounts();
    markWrong(element);
    estimate();
  }

  /** What the stage does between the elevations of a grid shows in no mount, unless they are jittered. */
  function jitterForMounts() {
    const several = !asTurns.input.checked && mounts.value().mounts_deg.length > 1;
    const jitter = inputs.get("jitter_deg");
    if (several && !hadSeveral && jitter.value === "0") jitter.value = Number(inputs.get("step_deg").value) / 2;
    hadSeveral = several;
  }

  let timer;
  let asked = new AbortController();

  function estimate() {
    forget();
    timer = setTimeout(ask, TYPING_MS);
  }

  function forget() {
    clearTimeout(timer);
    asked.abort();
  }

  async function ask() {
    warn([]);
    if (![...element.elements].every((input) => input.checkValidity())) return fill(summary, "No poses yet.");
    asked = new AbortController();
    const plan = value();
    try {
      const said = await post("/api/plans/estimate", { ...of(), plan }, asked.signal);
      fill(summary, estimateText(plan, said));
      warn(said.warnings);
    } catch (problem) {
      if (problem.name === "AbortError") return;
      if (!(problem instanceof ApiError)) throw problem;
      fill(summary, problem.message);
      markWrong(element, problem.fields);
    }
  }

  function warn(sentences) {
    cautions.hidden = !sentences.length;
    fill(
      cautions,
      sentences.map((sentence) => h("p", {}, sentence)),
    );
  }

  element.addEventListener("input", refresh);
  signal.addEventListener("abort", forget);
  refresh();
  /** What the address of the form says of the plan: `mounts=0,120&axis=x`. */
  function prefill(query) {
    mounts.set({ mounts_deg: query.get("mounts")?.split(","), mount_axis: query.get("axis") });
    refresh();
  }

  /** The form says a plan: one that the service has designed, or that of an earlier list. */
  function take(plan) {
    const said = { ...plan, expanded_uncertainty_deg: plan.until?.expanded_uncertainty_deg ?? null };
    for (const [name, input] of inputs) if (name in said) input.value = said[name] ?? "";
    order.value = plan.order;
    mounts.set(plan);
    hadSeveral = plan.mounts_deg?.length > 1; // its jitter is as it says
    const shape = plan.kind === "sweep" ? asTurns : plan.elevations_deg ? asList : asRange;
    shape.input.checked = true;
    if (shape === asList) list.value = plan.elevations_deg.join(", ").replaceAll("-", "−");
    refresh();
  }

  return { element, designer: designer(() => ({ ...of(), plan: value() }), take, signal), value, estimate, prefill, take };
}

/** "Design a plan", folded: what it takes is asked for when somebody opens it. */
function designer(of, take, signal) {
  const element = h("details", { id: "designer" }, h("summary", {}, "Design a plan"));
  const open = async () => {
    const { planDesigner } = await import("./plandesign.js");
    element.append(planDesigner(of, take, signal));
  };
  element.addEventListener("toggle", open, { once: true });
  return element;
}

function labelled({ name, label, unit, value, whole, hint }, inputs) {
  const input = h("input", {
    id: name,
    type: "number",
    step: whole ? "1" : "any",
    value,
    placeholder: hint,
    required: value !== null,
  });
  inputs.set(name, input);
  return h("div", { class: "field" }, h("label", { for: name }, unit ? `${label}, ${unit}` : label), input);
}

function radio(value, label, checked) {
  const input = h("input", { type: "radio", name: "elevations", id: `as-${value}`, value, checked });
  return { input, element: h("label", { for: `as-${value}` }, input, label) };
}

function number(input) {
  return input.value === "" ? null : Number(input.value);
}

/** How much a plan is, in words, as the service has computed it. */
function estimateText(plan, { n_poses: poses, wall_s: seconds }) {
  const upTo = plan.target_std_deg || plan.until ? "at most about" : "about";
  const turns = (plan.mounts_deg?.length ?? 1) - 1;
  const more = [
    plan.wait_temperature_c === null ? "" : ", and the wait for temperature",
    turns ? `; ${plural(poses / plan.mounts_deg.length, "pose")} a mount, and the unit turned ${["", "once", "twice"][turns] ?? `${turns} times`} in between` : "",
  ].join("");
  return [
    h("strong", {}, plural(poses, "pose")),
    `, ${upTo} ${duration(seconds)}${more}`,
  ];
}
