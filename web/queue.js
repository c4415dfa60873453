// A list of units, one after the other: mount what is said, press Enter, read the result from across the room.

import { ApiError, get, getNews, post } from "./api.js";
import { askConfirmation } from "./ask.js";
import { errorLine, fill, h } from "./dom.js";
import { moment, plural } from "./format.js";
import { may } from "./me.js";
import { Bell } from "./queuebell.js";
import { keepForNext, listForm } from "./queueform.js";
import { asRead, readerTypesInto } from "./queuekeys.js";
import { RigCard, TOO_SOON } from "./queuerig.js";
import { UnitsTable, counted, standingOf } from "./queuetable.js";

const LOOK_MS = 500;
const HIDDEN_LOOK_MS = 2000;
const BOARDS_MS = 2000; // how often the service is asked to look at the boards of idle rigs
const SCANNER_MS = 400; // an Enter so soon after a serial is the line feed of the scanner that sent it
const TOUCH = matchMedia("(pointer: coarse)"); // there the focus brings a keyboard up over the instruction

/** The newest list that is not another day's, the one that the address names, or the form for another one (`#/queue/new`). */
export async function queueView({ root, parts: [id], signal }) {
  await styled();
  if (id && id !== "new") return new QueuePage(root, id, signal).begin();
  const lists = await get("/api/batches", signal);
  const open = lists.filter(({ closed_at: closed }) => !closed);
  const today = open.find(({ takes_units: takes }) => takes);
  if (today && !id) return new QueuePage(root, today.id, signal).begin();
  const last = lists.length ? await get(`/api/batches/${encodeURIComponent(lists[0].id)}`, signal) : null;
  const form = await listForm(last, signal);
  fill(root, h("h1", {}, "Queue"), open.length > 0 && openLists(open), form);
}

function openLists(open) {
  const line = ({ id, rigs, note, created_at: made }) => h("li", {}, h("a", { href: `#/queue/${encodeURIComponent(id)}` }, "List of ", moment(made)), ` on ${rigs.join(", ")}${note ? `: ${note}` : ""}`);
  return h("section", { class: "card", "aria-label": "Open lists" }, h("p", {}, `${plural(open.length, "list")} open:`), h("ul", {}, open.map(line)));
}

/** Its style comes with it: nobody else's page waits for it. */
function styled() {
  if (document.getElementById("queue-style")) return null;
  const href = new URL("./queue.css", import.meta.url);
  return new Promise((done) => {
    const link = h("link", { id: "queue-style", rel: "stylesheet", href, on: { load: done, error: done } });
    document.head.append(link);
  });
}

/** What the keyboard does. */
function meaning(closed, { left }) {
  if (closed) return "This list takes no more units. Enter makes another list; a serial, scanned or typed, begins it.";
  if (!left) return "Enter makes another list. A serial, scanned or typed, joins this one.";
  return "Enter starts the unit that is mounted. A serial, scanned or typed, starts it where it is asked for, or joins the list.";
}

