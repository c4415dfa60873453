// The rigs as tables, one per hall. Only what has changed is redrawn, so that keyboard focus and pressed buttons
// survive the updates of forty rigs.

import { remove, serviceError } from "./api.js";
import { hallOf, inOrder, keyOf } from "./benchfilters.js";
import { button, errorLine, fill, h, headings, rigHref, runHref, runLink, runName, statusPill, unitLink } from "./dom.js";
import { duration, fixed, moment, plural } from "./format.js";
import { may } from "./me.js";
import { stopButton } from "./stop.js";

const COLUMNS = ["Rig", "State", "Run", "Waiting", "Needs attention", "Stop"];
const NAMED = 3;
const WORDS = { waiting: "waits for mounting" };

export class Halls {
  /** `announce(text)` is for screen readers: only events that need attention. */
  constructor(announce) {
    this.element = h("div", { class: "halls" });
    this.announce = announce;
    this.rows = new Map();
    this.benches = new Map();
  }

  /** The benches as they are now. */
  show(benches) {
    const built = JSON.stringify(benches.map(({ name, hall, rigs }) => [name, hall, rigs.map((rig) => rig.name)]));
    if (built !== this.built) this.#build(benches);
    this.built = built;
    const news = [];
    for (const bench of benches) {
      this.benches.get(bench.name).show(bench);
      for (const rig of bench.rigs) news.push(this.rows.get(keyOf(bench, rig)).show(rig, bench));
    }
    const events = news.filter(Boolean);
    if (events.length) this.announce(events.join(" "));
  }

  /** Shows only the rigs with these keys, and hides benches and halls without any; a bench without rigs stays. */
  choose(keys) {
    const isAll = keys.size === this.rows.size;
    for (const [key, { element }] of this.rows) element.hidden = !keys.has(key);
    for (const { element } of this.benches.values()) {
      element.hidden = !isAll && !element.querySelector("tr.rig:not([hidden])");
    }
    for (const hall of this.element.children) hall.hidden = !hall.querySelector("tbody:not([hidden])");
  }

  #build(benches) {
    this.rows.clear();
    this.benches.clear();
    const names = [...new Set(benches.map(hallOf))].sort(inOrder);
    const halls = names.map((name, k) => this.#hall(name, k, benches.filter((bench) => hallOf(bench) === name)));
    fill(this.element, halls);
  }

  #hall(name, k, benches) {
    const bodies = benches
      .sort((a, b) => inOrder(a.name, b.name))
      .map((bench) => {
        const head = new BenchHead();
        const rows = bench.rigs.map((rig) => new RigRow(rig.name));
        this.benches.set(bench.name, head);
        bench.rigs.forEach((rig, place) => this.rows.set(keyOf(bench, rig), rows[place]));
        head.element.append(...rows.map(({ element }) => element));
        return head.element;
      });
    const id = `hall-${k}`;
    const head = headings(...COLUMNS);
    asGrid(head, "rowgroup", "columnheader");
    const table = h("table", { class: "bench-table", role: "table", "aria-labelledby": id }, head, bodies);
    return h("section", { class: "card", "aria-labelledby": id }, h("h2", { id }, name), table);
  }
}

/** On a phone the rows are laid out as blocks, which browsers no longer expose as a table. */
function asGrid(group, role, cells) {
  group.setAttribute("role", role);
  for (const row of group.rows) {
    row.setAttribute("role", "row");
    for (const cell of row.cells) cell.setAttribute("role", cells);
  }
}

/** The row above a bench's rigs: its name and the age of its last report. */
class BenchHead {
  constructor() {
    this.cell = h("th", { scope: "rowgroup", colspan: COLUMNS.length, role: "rowheader", class: "bench" });
    this.element = h("tbody", { role: "rowgroup" }, h("tr", { role: "row" }, this.cell));
  }

  show({ name, state, silent_since: since, silent_for_s: silent_s, undelivered, refused, clock, rigs }) {
    const now = JSON.stringify([name, state, since, silent_s, undelivered, refused, clock, rigs.length]);
    if (now === this.now) return;
    this.now = now;
    const heard = {
      in_touch: () => h("span", { class: "muted" }, name === null ? "" : "connected: last report less than 10 s ago"),
      silent: () => h("span", { class: "away" }, `last report ${age(silent_s)} ago, `, moment(since)),
      never_seen: () => h("span", { class: "away" }, "no report yet"),
    }[state]();
    const rest = undelivered && `; ${plural(undelivered.parcels, "message")} not delivered yet`;
    const who = h("span", { class: "rig-name" }, name ?? "This machine");
    const off = clock && h("span", { class: "away" }, `; ${clock}`);
    const why = refused && h("p", { class: "error" }, `Takes no orders: ${refused}.`);
    fill(this.cell, who, " ", heard, h("span", { class: "muted" }, rest), off, why);
  }
}

class RigRow {
  constructor(name) {
    this.name = name;
    this.now = new Map();
    this.stop = stopButton(name);
    this.progress = h("progress", { max: "1", "aria-label": `Progress of the run on ${name}` });
    this.left = h("span", { class: "muted" });
    this.run = h("div");
    this.live = h("div", { class: "bench-progress" }, this.progress, this.left);
    const link = h("a", { href: rigHref(name) }, name);
    const cell = (k, ...children) => h("td", { role: "cell", "data-name": COLUMNS[k] }, children);
    this.state = cell(1);
    this.waiting = cell(3);
    this.trouble = cell(4);
    this.element = h(
      "tr",
      { class: "rig", role: "row", "data-rig": name },
      h("th", { scope: "row", role: "rowheader" }, link),
      this.state,
      cell(2, this.run, this.live),
      this.waiting,
      this.trouble,
      cell(5, this.stop),
    );
  }

