// A list of units, one after the other: mount what is said, press Enter, read the result from across the room.

import { ApiError, get, getNews, post } from "./api.js";
import { errorLine, fill, h, runLink, tableBox, headings, unitLink } from "./dom.js";
import { may } from "./me.js";
import { Bell } from "./queuebell.js";
import { listForm } from "./queueform.js";
import { RigCard } from "./queuerig.js";

const LOOK_MS = 500;
const HIDDEN_LOOK_MS = 2000;

/** The newest open list, the one that the address names, or the form for another one (`#/queue/new`). */
export async function queueView({ root, parts: [id], signal }) {
  await styled();
  if (id && id !== "new") return new QueuePage(root, id, signal).begin();
  const open = (await get("/api/batches", signal)).find(({ closed_at: closed }) => !closed);
  if (open && !id) return new QueuePage(root, open.id, signal).begin();
  const form = await listForm(signal);
  fill(root, h("h1", {}, "Queue"), open && h("p", {}, h("a", { href: "#/queue" }, "The list that is open")), form);
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
    this.units = h("section", { class: "card", "aria-labelledby": "queue-units-title" });
    this.scan = h("input", { id: "scan", type: "text", autocomplete: "off", spellcheck: "false", disabled: !may("operator") });
    this.add = h("button", { type: "submit" }, "Enter");
    this.facts = h("p", { class: "facts" });
    this.form = h(
      "form",
      { class: "scan", on: { submit: (event) => this.#entered(event), keydown: (event) => event.repeat && event.key === "Enter" && event.preventDefault() } },
      h("label", { for: "scan" }, "Enter starts the unit that is mounted. A serial, scanned or typed, starts it where it is asked for, or joins the list"),
      h("div", { class: "scan-line" }, this.scan, this.add),
    );
    signal.addEventListener("abort", () => clearTimeout(this.timer));
    document.addEventListener("visibilitychange", () => this.#soon(0), { signal });
  }

  async begin() {
    const { tag, answer } = await getNews(this.path, null, this.signal);
    this.tag = tag;
    fill(
      this.root,
      h("h1", { class: "for-screen-readers" }, "Queue"),
      this.rigs,
      this.error.element,
      this.said,
      !answer.closed_at && this.form,
      h("div", { class: "queue-line" }, this.facts, this.bell.buttons, this.#closing(answer)),
      this.units,
    );
    this.#show(answer);
    this.scan.focus();
    this.#soon(LOOK_MS);
  }

  #closing({ closed_at: closed }) {
    const other = h("a", { href: "#/queue/new" }, "Make another list");
    if (closed || !may("operator")) return other;
    const close = () => this.#ask(async () => this.#show(await post(`${this.path}/close`)));
    return [other, h("button", { id: "close-list", type: "button", class: "small", on: { click: close } }, "Close this list")];
  }

  #soon(after) {
    clearTimeout(this.timer);
    if (!this.signal.aborted) this.timer = setTimeout(() => this.#look(), after);
  }

  async #look() {
    try {
      const news = await getNews(this.path, this.tag, this.signal);
      if (news && !this.asking) {
        this.tag = news.tag;
        this.#show(news.answer);
      }
      this.error.say(this.refused ?? null);
    } catch (problem) {
      this.#say(problem);
    }
    this.#soon(document.hidden ? HIDDEN_LOOK_MS : LOOK_MS);
  }

  #show(list) {
    this.list = list;
    for (const rig of list.rigs) {
      if (!this.cards.has(rig.name)) {
        const card = new RigCard(rig.name, (turn) => this.#begin(turn), (verb, run) => this.#ask(() => post(`/api/runs/${encodeURIComponent(run)}/${verb}`)));
        this.cards.set(rig.name, card);
        this.rigs.append(card.element);
      }
      this.cards.get(rig.name).show(rig, list.rigs.length > 1, Boolean(list.closed_at));
    }
    this.bell.heed(list.rigs);
    const left = list.units.filter(({ state }) => ["waiting", "follow_up"].includes(state)).length;
    const good = list.units.filter(({ word }) => word === "pass" || word === "done").length;
    const poor = list.units.filter(({ word }) => word === "fail").length;
    fill(
      this.facts,
      h("span", { id: "queue-counts" }, `${left} to go, ${good} done, ${poor} failed`),
      list.operator && h("span", {}, `by ${list.operator}`),
      list.note && h("span", { class: "note" }, list.note),
    );
    const shown = JSON.stringify([list.units, list.closed_at]);
    if (shown === this.shown) return; // a button in the table keeps the focus
    this.shown = shown;
    fill(this.units, h("h2", { id: "queue-units-title" }, "Units"), tableBox("Units of this list", this.#table(list)));
  }

  #table({ units, closed_at: closed }) {
    const take = (unit) => this.#ask(async () => this.#show(await post(`${this.path}/remove`, { unit })));
    const rows = units.map((turn) =>
      h(
        "tr",
        {},
        h("th", { scope: "row" }, unitLink(turn.unit)),
        h("td", {}, h("span", { class: `pill turn-${turn.word ?? turn.state}` }, (turn.word ?? turn.state).replace("_", "-"))),
        h("td", {}, turn.rig ?? "–"),
        h("td", {}, turn.run_id ? runLink(turn.run_id) : "–"),
        h("td", { class: "wrap" }, turn.why),
        h("td", { class: "plain" }, !closed && turn.state === "waiting" && may("operator") && h("button", { type: "button", class: "small", "aria-label": `Take ${turn.unit} out`, on: { click: () => take(turn.unit) } }, "Take out")),
      ),
    );
    return h("table", { id: "queue-units" }, headings("Unit", "State", "Rig", "Run", "Why", "Change"), h("tbody", {}, rows));
  }

  /** Enter alone, or a serial and Enter: what a bar-code reader types. */
  async #entered(event) {
    event.preventDefault();
    if (this.asking) return;
    const serial = this.scan.value.trim();
    this.scan.value = "";
    const cards = [...this.cards.values()];
    if (!serial) {
      const ready = cards.filter((card) => card.asks);
      if (ready.length > 1) return this.#tell("Several rigs are ready: scan the unit that is mounted, or press its button.");
      return ready[0]?.press();
    }
    const asked = cards.find((card) => card.asks && card.unit === serial);
    if (asked) return asked.press();
    await this.#ask(async () => {
      const list = await post(`${this.path}/units`, { units: [serial] });
      this.#show(list);
      this.#tell(list.known.length ? `${serial} is in the list already.` : `${serial} was added.`);
    });
  }

  #begin({ rig, unit }) {
    return this.#ask(async () => this.#show(await post(`${this.path}/start`, { rig, unit })));
  }

  /** One question at a time; what is refused stays in view until the next. */
  async #ask(work) {
    if (this.asking) return;
    this.asking = true;
    this.refused = null;
    this.error.say(null);
    this.#tell("");
    try {
      await work();
    } catch (problem) {
      this.refused = problem;
      this.#say(problem);
    } finally {
      this.asking = false;
      this.tag = null;
      this.#soon(0);
    }
  }

  #tell(text) {
    this.said.textContent = text;
  }

  #say(problem) {
    if (this.signal.aborted) return;
    if (!(problem instanceof ApiError)) throw problem;
    this.error.say(problem);
  }
}