class QueuePage {
  constructor(root, id, signal) {
    this.root = root;
    this.path = `/api/batches/${encodeURIComponent(id)}`;
    this.signal = signal;
    this.cards = new Map();
    this.error = errorLine("queue-error");
    this.bell = new Bell();
    this.said = h("p", { id: "queue-said", role: "status", "aria-live": "polite" });
    this.rigs = h("div", { class: "turns" });
    this.units = new UnitsTable((unit) => this.#ask(`take ${unit}`, async () => this.#show(await post(`${this.path}/remove`, { unit }))));
    this.asked = new Map(); // promises, by what each is about
    this.answers = 0;
    this.untold = []; // serials that the service has not been told yet
    this.scannedAt = this.lookedAt = -Infinity;
    this.scan = h("input", { id: "scan", type: "text", autocomplete: "off", spellcheck: "false", disabled: !may("operator") });
    this.add = h("button", { type: "submit" }, "Enter");
    this.facts = h("p", { class: "facts" });
    this.means = h("label", { for: "scan" });
    this.other = h("a", { href: "#/queue/new" }, "Make another list");
    this.form = h(
      "form",
      { class: "scan", on: { submit: (event) => this.#entered(event), keydown: (event) => event.repeat && event.key === "Enter" && event.preventDefault() } },
      this.means,
      h("div", { class: "scan-line" }, this.scan, this.add),
    );
    this.clock = new Worker(new URL("./queueclock.js", import.meta.url));
    this.clock.addEventListener("message", () => this.#look());
    signal.addEventListener("abort", () => this.clock.terminate());
    document.addEventListener("visibilitychange", () => this.#soon(0), { signal });
    readerTypesInto(this.scan, signal);
    for (const part of [this.rigs, ...this.bell.buttons]) part.addEventListener("click", () => TOUCH.matches || this.#focus(), { signal });
  }

  async begin() {
    const { tag, answer } = await getNews(this.path, null, this.signal);
    this.tag = tag;
    fill(
      this.root,
      h("h1", { class: "for-screen-readers" }, "Queue"),
      this.rigs,
      h("div", { class: "at-hand" }, this.error.element, this.said, this.form),
      h("div", { class: "queue-line" }, this.facts, this.bell.buttons, this.#closing(answer)),
      this.units.element,
    );
    this.#show(answer);
    if (!TOUCH.matches) this.#focus();
    this.#soon(LOOK_MS);
  }

  /** The keyboard, and with it a scanner, goes here; the page stays where it is. */
  #focus() {
    this.scan.focus({ preventScroll: true });
  }

  #closing({ closed_at: closed }) {
    if (closed || !may("operator")) return this.other;
    const end = async () => this.#show(await post(`${this.path}/close`));
    const close = () => {
      const { left } = counted(this.list.units);
      if (!left) return this.#ask("close", end);
      const text = `${plural(left, "unit")} of it not measured. A list that is closed stays so; a run under way goes on.`;
      return askConfirmation({ title: "Close this list?", text, action: "Close it" }, end);
    };
    return [this.other, h("button", { id: "close-list", type: "button", class: "small", on: { click: close } }, "Close this list")];
  }

  #soon(after) {
    this.clock.postMessage(after);
  }

  async #look() {
    try {
      await this.#haveBoardsLookedAt();
      const { answers } = this;
      const news = await getNews(this.path, this.tag, this.signal);
      if (news && answers === this.answers) {
        // nothing younger is shown
        this.tag = news.tag;
        this.#show(news.answer);
      }
      if (this.untold.length) this.#ask("join", () => this.#join());
      if (this.refused?.status === 0) this.refused = null; // it answers again
      this.error.say(this.refused ?? null);
    } catch (problem) {
      this.#say(problem);
    }
    this.#soon(document.hidden ? HIDDEN_LOOK_MS : LOOK_MS);
  }

  /** Whoever watches an open list has the boards of its idle rigs looked at; one that has just become so at once. */
  async #haveBoardsLookedAt() {
    const idle = this.list.rigs.filter(({ on, busy_with: busy }) => on && on.state !== "running" && !busy);
    if (this.list.closed_at || !idle.length || document.hidden || !may("operator")) return;
    const isNew = this.isLooking && idle.some(({ seen }) => !seen); // of a bench that is away nothing is
    if (!isNew && performance.now() - this.lookedAt < BOARDS_MS) return;
    this.lookedAt = performance.now();
    const { rigs } = await post(`${this.path}/look`, {}, this.signal);
    this.isLooking = rigs.some(({ seen }) => seen);
  }

  #show(list) {
    this.list = list;
    const waiting = new Set(list.units.filter(({ state }) => state === "waiting").map(({ unit }) => unit));
    const counts = counted(list.units);
    const closed = Boolean(list.closed_at);
    const standing = { several: list.rigs.length > 1, closed, waiting, counts };
    this.isOver = closed || !counts.left;
    this.means.textContent = meaning(closed, counts);
    this.other.classList.toggle("button", this.isOver);
    if (closed) document.getElementById("close-list")?.remove();
    for (const rig of list.rigs) {
      if (!this.cards.has(rig.name)) {
        const begin = (turn) => this.#ask(`start on ${turn.rig}`, async () => this.#show(await post(`${this.path}/start`, turn)));
        const ask = (verb, run) => this.#ask(`${verb} ${run}`, () => post(`/api/runs/${encodeURIComponent(run)}/${verb}`));
        const card = new RigCard(rig.name, { begin, ask, tell: (text, about) => this.#tell(text, about) });
        this.cards.set(rig.name, card);
        this.rigs.append(card.element);
      }
      this.cards.get(rig.name).show(rig, standing);
    }
    if (this.saidOf && this.saidOf.card.rig.seen?.says !== this.saidOf.says) this.#tell("");
    this.#choose();
    this.bell.heed(list.rigs);
    fill(
      this.facts,
      h("span", { id: "queue-counts" }, `${counts.left} to go, ${counts.good} done, ${counts.poor} failed`),
      list.operator && h("span", {}, `by ${list.operator}`),
      list.note && h("span", { class: "note" }, list.note),
    );
    this.units.show(list);
  }

  /** Which rig Enter means: the only one that asks, or the one whose board has said last that its unit is there. */
  #choose() {
    const asking = [...this.cards.values()].filter((card) => card.asks);
    const sure = asking.filter((card) => card.isSure);
    this.sure = [...(this.sure ?? []).filter((card) => sure.includes(card)), ...sure.filter((card) => !this.sure?.includes(card))];
    this.meant = asking.length === 1 ? asking[0] : this.sure.at(-1);
    for (const card of this.cards.values()) card.point(card === this.meant, asking.length > 1);
  }

  /** Enter alone, or a serial and Enter: what a bar-code reader types, faster than the service answers. */
  #entered(event) {
    event.preventDefault();
    const serial = asRead(this.scan.value);
    this.scan.value = "";
    if (serial) {
      this.scannedAt = performance.now();
      if (this.list.closed_at) this.#another(serial);
      else this.#scanned(serial);
    } else if (performance.now() - this.scannedAt > SCANNER_MS) {
      if (this.isOver) this.#another();
      else if (this.meant) this.meant.press();
      else if ([...this.cards.values()].some((card) => card.asks)) this.#tell("Several rigs ask for a unit: scan the one that is mounted, or press its button.");
    }
  }

  /** To the form for another list, once what stands here can have been read; a serial goes with it. */
  #another(serial = "") {
    if (serial) keepForNext(serial);
    else if ([...this.cards.values()].some((card) => card.isCalm)) return this.#tell(TOO_SOON);
    location.hash = this.other.hash;
  }

