// A run that waits for the unit to be turned: one instruction, what gravity reads meanwhile, and Go.

import { post } from "./api.js";
import { errorLine, h } from "./dom.js";
import { fixed } from "./format.js";

const RIGHT_DEG = 5; // as near as the service asks for

/** `ask(verb)` posts resume or abort and gives what was wrong; `clamp` tells whether the rig turns the unit itself. */
export class WaitingCard {
  constructor(rig, ask, clamp) {
    this.rig = rig;
    this.title = h("h2", { id: "waiting-for" });
    this.how = h("p", {});
    this.now = h("p", { id: "mount-now", class: "mount-now", "aria-live": "off" });
    this.error = errorLine("waiting-error");
    this.buttons = [
      this.#button("go", "Go", "primary", () => ask("resume")),
      clamp && this.#button("turn", "Turn it with the rig's clamp", null, () => this.#turn()),
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
    this.title.textContent = `Turn the unit to ${fixed(asked.mount_deg, decimals(asked.mount_deg), "°")}, then Go`;
    const axis = asked.mount_axis.replace("-", "−");
    this.how.textContent = `Clamp it with its ${axis} along the stage's axis. The stage stands until you press Go.`;
    this.now.textContent = "";
    this.error.say(null);
  }

  reading({ mount_deg }) {
    if (this.element.hidden || mount_deg === undefined) return;
    const left = this.asked.mount_deg - mount_deg;
    const now = fixed(mount_deg, 0, "°");
    this.now.classList.toggle("right", Math.abs(left) <= RIGHT_DEG);
    this.now.textContent =
      Math.abs(left) <= RIGHT_DEG ? `Now at ${now}: right.` : `Now at ${now}: turn it ${left > 0 ? "on" : "back"} by ${fixed(Math.abs(left), 0, "°")}.`;
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

function decimals(angle) {
  return Number.isInteger(angle) ? 0 : 2;
}
