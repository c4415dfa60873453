// Elements without innerHTML: whatever comes from the service or a person ends up as text.

// Controls that have no look of their own, those among them that turn the direction of what stands around.
const UNSEEN = /[\u0000-\u0008\u000b-\u001f\u007f-\u009f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u2069\ufeff]/g;

/** A text as it can be read: a control in it is shown by its code, so that no text poses as another one. */
export function visible(text) {
  return text.replace(UNSEEN, (sign) => `\\u${sign.charCodeAt(0).toString(16).padStart(4, "0")}`);
}

/**
 * An element. `props` are attributes, except `on` (listeners by event); `true` sets a bare attribute,
 * null, undefined and false leave it out. Children are nodes, texts, or arrays of both.
 */
export function h(tag, props = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (name === "on") {
      for (const [event, listener] of Object.entries(value)) element.addEventListener(event, listener);
    } else if (value !== null && value !== undefined && value !== false) {
      element.setAttribute(name, value === true ? "" : String(value));
    }
  }
  element.append(...shown(children));
  return element;
}

function shown(children) {
  const kept = children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false);
  return kept.map((child) => (child instanceof Node ? child : visible(String(child))));
}

/** Replaces what an element holds; null and false among the children are left out. */
export function fill(element, ...children) {
  element.replaceChildren(...shown(children));
}

/**
 * Does `change` to what is within `element`, and leaves the focus where it was there: on what has its id now, else on
 * the view itself, where the keyboard goes on, and never on nothing.
 */
export function keepingFocus(element, change) {
  const had = document.activeElement;
  const isInside = element.contains(had);
  change();
  const now = document.activeElement; // a field that was removed and inserted again has lost the focus
  const isKept = now === had && had.checkVisibility();
  const isElsewhere = now !== had && now !== document.body;
  if (!isInside || isKept || isElsewhere) return;
  const same = had.id && document.getElementById(had.id);
  (same?.checkVisibility() ? same : element.closest("main"))?.focus({ preventScroll: true });
}

export function unitHref(serial) {
  return `#/units/${encodeURIComponent(serial)}`;
}

export function runHref(id) {
  return `#/runs/${encodeURIComponent(id)}`;
}

const UUID = /^[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}$/;

/** What a run is called where people read: a UUID by its first 8 characters, a number of older days as it is. */
export function runName(id) {
  return UUID.test(id) ? id.slice(0, 8) : id;
}

/** A run by that name, after `word`; the address and the title have the whole id. */
export function runLink(id, word = "") {
  return h("a", { href: runHref(id), title: id }, word + runName(id));
}

export function rigHref(name) {
  return `#/rigs/${encodeURIComponent(name)}`;
}

/** Where runs of a rig are solved together, with some of them or those of a unit ticked. */
export function solveHref({ rig, runs = [], unit }) {
  const named = [["rig", rig ?? ""], ...(unit ? [["unit", unit]] : []), ...runs.map((id) => ["run", id])];
  return `#/solve?${new URLSearchParams(named)}`;
}

export function unitLink(serial) {
  return h("a", { href: unitHref(serial), class: "serial" }, serial);
}

/** A run's status as a coloured word; the word alone carries the meaning. */
export function statusPill(status, props = {}) {
  return h("span", { ...props, class: `pill ${status}` }, status);
}

/** Beside a run that was made while its rig was in doubt; `suspect` is null for every other one. */
export function suspectTag(suspect) {
  return suspect && h("span", { class: "tag warns", title: suspect.reason }, "suspect");
}

/** An input with its label above it. */
export function field(id, label, input) {
  return h("div", { class: "field" }, h("label", { for: id }, label), input);
}

/** The input of a unit's serial number. */
export function serialInput(value = null) {
  return h("input", { id: "unit", type: "text", required: true, autocomplete: "off", spellcheck: "false", value });
}

/** A drop-down list of [value, text] pairs, or of values that are their own text. */
export function select(props, options, chosen) {
  const option = ([value, text = value]) => h("option", { value, selected: value === chosen }, text);
  return h("select", props, options.map((one) => option([one].flat())));
}

/** A card under a heading whose id is the card's with "-title". */
export function card(id, title, ...content) {
  const props = { class: "card", id, "aria-labelledby": `${id}-title` };
  return h("section", props, h("h2", { id: `${id}-title` }, title), content);
}

/** Named figures: pairs of a name and a value; what is null or false is left out. */
export function figureList(rows, props = {}, ...more) {
  const pairs = rows.filter(Boolean).map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value)));
  return h("dl", { class: "figures", ...props }, pairs, more);
}

/** A paragraph for each sentence, or a list of them. */
export const paragraphs = (sentences) => sentences.map((sentence) => h("p", {}, sentence));
export const bullets = (items, props = {}) => h("ul", props, items.map((item) => h("li", {}, item)));

/** Sentences of caution under their heading; nothing where there are none. */
export function warningBox(sentences, testid) {
  if (!sentences.length) return null;
  return h("div", { class: "cautions", "data-testid": testid }, h("h3", {}, "Warnings"), bullets(sentences));
}

