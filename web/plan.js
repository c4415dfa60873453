// The form of a plan: one line with its poses, range and duration; presets and fields folded behind it.

import { post, serviceError } from "./api.js";
import { askConfirmation } from "./ask.js";
import { button, field, fill, h, markWrong, paragraphs, select, unfold } from "./dom.js";
import { duration, fixed, plural } from "./format.js";

const JITTER_WHY = "Several mounts: half a step of jitter also shows stage errors between the steps.";
const TYPING_MS = 250; // no request while the user types

const RANGE = [
  spec("start_deg", "From", "°", -60),
  spec("stop_deg", "To", "°", 60),
  spec("step_deg", "Step", "°", 10),
];
const JITTER = spec("jitter_deg", "Jitter", "±°", 0);
const USUAL = [
  spec("sweeps", "Sweeps", "", 4, { whole: true }),
  spec("settle_s", "Settling time", "s", 1),
  spec("dwell_s", "Dwell time", "s", 2),
];
const ADVANCED = [
  spec("rate_hz", "Sample rate", "Hz", 200, { whole: true }),
  spec("target_std_deg", "Dwell until standard error", "°", null, { hint: "fixed dwell" }),
  spec("expanded_uncertainty_deg", "Stop at expanded uncertainty", "°", null, { hint: "whole plan" }),
  spec("velocity_dps", "Stage velocity", "°/s", null, { hint: "stage default" }),
  spec("wait_s", "Wait before each sweep", "s", 0),
  spec("wait_temperature_c", "Wait for temperature", "°C", null, { hint: "do not wait" }),
  spec("seed", "Seed", "", 0, { whole: true }),
];
const ORDERS = [
  ["sweep", "Up, then down"],
  ["random", "Random"],
  ["given", "As given"],
];
const STANDARD = {
  ...Object.fromEntries([...RANGE, JITTER, ...USUAL, ...ADVANCED].map(({ name, value }) => [name, value])),
  order: "sweep",
  mounts_deg: [0],
  mount_axis: "x",
};
const PRESETS = [
  ["quick", "Quick", { ...STANDARD, step_deg: 20, sweeps: 2 }],
  ["standard", "Standard", STANDARD],
  ["three-mounts", "Three mounts", { ...STANDARD, mounts_deg: [0, 120, 240], jitter_deg: 5 }],
];

function spec(name, label, unit, value, { whole = false, hint = null } = {}) {
  return { name, label, unit, value, whole, hint };
}

/**
 * The form's fieldset: `value()` is its plan; `estimate()` shows the plan's size and warnings again, for the rig and unit
 * of `of()`; `begin(start)` calls `start`, after a question if a designed plan is shown that the form has not taken.
 * `signal` aborts when the view is left.
 */
