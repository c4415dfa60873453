// All units, and one unit with its history.

import { get, remove } from "./api.js";
import { askConfirmation } from "./ask.js";
import { Calibrations } from "./calibrations.js";
import { Chart } from "./charts.js";
import { fill, h, headings, solveHref, tableBox, unitLink } from "./dom.js";
import { moment, plural } from "./format.js";
import { unitHistory } from "./history.js";
import { may } from "./me.js";
import { runHeadings, runRow } from "./runlist.js";

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
  const unit = await get(path, signal);
  const solvable = unit.runs.find((run) => run.result);
  const calibrations = new Calibrations(serial, signal);
  const chart = new Chart("history", "Bias, scale and RMS error over time", { tall: true, signal });
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
