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
  const now = document.activeElement; // a field that was taken out and put back has lost the focus, too
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

/** A table in a box of its own that scrolls sideways on a narrow screen, also by keyboard. */
export function tableBox(label, table) {
  return h("div", { class: "table-box", role: "region", "aria-label": `Table: ${label}`, tabindex: "0" }, table);
}

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
    const folded = input.closest("details");
    if (folded) folded.open = true;
    first ??= input;
  }
  return first;
}

/** Disables buttons while what they ask for is done. What it gives enables them, and one that had the focus has it again. */
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
 * What a form does when it is submitted: `send` runs with the button disabled; what it throws stands in the error
 * line and goes to `failed`; the fields that it names are marked, and the first of them has the focus.
 */
export function onSubmit(form, button, error, send, failed = () => {}) {
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const release = held(button);
    error.say(null);
    markWrong(form);
    try {
      await send();
    } catch (problem) {
      error.say(problem);
      failed(problem);
      markWrong(form, problem.fields)?.focus();
    } finally {
      release();
    }
  });
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