export function planForm(of, signal) {
  const inputs = new Map();
  const make = (one) => labelled(one, inputs);
  const asRange = radio("range", "Range", true);
  const asList = radio("list", "List", false);
  const asTurns = radio("turns", "Continuous sweep", false);
  const list = h("input", {
    id: "elevations_deg",
    type: "text",
    inputmode: "text",
    placeholder: "−60, −20, 0, 20, 60",
  });
  const order = select({ id: "order" }, ORDERS);
  const summary = h("span", { id: "plan-summary", "aria-live": "polite" });
  const cautions = h("div", { id: "plan-warnings", class: "cautions", role: "status", hidden: true });
  const range = RANGE.map(make);
  const given = field("elevations_deg", "Elevations, °, in any order", list);
  given.classList.add("wide");
  const jittered = h("p", { id: "jitter-why", class: "muted", hidden: true }, JITTER_WHY);
  const presets = PRESETS.map(([id, text, plan]) => button(text, () => take(plan), { id: `preset-${id}` }));
  const designer = designDetails(() => ({ ...of(), plan: value() }), take, () => pace, signal);
  const advanced = h("details", {}, h("summary", {}, "More settings"), h("div", { class: "fields two" }, ADVANCED.map(make)));
  const mounts = mountFields();
  const fields = h(
    "details",
    { id: "plan-fields" },
    h("summary", {}, h("span", { class: "name" }, "Plan"), summary, h("span", { class: "change" }, "change")),
    h("div", { class: "buttons presets", role: "group", "aria-label": "Presets" }, presets, designer),
    h(
      "div",
      { class: "choice", role: "radiogroup", "aria-label": "Elevations" },
      asRange.element,
      asList.element,
      asTurns.element,
    ),
    h("div", { class: "fields four" }, range, given, make(JITTER)),
    jittered,
    h("div", { class: "fields four" }, field("order", "Order", order), USUAL.map(make)),
    mounts.element,
    advanced,
  );
  const element = h("fieldset", { id: "plan", "aria-label": "Plan" }, fields, cautions);

  function value() {
    let plan = asTurns.input.checked ? { kind: "sweep", order: "sweep" } : { order: order.value, ...mounts.value() };
    for (const { name } of [...(asList.input.checked ? [] : RANGE), JITTER, ...USUAL, ...ADVANCED]) {
      plan[name] = number(inputs.get(name));
    }
    const { expanded_uncertainty_deg: wanted, ...rest } = plan;
    plan = { ...rest, until: wanted === null ? null : { expanded_uncertainty_deg: wanted } };
    if (asList.input.checked) plan.elevations_deg = numbers(list.value);
    return plan;
  }

  let hadSeveral = false;

  function refresh() {
    for (const one of range) one.hidden = asList.input.checked;
    given.hidden = !asList.input.checked;
    for (const { name } of RANGE) inputs.get(name).disabled = asList.input.checked;
    list.required = asList.input.checked;
    order.disabled = mounts.element.hidden = asTurns.input.checked;
    jitterForMounts();
    markWrong(element);
    const now = comparable(value());
    presets.forEach((one, k) => one.setAttribute("aria-pressed", now === comparable(PRESETS[k][2])));
    estimate();
  }

  /** Presets a jitter for several mounts: without it, stage errors between the grid's elevations stay undetected. */
  function jitterForMounts() {
    const several = !asTurns.input.checked && mounts.value().mounts_deg.length > 1;
    const jitter = inputs.get("jitter_deg");
    if (several && !hadSeveral && jitter.value === "0") jitter.value = Number(inputs.get("step_deg").value) / 2;
    hadSeveral = several;
    jittered.hidden = !several || !Number(jitter.value);
  }

  let pace = 1; // seconds on the wall for one of the rig's clock, which a simulated rig may run faster
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
    if ([...element.elements].some((input) => input.willValidate && !input.validity.valid)) return fill(summary, "No poses yet.");
    asked = new AbortController();
    const plan = value();
    try {
      const estimated = await post("/api/plans/estimate", { ...of(), plan }, asked.signal);
      pace = estimated.wall_s / estimated.duration_s || 1;
      fill(summary, estimateText(plan, estimated));
      warn(estimated.warnings);
    } catch (problem) {
      if (problem.name === "AbortError") return;
      fill(summary, serviceError(problem).message);
      markWrong(element, problem.fields);
    }
  }

  function warn(sentences) {
    cautions.hidden = !sentences.length;
    fill(cautions, paragraphs(sentences));
  }

  element.addEventListener("input", refresh);
  element.addEventListener("invalid", ({ target }) => unfold(target), true); // the browser shows why it is refused
  signal.addEventListener("abort", forget);
  refresh();
  /** Fills the plan from the address: `mounts=0,120&axis=x`. */
  function prefill(query) {
    mounts.set({ mounts_deg: query.get("mounts")?.split(","), mount_axis: query.get("axis") });
    refresh();
  }

  /** Fills the form from a plan: one that the service has designed, or that of an earlier batch. */
  function take(plan) {
    const values = { ...plan, expanded_uncertainty_deg: plan.until?.expanded_uncertainty_deg ?? null };
    for (const [name, input] of inputs) if (name in values) input.value = values[name] ?? "";
    order.value = plan.order;
    mounts.set(plan);
    hadSeveral = plan.mounts_deg?.length > 1; // with its own jitter
    const shape = plan.kind === "sweep" ? asTurns : plan.elevations_deg ? asList : asRange;
    shape.input.checked = true;
    if (shape === asList) list.value = plan.elevations_deg.join(", ").replaceAll("-", "−");
    refresh();
  }

  const begin = (start) => (designer.querySelector("#use-plan") ? askConfirmation(UNUSED, start) : start());
  return { element, value, estimate, prefill, take, begin };
}

