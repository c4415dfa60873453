// What units are held against: a card a limit, tried from the top; saved all at once.

import { get, put } from "./api.js";
import { errorLine, field, fill, h, onSubmit } from "./dom.js";
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
  return h(
    "section",
    { class: "card prose" },
    h(
      "p",
      {},
      "A result is held against the first limit whose units and rig match, and its verdict says pass, conditional ",
      "pass, conditional fail or fail. The simple rule compares the figure with its limit L; the guarded rule passes ",
      "up to L − w and fails from L + w on, with w = guard × expanded uncertainty. A field left empty asks nothing.",
    ),
    h(
      "p",
      { class: "muted" },
      "Without a known expanded uncertainty nothing passes. A limit on the bias cannot be decided while the level is ",
      "not known; the largest error is then that of the elevation less its mean over the range.",
    ),
  );
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
      : h("p", { class: "muted" }, "An admin may change them."),
  );

  function show(focus) {
    cards.forEach((card, k) => card.number(k, cards.length));
    const none = h("p", { class: "card muted" }, "No limit yet: verdicts say what is left, and nothing of pass or fail.");
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
    await put(
      "/api/limits",
      cards.map((card) => card.value()),
    );
    saved.textContent = "Saved. Verdicts of runs are by these limits now.";
  });
  return form;
}

/** A limit's fields: `value()` is what they say, `number(k, n)` names them for its place among n. */
function limitCard(limit, rigs, { move, remove }) {
  const title = h("legend");
  const inputs = new Map();
  const make = (key, label, input) => {
    inputs.set(key, input);
    return field("", label, input);
  };
  const text = (key) => h("input", { type: "text", value: limit[key], autocomplete: "off", spellcheck: "false" });
  const number = (value) => h("input", { type: "number", step: "any", inputmode: "decimal", value });
  const options = (pairs, chosen) =>
    pairs.map(([value, label]) => h("option", { value, selected: value === (chosen ?? "") }, label));
  const names = new Set([...rigs.map(({ name }) => name), limit.rig].filter(Boolean));
  const up = h("button", { type: "button", class: "small", on: { click: () => move(-1, up) } }, "Earlier");
  const down = h("button", { type: "button", class: "small", on: { click: () => move(1, down) } }, "Later");
  const gone = h("button", { type: "button", class: "small", on: { click: remove } }, "Remove");
  const rig = h("select", {}, options([["", "every rig"], ...[...names].map((name) => [name, name])], limit.rig));
  const element = h(
    "fieldset",
    { class: "card limit" },
    title,
    may("admin") && h("div", { class: "limit-order" }, up, down, gone),
    h(
      "div",
      { class: "fields four" },
      make("name", "Name", text("name")),
      make("units", "Units (* and ? as in file names)", text("units")),
      make("rig", "Rig", rig),
    ),
    h(
      "div",
      { class: "fields four" },
      FIGURES.map(([key, label]) => make(key, label, number(limit[key]))),
    ),
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
      make("rule", "Decision rule", h("select", {}, options(RULES, limit.rule))),
      make("guard", "Guard, w over U", number(limit.guard)),
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
