// The list of units, and one unit with its history.

import { get, post, remove } from "./api.js";
import { confirmButton } from "./ask.js";
import { Calibrations } from "./calibrations.js";
import { Chart, NONE_VALID } from "./charts.js";
import { attempt, card, dataTable, errorLine, fill, h, numberCell, runHref, select, solveHref, tableRow, unitLink } from "./dom.js";
import { moment, plural } from "./format.js";
import { unitHistory } from "./history.js";
import { may } from "./me.js";
import { runHeadings, runRow } from "./runlist.js";

export async function unitsView({ root, signal }) {
  const units = await get("/api/units", signal);
  const rows = units.map((unit) =>
    tableRow(unitLink(unit.serial), [
      numberCell(unit.n_runs.toLocaleString()),
      moment(unit.last_run_at),
      [moment(unit.due_at), unit.overdue && h("span", { class: "tag warns" }, "overdue")],
    ]),
  );
  fill(
    root,
    h("h1", {}, "Units"),
    h(
      "section",
      { class: "card" },
      units.length
        ? dataTable("Units", ["Unit", "#Runs", "Last run", "Due"], rows, { id: "units-table" })
        : h("p", { class: "muted" }, "No units yet. A unit appears with its first run."),
      units.length > 1 && h("p", { class: "downloads" }, h("a", { href: "#/compare" }, "Compare units")),
    ),
  );
}

export async function unitView({ root, parts: [serial], signal }) {
  const path = `/api/units/${encodeURIComponent(serial)}`;
  const [unit, rigs] = await Promise.all([get(path, signal), get("/api/rigs", signal)]);
  const solvable = unit.runs.find((run) => run.result);
  const calibrations = new Calibrations(serial, signal);
  const chart = new Chart("history", "Bias, scale and RMS error over time", { tall: true, signal, empty: NONE_VALID });
  const rows = unit.runs.map((run) => runRow(run, { withUnit: false }));
  fill(
    root,
    h("h1", {}, "Unit ", h("span", { class: "serial" }, unit.serial)),
    h("p", { class: "muted" }, `${plural(unit.n_runs, "run")}, known since `, moment(unit.created_at)),
    unit.n_runs === 0 && may("releaser") && removal(serial, path, calibrations),
    unit.revision_in_force !== null && rigs.length > 0 && may("operator") && verifying(unit, rigs),
    calibrations.elements,
    unitHistory(serial, signal),
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
        h("a", { href: `#/trail?unit=${encodeURIComponent(serial)}` }, "Audit log of this unit"),
        h("a", { href: `${path}/archive`, download: "", id: "archive" }, "Archive of this unit (ZIP)"),
      ),
    ),
  );
  await Promise.all([calibrations.read(), chart.load(`${path}/figures/history`)]);
}

/** The button that verifies the revision in force with new poses, by default on the rig that it was calibrated on. */
function verifying({ serial, runs, active_run_id: active, revision_in_force: revision }, rigs) {
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