/**
 * A table in a box of its own that scrolls if it is long, also by keyboard. On a narrow screen its rows are cards
 * (views.css), in which each cell shows its heading.
 */
export function tableBox(label, table) {
  if (table instanceof HTMLTableElement) keepLabelled(table);
  return h("div", { class: "table-box", role: "region", "aria-label": `Table: ${label}`, tabindex: "0" }, table);
}

/** Gives each cell its heading as `data-label`, also in rows that come later. */
function keepLabelled(table) {
  const names = [...(table.tHead?.rows[0]?.cells ?? [])].flatMap((cell) => Array(cell.colSpan).fill(cell.textContent));
  const label = () => {
    for (const row of [...table.tBodies].flatMap((body) => [...body.rows])) {
      if (!row.cells.length || "label" in row.cells[0].dataset) continue;
      let place = 0;
      for (const cell of row.cells) {
        cell.dataset.label = cell.colSpan === 1 ? (names[place] ?? "") : "";
        place += cell.colSpan;
      }
    }
  };
  label();
  new MutationObserver(label).observe(table, { childList: true, subtree: true });
}

/** A table with headings in such a box; `rows` are its rows, or its body. */
export function dataTable(label, names, rows, props = {}) {
  return tableBox(label, h("table", props, headings(...names), rows instanceof Node ? rows : h("tbody", {}, rows)));
}

/** A row of it under a heading; what is no cell among `cells` becomes one. */
export function tableRow(head, cells, props = {}) {
  const cell = (one) => (one instanceof HTMLTableCellElement ? one : h("td", {}, one));
  return h("tr", props, h("th", { scope: "row" }, head), cells.map(cell));
}

/** In place of a list of units that has none. */
export const NO_UNITS = "No units yet. A unit appears with its first run: calibrate one, or import its poses.";

export const numberCell = (text) => h("td", { class: "number" }, text);

/** A table's head; a name that begins with "#" stands over numbers, and none at all over buttons. */
export function headings(...names) {
  const cell = (name) =>
    h(
      "th",
      { scope: "col", class: name.startsWith("#") && "number" },
      name.replace(/^#/, "") || h("span", { class: "for-screen-readers" }, "Actions"),
    );
  return h("thead", {}, h("tr", {}, names.map(cell)));
}

/**
 * Marks the inputs of a form that a refusal names; the first of them, or null. An input's name, else its id, is the
 * place itself ("[0].rms_deg"), one within it, or its last word ("plan.sweeps" is #sweeps).
 */
export function markWrong(form, fields = []) {
  const isWrong = (key) =>
    fields.some((place) => {
      const whole = place.replace(/\[\d+\]$/, "");
      return key === place || key.startsWith(`${place}[`) || key === whole || key === whole.split(".").at(-1);
    });
  let first = null;
  for (const input of form.elements) {
    const key = input.name || input.id;
    if (!key || !isWrong(key)) {
      input.removeAttribute("aria-invalid");
      continue;
    }
    input.setAttribute("aria-invalid", "true");
    unfold(input);
    first ??= input;
  }
  return first;
}

/** Opens every fold around an element. */
export function unfold(element) {
  for (let fold = element.closest("details"); fold; fold = fold.parentElement.closest("details")) fold.open = true;
}

/** A button that calls `click`. */
export function button(text, click, props = {}) {
  return h("button", { type: "button", ...props, on: { click } }, text);
}

/** Disables buttons during a request. The function returned enables them, and gives one that had the focus it again. */
export function held(...buttons) {
  const had = document.activeElement;
  for (const button of buttons) button.disabled = true;
  return () => {
    for (const button of buttons) button.disabled = false;
    const isLost = document.activeElement === document.body || !document.activeElement.checkVisibility();
    if (isLost && buttons.includes(had)) had.focus({ preventScroll: true });
  };
}

/**
 * Has a form call `send` when it is submitted, with the button disabled. The error line shows what it throws; the fields
 * that the error names are marked, and the first of them gets the focus.
 */
export function onSubmit(form, button, error, send) {
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    markWrong(form);
    return attempt([button], error, send, (problem) => markWrong(form, problem.fields)?.focus());
  });
}

/** Calls `act` with the buttons disabled; the error line shows what it throws. */
export async function attempt(buttons, error, act, failed = () => {}) {
  const release = held(...buttons);
  error.say(null);
  try {
    await act();
  } catch (problem) {
    error.say(problem);
    failed(problem);
  } finally {
    release();
  }
}

/** Has the browser save what is in memory as a file. */
export function saveFile(blob, name) {
  const address = URL.createObjectURL(blob);
  h("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}

/** A line for an error near what caused it; empty and hidden until `say` is called. */
export function errorLine(id) {
  const element = h("p", { id, class: "error", role: "alert", hidden: true });
  return {
    element,
    say(error) {
      element.textContent = error ? visible(error.message) : "";
      element.hidden = !error;
    },
  };
}