  #scanned(typed) {
    const known = this.list.units.map(({ unit }) => unit);
    const alike = (unit) => unit.toLowerCase() === typed.toLowerCase();
    const serial = known.includes(typed) ? typed : (known.find(alike) ?? typed); // a reader may send other case
    const cards = [...this.cards.values()];
    const theirs = cards.filter((one) => one.asks && one.unit === serial);
    const card = theirs.find((one) => !one.isSilent) ?? theirs[0];
    if (card && !card.isSilent) return card.press({ named: card.taken !== serial });
    const waits = this.list.units.some(({ unit, state }) => unit === serial && state === "waiting");
    const asking = cards.filter((one) => one.asks && one.rig.on?.state === "waiting");
    const place = cards.find((one) => one.hasNothing) ?? (!card && asking.length === 1 ? asking[0] : null);
    if (waits && place) {
      place.take(serial);
      this.#choose();
      return this.#tell(place.rig.on ? `${serial} comes before the others.` : `${serial} may go to rig ${place.name} as well.`);
    }
    if (card) return card.press();
    this.untold.push(serial);
    return this.#ask("join", () => this.#join());
  }

  /** Has what was scanned join the list. Where no answer comes it is kept, and joins once there is one: it starts nothing then. */
  async #join() {
    while (this.untold.length) {
      const [serial] = this.untold;
      try {
        const list = await post(`${this.path}/units`, { units: [serial] });
        this.#show(list);
        this.#tell(list.known.length ? standingOf(serial, list.units) : `${serial} was added.`);
      } catch (problem) {
        if (problem.status !== 0) this.untold.shift();
        else this.#tell(`Scanned meanwhile, and kept here until the service answers: ${this.untold.join(", ")}.`);
        throw problem;
      }
      this.untold.shift();
    }
  }

  /** One question at a time about each thing: none waits for the design of a run. What is refused stays in view until the next. */
  #ask(about, work) {
    if (!this.asked.has(about)) this.asked.set(about, this.#answered(work).finally(() => this.asked.delete(about)));
    return this.asked.get(about);
  }

  async #answered(work) {
    this.refused = null;
    this.error.say(null);
    this.#tell("");
    try {
      await work();
    } catch (problem) {
      this.refused = problem;
      this.#say(problem);
    } finally {
      this.answers += 1;
      this.tag = null;
      this.#soon(0);
    }
  }

  /** Says a line; one about what was seen on a rig holds as long as that is. */
  #tell(text, about = null) {
    this.said.textContent = text;
    this.saidOf = about && { card: about, says: about.rig.seen?.says };
  }

  #say(problem) {
    if (this.signal.aborted) return;
    if (!(problem instanceof ApiError)) throw problem;
    this.error.say(problem);
  }
}
