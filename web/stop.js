// The stop buttons in the header: visible on every page, one click, without confirmation.

import { post, serviceError } from "./api.js";
import { fill, h, runName } from "./dom.js";
import { onRigs } from "./rigs.js";

const BUTTONS = 3;
const CHOSEN_KEY = "calrig.stop-rig";
const CALM_MS = 15_000;
const BACK =
  "The service is reachable again. Stop requests sent while it was away were not delivered: if a stage moves, press Stop " +
  "again.";
const CUT = "If the stage still moves, cut its motor power.";
const CUT_EACH = "If a stage still moves, cut its motor power.";

let preferred = null;

/** Puts the button of a page's own rig first; null on pages without one. */
export function preferRig(name) {
  if (name === preferred) return;
  preferred = name;
  window.dispatchEvent(new Event("calrig:prefer"));
}

/** Has the Escape key stop the rigs that `moving()` names while a view is open, unless it closes a dialog. */
export function stopsOnEscape(moving, signal) {
  const pressed = (event) => {
    if (event.key !== "Escape" || event.repeat || document.querySelector("dialog[open]")) return;
    const names = moving();
    if (names.length > 1) stopAll(names.map((name) => ({ name })), document.getElementById("stop-line"));
    else if (names.length) stopRig(names[0]);
  };
  window.addEventListener("keydown", pressed, { signal });
}

/**
 * Fills `place` with a button for each rig and one for all, in configured order, a page's own rig first. While a page is
 * shown, no button changes its rig under the pointer. Many rigs share a list; if they are in several halls, the last
 * button stops those of one hall, as no operator sees more. `line` shows the outcome.
 */
export function stopButtons(place, line) {
  let known = [];
  const draw = () => {
    const first = known.filter(({ name }) => name === preferred);
    const rigs = [...first, ...known.filter(({ name }) => name !== preferred)];
    if (rigs.length > BUTTONS) return fill(place, chosenRig(rigs, () => known, line));
    fill(place, rigs.map(({ name }) => button(name, line)), rigs.length > 1 && allButton(() => known, line));
  };
  window.addEventListener("calrig:prefer", () => known.length > 1 && draw());
  onRigs((rigs) => {
    const same = named(rigs) === named(known);
    known = rigs;
    if (!same) draw();
    for (const { name, state } of rigs) {
      const option = [...place.querySelectorAll("option")].find(({ value }) => value === name);
      if (option) option.textContent = state === "busy" ? `${name} (busy)` : name;
    }
  });
  window.addEventListener("calrig:there", () => line.lost && back(line));
}

const named = (rigs) => rigs.map(({ name, hall }) => `${name} ${hall ?? ""}`).join("\n");

/** A button for a rig in a list, with the rig's name for screen readers; the header shows the outcome. */
export function stopButton(name) {
  const element = button(name, document.getElementById("stop-line"));
  element.querySelector("span").className = "for-screen-readers";
  return element;
}

function button(name, line) {
  const text = h("span", {}, name);
  const element = h("button", { type: "button", class: "stop", "data-rig": name }, "Stop ", text);
  element.addEventListener("click", () => stop(element.dataset.rig, line));
  return element;
}

function allButton(rigs, line) {
  const element = h("button", { type: "button", class: "stop", id: "stop-all" }, "Stop all");
  element.addEventListener("click", () => stopAll(rigs(), line));
  return element;
}

