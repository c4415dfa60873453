// The stop buttons in the page's header: in view on every page, one click, no question asked.

import { ApiError, post } from "./api.js";
import { fill, h, runName } from "./dom.js";
import { onRigs } from "./rigs.js";

const BUTTONS = 3;
const CALM_MS = 15_000;
const CUT = "If the stage still moves, cut its motor power.";

let preferred = null;

/** On a page about one rig, that is the one offered where there are too many for a button each. */
export function preferRig(name) {
  preferred = name;
  window.dispatchEvent(new Event("calrig:prefer"));
}

/**
 * Fills `place` with a button for each rig, always in the same order: a button never becomes another rig's
 * under the pointer. Of many rigs one is chosen from a list. What came of it is said in `line`.
 */
export function stopButtons(place, line) {
  let names = null;
  onRigs((rigs) => {
    const now = rigs.map(({ name }) => name).join("\n");
    if (now !== names) {
      names = now;
      fill(place, rigs.length > BUTTONS ? chosenRig(rigs, line) : rigs.map(({ name }) => button(name, line)));
    }
    for (const { name, state } of rigs) {
      const option = [...place.querySelectorAll("option")].find(({ value }) => value === name);
      if (option) option.textContent = state === "busy" ? `${name} (busy)` : name;
    }
  });
}

/** One for a rig in a list, which is heard as its own; what comes of it is said in the page's header. */
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

function chosenRig(rigs, line) {
  const choice = h(
    "select",
    { id: "stop-rig", "aria-label": "Rig to stop" },
    rigs.map(({ name }) => h("option", { value: name }, name)),
  );
  const element = button(rigs[0].name, line);
  const choose = (name) => {
    if (!rigs.some((rig) => rig.name === name)) return;
    choice.value = name;
    element.dataset.rig = name;
    element.querySelector("span").textContent = name;
  };
  choice.addEventListener("change", () => choose(choice.value));
  window.addEventListener("calrig:prefer", () => choose(preferred));
  choose(preferred ?? rigs.find(({ state }) => state === "busy")?.name);
  return [choice, element];
}

async function stop(name, line) {
  clearTimeout(line.timer);
  say(line, `Stopping ${name}…`, "muted");
  try {
    const { state, run_id: run } = await post(`/api/rigs/${encodeURIComponent(name)}/stop`);
    const ended = run ? ` Run ${runName(run)} ends; its poses are kept.` : "";
    say(line, `${name}: the stage was told to stop.${ended}${state === "unreachable" ? ` ${CUT}` : ""}`, "told");
    line.timer = setTimeout(() => (line.hidden = true), CALM_MS);
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    const known = error.status === 409; // the service has been at the stage, and says what to do
    say(line, `${name} was not stopped: ${error.message}${known ? "." : ` ${CUT}`}`, "error");
  }
}

function say(line, text, kind) {
  fill(line, text);
  line.className = kind;
  line.hidden = false;
}
