// A run's plan and provenance as lists of names and values.

import { h } from "./dom.js";

export function provenanceLists(run) {
  return [
    list("Plan", run.plan ?? {}, "plan-details"),
    list("Provenance", run.provenance, "provenance"),
  ];
}

function list(title, document, testid) {
  const rows = flatten(document);
  const body = rows.length
    ? h("dl", { class: "pairs" }, rows.map(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]))
    : h("p", { class: "muted" }, "Nothing recorded.");
  return h("div", { "data-testid": testid }, h("h3", {}, title), body);
}

/** Nested names joined by dots; a list of plain values on one line. */
function flatten(value, name = "") {
  if (value === null) return [[name, "–"]];
  if (Array.isArray(value) && value.every((item) => typeof item !== "object")) {
    return [[name, value.length ? value.join(", ") : "none"]];
  }
  if (typeof value === "object") {
    return Object.entries(value).flatMap(([key, item]) => flatten(item, name ? `${name}.${key}` : key));
  }
  return [[name, String(value)]];
}
