// A rig: its reference, its check standard, and the runs in doubt.

import { get, post, put, remove } from "./api.js";
import { confirmButton } from "./ask.js";
import { Chart } from "./charts.js";
import {
  dataTable,
  errorLine,
  field,
  figureList,
  fill,
  h,
  numberCell,
  onSubmit,
  runLink,
  select,
  solveHref,
  statusPill,
  tableRow,
  unitLink,
} from "./dom.js";
import { fixed, isKnown, moment, plural, significant } from "./format.js";
import { may } from "./me.js";
import { onRigs } from "./rigs.js";
import { preferRig, stopsOnEscape } from "./stop.js";

const STATES = { passed: "good", failed: "poor", not_known: "unknown" };
const HEADLINES = { passed: "The rig passes.", failed: "The rig fails.", not_known: "Not yet checked." };
const WORDS = { passed: "passed", failed: "failed", not_known: "not checked" };
const EVERY_DAYS = 30;

export async function rigView({ root, parts: [name], signal }) {
  preferRig(name);
  let isBusy = false;
  onRigs((rigs) => (isBusy = rigs.some((rig) => rig.name === name && rig.state === "busy")), signal);
  stopsOnEscape(() => (isBusy ? [name] : []), signal);
  const path = `/api/rigs/${encodeURIComponent(name)}/check-unit`;
  const card = h("section", { class: "card", id: "check", "aria-labelledby": "check-title" });
  const chart = new Chart("check-chart", "Control chart: bias and scale of the check standard", { signal });
  const read = async () => {
    const [named, units] = await Promise.all([get("/api/check-units", signal), get("/api/units", signal)]);
    const check = named.some(({ rig }) => rig === name) ? await get(path, signal) : null;
    const form = may("releaser") && naming(path, check, units, read);
    fill(
      card,
      h("h2", { id: "check-title" }, "Check standard"),
      check ? standing(check) : h("p", { class: "muted" }, "No check standard: rig drift is not monitored."),
      form,
      check && checks(check),
    );
    chart.element.hidden = !check;
    if (check) await chart.load(`/api/rigs/${encodeURIComponent(name)}/figures/check-unit`);
  };
  const reference = h("section", { class: "card", id: "reference", "aria-labelledby": "reference-title" });
  const together = h("a", { href: solveHref({ rig: name }), id: "solve-rig" }, "Separate errors of stage and units");
  fill(root, h("h1", {}, `Rig ${name}`), reference, card, chart.element, h("p", {}, together));
  await Promise.all([read(), showReference(reference, name, signal)]);
}

const HOLDS = { holds: "good", moved: "poor", not_known: "unknown" };
const HOLD_WORDS = { holds: "The map is valid.", moved: "The map has changed.", not_known: "Not yet checked." };

async function showReference(card, name, signal) {
  const path = `/api/rigs/${encodeURIComponent(name)}/map`;
  const maps = await get("/api/stage-maps", signal);
  const map = maps.some(({ rig }) => rig === name) ? await get(path, signal) : null;
  fill(
    card,
    h("h2", { id: "reference-title" }, "Reference"),
    map
      ? mapInForce(map)
      : h("p", { class: "muted" }, "The stage's certificate in calrig.toml. No stage map is in force."),
    map?.solve && may("admin") && withdrawing(path, () => showReference(card, name, signal)),
  );
}

function mapInForce(map) {
  const [low, high] = map.dial_deg;
  const figures = [
    ["Source", map.file ? `file ${map.file}` : `solution ${map.solve.slice(0, 8)}`],
    ["Solved", moment(map.solved_at)],
    ["In force since", moment(map.put_at)],
    ["Standard uncertainty", significant(map.std_deg, 2, "°")],
    ["Dial", `${fixed(low, 0, "°")} to ${fixed(high, 0, "°")}`],
    ["From", `${plural(map.units.length, "unit")}, ${plural(map.runs.length, "run")}`],
  ];
  return [
    h("p", {}, map.says),
    h(
      "div",
      { class: `verdict ${HOLDS[map.holds.state]}`, role: "status" },
      h("p", { class: "headline" }, HOLD_WORDS[map.holds.state]),
      h("p", {}, map.holds.says),
    ),
    figureList(figures),
  ];
}

function withdrawing(path, read) {
  const question = {
    title: "Withdraw the stage map?",
    text: "New runs use the stage's certificate again. Existing runs stay unchanged.",
    action: "Withdraw",
  };
  const withdraw = () => post(path, { solve: null });
  const drop = confirmButton("Withdraw the map…", question, withdraw, read, { id: "withdraw-map" });
  return h("div", { class: "buttons" }, drop);
}

function standing(check) {
  const figures = [
    ["Unit", unitLink(check.unit)],
    ["Every", plural(check.interval_days, "day")],
    ["Last check", moment(check.last_check_at)],
    ["Last passed", moment(check.last_passed_at)],
    [check.overdue ? "Next check (overdue)" : "Next check", moment(check.due_at)],
  ];
  const suspects = check.suspect_runs.map((id, k) => [k > 0 && ", ", runLink(id)]);
  return [
    h(
      "div",
      { class: `verdict ${STATES[check.state]}`, role: "status" },
      h("p", { class: "headline" }, HEADLINES[check.state]),
      h("p", {}, check.says),
      suspects.length > 0 && h("p", { id: "suspects" }, h("strong", {}, "Suspect runs: "), suspects),
    ),
    figureList(figures),
  ];
}

function naming(path, check, units, read) {
  const unit = select({ id: "check-unit", required: true }, units.map(({ serial }) => serial), check?.unit);
  const days = h("input", {
    id: "check-days",
    type: "number",
    min: "0.1",
    step: "any",
    required: true,
    value: check?.interval_days ?? EVERY_DAYS,
  });
  const error = errorLine("check-error");
  const save = h("button", { type: "submit", id: "name-check", class: check ? null : "primary" }, check ? "Change" : "Save");
  const question = {
    title: "Remove the check standard?",
    text: "Runs of this rig are no longer suspect because of a check. They stay unchanged.",
    action: "Remove",
  };
  const drop = check && confirmButton("Remove the check standard…", question, () => remove(path), read, { id: "drop-check" });
  const form = h(
    "form",
    {},
    h("div", { class: "fields two" }, field("check-unit", "Unit", unit), field("check-days", "Check every, days", days)),
    error.element,
    h("div", { class: "buttons" }, save, drop),
  );
  onSubmit(form, save, error, async () => {
    await put(path, { unit: unit.value, interval_days: Number(days.value) });
    await read();
  });
  return units.length > 0 && form;
}

function checks({ checks: all }) {
  const rows = all.toReversed().map((check) =>
    tableRow(runLink(check.run_id), [
      moment(check.finished_at),
      numberCell(significant(check.bias_deg, 4, "°")),
      numberCell(significant(check.scale, 6)),
      numberCell(isKnown(check.average) ? fixed(check.average, 2, "σ") : "–"),
      h("td", { class: "plain" }, check.is_check ? statusPill(WORDS[check.verdict]) : h("span", { class: "muted" }, "history")),
    ]),
  );
  const names = ["Run", "Finished", "#Bias", "#Scale", "#Moving average", "Verdict"];
  return dataTable("Checks", names, rows, { id: "checks-table" });
}
