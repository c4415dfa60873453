// The table of a batch's units, and their counts.

import { button, dataTable, fill, h, runLink, tableRow, unitLink } from "./dom.js";
import { may } from "./me.js";

export class UnitsTable {
  /** `take(unit)` removes a waiting unit. */
  constructor(take) {
    this.take = take;
    this.element = h("section", { class: "card", "aria-labelledby": "queue-units-title" });
  }

  show({ units, closed_at: closed }) {
    const shown = JSON.stringify([units, closed]);
    if (shown === this.shown) return; // a button in the table keeps the focus
    this.shown = shown;
    const names = ["Unit", "State", "Rig", "Run", "Why", "Change"];
    const table = dataTable("Units of this batch", names, units.map((turn) => this.#row(turn, closed)), { id: "queue-units" });
    fill(this.element, h("h2", { id: "queue-units-title" }, "Units"), table);
  }

  #row(turn, closed) {
    const canGo = !closed && turn.state === "waiting" && may("operator");
    const props = { class: "small", "aria-label": `Remove ${turn.unit}` };
    const state = turn.word ?? turn.state;
    return tableRow(unitLink(turn.unit), [
      h("span", { class: `pill turn-${state}` }, state.replace("_", "-")),
      turn.rig ?? "–",
      turn.run_id ? runLink(turn.run_id) : "–",
      h("td", { class: "wrap" }, turn.why),
      h("td", { class: "plain" }, canGo && button("Remove", () => this.take(turn.unit), props)),
    ]);
  }
}

/** The state of a unit that is in the batch already. */
export function standingOf(serial, units) {
  const turn = units.findLast(({ unit }) => unit === serial);
  const place = units.filter(({ state }) => state === "waiting").indexOf(turn) + 1;
  if (turn.state === "running") return `${serial} is being measured on rig ${turn.rig}.`;
  if (turn.state === "waiting") return `${serial} is in the batch already, as number ${place} of the waiting units.`;
  if (turn.state === "follow_up") return `${serial} is in the batch already: a follow-up run identifies why it failed.`;
  return `${serial} has been measured in this batch: ${(turn.word ?? turn.state).toUpperCase()}.`;
}

/** Counts units: still to be measured, and by their last result. A unit that failed may be still to be measured again. */
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
