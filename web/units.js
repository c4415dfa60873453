// One unit with its history.

import { get, post, remove, serviceError } from "./api.js";
import { confirmButton } from "./ask.js";
import { Calibrations } from "./calibrations.js";
import { Chart, NONE_VALID } from "./charts.js";
import {
  attempt,
  card,
  dataTable,
  errorLine,
  fill,
  h,
  numberCell,
  runHref,
  runLink,
  select,
  solveHref,
  statusPill,
} from "./dom.js";
import { fixed, isKnown, moment, plural, plusMinus, significant } from "./format.js";
import { LongWork } from "./longwork.js";
import { may } from "./me.js";
import { runHeadings, runRow } from "./runlist.js";
import { solutionLinks } from "./solutions.js";

export async function unitView({ root, parts: [serial], signal }) {
  const path = `/api/units/${encodeURIComponent(serial)}`;
  const [unit, rigs] = await Promise.all([get(path, signal), get("/api/rigs", signal)]);
  const solvable = unit.runs.find((run) => run.result);
  const calibrations = new Calibrations(serial, signal);
  const calibrationsShown = calibrations.read();
  const chart = new Chart("history", "Bias, scale and RMS error over time, plain fit", { tall: true, signal, empty: NONE_VALID });
  const rows = unit.runs.map((run) => runRow(run, { withUnit: false }));
  fill(
    root,
    h("h1", {}, "Unit ", h("span", { class: "serial" }, unit.serial)),
    h("p", { class: "muted" }, `${plural(unit.n_runs, "run")}, known since `, moment(unit.created_at)),
    unit.n_runs === 0 && may("releaser") && removal(serial, path, calibrations),
    unit.revision_in_force !== null && rigs.length > 0 && may("operator") && verifying(unit, rigs),
    calibrations.elements,
    unitHistory(serial, signal, calibrationsShown),
    chart.element,
    card(
      "runs",
      "Runs",
      dataTable("Runs of this unit", runHeadings({ withUnit: false }), rows, { id: "history-table" }),
      h(
        "p",
        { class: "downloads" },
        h("a", { href: `#/compare?unit=${encodeURIComponent(serial)}` }, "Compare with other units"),
        solvable && h("a", { href: solveHref({ rig: solvable.rig, unit: serial }) }, "Separate errors of stage and unit"),
        solutionLinks({ unit: serial }, signal),
        h("a", { href: `#/trail?unit=${encodeURIComponent(serial)}` }, "Audit log of this unit"),
        h("a", { href: `${path}/archive`, download: "", id: "archive" }, "Archive of this unit (ZIP)"),
      ),
    ),
  );
  await Promise.all([calibrationsShown, chart.load(`${path}/figures/history`)]);
}

/** The button that verifies the revision in force with new poses, by default on the rig that it was calibrated on. */
export function verifying({ serial, runs, active_run_id: active, revision_in_force: revision }, rigs) {
  const last = runs.find(({ id }) => id === active)?.rig;
  const rig = select({ id: "verify-rig", "aria-label": "Rig to verify on" }, rigs.map(({ name }) => name), last);
  const button = h("button", { type: "button", id: "verify" }, "Verify");
  const error = errorLine("verify-error");
  const verify = async () => {
    const run = await post("/api/runs", { unit: serial, rig: rig.value, plan: { kind: "verification" } });
    location.hash = runHref(run.id);
  };
  button.addEventListener("click", () => attempt([button], error, verify));
  const says = `Starts a run that applies revision ${revision} to new poses and reports the residual.`;
  return h(
    "div",
    {},
    error.element,
    h("div", { class: "buttons verify" }, button, rigs.length > 1 && rig, h("span", { class: "muted" }, says)),
  );
}

/** The button that removes a unit whose runs were all moved to another serial number. */
function removal(serial, path, calibrations) {
  const question = {
    title: `Remove unit ${serial}?`,
    text: "It has no runs. Its entries in the audit log are kept.",
    action: "Remove the unit",
  };
  const removed = () => remove(path).then(() => (calibrations.unitIsGone = true));
  const leave = () => (location.hash = "#/units");
  return h("p", {}, confirmButton("Remove this empty unit…", question, removed, leave, { id: "remove-unit" }));
}

const LEAST_P = 0.0001;
const SEARCH = { doing: "Diagnosing both runs together.", share: "the search" };