  /** Returns an event that needs attention, or null. */
  show(rig, bench) {
    const { run, run_id: id, stop_asked_at, queued, unresolved, check } = rig;
    const kind = kindOf(rig);
    const since = kind === "offline" && ` for ${age(bench.silent_for_s)}`;
    const word = WORDS[kind] ?? kind;
    this.#write("state", [kind, since], () => {
      fill(this.state, h("span", { class: `pill ${kind}` }, word), since && h("span", { class: "muted" }, since));
    });
    this.#write("run", [run?.id ?? id, run?.unit, run?.status === "queued" && !run.error, kind, run?.waiting_for], () => {
      fill(this.run, runWords(rig));
    });
    this.#showProgress(run, kind);
    this.#write("queued", queued.map((one) => one.id), () => fill(this.waiting, queueWords(queued)));
    const held = [run, ...queued].filter((one) => one?.held).map((one) => one.id);
    this.#write("trouble", [stop_asked_at, held, unresolved?.id, unresolved?.status, check?.overdue && check], () => {
      const stop = stop_asked_at && stopWaits(stop_asked_at, this.name);
      const asks = held.length > 0 && waitsForAPerson(held);
      fill(this.trouble, stop, asks, unresolved && failure(unresolved), check?.overdue && overdue(check, this.name));
    });
    this.stop.hidden = id === null;
    const needs = unresolved ? `run ${unresolved.status}` : kind in WORDS || kind === "offline" ? word : "";
    const isNews = this.needs !== undefined && needs && needs !== this.needs;
    this.needs = needs;
    return isNews ? `Rig ${this.name}: ${needs}.` : null;
  }

  #write(part, what, write) {
    const now = JSON.stringify(what);
    if (this.now.get(part) === now) return;
    this.now.set(part, now);
    write();
  }

  #showProgress(run, kind) {
    this.live.hidden = !run || run.status === "queued";
    if (this.live.hidden) return;
    const { poses_done: done, poses_total: total, fraction, remaining_s: left_s } = run.progress;
    this.progress.value = fraction;
    const poses = total ? `${done} of ${plural(total, "pose")}` : `${Math.floor(100 * fraction)} % of the log`;
    const left = left_s === null ? "" : `, about ${duration(left_s)} left`;
    const now = { offline: " at the last report", paused: ", paused", waiting: ", paused" }[kind] ?? left;
    this.left.textContent = poses + now;
  }
}

/** A duration in the steps in which the service reports it. */
function age(seconds) {
  if (seconds < 60) return `${seconds}\u00a0s`;
  if (seconds < 3600) return `${seconds / 60}\u00a0min`;
  const hours = seconds / 3600;
  return hours < 48 ? `${hours}\u00a0h` : plural(Math.floor(hours / 24), "day");
}

function kindOf({ state, run }) {
  if (state !== "busy") return state;
  if (run?.waiting_for) return "waiting";
  return run?.status === "paused" ? "paused" : state;
}

function runWords({ run, run_id: id, state }) {
  if (!run) return id && runLink(id, "Run ");
  const { mount_deg: mount, mount_axis: axis } = run.waiting_for ?? {};
  const clamp = `Clamp the unit at ${fixed(mount, 0, "°")} about ${axis}, then resume the run.`;
  return [
    unitLink(run.unit),
    " ",
    runLink(run.id, "run "),
    run.kind !== "calibration" && ` (${run.kind})`,
    run.status === "queued" && !run.error && state !== "offline" && h("span", { class: "muted" }, " about to begin"),
    run.waiting_for && h("p", { class: "wait" }, clamp),
  ];
}

function queueWords(queued) {
  if (!queued.length) return [];
  const named = queued.slice(0, NAMED).map(({ id, unit }, k) => {
    return [k > 0 && ", ", h("a", { href: runHref(id), title: `run ${runName(id)}` }, unit)];
  });
  const more = queued.length > NAMED && ` and ${queued.length - NAMED} more`;
  return [`${plural(queued.length, "run")}: `, named, more];
}

function failure({ id, status, error, unit }) {
  const why = error && h("span", { class: "reason" }, error);
  return h("div", {}, statusPill(status), " ", runLink(id, "run "), ` of ${unit} `, why);
}

/** Runs that the bench holds back since it was away: their pages have the button. */
function waitsForAPerson(ids) {
  const links = ids.slice(0, NAMED).map((id, k) => [k > 0 && ", ", runLink(id, "run ")]);
  return h("div", {}, "Continue or end: ", links, ids.length > NAMED && ` and ${ids.length - NAMED} more`);
}

/** A stop that the bench has not answered, and the button that withdraws it. */
function stopWaits(asked_at, name) {
  const error = errorLine();
  const ask = async () => {
    withdraw.disabled = true;
    try {
      await remove(`/api/rigs/${encodeURIComponent(name)}/stop`);
    } catch (problem) {
      withdraw.disabled = false;
      error.say(serviceError(problem));
    }
  };
  const withdraw = button("Withdraw stop", ask, { class: "withdraw-stop" });
  const told = " not answered yet. The bench obeys it before anything else. ";
  return h("div", { class: "stop-waits" }, "Stop of ", moment(asked_at), told, may("operator") && withdraw, error.element);
}

function overdue({ unit, due_at: due }, name) {
  const link = h("a", { href: rigHref(name) }, "check overdue");
  return h("div", {}, link, " since ", moment(due), h("span", { class: "muted" }, `, by ${unit}`));
}
