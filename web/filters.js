// Filters of a list. The address stores them, for reload, links and history.

import { field, h, select } from "./dom.js";

const TYPING_MS = 250;

/** A field for a part of a text. */
export function searchField(id, value) {
  const rest = { autocomplete: "off", spellcheck: "false", maxlength: "200", placeholder: "any" };
  return h("input", { id, type: "search", value, ...rest });
}

/** A field for one of some values, or any. */
export function choice(id, options, value) {
  return select({ id }, [["", "any"], ...options], value);
}

/**
 * `element`, the form, and `values()`, the filters that are set, by name. `inputs` are titles and fields by the name of
 * each in the address; `changed()` is called when one changes, after a pause while text is typed.
 */
export function filterForm(label, inputs, changed, signal) {
  const entries = Object.entries(inputs);
  const set = () => entries.flatMap(([key, [, { value }]]) => (value.trim() ? [[key, value.trim()]] : []));

  /** Stores the filters in the address, without a history entry for each letter. */
  function keep() {
    const [path, old] = (location.hash || "#/").split("?", 2);
    const all = new URLSearchParams(old);
    for (const [key] of entries) all.delete(key);
    for (const [key, value] of set()) all.set(key, value);
    history.replaceState(history.state, "", path + (all.size ? `?${all}` : ""));
  }

  let timer;
  const fields = entries.map(([, [title, input]]) => field(input.id, title, input));
  const element = h("form", { class: "filters", role: "search", "aria-label": label }, fields);
  element.addEventListener("submit", (event) => event.preventDefault());
  element.addEventListener("input", ({ target }) => {
    clearTimeout(timer);
    keep();
    if (target.type === "search") timer = setTimeout(changed, TYPING_MS);
    else changed();
  });
  signal.addEventListener("abort", () => clearTimeout(timer));
  return { element, values: () => Object.fromEntries(set()) };
}
