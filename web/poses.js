// The table of a run's poses; excluded ones stay visible, with the reason.

import { h, headings, numberCell } from "./dom.js";
import { fixed, plusMinus } from "./format.js";

const APPROACH = { 1: ["▲", "upward"], "-1": ["▼", "downward"] };

const ANGLES = ["#Target", "#Stage", "#Reading", "#Raw error", "#Residual"];
const NAMES = ["Pose", "#Sweep", ...ANGLES, "Approach", "#Temperature", "#Samples", "#Settling", ""];

export class PoseTable {
  /** The callbacks get the pose to exclude or to include again. */
  constructor(onExclude, onInclude) {
    this.onExclude = onExclude;
    this.onInclude = onInclude;
    this.rows = new Map();
    this.body = h("tbody");
    this.element = h("table", { id: "poses-table" }, headings(...NAMES), this.body);
  }

  get size() {
    return this.rows.size;
  }

  /** Adds poses; one that is in the table already is replaced. */
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
    return h(
      "tr",
      { class: pose.excluded && "voided", "data-pose": pose.index },
      h("th", { scope: "row" }, pose.index),
      numberCell(pose.pass ?? "–"),
      numberCell(fixed(pose.target_deg, 2, "°")),
      numberCell(orDash(pose.stage_deg, 3, "°")),
      numberCell(plusMinus(pose.reading_deg, pose.reading_stderr_deg, "°")),
      numberCell(orDash(pose.raw_error_deg, 3, "°")),
      numberCell(orDash(pose.residual_deg, 3, "°")),
      h(
        "td",
        { class: "plain" },
        h("span", { role: "img", "aria-label": `approached: ${words}`, title: words }, arrow),
      ),
      numberCell(orDash(pose.temperature_c, 1, "°C")),
      numberCell(pose.n_samples ?? "–"),
      numberCell(orDash(pose.settle_s, 2, "s")),
      h("td", { class: "plain" }, this.#action(pose, excludable)),
    );
  }

  #action(pose, excludable) {
    const [verb, act] = pose.excluded ? ["Include", this.onInclude] : ["Exclude", this.onExclude];
    const props = { type: "button", class: "small", "aria-label": `${verb} pose ${pose.index}`, on: { click: () => act(pose) } };
    const reason = pose.excluded && h("span", { class: "reason" }, `excluded: ${pose.excluded} `);
    return [reason, excludable && h("button", props, verb)];
  }
}

/** In tables a dash stands for "not known". */
function orDash(value, decimals, unit) {
  return value === null || value === undefined ? "–" : fixed(value, decimals, unit);
}
