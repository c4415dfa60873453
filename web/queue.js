// A batch of units, one after another: mount the unit, press Enter, read the result from across the room.

import { get, getNews, post, serviceError } from "./api.js";
import { askConfirmation } from "./ask.js";
import { button, dataTable, errorLine, fill, h, runLink, tableRow, unitLink } from "./dom.js";
import { moment, plural } from "./format.js";
import { may } from "./me.js";
import { Bell } from "./queuebell.js";
import { keepForNext, listForm } from "./queueform.js";
import { SCANNER_MS, asRead, readerTypesInto } from "./queuekeys.js";
import { RigCard, TOO_SOON } from "./queuerig.js";
import { stopRig, stopsOnEscape } from "./stop.js";

const LOOK_MS = 500;
const HIDDEN_LOOK_MS = 2000;
const BOARDS_MS = 2000; // interval of the presence checks of idle rigs
const STOPPED_MS = 1500; // after a stop, a key that was meant for Stop starts nothing
const STOPPED = "Not started: a stop was just requested. Read the instruction, then try again.";
const TOUCH = matchMedia("(pointer: coarse)"); // there the focus opens a keyboard over the instruction

/** The newest open batch of today, the one that the address names, or the form of a new one (`#/queue/new`). */
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
  const line = ({ id, rigs, note, created_at: made }) => {
    const link = h("a", { href: `#/queue/${encodeURIComponent(id)}` }, "Batch of ", moment(made));
    return h("li", {}, link, ` on ${rigs.join(", ")}${note ? `: ${note}` : ""}`);
  };
  const title = h("p", {}, `${plural(open.length, "open batch", "open batches")}:`);
  return h("section", { class: "card", "aria-label": "Open batches" }, title, h("ul", {}, open.map(line)));
}

/** Loads the style of this view, which no other view needs. */
function styled() {
  if (document.getElementById("queue-style")) return null;
  const href = new URL("./queue.css", import.meta.url);
  return new Promise((done) => {
    const link = h("link", { id: "queue-style", rel: "stylesheet", href, on: { load: done, error: done } });
    document.head.append(link);
  });
}