/**
 * A card that loads itself, and again after two runs have been diagnosed together. It is filled once what is `above` it
 * is shown: else its buttons would move away from under the pointer.
 */
function unitHistory(serial, signal, above) {
  const path = `/api/units/${encodeURIComponent(serial)}`;
  const body = h("div");
  const error = errorLine("changes-error");
  const work = new LongWork("both", SEARCH, signal);
  const chart = new Chart("unit-chart", "Control chart: bias and scale since the unit last changed", { low: true, signal });
  const element = card("changes", "Changes between runs", error.element, work.element, body);

  async function read() {
    const [unit, changes] = await Promise.all([get(path, signal), get(`${path}/changes`, signal), above]);
    const rows = changes.toReversed().map((change) => row(change, diagnoseBoth));
    const drawn = changes.some((change) => isKnown(change.signal));
    fill(
      body,
      due(unit),
      rows.length
        ? [h("p", { class: "muted", id: "changes-basis" }, BASIS), dataTable("Changes", HEADINGS, rows, { id: "changes-table", class: "dense" })]
        : h("p", { class: "muted" }, "Changes are evaluated from two valid calibrations on."),
      drawn && chart.element,
    );
    if (drawn) await chart.load(`${path}/figures/chart`);
  }

  const say = (problem) => error.say(serviceError(problem, signal));

  function diagnoseBoth({ from, to }) {
    const address = `/api/runs/${encodeURIComponent(to)}/diagnosis`;
    return attempt(body.querySelectorAll("button"), error, async () => {
      if (await work.carryOut(address, { runs: [from] })) await read();
    });
  }

  read().catch(say);
  return element;
}

function due({ due_at: at, overdue, due_says: says }) {
  return h(
    "p",
    { id: "due" },
    h("strong", {}, "Due: "),
    at ? moment(at) : "not known",
    overdue && h("span", { class: "tag warns" }, "overdue"),
    `: ${says}`,
  );
}

const HEADINGS = ["From run", "To run", "Verdict", "Statement", "#Days", "#Bias", "#Scale", "#RMS error", "Gyro", "#p"];
const BASIS =
  "Bias, scale and RMS error are compared by the plain fit of each run, without effects. The calibration in force, with its " +
  "effects, is listed above. Gyro: noise of both runs alone; it does not enter the verdict.";
const WORDS = { changed: "changed", unchanged: "unchanged", not_known: "not known" };

function pValue(p) {
  if (!isKnown(p)) return "–";
  return p < LEAST_P ? `< ${LEAST_P}` : significant(p, 2);
}

const AXES = ["x", "y", "z"];

/** The gyro's biases and scale, as far as they are known. */
function gyroChange(gyro) {
  if (!gyro) return "–";
  const biases = AXES.map((axis, k) => isKnown(gyro.bias_dps[k]) && `${axis} ${plusMinus(gyro.bias_dps[k], gyro.bias_std_dps[k], "°/s")}`);
  return [...biases, isKnown(gyro.scale) && `scale ${plusMinus(gyro.scale, gyro.scale_std)}`].filter(Boolean).join(", ");
}

function row(change, diagnoseBoth) {
  const link = (id) => h("td", {}, runLink(id));
  const untraced = change.verdict === "changed" && change.effects === null && may("operator");
  const button = untraced && h("button", { type: "button" }, "Diagnose both");
  if (button) button.addEventListener("click", () => diagnoseBoth(change));
  return h(
    "tr",
    { "data-to": change.to },
    link(change.from),
    link(change.to),
    h(
      "td",
      { class: "plain" },
      statusPill(WORDS[change.verdict]),
      change.signal && h("span", { class: "tag warns", title: "The control chart signals at this run." }, "chart"),
    ),
    h("td", { class: "wrap" }, change.says, button && h("div", { class: "buttons" }, button)),
    numberCell(fixed(change.days, change.days < 10 ? 1 : 0)),
    numberCell(plusMinus(change.bias_deg, change.bias_std_deg, "°")),
    numberCell(plusMinus(change.scale, change.scale_std)),
    numberCell(isKnown(change.rms_deg) ? significant(change.rms_deg, 2, "°") : "–"),
    h("td", { class: "wrap" }, gyroChange(change.gyro)),
    numberCell(pValue(change.p_value)),
  );
}
