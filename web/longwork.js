// A job of the service that takes long: its progress, and a button that cancels it.

import { ApiError, begin, beginGet, beginUpload, get, remove } from "./api.js";
import { h } from "./dom.js";

const LOOK_MS = 400;
const UNDER_WAY = new Set(["queued", "running"]);

export const CANCELLED = "Cancelled: nothing was kept of it.";

/**
 * A line beside the control that requests the work. `doing` describes the work, `share` what the fraction counts;
 * `signal` aborts when the view is left. Afterwards `answer` is the answer, or `result` its address.
 */
export class LongWork {
  constructor(id, { doing, share }, signal) {
    this.words = { doing, share };
    this.signal = signal;
    this.says = h("p", { id: `${id}-says`, class: "muted", role: "status", "aria-live": "polite" });
    this.bar = h("progress", { max: "1", "aria-labelledby": `${id}-says` });
    const cancel = { type: "button", id: `${id}-cancel`, on: { click: () => this.#cancel() } };
    this.button = h("button", cancel, "Cancel");
    const props = { id: `${id}-progress`, class: "long-work", hidden: true };
    this.element = h("div", props, h("div", {}, this.says, this.bar), this.button);
  }

  /** Requests the work. Resolves to whether it was done: false if it was cancelled, or if the view was left. */
  carryOut(path, body) {
    return this.#take(path, (given) => begin(path, body, given));
  }

  /** As `carryOut`, of what a GET computes. */
  compute(path) {
    return this.#take(path, (given) => beginGet(path, given));
  }

  /** As `carryOut`, of a form with a file; leaving the view during the upload cancels it. */
  send(path, form) {
    return this.#take(path, (given) => {
      this.#sent(0);
      return beginUpload(path, form, AbortSignal.any([given, this.signal]), (share) => this.#sent(share));
    });
  }

  #take(path, ask) {
    this.asked = new AbortController();
    this.#show({ state: "running", fraction: null });
    return this.#untilEnd(async () => {
      const { job, answer } = await ask(this.asked.signal);
      this.answer = answer;
      if (job) sessionStorage.setItem(path, job);
      return job ? this.#follow(path) : true;
    });
  }

  /** The answer itself, read by its address if need be. */
  async document() {
    return this.answer ?? get(this.result, this.signal);
  }

  /** The id of what was made. */
  get resultId() {
    return this.answer?.id ?? this.result.split("/").at(-1);
  }

  /** Continues work that this tab has requested before, if any, with `button` disabled; `take` gets `carryOut`'s promise. */
  resumeWith(path, button, error, take) {
    if (!LongWork.isUnderWay(path)) return;
    button.disabled = true;
    take(this.resume(path))
      .catch((problem) => error.say(problem))
      .finally(() => (button.disabled = false));
  }

  /** Whether this tab has requested it and has not seen its end: then `resume` continues as `carryOut` would. */
  static isUnderWay(path) {
    return sessionStorage.getItem(path) !== null;
  }

  resume(path) {
    return this.#untilEnd(() => this.#follow(path));
  }

  async #untilEnd(work) {
    this.element.hidden = false;
    this.button.disabled = false;
    try {
      return await work();
    } catch (error) {
      if (error.name !== "AbortError") throw error;
      return false;
    } finally {
      this.element.hidden = true;
      this.job = null;
    }
  }

  async #follow(path) {
    this.job = sessionStorage.getItem(path);
    let job;
    try {
      while (UNDER_WAY.has((job = await get(this.job, this.signal)).state)) {
        this.#show(job);
        await new Promise((done) => setTimeout(done, LOOK_MS));
      }
    } catch (error) {
      if (error.status === 404) sessionStorage.removeItem(path);
      throw error;
    }
    sessionStorage.removeItem(path);
    if (job.state === "failed") throw new ApiError(job.error, 0);
    this.result = job.result;
    return job.state === "done";
  }

  #show({ state, fraction }) {
    const share = fraction === null ? "" : ` ${Math.round(100 * fraction)}\u00a0% of ${this.words.share}.`;
    this.says.textContent =
      state === "queued" ? "Queued: the service completes other work first." : `${this.words.doing}${share}`;
    if (fraction === null) this.bar.removeAttribute("value");
    else this.bar.value = fraction;
  }

  #sent(share) {
    if (share === 1) return this.#show({ state: "running", fraction: null });
    this.says.textContent = `Sending the file: ${Math.floor(100 * share)}\u00a0% of it is sent.`;
    this.bar.value = share;
  }

  async #cancel() {
    this.button.disabled = true;
    if (!this.job) return this.asked.abort(); // the service ends what nobody waits for
    try {
      await remove(this.job);
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      this.says.textContent = error.message;
      this.button.disabled = false;
    }
  }
}
