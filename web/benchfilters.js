// Filters of the rigs: hall, state and text. The address stores them, for a reload or a link.

import { field, fill, h } from "./dom.js";

const ANY = "";
const NO_HALL = "(no hall)";

/** States of a rig, one of the first five, and what else needs attention. */
const KINDS = [
  ["idle", "idle", (rig) => rig.state === "idle"],
  ["busy", "busy", (rig) => rig.state === "busy" && !rig.run?.waiting_for],
  ["mount", "waits for mounting", (rig) => rig.state === "busy" && Boolean(rig.run?.waiting_for)],
  ["unreachable", "unreachable", (rig) => rig.state === "unreachable"],
  ["offline", "offline", (rig) => rig.state === "offline"],
  ["queued", "has runs waiting", (rig) => rig.queued.length > 0],
  ["failed", "failed, unresolved", (rig) => rig.unresolved !== null],
  ["overdue", "check overdue", (rig) => Boolean(rig.check?.overdue)],
];

export function hallOf(bench) {
  return bench.hall ?? NO_HALL;
}

/** A key that is unique to a rig. */
export function keyOf(bench, rig) {
  return `${bench.name}/${rig.name}`;
}

/** Names with numbers in them as people sort them, the nameless last. */
export function inOrder(a, b) {
  if ((a === NO_HALL) !== (b === NO_HALL)) return a === NO_HALL ? 1 : -1;
  return (a ?? "").localeCompare(b ?? "", undefined, { numeric: true });
}

export class BenchFilters {
  /** `query` is the address's; `changed()` is called when a filter changes. */
  constructor(query, changed) {
    this.hall = query.get("hall") ?? ANY;
    this.kind = KINDS.some(([key]) => key === query.get("show")) ? query.get("show") : ANY;
    this.halls = h("select", { id: "filter-hall" });
    this.text = h("input", {
      id: "filter-text",
      type: "search",
      autocomplete: "off",
      spellcheck: "false",
      placeholder: "any",
      value: query.get("q"),
    });
    this.counts = new Map();
    const choices = [[ANY, "all"], ...KINDS].map(([key, title]) => this.#choice(key, title));
    this.element = h(
      "form",
      { class: "card bench-filters", role: "search", "aria-label": "Filter rigs" },
      h(
        "div",
        { class: "fields two" },
        field("filter-hall", "Hall", this.halls),
        field("filter-text", "Rig, bench or unit", this.text),
      ),
      h(
        "fieldset",
        {},
        h("legend", { class: "for-screen-readers" }, "State of the rigs"),
        h("div", { class: "choices" }, choices),
      ),
    );
    const take = () => {
      this.hall = this.halls.value;
      this.kind = this.element.elements.show.value;
      this.#keep();
      changed();
    };
    this.element.addEventListener("input", take);
    this.element.addEventListener("submit", (event) => event.preventDefault());
  }

  #choice(key, title) {
    const count = h("span", { class: "count" });
    this.counts.set(key, count);
    const input = h("input", { type: "radio", name: "show", value: key, checked: key === this.kind });
    return h("label", {}, input, h("span", {}, `${title} `, count));
  }

  /** Stores the filters in the address, without a history entry for each letter. */
  #keep() {
    const query = new URLSearchParams();
    const wanted = { hall: this.hall, show: this.kind, q: this.text.value.trim() };
    for (const [name, value] of Object.entries(wanted)) if (value) query.set(name, value);
    const text = query.toString();
    history.replaceState(history.state, "", `#/benches${text && `?${text}`}`);
  }

  /** The keys of the rigs that match, and the number of all rigs; updates the count of each choice. */
  choose(benches) {
    const words = this.text.value.trim().toLowerCase().split(/\s+/);
    const all = benches.flatMap((bench) => bench.rigs.map((rig) => ({ bench, rig })));
    const named = all.filter((one) => words.every((word) => saysOf(one).includes(word)));
    const isKind = KINDS.find(([key]) => key === this.kind)?.[2] ?? (() => true);
    const ofKind = named.filter(({ rig }) => isKind(rig));
    const isHere = ({ bench }) => this.hall === ANY || hallOf(bench) === this.hall;
    const here = named.filter(isHere);
    this.counts.get(ANY).textContent = here.length;
    for (const [key, , is] of KINDS) this.counts.get(key).textContent = here.filter(({ rig }) => is(rig)).length;
    this.#showHalls(benches, ofKind);
    return { rigs: new Set(ofKind.filter(isHere).map(({ bench, rig }) => keyOf(bench, rig))), count: all.length };
  }

  /** Updates the halls; the selected one remains a choice while no bench is in it. */
  #showHalls(benches, found) {
    const names = [...new Set([...benches.map(hallOf), ...(this.hall ? [this.hall] : [])])].sort(inOrder);
    const count = (name) => found.filter(({ bench }) => hallOf(bench) === name).length;
    const options = [["", `all halls (${found.length})`], ...names.map((name) => [name, `${name} (${count(name)})`])];
    const now = JSON.stringify(options);
    if (now === this.options) return; // an open list is not changed under the pointer for nothing
    this.options = now;
    const kept = options.map(([value, text]) => h("option", { value, selected: value === this.hall }, text));
    fill(this.halls, kept);
  }
}

function saysOf({ bench, rig }) {
  const runs = [rig.run, rig.unresolved, ...rig.queued].filter(Boolean);
  return [rig.name, bench.name, rig.check?.unit, ...runs.flatMap(({ id, unit }) => [id, unit])].join(" ").toLowerCase();
}