/** The list, the button of its selected rig, and the one of all rigs, or of all in that rig's hall. */
function chosenRig(rigs, known, line) {
  const option = ({ name }) => h("option", { value: name }, name);
  const halls = [...new Set(rigs.map(({ hall }) => hall))];
  const ofHall = (hall) => rigs.filter((rig) => rig.hall === hall);
  const groups = halls.map((hall) => h("optgroup", { label: hallName(hall) }, ofHall(hall).map(option)));
  const choice = h("select", { id: "stop-rig", "aria-label": "Rig to stop" }, halls.length > 1 ? groups : rigs.map(option));
  const one = button(rigs[0].name, line);
  const hallOf = (name) => rigs.find((rig) => rig.name === name).hall;
  const all = allButton(() => known().filter(({ hall }) => halls.length === 1 || hall === hallOf(choice.value)), line);
  const choose = (name) => {
    choice.value = name;
    one.dataset.rig = name;
    one.querySelector("span").textContent = name;
    if (halls.length > 1) fill(all, `Stop all, ${hallName(hallOf(name))}`);
  };
  choice.addEventListener("change", () => {
    choose(choice.value);
    localStorage.setItem(CHOSEN_KEY, choice.value); // per browser, as a screen belongs to one hall
  });
  const kept = rigs.find(({ name }) => name === localStorage.getItem(CHOSEN_KEY));
  const usual = kept ?? rigs.find(({ state }) => state === "busy") ?? rigs[0];
  choose(preferred === rigs[0].name ? preferred : usual.name);
  return [choice, one, all];
}

const hallName = (hall) => hall ?? "no hall";

/** Stops a rig; the header shows the outcome. */
export function stopRig(name) {
  return stop(name, document.getElementById("stop-line"));
}

async function stop(name, line) {
  say(line, `Stopping ${name}…`, "muted");
  const { state, run_id: run, problem } = await request(name);
  if (problem) {
    // the message of a 409 itself says what to do
    return saysNot(line, `${name} was not stopped: ${problem.message}`, problem.status === 409 ? "." : ` ${CUT}`, problem);
  }
  const ended = run ? ` Run ${runName(run)} ends; its poses are kept.` : "";
  say(line, `${name}: ${state === "unreachable" ? `stop sent. ${CUT}` : "stage stopped."}${ended}`, "told");
  calmLater(line);
}

/** Stops each rig independently, those with a run first; none waits for a rig that does not answer. */
async function stopAll(rigs, line) {
  const names = rigs.toSorted((a, b) => (b.state === "busy") - (a.state === "busy")).map(({ name }) => name);
  say(line, `Stopping all ${names.length} rigs…`, "muted");
  const answers = await Promise.all(names.map(async (name) => ({ name, ...(await request(name)) })));
  const not = answers.filter(({ problem, state }) => problem || state === "unreachable");
  if (not.length) {
    const lost = not.find(({ problem }) => problem?.status === 0)?.problem;
    const why = lost ? lost.message : not.map(({ name, problem }) => `${name}: ${problem?.message ?? "unreachable"}`).join("; ");
    const words = `Standstill not confirmed: ${not.map(({ name }) => name).join(", ")}. ${why}. ${CUT_EACH}`;
    return saysNot(line, words.replaceAll("..", "."), "", lost);
  }
  say(line, `All ${names.length} stages stopped: ${names.join(", ")}.`, "told");
  calmLater(line);
}

/** The service's answer, or the `problem`. The event "calrig:stop" tells the view which rig it is, and the answer. */
function request(name) {
  const answer = asked(name);
  window.dispatchEvent(new CustomEvent("calrig:stop", { detail: { name, answer } }));
  return answer;
}

async function asked(name) {
  try {
    return await post(`/api/rigs/${encodeURIComponent(name)}/stop`);
  } catch (problem) {
    return { problem: serviceError(problem) };
  }
}

/** Shows a failure until it is resolved: without any answer, until the service is reachable again. */
function saysNot(line, text, more, problem) {
  say(line, text + more, "error");
  line.lost = problem?.status === 0;
}

function back(line) {
  say(line, BACK, "told");
}

function calmLater(line) {
  line.timer = setTimeout(() => (line.hidden = true), CALM_MS);
}

function say(line, text, kind) {
  clearTimeout(line.timer);
  line.lost = false;
  fill(line, text);
  line.className = kind;
  line.hidden = false;
}
