// Folds: one line each for what is not needed at first sight. They are open on paper.

import { fill, h } from "./dom.js";

export class Fold {
  constructor(id, title, ...content) {
    this.title = h("h2", { id: `${id}-title` }, title);
    this.line = h("span", { class: "muted" });
    this.element = h(
      "details",
      { class: "fold", id: `${id}-fold` },
      h("summary", {}, this.title, this.line),
      h("div", {}, content),
    );
  }

  get isOpen() {
    return this.element.open;
  }

  open(isOpen) {
    this.element.open = isOpen;
  }

  /** The line beside the title. */
  say(...text) {
    fill(this.line, text);
  }

  /** Calls `show` whenever it is opened: a chart is drawn in the size of its place, which a closed fold does not have. */
  onOpen(show, signal) {
    onOpen(this.element, show, signal);
  }
}

/** As `Fold.onOpen`, of any <details>. */
export function onOpen(details, show, signal) {
  details.addEventListener("toggle", () => details.open && show(), { signal });
}

/** Does `change` to what is within `element`; a fold that was open stays so, known by its `data-fold` or its id. */
export function keepingFolds(element, change) {
  const folds = () => Map.groupBy(element.querySelectorAll("details"), ({ id, dataset }) => dataset.fold ?? id);
  const before = folds();
  change();
  for (const [key, now] of folds()) now.forEach((fold, k) => (fold.open = before.get(key)?.[k]?.open ?? fold.open));
}

let unfolded = [];

window.addEventListener("beforeprint", () => {
  const folded = document.querySelectorAll("main details:not([open])");
  unfolded.push(...folded);
  for (const one of folded) one.open = true;
});
window.addEventListener("afterprint", () => {
  for (const one of unfolded) one.open = false;
  unfolded = [];
});
