// One rig of a list: what to do at it now, or how far it is, and what came out last, in letters for three metres.

import { h, fill, runLink } from "./dom.js";
import { duration, fixed } from "./format.js";
import { may } from "./me.js";

const CALM_MS = 700; // an Enter meant for what stood here before starts nothing
const SHAPES = { pass: "✓", fail: "✗", done: "●" };

/** `begin({ rig, unit })` starts a turn; `ask(verb, run)` posts resume or abort. */
export class RigCard {
  constructor(name, begin, ask) {
    this.name = name;
    this.begin = begin;
    this.ask = ask;
    this.title = h("h2", {});
    this.result = h("p", { class: "big-word", hidden: true });
    this.of = h("p", { class: "big-unit" });
    this.todo = h("p", { class: "todo", role: "status", "aria-live": "assertive" });
    this.why = h("p", { class: "error", hidden: true });
    this.bar = h("progress", { max: "1", value: "0", "aria-label": `Progress on ${name}`, hidden: true });
    this.more = h("p", { class: "muted" });
    this.go = h("button", { type: "button", class: "primary", "data-go": name, on: { click: () => this.press() } });
    this.abort = h("button", { type: "button", class: "danger", on: { click: () => this.ask("abort", this.rig.on.run_id) } }, "Abort");
    this.element = h(
      "section",
      { class: "card turn", "aria-label": `Rig ${name}`, "data-rig-turn": name },
      this.title,
      this.result,
      this.of,
      this.todo,
      this.why,
      this.bar,
      this.more,
      h("div", { class: "buttons" }, this.go, this.abort),
    );
  }

  /** Whether Enter does something here. */
  get asks() {
    return Boolean(this.does);
  }

  /** The unit that it is about. */
  get unit() {
    return this.rig?.on?.unit;
  }

  /** What Enter means here; nothing in the moment after it has changed. */
  press() {
    return this.does && !this.go.disabled ? this.does() : null;
  }

  show(rig, named, closed) {
    this.rig = rig;
    const [text, button, does] = closed ? ["This list is closed", null, null] : this.#now(rig);
    if (text !== this.text) this.#calm();
    this.text = text;
    this.does = may("operator") ? does : null;
    fill(this.title, named && `Rig ${rig.name}`);
    this.title.hidden = !named;
    this.todo.textContent === text || fill(this.todo, text);
    const under_way = rig.on?.state === "running";
    const word = under_way ? null : rig.last?.word;
    this.result.hidden = !word;
    this.result.className = `big-word ${word}`;
    fill(this.result, word && [h("span", { "aria-hidden": "true" }, SHAPES[word]), ` ${word.toUpperCase()}`]);
    fill(this.of, word && [`${rig.last.unit} `, runLink(rig.last.run_id, "run "), rig.last_says.length > 0 && h("small", {}, rig.last_says[0])]);
    const why = under_way ? null : rig.on?.why;
    this.why.hidden = !why;
    fill(this.why, why && [why, rig.on.run_id && [" ", runLink(rig.on.run_id, "Run ")]]);
    this.bar.hidden = !under_way;
    this.bar.value = rig.progress?.fraction ?? 0;
    fill(this.more, under_way ? left(rig) : rig.next && `Then ${rig.next.unit}`);
    this.go.hidden = !this.does;
    this.go.textContent = button ?? "";
    this.abort.hidden = !under_way || !may("operator");
  }

  #calm() {
    this.go.disabled = true;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => (this.go.disabled = false), CALM_MS);
  }

  /** The instruction, the button, and what both do. */
  #now({ name, state, busy_with: busy, on, waiting_for: waits }) {
    if (on?.state === "running" && waits) {
      const text = `Turn ${on.unit} to ${fixed(waits.mount_deg, Number.isInteger(waits.mount_deg) ? 0 : 2, "°")}, press Enter`;
      return [text, "It sits: go on", () => this.ask("resume", on.run_id)];
    }
    if (on?.state === "running") return [`${on.unit} is being measured`, null, null];
    if (busy) return [`Rig ${name} is busy`, null, null];
    if (state === "offline") return [`Rig ${name} is offline`, null, null];
    if (!on) return ["No unit left", null, null];
    const text = on.state === "follow_up" ? `Leave ${on.unit} mounted, press Enter: another run tells why` : `Mount ${on.unit}, press Enter`;
    return [text, `Start ${on.unit}`, () => this.begin({ rig: name, unit: on.unit })];
  }
}

function left({ status, progress, next }) {
  const rest = progress?.remaining_s ?? null;
  const words = [
    `${progress?.poses_done ?? 0} of ${progress?.poses_total ?? 0} poses`,
    status === "paused" ? "paused" : rest === null ? null : `about ${duration(rest)} left`,
    next && `then ${next.unit}`,
  ];
  return words.filter(Boolean).join(", ");
}
