// A run that waits for the unit to be remounted: instruction, angle measured by gravity, and buttons.

import { post } from "./api.js";
import { errorLine, h } from "./dom.js";
import { fixed } from "./format.js";

const RIGHT_DEG = 5; // the tolerance of the service

/** `ask(verb)` posts resume or abort; `clamp`: whether the rig can rotate the unit itself. */
export class WaitingCard {
  constructor(rig, ask, clamp) {
    this.rig = rig;
    this.title = h("h2", { id: "waiting-for" });
    this.how = h("p", {});
    this.now = h("p", { id: "mount-now", class: "mount-now", "aria-live": "off" });
    this.error = errorLine("waiting-error");
    this.buttons = [
      this.#button("go", "Continue", "primary", () => ask("resume")),
      clamp && this.#button("turn", "Rotate it with the rig's clamp", null, () => this.#turn()),
      this.#button("abort-waiting", "Abort", "danger", () => ask("abort")),
    ].filter(Boolean);
    this.element = h(
      "section",
      { class: "card waiting", "aria-labelledby": "waiting-for" },
      this.title,
      this.how,
      this.now,
      this.error.element,
      h("div", { class: "buttons" }, this.buttons),
    );
  }

  show(asked) {
    this.element.hidden = !asked;
    if (!asked || JSON.stringify(asked) === JSON.stringify(this.asked)) return;
    this.asked = asked;
    const decimals = Number.isInteger(asked.mount_deg) ? 0 : 2;
    this.title.textContent = `Clamp the unit at ${fixed(asked.mount_deg, decimals, "°")}, then continue`;
    const axis = asked.mount_axis.replace("-", "−");
    this.how.textContent = `The unit's ${axis} axis lies along the stage axis. The stage stays at rest until you press Continue.`;
    this.now.textContent = "";
    this.error.say(null);
  }

  reading({ mount_deg }) {
    if (this.element.hidden || mount_deg === undefined) return;
    const left = this.asked.mount_deg - mount_deg;
    const now = fixed(mount_deg, 0, "°");
    const isRight = Math.abs(left) <= RIGHT_DEG;
    this.now.classList.toggle("right", isRight);
    const further = left < 0 ? `Turn back by ${fixed(-left, 0, "°")}.` : `Turn by a further ${fixed(left, 0, "°")}.`;
    this.now.textContent = `Now at ${now}. ${isRight ? "Within tolerance." : further}`;
  }

  #button(id, text, kind, work) {
    const pressed = async () => {
      this.error.say(null);
      for (const button of this.buttons) button.disabled = id !== "turn" || button.id !== "abort-waiting";
      try {
        await work();
      } catch (problem) {
        if (problem.status === undefined) throw problem;
        this.error.say(problem);
      } finally {
        for (const button of this.buttons) button.disabled = false;
      }
    };
    return h("button", { id, type: "button", class: kind, on: { click: pressed } }, text);
  }

  async #turn() {
    await post(`/api/rigs/${encodeURIComponent(this.rig)}/clamp`, this.asked);
  }
}
