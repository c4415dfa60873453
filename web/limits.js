// Limits for verdicts: one card per limit, tried from the top; saved together.

import { get, put } from "./api.js";
import { button, errorLine, field, fill, h, onSubmit, select } from "./dom.js";
import { may } from "./me.js";

const FIGURES = [
  ["max_error_deg", "Largest error, °"],
  ["rms_deg", "RMS error, °"],
  ["expanded_uncertainty_deg", "Expanded uncertainty, °"],
];
const RANGES = [
  ["bias_deg", "Bias", ", °"],
  ["scale", "Scale", ""],
];
const RULES = [
  ["simple", "Simple"],
  ["guarded", "Guarded"],
];
const NEW = { units: "*", rule: "guarded", guard: 1 };

export async function limitsView({ root, signal }) {
  const [limits, rigs] = await Promise.all([get("/api/limits", signal), get("/api/rigs", signal)]);
  fill(root, h("h1", {}, "Limits"), explanation(), limitsForm(limits, rigs));
}

function explanation() {
  const rules =
    "The first limit whose units and rig match applies to a result. The verdict is pass, conditional pass, conditional " +
    "fail or fail. The simple rule compares the figure with its limit L. The guarded rule passes up to L − w and fails " +
    "from L + w on, with w = guard factor × expanded uncertainty. An empty field sets no limit.";
  const unknown =
    "Without a known expanded uncertainty nothing passes. While the level is unknown, a limit on the bias is undecided, " +
    "and the largest error is that of the elevation relative to its mean over the range.";
  return h("section", { class: "card prose" }, h("p", {}, rules), h("p", { class: "muted" }, unknown));
}

function limitsForm(limits, rigs) {
  const cards = [];
  const list = h("div", { id: "limits", class: "limits" });
  const error = errorLine("limits-error");
  const saved = h("p", { id: "limits-saved", class: "muted", role: "status" });
  const save = h("button", { id: "save-limits", type: "submit", class: "primary" }, "Save");
  const add = h("button", { id: "add-limit", type: "button" }, "Add a limit");
  const form = h(
    "form",
    { id: "limits-form", novalidate: true },
    list,
    error.element,
    may("admin")
      ? h("div", { class: "buttons" }, save, add, saved)
      : h("p", { class: "muted" }, "Only an admin can change limits."),
  );

  function show(focus) {
    cards.forEach((card, k) => card.number(k, cards.length));
    const none = h("p", { class: "card muted" }, "No limits yet. Verdicts describe the residual, without pass or fail.");
    fill(list, cards.length ? cards.map((card) => card.element) : none);
    focus?.focus();
  }

  function insert(limit) {
    const card = limitCard(limit, rigs, {
      move: (by, button) => {
        const from = cards.indexOf(card);
        cards.splice(from, 1);
        cards.splice(from + by, 0, card);
        show(button);
      },
      remove: () => {
        cards.splice(cards.indexOf(card), 1);
        show(add);
      },
    });
    cards.push(card);
    return card;
  }

  limits.forEach(insert);
  show();
  add.addEventListener("click", () => show(insert(NEW).first));
  form.addEventListener("input", () => (saved.textContent = ""));
  form.addEventListener("click", (event) => event.target !== save && (saved.textContent = ""));
  onSubmit(form, save, error, async () => {
    await put("/api/limits", cards.map((card) => card.value()));
    saved.textContent = "Saved. These limits now apply to the verdicts of all runs.";
  });
  return form;
}

/** A limit's fields: `value()` reads them, `number(k, n)` names them as limit k of n. */
function limitCard(limit, rigs, { move, remove }) {
  const title = h("legend");
  const inputs = new Map();
  const make = (key, label, input) => {
    inputs.set(key, input);
    return field("", label, input);
  };
  const text = (key) => h("input", { type: "text", value: limit[key], autocomplete: "off", spellcheck: "false" });
  const number = (value) => h("input", { type: "number", step: "any", inputmode: "decimal", value });
  const names = new Set([...rigs.map(({ name }) => name), limit.rig].filter(Boolean));
  const small = { class: "small" };
  const up = button("Move up", () => move(-1, up), small);
  const down = button("Move down", () => move(1, down), small);
  const gone = button("Remove", remove, small);
  const rig = select({}, [["", "any rig"], ...names], limit.rig ?? "");
  const element = h(
    "fieldset",
    { class: "card limit" },
    title,
    may("admin") && h("div", { class: "limit-order" }, up, down, gone),
    h(
      "div",
      { class: "fields four" },
      make("name", "Name", text("name")),
      make("units", "Units (wildcards * and ?)", text("units")),
      make("rig", "Rig", rig),
    ),
    h("div", { class: "fields four" }, FIGURES.map(([key, label]) => make(key, label, number(limit[key])))),
    h(
      "div",
      { class: "fields four" },
      RANGES.flatMap(([key, label, unit]) => [
        make(`${key}[0]`, `${label} from${unit}`, number(limit[key]?.[0])),
        make(`${key}[1]`, `${label} to${unit}`, number(limit[key]?.[1])),
      ]),
    ),
    h(
      "div",
      { class: "fields four" },
      make("rule", "Decision rule", select({}, RULES, limit.rule)),
      make("guard", "Guard factor, w/U", number(limit.guard)),
    ),
  );
  const guarded = () => (inputs.get("guard").parentElement.hidden = inputs.get("rule").value !== "guarded");
  inputs.get("rule").addEventListener("change", guarded);
  guarded();

  return {
    element,
    first: inputs.get("name"),
    number(place, of) {
      title.textContent = `Limit ${place + 1}`;
      up.disabled = place === 0;
      down.disabled = place === of - 1;
      for (const button of [up, down, gone])
        button.setAttribute("aria-label", `${button.textContent}: limit ${place + 1}`);
      for (const [key, input] of inputs) {
        input.name = `[${place}].${key}`;
        input.id = `limit-${place}-${key}`;
        input.previousElementSibling.htmlFor = input.id;
      }
    },
    value() {
      const given = (key) => inputs.get(key).value.trim();
      const figure = (key) => (given(key) === "" ? null : Number(given(key)));
      const range = (key) => {
        const ends = [figure(`${key}[0]`), figure(`${key}[1]`)];
        return ends.every((end) => end === null) ? null : ends;
      };
      return {
        name: given("name"),
        units: given("units"),
        rig: given("rig") || null,
        ...Object.fromEntries(FIGURES.map(([key]) => [key, figure(key)])),
        ...Object.fromEntries(RANGES.map(([key]) => [key, range(key)])),
        rule: given("rule"),
        guard: given("rule") === "guarded" ? figure("guard") : 1,
      };
    },
  };
}