/** What Enter and a scanned serial number do. */
function meaning(closed, { left }) {
  const another = "Press Enter to create another batch.";
  if (closed) return `This batch takes no more units. ${another} A scanned or typed serial number begins it.`;
  if (!left) return `${another} A scanned or typed serial number joins this one.`;
  return (
    "Press Enter to start the mounted unit. Scan or type a serial number: a unit that a rig asks for starts; any other " +
    "joins the batch."
  );
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
    this.asked = new Map(); // requests in progress, by subject
    this.answers = 0;
    this.stopping = 0; // stops that were just requested
    this.untold = []; // serial numbers not sent to the service yet
    this.scannedAt = this.lookedAt = -Infinity;
    const quiet = { autocomplete: "off", spellcheck: "false" };
    this.scan = h("input", { id: "scan", type: "text", disabled: !may("operator"), ...quiet });
    this.add = h("button", { type: "submit" }, "Enter");
    this.facts = h("p", { class: "facts" });
    this.means = h("label", { for: "scan" });
    this.other = h("a", { href: "#/queue/new" }, "New batch");
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
    stopsOnEscape(() => this.#busyRigs(), signal);
    window.addEventListener("calrig:stop", ({ detail }) => this.#stopped(detail), { signal });
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

  /** Directs the keyboard, and with it a scanner, to the input, without scrolling. */
  #focus() {
    this.scan.focus({ preventScroll: true });
  }

  /** The rigs that have a run, or for which a start was requested. */
  #busyRigs() {
    const isBusy = ({ name, state, on }) => state === "busy" || on?.state === "running" || this.asked.has(startOn(name));
    return this.list.rigs.filter(isBusy).map(({ name }) => name);
  }

  /**
   * After a stop of a rig, from the header or by key: the keyboard goes back to the input, and for a moment nothing
   * starts. A start that is in progress is cancelled, and a run that it may have started is stopped as well.
   */
  async #stopped({ name, answer }) {
    this.cards.get(name)?.cancel();
    this.asked.get(startOn(name))?.then(() => stopRig(name));
    if (!TOUCH.matches && !document.querySelector("dialog[open]")) this.#focus();
    this.stopping += 1;
    await answer;
    setTimeout(() => (this.stopping -= 1), STOPPED_MS);
  }

  /** What starts a motion: not just after a stop. */
  #move(about, work) {
    return this.stopping ? this.#tell(STOPPED) : this.#ask(about, work);
  }

  #closing({ closed_at: closed }) {
    if (closed || !may("operator")) return this.other;
    const end = async () => this.#show(await post(`${this.path}/close`));
    const close = () => {
      const { left } = counted(this.list.units);
      if (!left) return this.#ask("close", end);
      const text = `${plural(left, "unit")} not measured. A closed batch cannot be reopened. A run in progress continues.`;
      return askConfirmation({ title: "Close this batch?", text, action: "Close" }, end);
    };
    return [this.other, h("button", { id: "close-list", type: "button", class: "small", on: { click: close } }, "Close this batch")];
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
        // no newer answer is shown
        this.tag = news.tag;
        this.#show(news.answer);
      }
      if (this.untold.length) this.#ask("join", () => this.#join());
      if (this.refused?.status === 0) this.refused = null; // the service answers again
      this.error.say(this.refused ?? null);
    } catch (problem) {
      this.#say(problem);
    }
    this.#soon(document.hidden ? HIDDEN_LOOK_MS : LOOK_MS);
  }

  /** Requests presence checks of the boards of idle rigs; for a rig that has just become idle at once. */
  async #haveBoardsLookedAt() {
    const idle = this.list.rigs.filter(({ on, busy_with: busy }) => on && on.state !== "running" && !busy);
    if (this.list.closed_at || !idle.length || document.hidden || !may("operator")) return;
    const isNew = this.isLooking && idle.some(({ seen }) => !seen); // a bench that is offline reports none
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
        const begin = (turn, signal) => this.#move(startOn(turn.rig), async () => this.#show(await post(`${this.path}/start`, turn, signal)));
        const ask = (verb, run) => {
          const send = () => post(`/api/runs/${encodeURIComponent(run)}/${verb}`);
          return verb === "resume" ? this.#move(`${verb} ${run}`, send) : this.#ask(`${verb} ${run}`, send);
        };
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

  /** Chooses the rig that Enter starts: the only one that asks, or the one whose board last reported its unit. */
  #choose() {
    const asking = [...this.cards.values()].filter((card) => card.asks);
    const sure = asking.filter((card) => card.isSure);
    this.sure = [...(this.sure ?? []).filter((card) => sure.includes(card)), ...sure.filter((card) => !this.sure?.includes(card))];
    this.meant = asking.length === 1 ? asking[0] : this.sure.at(-1);
    for (const card of this.cards.values()) card.point(card === this.meant, asking.length > 1);
  }

  /** Handles Enter alone, or a serial number and Enter, as a bar-code reader types it. */
  #entered(event) {
    event.preventDefault();
    const serial = asRead(this.scan.value);
    this.scan.value = "";
    if (serial) {
      this.scannedAt = performance.now();
      if (this.list.closed_at) this.#another(serial);
      else this.#scanned(serial);
    } else if (this.stopping) {
      this.#tell(STOPPED);
    } else if (performance.now() - this.scannedAt > SCANNER_MS) {
      if (this.isOver) this.#another();
      else if (this.meant) this.meant.press();
      else if ([...this.cards.values()].some((card) => card.asks)) this.#tell("Several rigs ask for a unit. Scan the mounted unit, or press its button.");
    }
  }

  /** Opens the form of another batch, once the result here has been visible for a moment; a serial number goes along. */
  #another(serial = "") {
    if (serial) keepForNext(serial);
    else if ([...this.cards.values()].some((card) => card.isCalm)) return this.#tell(TOO_SOON);
    location.hash = this.other.hash;
  }

  #scanned(typed) {
    const known = this.list.units.map(({ unit }) => unit);
    const alike = (unit) => unit.toLowerCase() === typed.toLowerCase();
    const serial = known.includes(typed) ? typed : (known.find(alike) ?? typed); // a reader may change the case
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
      return this.#tell(place.rig.on ? `${serial} is next.` : `${serial} can be mounted on rig ${place.name} as well.`);
    }
    if (card) return card.press();
    this.untold.push(serial);
    return this.#ask("join", () => this.#join());
  }

  /** Adds scanned units to the batch. Without an answer they are stored and added once the service answers; they start nothing. */
  async #join() {
    while (this.untold.length) {
      const [serial] = this.untold;
      try {
        const list = await post(`${this.path}/units`, { units: [serial] });
        this.#show(list);
        this.#tell(list.known.length ? standingOf(serial, list.units) : `${serial} was added.`);
      } catch (problem) {
        if (problem.status !== 0) this.untold.shift();
        else this.#tell(`The service does not answer. These units are kept here and added later: ${this.untold.join(", ")}.`);
        throw problem;
      }
      this.untold.shift();
    }
  }

  /** Runs one request per subject at a time, so that none waits for the design of a run. A refusal stays visible until the next. */
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
      if (problem.name === "AbortError") return; // cancelled here
      this.refused = problem;
      this.#say(problem);
    } finally {
      this.answers += 1;
      this.tag = null;
      this.#soon(0);
    }
  }

  /** Shows a message; one about a presence check lasts as long as its status. */
  #tell(text, about = null) {
    this.said.textContent = text;
    this.saidOf = about && { card: about, says: about.rig.seen?.says };
  }

  #say(problem) {
    this.error.say(serviceError(problem, this.signal));
  }
}

