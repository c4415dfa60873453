// A run in progress: progress, current readings, and the buttons.

import { h } from "./dom.js";
import { duration, fixed, plural } from "./format.js";

export const TERMINAL = new Set(["completed", "failed", "aborted", "interrupted"]);

/** Hidden once the run has ended. `ask(verb)` posts pause, resume or abort; `announce(text)` is for screen readers. */
export class LivePanel {
  constructor(ask, announce) {
    this.announce = announce;
    this.bar = h("progress", { id: "progress", max: "1", value: "0", "aria-label": "Progress of the run" });
    this.count = h("span", { id: "poses-done" });
    this.remaining = h("span", { id: "remaining" });
    this.values = ["Stage", "Reading", "Reading − stage", "Temperature"].map((name) => {
      const value = h("dd", {}, "–");
      return { value, element: h("div", {}, h("dt", {}, name), value) };
    });
    const button = (id, text, kind) =>
      h("button", { id, type: "button", class: kind, on: { click: () => ask(id) } }, text);
    this.pause = button("pause", "Pause", null);
    this.resume = button("resume", "Resume", null);
    this.abort = button("abort", "Abort", "danger");
    this.element = h(
      "section",
      { class: "card live", "aria-label": "The run now" },
      h("dl", { class: "readouts" }, this.values.map(({ element }) => element)),
      this.bar,
      h(
        "div",
        { class: "live-line" },
        h("p", {}, this.count, this.remaining),
        h("div", { class: "buttons" }, this.pause, this.resume, this.abort),
      ),
    );
  }

  show(run) {
    this.element.hidden = TERMINAL.has(run.status);
    if (run.status !== "running") this.holding = false;
    this.paused = run.status === "paused";
    this.#buttons();
    this.progress(run.progress);
  }

  /** The run waits for the operator: the buttons are then in the card with the instruction. */
  waits(waiting) {
    this.waiting = waiting;
    this.#buttons();
  }

  /** A pause was requested or revoked; the run pauses after the current pose. */
  hold(holding) {
    this.holding = holding && !this.paused;
    this.#buttons();
    this.#left();
  }

  progress(progress) {
    const { poses_done, poses_total, fraction } = progress;
    this.latest = progress;
    this.bar.value = fraction;
    this.count.textContent = poses_total
      ? `${poses_done} of ${plural(poses_total, "pose")}`
      : `${Math.floor(100 * fraction)} % of the log`;
    this.#left();
    const tenth = Math.floor(fraction * 10);
    if (tenth === this.tenth) return;
    this.tenth = tenth;
    this.announce(`${tenth * 10} % done, ${this.remaining.textContent}`);
  }

  /** Shows one of pause and resume; the focus moves from one to the other. */
  #buttons() {
    const had = [this.pause, this.resume].includes(document.activeElement);
    this.pause.hidden = this.paused || this.holding;
    this.resume.hidden = !this.pause.hidden || this.waiting;
    this.abort.hidden = this.waiting;
    if (had) (this.pause.hidden ? this.resume : this.pause).focus();
  }

  #left() {
    const seconds = this.latest?.remaining_s ?? null;
    const left = seconds === null ? "time left not known yet" : `about ${duration(seconds)} left`;
    this.remaining.textContent = this.paused
      ? `paused, ${left}`
      : this.holding
        ? "pausing after this pose"
        : left;
  }

  reading({ stage_deg, reading_deg, temperature_c }) {
    const both = stage_deg !== null && reading_deg !== null;
    const texts = [
      fixed(stage_deg, 2, "°"),
      fixed(reading_deg, 2, "°"),
      fixed(both ? reading_deg - stage_deg : null, 2, "°"),
      fixed(temperature_c, 1, "°C"),
    ];
    texts.forEach((text, k) => (this.values[k].value.textContent = text));
  }
}
