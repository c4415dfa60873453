// All units, and one unit with its history.

import { get, post, remove } from "./api.js";
import { askConfirmation } from "./ask.js";
import { Calibrations } from "./calibrations.js";
import { Chart } from "./charts.js";
import { errorLine, fill, h, headings, held, runHref, solveHref, tableBox, unitLink } from "./dom.js";
import { moment, plural } from "./format.js";
import { unitHistory } from "./history.js";
import { may } from "./me.js";
import { runHeadings, runRow } from "./runlist.js";

const NONE_COUNT = "No completed calibration that counts: nothing is drawn of other runs, or of voided ones.";

export async function unitsView({ root, signal }) {
  const units = await get("/api/units", signal);
  const rows = units.map((unit) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, unitLink(unit.serial)),
      h("td", { class: "number" }, unit.n_runs.toLocaleString()),
      h("td", {}, moment(unit.last_run_at)),
      h("td", {}, moment(unit.due_at), unit.overdue && h("span", { class: "tag warns" }, "overdue")),
    ),
  );
  fill(
    root,
    h("h1", {}, "Units"),
    h(
      "section",
      { class: "card" },
      units.length
        ? tableBox(
            "Units",
            h("table", { id: "units-table" }, headings("Unit", "#Runs", "Last run", "Due"), h("tbody", {}, rows)),
          )
        : h("p", { class: "muted" }, "No unit yet: a unit appears with its first run."),
      units.length > 1 && h("p", { class: "downloads" }, h("a", { href: "#/compare" }, "Compare units")),
    ),
  );
}

export async function unitView({ root, parts: [serial], signal }) {
  const path = `/api/units/${encodeURIComponent(serial)}`;
  const [unit, rigs] = await Promise.all([get(path, signal), get("/api/rigs", signal)]);
  const solvable = unit.runs.find((run) => run.result);
  const calibrations = new Calibrations(serial, signal);
  const chart = new Chart("history", "Bias, scale and RMS error over time", { tall: true, signal, empty: NONE_COUNT });
  const body = h(
    "tbody",
    {},
    unit.runs.map((run) => runRow(run, { withUnit: false })),
  );
  fill(
    root,
    h("h1", {}, "Unit ", h("span", { class: "serial" }, unit.serial)),
    h("p", { class: "muted" }, `${plural(unit.n_runs, "run")}, known since `, moment(unit.created_at)),
    unit.n_runs === 0 && may("releaser") && removal(serial, path, calibrations),
    unit.revision_in_force !== null && rigs.length > 0 && may("operator") && verifying(unit, rigs),
    calibrations.elements,
    unitHistory(serial, signal),
    chart.element,
    h(
      "section",
      { class: "card", "aria-labelledby": "history-title" },
      h("h2", { id: "history-title" }, "Runs"),
      tableBox(
        "Runs of this unit",
        h("table", { id: "history-table" }, runHeadings({ withUnit: false }), body),
      ),
      h(
        "p",
        { class: "downloads" },
        h("a", { href: `#/compare?unit=${encodeURIComponent(serial)}` }, "Compare with other units"),
        solvable && h("a", { href: solveHref({ rig: solvable.rig, unit: serial }) }, "Solve together with its stage"),
        h("a", { href: `#/trail?unit=${encodeURIComponent(serial)}` }, "Trail: who did what"),
        h("a", { href: `${path}/archive`, download: "", id: "archive" }, "Archive of all this (zip)"),
      ),
    ),
  );
  await Promise.all([calibrations.read(), chart.load(`${path}/figures/history`)]);
}

/** Applies the revision in force to fresh poses of the default plan, on the rig that it was calibrated on if that is there. */
function verifying({ serial, runs, active_run_id: active, revision_in_force: revision }, rigs) {
  const last = runs.find(({ id }) => id === active)?.rig;
  const options = rigs.map(({ name }) => h("option", { value: name, selected: name === last }, name));
  const rig = h("select", { id: "verify-rig", "aria-label": "Rig to verify on" }, options);
  const button = h("button", { type: "button", id: "verify" }, "Verify");
  const error = errorLine("verify-error");
  button.addEventListener("click", async () => {
    const release = held(button);
    error.say(null);
    try {
      const run = await post("/api/runs", { unit: serial, rig: rig.value, plan: { kind: "verification" } });
      location.hash = runHref(run.id);
    } catch (problem) {
      error.say(problem);
    } finally {
      release();
    }
  });
  const says = `Starts a run that applies revision ${revision} to fresh poses and tells what is left.`;
  return h(
    "div",
    {},
    error.element,
    h("div", { class: "buttons verify" }, button, rigs.length > 1 && rig, h("span", { class: "muted" }, says)),
  );
}

/** Of a unit whose runs were moved to their right serial number. */
function removal(serial, path, calibrations) {
  const question = {
    title: `Remove unit ${serial}?`,
    text: "It has no runs. The trail keeps what was done to it.",
    action: "Remove the unit",
  };
  const button = h("button", { type: "button", id: "remove-unit" }, "Remove this empty unit…");
  button.addEventListener("click", async () => {
    const removed = () => remove(path).then(() => (calibrations.unitIsGone = true));
    if (await askConfirmation(question, removed)) location.hash = "#/units";
  });
  return h("p", {}, button);
}
