// The first view: start a run, rigs, and the list of runs.

import { get, post } from "./api.js";
import {
  attempt,
  button,
  card,
  dataTable,
  errorLine,
  field,
  fill,
  h,
  onSubmit,
  rigHref,
  runHref,
  runLink,
  select,
  serialInput,
  statusPill,
  tableBox,
} from "./dom.js";
import { planForm } from "./plan.js";
import { onRigs, standing } from "./rigs.js";
import { runList } from "./runlist.js";
import { stagePlace } from "./stageplace.js";

const OPERATOR_KEY = "calrig.operator";
const TOUCH = window.matchMedia("(pointer: coarse)"); // where a focus would open the keyboard over the page

/** The address can fill the form: `#/?unit=AS-1&rig=bench-1&mounts=0,120,240&axis=x`, or `#/?again=RUN` as a run was. */
export async function startView({ root, query, signal }) {
  const [rigs, before] = await Promise.all([get("/api/rigs", signal), runAgain(query.get("again"), signal)]);
  const { form, place, unit } = startForm(rigs, before, query, signal);
  const rigList = h("ul", { class: "rigs", "data-testid": "rigs" });
  const runs = runList(rigs, query, signal);
  showRigs(rigList, rigs);
  fill(
    root,
    h("h1", {}, "Calibrate a unit"),
    h("div", { class: "columns" }, form, card("rigs", "Rigs", rigList, portsLook())),
    runs.element,
  );
  if (!TOUCH.matches) unit.focus({ preventScroll: true }); // a bar-code reader types where the focus is
  await Promise.all([runs.refresh(), rigs.length > 0 && place.look()]);
  import("./run.js").catch(() => {}); // preloads the view that Start opens
  keepFresh(rigList, runs, rigs, signal);
}

const runAgain = (id, signal) => (id ? get(`/api/runs/${encodeURIComponent(id)}`, signal) : null);

function startForm(rigs, before, query, signal) {
  const rig = select({ id: "rig" }, rigs.map(({ name }) => name), before?.rig ?? query.get("rig"));
  const unit = serialInput(before?.unit ?? query.get("unit"));
  const operator = h("input", {
    id: "operator",
    type: "text",
    autocomplete: "name",
    value: localStorage.getItem(OPERATOR_KEY),
  });
  const note = h("input", { id: "note", type: "text", autocomplete: "off", value: before?.note });
  const plan = planForm(() => ({ rig: rig.value || null, unit: unit.value }), signal);
  if (before?.plan) plan.take(before.plan);
  else plan.prefill(query);
  const place = stagePlace(() => rig.value, signal);
  const error = errorLine("start-error");
  const busy = h("p", { id: "rig-busy", class: "cautions", role: "alert", hidden: true });
  unit.addEventListener("change", () => plan.estimate());
  rig.addEventListener("change", () => {
    plan.estimate();
    place.look().catch((problem) => signal.aborted || error.say(problem));
  });
  const start = h("button", { id: "start", type: "submit", class: "primary" }, "Start");
  const form = h(
    "form",
    { class: "card start" },
    h(
      "div",
      { class: "fields two" },
      field("unit", "Serial number", unit),
      field("rig", "Rig", rig),
    ),
    plan.element,
    error.element,
    busy,
    h("div", { class: "buttons" }, start),
    h(
      "details",
      { id: "run-more" },
      h("summary", {}, "Operator, note, stage position"),
      h("div", { class: "fields two" }, field("operator", "Operator (optional)", operator), field("note", "Note (optional)", note)),
      place.element,
    ),
  );
  const begin = async (queue) => {
    busy.hidden = true;
    localStorage.setItem(OPERATOR_KEY, operator.value);
    const body = {
      rig: rig.value || null,
      unit: unit.value,
      plan: plan.value(),
      operator: operator.value || null,
      note: note.value || null,
      stage_at_deg: place.value(),
      queue,
    };
    location.hash = runHref((await post("/api/runs", body)).id);
  };
  const queueUp = button("Queue this run", () => attempt([queueUp], error, () => begin(true)), { id: "queue-run" });
  const send = async () => {
    try {
      await begin(false);
    } catch (problem) {
      const run = problem.status === 409 && (await runOn(rig.value));
      if (!run) throw problem;
      fill(busy, `Rig ${rig.value} is busy with `, runLink(run, "run "), ". ", queueUp);
      busy.hidden = false;
    }
  };
  onSubmit(form, start, error, () => plan.begin(send));
  return { form, place, unit };
}

/** The run that keeps a rig busy, or null. */
async function runOn(name) {
  const rigs = await get("/api/rigs");
  return rigs.find((rig) => rig.name === name && rig.state === "busy")?.run_id;
}

function showRigs(list, rigs) {
  fill(
    list,
    rigs.map((rig) =>
      h(
        "li",
        {},
        h(
          "span",
          { class: "rig-name" },
          h("a", { href: rigHref(rig.name) }, rig.name),
          rig.simulated && h("span", { class: "tag" }, "simulated"),
        ),
        statusPill(rig.state),
        h("span", { class: "muted" }, `stage ${rig.stage}, board ${rig.imu}`),
        rig.run_id && runLink(rig.run_id, "Watch run "),
      ),
    ),
    rigs.length === 0 && h("li", { class: "muted" }, "No rig is configured."),
  );
}

/** Updates rigs and runs after every change of the rigs. */
function keepFresh(rigList, runs, rigs, signal) {
  let before = standing(rigs);
  onRigs((now) => {
    if (standing(now) === before) return;
    before = standing(now);
    showRigs(rigList, now);
    runs.refresh();
  }, signal);
}

function portsLook() {
  const error = errorLine("ports-error");
  const shown = h("div", { "data-testid": "ports", "aria-live": "polite" });
  const look = h("button", { type: "button", id: "look-at-ports" }, "Scan serial ports");
  look.addEventListener("click", () => {
    fill(shown, h("p", { class: "muted" }, "Scanning every port, about seven seconds…"));
    const scan = async () => show(shown, await post("/api/rigs/scan"));
    return attempt([look], error, scan, () => fill(shown));
  });
  return h(
    "div",
    {},
    h("div", { class: "buttons" }, look),
    h("p", { class: "muted" }, "Nothing moves. The scan resets boards that are not in a run."),
    error.element,
    shown,
  );
}

function show(place, { found, stanza }) {
  if (!found.length) return fill(place, h("p", { class: "muted" }, "No serial port found. Check the USB cable."));
  fill(
    place,
    dataTable("Ports", ["Port", "Device", "Identity", "USB adapter"], found.map(row)),
    stanza && h("p", { class: "muted" }, "For calrig.toml:"),
    stanza && tableBox("For calrig.toml", h("pre", { "data-testid": "stanza" }, stanza)),
  );
}

function row({ port, kind, driver, identity, usb_id, usb_serial }) {
  return h(
    "tr",
    {},
    h("td", {}, port),
    h("td", {}, kind),
    h("td", {}, driver ? `${driver}: ${identity}` : identity),
    h("td", {}, [usb_id, usb_serial].filter(Boolean).join(", ")),
  );
}