const UNUSED = {
  title: "Start without the designed plan?",
  text: "The form still has its own plan. To measure with the designed one, cancel and press Use this plan.",
  action: "Start the form's plan",
};

/** A plan as text, to see whether two are the same. */
function comparable({ kind, elevations_deg: list, until, ...plan }) {
  return JSON.stringify([kind, list, until ?? null, Object.keys(STANDARD).map((name) => plan[name] ?? null)]);
}

/** The design of a plan, folded: loaded when the user opens it. */
function designDetails(of, take, pace, signal) {
  const element = h("details", { id: "designer" }, h("summary", {}, "By uncertainty"));
  const open = async () => {
    const { planDesigner } = await import("./plandesign.js");
    element.append(planDesigner(of, take, pace, signal));
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
  return field(name, unit ? `${label}, ${unit}` : label, input);
}

function radio(value, label, checked) {
  const input = h("input", { type: "radio", name: "elevations", id: `as-${value}`, value, checked });
  return { input, element: h("label", { for: `as-${value}` }, input, label) };
}

function number(input) {
  return input.value === "" ? null : Number(input.value);
}

/** The number of poses, their range and the duration that the service has estimated. */
function estimateText(plan, { n_poses: poses, wall_s: seconds, elevations_deg: elevations }) {
  const upTo = plan.target_std_deg || plan.until ? "at most about" : "about";
  const turns = (plan.mounts_deg?.length ?? 1) - 1;
  const wait = plan.wait_temperature_c === null ? "" : ", plus the wait for temperature";
  const each = turns && `; ${plural(poses / plan.mounts_deg.length, "pose")} per mounting, the unit remounted `;
  const often = turns && (["once", "twice"][turns - 1] ?? `${turns} times`);
  const [low, high] = [Math.min(...elevations), Math.max(...elevations)].map((end) => fixed(end, end % 1 ? 1 : 0, "°"));
  const jitter = plan.jitter_deg ? `, jitter ±${Number(plan.jitter_deg.toPrecision(2))}°` : "";
  return [
    h("strong", {}, plural(poses, "pose")),
    `, ${low} to ${high}${jitter}, ${upTo} ${duration(seconds)}${wait}`,
    turns > 0 && each + often,
  ];
}

const MOUNTS = ["0", "0, 120, 240", "0, 51.43, 154.29"];
const AXES = ["x", "y", "z", "-x", "-y", "-z"];

/** The fields; `value()` is their part of the plan, `set(plan)` fills them from a plan. */
function mountFields() {
  const angles = h("input", { id: "mounts_deg", type: "text", list: "mounts-usual", value: "0", required: true });
  const usual = h("datalist", { id: "mounts-usual" }, MOUNTS.map((value) => h("option", { value })));
  const axis = select({ id: "mount_axis" }, AXES.map((value) => [value, value.replace("-", "−")]));

  function set({ mounts_deg: mounts, mount_axis: along }) {
    if (mounts) angles.value = mounts.join(", ");
    if (AXES.includes(along)) axis.value = along;
  }

  const element = h(
    "div",
    { class: "fields two" },
    h("div", { class: "field" }, h("label", { for: "mounts_deg" }, "Mounting angles, °"), angles, usual),
    field("mount_axis", "Unit axis along stage axis", axis),
  );
  return { element, set, value: () => ({ mounts_deg: numbers(angles.value), mount_axis: axis.value }) };
}

/** "−60, 0; 60.5" as numbers; a word that is no number stays a word, and the service refuses it by name. */
function numbers(text) {
  const words = text
    .replaceAll("−", "-")
    .split(/[\s,;]+/)
    .filter(Boolean);
  return words.map((word) => (Number.isFinite(Number(word)) ? Number(word) : word));
}