/** The subject of the request that starts a unit on a rig. */
const startOn = (rig) => `start on ${rig}`;

class UnitsTable {
  /** `take(unit)` removes a waiting unit. */
  constructor(take) {
    this.take = take;
    this.element = h("section", { class: "card", "aria-labelledby": "queue-units-title" });
  }

  show({ units, closed_at: closed }) {
    const shown = JSON.stringify([units, closed]);
    if (shown === this.shown) return; // a button in the table keeps the focus
    this.shown = shown;
    const names = ["Unit", "State", "Rig", "Run", "Why", "Change"];
    const table = dataTable("Units of this batch", names, units.map((turn) => this.#row(turn, closed)), { id: "queue-units" });
    fill(this.element, h("h2", { id: "queue-units-title" }, "Units"), table);
  }

  #row(turn, closed) {
    const canGo = !closed && turn.state === "waiting" && may("operator");
    const props = { class: "small", "aria-label": `Remove ${turn.unit}` };
    const state = turn.word ?? turn.state;
    return tableRow(unitLink(turn.unit), [
      h("span", { class: `pill turn-${state}` }, state.replace("_", "-")),
      turn.rig ?? "–",
      turn.run_id ? runLink(turn.run_id) : "–",
      h("td", { class: "wrap" }, turn.why),
      h("td", { class: "plain" }, canGo && button("Remove", () => this.take(turn.unit), props)),
    ]);
  }
}

/** The state of a unit that is in the batch already. */
function standingOf(serial, units) {
  const turn = units.findLast(({ unit }) => unit === serial);
  const place = units.filter(({ state }) => state === "waiting").indexOf(turn) + 1;
  if (turn.state === "running") return `${serial} is being measured on rig ${turn.rig}.`;
  if (turn.state === "waiting") return `${serial} is in the batch already, as number ${place} of the waiting units.`;
  if (turn.state === "follow_up") return `${serial} is in the batch already: a follow-up run identifies why it failed.`;
  return `${serial} has been measured in this batch: ${(turn.word ?? turn.state).toUpperCase()}.`;
}

/** Counts units: still to be measured, and by their last result. A unit that failed may be still to be measured again. */
function counted(units) {
  const words = new Map();
  const left = new Set();
  for (const { unit, state, word } of units) {
    if (word || state === "failed") words.set(unit, word ?? "fail");
    if (!["done", "failed"].includes(state)) left.add(unit);
  }
  const poor = [...words.values()].filter((word) => word === "fail").length;
  return { left: left.size, poor, good: words.size - poor };
}
