// The units of a list in a table, and how many there are of each kind.

import { fill, h, headings, runLink, tableBox, unitLink } from "./dom.js";
import { may } from "./me.js";

export class UnitsTable {
  /** `take(unit)` takes a unit out that waits. */
  constructor(take) {
    this.take = take;
    this.element = h("section", { class: "card", "aria-labelledby": "queue-units-title" });
  }

  show({ units, closed_at: closed }) {
    const shown = JSON.stringify([units, closed]);
    if (shown === this.shown) return; // a button in the table keeps the focus
    this.shown = shown;
    const names = headings("Unit", "State", "Rig", "Run", "Why", "Change");
    const table = h("table", { id: "queue-units" }, names, h("tbody", {}, units.map((turn) => this.#row(turn, closed))));
    fill(this.element, h("h2", { id: "queue-units-title" }, "Units"), tableBox("Units of this list", table));
  }

  #row(turn, closed) {
    const canGo = !closed && turn.state === "waiting" && may("operator");
    const take = { type: "button", class: "small", "aria-label": `Remove ${turn.unit}`, on: { click: () => this.take(turn.unit) } };
    return h(
      "tr",
      {},
      h("th", { scope: "row" }, unitLink(turn.unit)),
      h("td", {}, h("span", { class: `pill turn-${turn.word ?? turn.state}` }, (turn.word ?? turn.state).replace("_", "-"))),
      h("td", {}, turn.rig ?? "–"),
      h("td", {}, turn.run_id ? runLink(turn.run_id) : "–"),
      h("td", { class: "wrap" }, turn.why),
      h("td", { class: "plain" }, canGo && h("button", take, "Remove")),
    );
  }
}

/** What a list has of a unit already, for whoever names it once more. */
export function standingOf(serial, units) {
  const turn = units.findLast(({ unit }) => unit === serial);
  const place = units.filter(({ state }) => state === "waiting").indexOf(turn) + 1;
  if (turn.state === "running") return `${serial} is being measured on rig ${turn.rig}.`;
  if (turn.state === "waiting") return `${serial} is in the list already: number ${place} of those that wait.`;
  if (turn.state === "follow_up") return `${serial} is in the list already: another run of it tells why it failed.`;
  return `${serial} has had its turn in this list: ${(turn.word ?? turn.state).toUpperCase()}.`;
}

/** Units: those with a turn to come, and the others and they by their last word. One may be to go and have failed. */
export function counted(units) {
  const words = new Map();
  const left = new Set();
  for (const { unit, state, word } of units) {
    if (word || state === "failed") words.set(unit, word ?? "fail");
    if (!["done", "failed"].includes(state)) left.add(unit);
  }
  const poor = [...words.values()].filter((word) => word === "fail").length;
  return { left: left.size, poor, good: words.size - poor };
}
