// One rig of a batch: instruction or progress, and the last result, legible from three metres.

import { h, fill, runLink } from "./dom.js";
import { duration, fixed } from "./format.js";
import { may } from "./me.js";
import { CALM_MS } from "./queuekeys.js";

export const TOO_SOON = "Enter ignored: the instruction had just changed. Read it, then press Enter again.";
const SHAPES = { pass: "✓", fail: "✗", done: "●", stopped: "–" };
const SIGHTS = { there: "✓", wrong: "✗", askew: "✗", absent: "–", moving: "…", looking: "…" };

/** `begin({ rig, unit }, signal)` starts a unit; `ask(verb, run)` posts resume or abort; `tell(text)` shows why nothing started. */
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
    const button = (props, click) => h("button", { type: "button", ...props, on: { click } });
    this.go = button({ class: "primary", "data-go": name }, () => this.press({ byHand: true }));
    const abort = () => (this.leaving ? this.cancel() : ask("abort", this.rig.on.run_id));
    this.abort = button({ class: "danger" }, abort);
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

  /** Whether its board has reported the requested unit. */
  get isSure() {
    return this.asks && ["there", "wrong"].includes(this.rig.seen?.state) && this.rig.seen.serial === this.unit;
  }

  /** Whether no board answers: then Enter and a scan start nothing, only the button does. */
  get isSilent() {
    return this.rig.seen?.state === "absent";
  }

  /** Whether it is idle without a unit. */
  get hasNothing() {
    return !this.rig.on && this.rig.state === "idle";
  }

  /** The unit of the instruction, which Enter starts. */
  unit = null;

  /** Makes a waiting unit, scanned ahead of others, the unit of the instruction. */
  take(unit) {
    this.taken = unit;
    this.show(this.rig, this.standing);
  }

  /** Carries out the instruction by Enter or button (`byHand`), unless it has just changed and the unit was not scanned. */
  press({ named = false, byHand = false } = {}) {
    if (!this.does) return null;
    if (this.isCalm && !named) return this.tell(TOO_SOON);
    return byHand && this.anyway ? this.anyway() : this.does();
  }

  /** Cancels the start of a follow-up run that is being designed, if any. */
  cancel() {
    this.leaving?.abort();
  }

  /** `standing`: whether the batch has `several` rigs or is `closed`, the Set of `waiting` units, and the counts. */
  show(rig, standing) {
    this.rig = rig;
    this.standing = standing;
    const { several, closed, waiting, counts } = standing;
    if (!waiting.has(this.taken)) this.taken = null;
    const { says, button, does, unit, anyway } = this.#seen(rig, this.#now(rig, { closed, waiting, counts }));
    this.instruction = says;
    this.unit = unit ?? rig.on?.unit;
    this.does = may("operator") ? does : null;
    this.anyway = anyway;
    fill(this.title, several && `Rig ${rig.name}`);
    this.title.hidden = !several;
    const under_way = rig.on?.state === "running";
    this.result.hidden = under_way || !(rig.last || rig.nothing_measured);
    this.of.hidden = this.result.hidden;
    if (!this.result.hidden) this.#came(rig);
    const why = under_way || closed ? null : rig.on?.why;
    this.#look(closed || (why && rig.seen?.says.includes(why)) ? null : rig.seen, rig.last);
    this.why.hidden = !why || rig.nothing_measured; // then it stands above
    this.why.className = rig.on?.run_id ? "error" : "muted";
    fill(this.why, why && [rig.on.run_id && [runLink(rig.on.run_id, "Run "), ": "], why]);
    const then = this.unit === rig.on?.unit ? rig.next?.unit : rig.on?.unit;
    this.bar.hidden = !under_way;
    this.bar.value = rig.progress?.fraction ?? 0;
    fill(this.more, under_way ? [`${left(rig)}. `, runLink(rig.on.run_id, "Run ")] : !closed && then && `Then ${then}`);
    this.go.hidden = !this.does;
    this.go.textContent = button ?? "";
    this.go.classList.toggle("primary", !anyway);
    this.abort.hidden = !(under_way || this.leaving) || !may("operator");
    this.abort.textContent = under_way ? "Abort" : "Cancel";
  }

  /** Shows the outcome of the last run. */
  #came({ on, last, last_says: says, nothing_measured: stopped }) {
    const word = stopped ? "stopped" : last.word;
    const { unit, run_id: run, why } = stopped ? on : last;
    this.result.className = `big-word ${word}`;
    fill(this.result, h("span", { "aria-hidden": "true" }, SHAPES[word]), ` ${word.toUpperCase()}`);
    const reason = why ?? (stopped ? null : says[0]);
    fill(this.of, `${unit} `, runLink(run, "run "), reason && h("small", {}, reason));
  }

  /** Shows the instruction; `isMeant`: whether Enter starts this rig, which is marked if `others` ask as well. */
  point(isMeant, others) {
    const text = this.instruction(isMeant ? "press Enter" : "scan it");
    const isNew = this.todo.textContent !== text;
    if (isNew) fill(this.todo, text);
    if (isNew || (isMeant && !this.isMeant)) this.#calm();
    this.isMeant = isMeant;
    this.element.classList.toggle("meant", isMeant && others);
  }

  /** Shows the presence status of the unit, by its board and gravity. */
  #look(seen, last) {
    const stays = seen?.state === "wrong" && seen.serial === last?.unit; // until it is removed
    const isTaken = seen?.state === "wrong" && seen.serial === this.unit; // another waiting unit, accepted instead
    const isNews = seen && !stays && (seen.state !== "there" || seen.serial); // without a serial number it may be any unit
    this.sight.hidden = !seen;
    this.sight.className = `sight ${isTaken ? "there" : isNews ? seen.state : ""}`;
    let says = seen ? `${SIGHTS[seen.state]} ${seen.says}` : "";
    if (seen?.state === "there" && this.unit !== this.rig.on.unit) says = `${SIGHTS.there} Board detected. Check that the unit is ${this.unit}.`;
    if (stays) says = `${seen.serial} is still mounted.`;
    if (isTaken) says = `${SIGHTS.there} The board reports ${seen.serial}; ${this.rig.on.unit} stays in the batch.`;
    this.sight.textContent === says || fill(this.sight, says);
  }

  /** Starts a follow-up run, which the service diagnoses and designs first. */
  async #followUp(turn) {
    this.leaving = new AbortController();
    this.show(this.rig, this.standing);
    this.point(false);
    await this.begin(turn, this.leaving.signal);
    this.leaving = null;
  }

  /** Ignores Enter and taps for a moment; the stop buttons stay active. */
  #calm() {
    const set = (isCalm) => {
      this.isCalm = this.go.disabled = isCalm;
      this.element.classList.toggle("calm", isCalm);
    };
    set(true);
    clearTimeout(this.timer);
    this.timer = setTimeout(() => set(false), CALM_MS);
  }

  /** Adapts the instruction to a presence check that failed: only the button starts it, or it must be confirmed. */
  #seen({ on, seen }, now) {
    if (seen && !["askew", "looking"].includes(seen.state)) this.doubted = null;
    if (!now.does || !["absent", "askew"].includes(seen?.state)) return now;
    if (seen.state === "absent") {
      const says = () => `${on.state === "follow_up" ? "Leave" : "Mount"} ${now.unit}: no board answers yet`;
      return { ...now, says, button: `Start ${now.unit} anyway`, does: () => this.tell(`Not started. ${seen.says}`, this), anyway: now.does };
    }
    if (on.state !== "waiting") return now;
    const does = () => {
      const isRepeated = this.doubted === now.unit;
      this.doubted = isRepeated ? null : now.unit;
      if (isRepeated) return now.does();
      this.#calm();
      return this.tell(`Not started. ${seen.says} If this is correct, start it again.`);
    };
    return { ...now, says: (key) => `Check ${now.unit}, ${key}`, does };
  }

  /** The instruction, the label of the button, what both do, and their unit. */
  #now({ name, state, status, busy_with: busy, on, seen, last, designing, waiting_for: waits }, { closed, waiting, counts }) {
    if (on?.state === "running" && waits) {
      const angle = fixed(waits.mount_deg, Number.isInteger(waits.mount_deg) ? 0 : 2, "°");
      return { says: (key) => `Clamp ${on.unit} at ${angle}, ${key}`, button: "Unit clamped, continue", does: () => this.ask("resume", on.run_id) };
    }
    if (on?.state === "running") return { says: () => `${on.unit} is ${status === "paused" ? "paused" : "being measured"}` };
    if (closed && counts.left) return { says: () => "This batch is closed" };
    if (!counts.left) return { says: () => `All measured: ${counts.good} done, ${counts.poor} failed` };
    if (busy) return { says: () => `Rig ${name} is busy` };
    if (state === "offline") return { says: () => `Rig ${name} is offline` };
    if (!on && !this.taken) return { says: () => "No unit left for this rig" };
    const start = (unit) => ({ button: `Start ${unit}`, does: () => this.begin({ rig: name, unit }), unit });
    if (on?.state === "follow_up") {
      if (this.leaving || designing) return { says: () => `Leave ${on.unit} mounted: its next run is being designed` };
      const says = (key) => `Leave ${on.unit} mounted, ${key}: another run identifies the cause`;
      return { ...start(on.unit), says, does: () => this.#followUp({ rig: name, unit: on.unit }) };
    }
    const asked = this.taken && !seen?.serial ? this.taken : on.unit; // the board's own serial number takes precedence
    const says = (key) => `Mount ${asked}, ${key}`;
    if (seen?.state !== "wrong") return { ...start(asked), says };
    if (seen.serial !== last?.unit && waiting.has(seen.serial)) {
      // it waits as well and can stay mounted
      return { ...start(seen.serial), says: (key) => `${seen.serial} is mounted, ${key}` };
    }
    return { ...start(on.unit), says, does: () => this.tell(`Not started. ${seen.says}`, this) };
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
