// One rig of a list: what to do at it now, or how far it is, and what came out last, in letters for three metres.

import { h, fill, runLink } from "./dom.js";
import { duration, fixed } from "./format.js";
import { may } from "./me.js";

const CALM_MS = 700; // an Enter meant for what stood here before starts nothing
const SHAPES = { pass: "✓", fail: "✗", done: "●" };
const SIGHTS = { there: "✓", wrong: "✗", askew: "✗", absent: "–", moving: "…", looking: "…" };

/** `begin({ rig, unit })` starts a turn; `ask(verb, run)` posts resume or abort; `tell(text)` says why nothing began. */
export class RigCard {
  constructor(name, { begin, ask, tell }) {
    this.name = name;
    this.begin = begin;
    this.tell = tell;
    this.title = h("h2", {});
    this.result = h("p", { class: "big-word", hidden: true });
    this.of = h("p", { class: "big-unit" });
    this.todo = h("p", { class: "todo", role: "status", "aria-live": "assertive" });
    this.sight = h("p", { class: "sight", role: "status", "aria-live": "polite", hidden: true });
    this.why = h("p", { class: "error", hidden: true });
    this.bar = h("progress", { max: "1", value: "0", "aria-label": `Progress on ${name}`, hidden: true });
    this.more = h("p", { class: "muted" });
    this.go = h("button", { type: "button", class: "primary", "data-go": name, on: { click: () => this.press() } });
    this.abort = h("button", { type: "button", class: "danger", on: { click: () => ask("abort", this.rig.on.run_id) } }, "Abort");
    this.element = h(
      "section",
      { class: "card turn", "aria-label": `Rig ${name}`, "data-rig-turn": name },
      this.title,
      this.result,
      this.of,
      this.todo,
      this.sight,
      this.why,
      this.bar,
      this.more,
      h("div", { class: "buttons" }, this.go, this.abort),
    );
    this.ask = ask;
  }

  /** Whether Enter does something here. */
  get asks() {
    return Boolean(this.does);
  }

  /** Whether its board has said that the unit asked for is there. */
  get isSure() {
    return this.asks && this.rig.seen?.state === "there" && this.rig.seen.serial === this.unit;
  }

  /** The unit that Enter is about: that of the instruction. */
  unit = null;

  /** What Enter means here; nothing in the moment after it has changed, unless the unit was named. */
  press({ named = false } = {}) {
    if (!this.does) return null;
    if (this.isCalm && !named) return this.tell(`That was sooner than the instruction could be read: once more, to start ${this.unit}.`);
    return this.does();
  }

  /** `standing`: whether the list has `several` rigs, is `closed`, which units wait, as a Set, and how many are what. */
  show(rig, { several, closed, waiting, counts }) {
    this.rig = rig;
    const { text, button, does, unit } = this.#now(rig, { closed, waiting, counts });
    if (text !== this.text) this.calm();
    this.text = text;
    this.unit = unit ?? rig.on?.unit;
    this.does = may("operator") ? does : null;
    fill(this.title, several && `Rig ${rig.name}`);
    this.title.hidden = !several;
    this.todo.textContent === text || fill(this.todo, text);
    const under_way = rig.on?.state === "running";
    const word = under_way ? null : rig.last?.word;
    this.result.hidden = !word;
    this.result.className = `big-word ${word}`;
    fill(this.result, word && [h("span", { "aria-hidden": "true" }, SHAPES[word]), ` ${word.toUpperCase()}`]);
    const says = rig.last_says[0] ?? rig.last?.why;
    fill(this.of, word && [`${rig.last.unit} `, runLink(rig.last.run_id, "run "), says && h("small", {}, says)]);
    const why = under_way || closed ? null : rig.on?.why;
    this.#look(closed || (why && rig.seen?.says.includes(why)) ? null : rig.seen, rig.last);
    this.why.hidden = !why;
    this.why.className = rig.on?.run_id ? "error" : "muted";
    fill(this.why, why && [why, rig.on.run_id && [" ", runLink(rig.on.run_id, "Run ")]]);
    this.bar.hidden = !under_way;
    this.bar.value = rig.progress?.fraction ?? 0;
    fill(this.more, under_way ? [`${left(rig)}. `, runLink(rig.on.run_id, "Run ")] : !closed && rig.next && `Then ${rig.next.unit}`);
    this.go.hidden = !this.does;
    this.go.textContent = button ?? "";
    this.abort.hidden = !under_way || !may("operator");
  }

  /** Whether the unit is there, as its board and gravity have it. */
  #look(seen, last) {
    const stays = seen?.state === "wrong" && seen.serial === last?.unit; // as it does until it is taken off
    const isNews = seen && !stays && (seen.state !== "there" || seen.serial); // a nameless unit may be any
    this.sight.hidden = !seen;
    this.sight.className = `sight ${isNews ? seen.state : ""}`;
    const says = stays ? `${seen.serial} is still mounted.` : seen ? `${SIGHTS[seen.state]} ${seen.says}` : "";
    this.sight.textContent === says || fill(this.sight, says);
  }

  /** From now on, for a moment, Enter starts nothing here. */
  calm() {
    this.isCalm = this.go.disabled = true;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => (this.isCalm = this.go.disabled = false), CALM_MS);
  }

  /** The instruction, the button, what both do, and the unit that they are about. */
  #now({ name, state, status, busy_with: busy, on, seen, last, waiting_for: waits }, { closed, waiting, counts }) {
    if (on?.state === "running" && waits) {
      const text = `Turn ${on.unit} to ${fixed(waits.mount_deg, Number.isInteger(waits.mount_deg) ? 0 : 2, "°")}, press Enter`;
      return { text, button: "It sits: go on", does: () => this.ask("resume", on.run_id) };
    }
    if (on?.state === "running") return { text: `${on.unit} is ${status === "paused" ? "paused" : "being measured"}` };
    if (closed) return { text: "This list is closed" };
    if (busy) return { text: `Rig ${name} is busy` };
    if (state === "offline") return { text: `Rig ${name} is offline` };
    if (!on) return { text: `No unit left: ${counts.good} done, ${counts.poor} failed` };
    const start = (unit) => () => this.begin({ rig: name, unit });
    const button = `Start ${on.unit}`;
    if (on.state === "follow_up") return { text: `Leave ${on.unit} mounted, press Enter: another run tells why`, button, does: start(on.unit) };
    const text = `Mount ${on.unit}, press Enter`;
    if (seen?.state !== "wrong") return { text, button, does: start(on.unit) };
    if (seen.serial !== last?.unit && waiting.has(seen.serial)) {
      // its board says so, and it waits as well: nobody need take it off again
      return { text: `${seen.serial} is mounted, press Enter`, button: `Start ${seen.serial}`, does: start(seen.serial), unit: seen.serial };
    }
    return { text, button, does: () => this.tell(`Not started. ${seen.says}`, this) };
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
