// Signals of the end of a run: page title, sound, notification.

import { h } from "./dom.js";

const MUTE_KEY = "calrig.mute";
const TONES_HZ = { pass: [880], done: [660], fail: [220, 220], stopped: [220] };
const TONE_S = 0.25;

export class Bell {
  constructor() {
    this.heard = null;
    this.mute = h("button", { id: "mute", type: "button", class: "small", on: { click: () => this.#toggle() } });
    this.ask = h("button", { id: "notify", type: "button", class: "small", on: { click: () => this.#allow() } }, "Notify me");
    this.ask.hidden = !("Notification" in window) || Notification.permission !== "default";
    this.buttons = [this.mute, this.ask];
    this.#label();
  }

  /** Signals what has ended since the last call. */
  heed(rigs) {
    const now = new Map(rigs.map((rig) => [rig.name, `${rig.last?.run_id ?? ""} ${rig.on?.why ?? ""}`]));
    const before = this.heard;
    this.heard = now;
    const running = rigs.every(({ on }) => on?.state === "running");
    if (running) document.title = `${rigs.map(({ on }) => on.unit).join(", ")} · calrig`;
    if (!before && rigs.length === 1 && !running) setTimeout(() => entitle(outcome(rigs[0]))); // after a reload, once the view has its title
    if (!before) return;
    for (const rig of rigs.filter(({ name }) => before.get(name) !== now.get(name) && before.has(name))) this.#tell(rig, before.get(rig.name));
  }

  #tell({ name, last, on }, before) {
    const ended = last && !before.startsWith(last.run_id);
    if (!ended && !on?.why) return;
    const [word, unit] = ended ? [last.word, last.unit] : ["stopped", on.unit];
    entitle([word, unit]);
    if (!this.muted) sound(TONES_HZ[word]);
    if ("Notification" in window && Notification.permission === "granted") notify(`${word.toUpperCase()} ${unit}`, name);
  }

  get muted() {
    return localStorage.getItem(MUTE_KEY) === "1";
  }

  #toggle() {
    localStorage.setItem(MUTE_KEY, this.muted ? "0" : "1");
    this.#label();
    if (!this.muted) sound(TONES_HZ.pass);
  }

  #label() {
    this.mute.textContent = this.muted ? "Sound is off" : "Sound is on";
    this.mute.setAttribute("aria-pressed", String(!this.muted));
  }

  async #allow() {
    this.ask.hidden = (await Notification.requestPermission()) !== "default";
  }
}

/** The last outcome of a rig: a word and the unit; null before the first. */
function outcome({ last, on, nothing_measured: stopped }) {
  if (stopped) return ["stopped", on.unit];
  return last && [last.word, last.unit];
}

function entitle(came) {
  if (came) document.title = `${came[0].toUpperCase()} ${came[1]} · calrig`;
}

/** Shows one notification per rig, the latest. */
function notify(text, rig) {
  try {
    new Notification(text, { tag: `calrig-queue-${rig}`, renotify: true });
  } catch (problem) {
    if (!(problem instanceof TypeError)) throw problem; // phones have none without a service worker
  }
}

let audio;

/** Plays the tones; silent before the user has interacted with the page, as browsers require. */
function sound(tones) {
  if (!("AudioContext" in window) || !navigator.userActivation?.hasBeenActive) return;
  audio ??= new AudioContext();
  tones.forEach((hertz, k) => {
    const tone = audio.createOscillator();
    const volume = audio.createGain();
    volume.gain.value = 0.2;
    tone.frequency.value = hertz;
    tone.connect(volume).connect(audio.destination);
    tone.start(audio.currentTime + 1.4 * k * TONE_S);
    tone.stop(audio.currentTime + (1.4 * k + 1) * TONE_S);
  });
}
