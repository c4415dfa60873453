// The poses of a run as a table; one can be excluded, with a reason, and stays in sight.

import { h, headings } from "./dom.js";
import { fixed, plusMinus } from "./format.js";

const APPROACH = { 1: ["▲", "upward"], "-1": ["▼", "downward"] };

export class PoseTable {
  /** Called with a pose when somebody wants it out, or in again. */
  constructor(onExclude, onInclude) {
    this.onExclude = onExclude;
    this.onInclude = onInclude;
    this.rows = new Map();
    this.body = h("tbody");
    const names = [
      "Pose",
      "#Sweep",
      "#Target",
      "#Stage",
      "#Reading",
      "#Raw error",
      "#Residual",
      "Approach",
      "#Temperature",
      "#Samples",
      "#Settling",
      "",
    ];
    this.element = h("table", { id: "poses-table" }, headings(...names), this.body);
  }

  get size() {
    return this.rows.size;
  }

  /** Shows poses, each once: one that is there already is replaced. */
  show(poses, excludable) {
    for (const pose of poses) {
      const row = this.#row(pose, excludable);
      const old = this.rows.get(pose.index);
      if (old) old.replaceWith(row);
      else this.body.append(row);
      this.rows.set(pose.index, row);
    }
  }

  #row(pose, excludable) {
    const [arrow, words] = APPROACH[pose.approach] ?? ["–", "not known"];
    const number = (text) => h("td", { class: "number" }, text);
    return h(
      "tr",
      { class: pose.excluded && "voided", "data-pose": pose.index },
      h("th", { scope: "row" }, pose.index),
      number(pose.pass ?? "–"),
      number(fixed(pose.target_deg, 2, "°")),
      number(orDash(pose.stage_deg, 3, "°")),
      number(plusMinus(pose.reading_deg, pose.reading_stderr_deg, "°")),
      number(orDash(pose.raw_error_deg, 3, "°")),
      number(orDash(pose.residual_deg, 3, "°")),
      h(
        "td",
        { class: "plain" },
        h("span", { role: "img", "aria-label": `approached: ${words}`, title: words }, arrow),
      ),
      number(orDash(pose.temperature_c, 1, "°C")),
      number(pose.n_samples ?? "–"),
      number(orDash(pose.settle_s, 2, "s")),
      h("td", { class: "plain" }, this.#action(pose, excludable)),
    );
  }

  #action(pose, excludable) {
    const [verb, act] = pose.excluded ? ["Include", this.onInclude] : ["Exclude", this.onExclude];
    const button = h(
      "button",
      {
        type: "button",
        class: "small",
        "aria-label": `${verb} pose ${pose.index}`,
        on: { click: () => act(pose) },
      },
      verb,
    );
    return [
      pose.excluded && h("span", { class: "reason" }, `excluded: ${pose.excluded} `),
      excludable && button,
    ];
  }
}

/** In a table a dash reads as "not known"; the column's heading says of what. */
function orDash(value, decimals, unit) {
  return value === null || value === undefined ? "–" : fixed(value, decimals, unit);
}
