// A joint solution: stage map, mounts and units, with what is not separable and the recommended mounts.

import { get, post } from "./api.js";
import { confirmButton } from "./ask.js";
import { Chart } from "./charts.js";
import {
  dataTable,
  figureList,
  fill,
  h,
  headings,
  numberCell,
  rigHref,
  runLink,
  solveHref,
  tableBox,
  tableRow,
  unitLink,
  warningBox,
} from "./dom.js";
import { fixed, isKnown, moment, plural, plusMinus, range, significant } from "./format.js";
import { may } from "./me.js";

const MOST_RUNS = 12; // listed in the head
const MOST_UNITS = 5; // listed in the verdict
/** Titles and units of the parameters of a unit. */
const PARAMETERS = {
  y_mg: ["Offset of y", "mg"],
  z_mg: ["Offset of z", "mg"],
  gain_pct: ["Gain of y against z", "%"],
  skew_deg: ["Skew of y against z", "°"],
  y_mg_per_g2: ["Quadratic term of y", "mg/g²"],
  y_mg_per_g3: ["Cubic term of y", "mg/g³"],
  z_mg_per_g2: ["Quadratic term of z", "mg/g²"],
  z_mg_per_g3: ["Cubic term of z", "mg/g³"],
  y_mg_per_g4: ["Quartic term of y", "mg/g⁴"],
  z_mg_per_g4: ["Quartic term of z", "mg/g⁴"],
  y_mg_per_c: ["Offset of y, per °C", "mg/°C"],
  z_mg_per_c: ["Offset of z, per °C", "mg/°C"],
  reference_c: ["At", "°C"],
  deg_per_deg2: ["Quadratic term of the angle", "°/°²"],
  deg_per_deg3: ["Cubic term of the angle", "°/°³"],
};
const TITLES = {
  map: "Stage map ± two standard errors",
  before: "Residual angle without the map",
  after: "Residual angle with the map",
};

export async function solutionView({ root, parts: [id], signal }) {
  const path = `/api/solve/${encodeURIComponent(id)}`;
  const found = await get(path, signal);
  const drawn = isWhole(found) ? [["map", TITLES.map]] : Object.entries(TITLES); // three-axis solutions have no charts of poses
  const charts = drawn.map(([name, title]) => [name, new Chart(`solve-${name}`, title, { signal })]);
  const [[, map], ...left] = charts;
  fill(
    root,
    heading(found),
    h(
      "section",
      { class: "card solution", "aria-labelledby": "separation-title" },
      h("h2", { id: "separation-title" }, "Separation of stage and units"),
      verdict(found),
      advice(found),
      figures(found),
      inForce(found),
      h("p", { class: "downloads" }, download(`${path}/map`, "stage-map.json", "Stage map (JSON)")),
    ),
    map.element,
    left.length > 0 && h("div", { class: "charts" }, left.map(([, chart]) => chart.element)),
    card("Mounts", mountTable(found.mounts)),
    card("Orders of the map", orderTable(found.stage)),
    found.units.map((unit) => unitCard(unit, found, path)),
  );
  await Promise.all(charts.map(([name, chart]) => chart.load(`${path}/figures/${name}`)));
}

const download = (href, name, text) => h("a", { href, download: name }, text);
const card = (title, ...content) => h("section", { class: "card" }, h("h2", {}, title), content);
const short = (value) => fixed(value, 3).replace(/\.?0+$/, "");

function heading({ id, created_at: at, by, rig, runs, linear, periods_deg: periods }) {
  return h(
    "div",
    {},
    h("h1", { title: id }, "Stage and units solved together"),
    h(
      "p",
      { class: "facts" },
      rig && h("span", {}, "Rig ", h("a", { href: rigHref(rig) }, rig)),
      h("span", {}, moment(at), by && ` by ${by}`),
      linear && h("span", {}, "units stated to be linear"),
      periods.length > 0 && h("span", {}, `known periods: ${periods.map((deg) => `${deg}°`).join(", ")}`),
      h("a", { href: solveHref({ rig, runs }) }, "Solve again"),
    ),
    h(
      "p",
      { class: "facts" },
      `${plural(runs.length, "run")}: `,
      runs.slice(0, MOST_RUNS).map((run) => runLink(run)),
      runs.length > MOST_RUNS && `and ${runs.length - MOST_RUNS} more`,
    ),
  );
}

/** Whether the solution is of three axes: units were clamped on several faces. */
const isWhole = ({ mounts }) => mounts.some(({ mount_axis: axis = "x" }) => !axis.endsWith("x"));

/** Whether held-out poses are predicted better with the map than without. */
const isBetter = ({ before, final }) => final.held_out_rms_deg < before.held_out_rms_deg;

function headline(found) {
  if (!found.separable) return "Stage and units are not separable by these poses.";
  return isBetter(found)
    ? "Stage and units are separable."
    : "Stage and units are separable, but the map does not predict the held-out poses.";
}

function verdict(found) {
  const { separable, units, noise, warnings } = found;
  const worst = (unit) => Math.max(...unit.elevation_std_deg.std_deg);
  const known = units.map(
    (unit) => `unit ${unit.unit}: ± ${significant(worst(unit), 2, "°")} at most, ${range(...unit.range_deg, 0, "°")}`,
  );
  const more = units.length > MOST_UNITS ? `; ${plural(units.length - MOST_UNITS, "more unit")} below` : "";
  return [
    h(
      "div",
      { class: `verdict ${separable && isBetter(found) ? "good" : "fair"}`, "data-testid": "solve-verdict" },
      h("p", { class: "headline" }, headline(found)),
      h("p", {}, `Standard error of a calibrated elevation: ${known.slice(0, MOST_UNITS).join("; ")}${more}.`),
      h("p", {}, `Standard deviation of one pose: ${significant(noise.std_deg, 2, "°")}.`),
    ),
    warningBox(warnings, "solve-warnings"),
  ];
}

/** The recommended mounts, and a link to a plan with them. */
function advice({ advice: advised, rig, units }) {
  if (!advised) return null;
  const plan = new URLSearchParams({ mounts: advised.mounts_deg.map((deg) => Number(deg.toFixed(2))).join(",") });
  if (rig) plan.set("rig", rig);
  if (units.length === 1) plan.set("unit", units[0].unit);
  return h(
    "div",
    { class: "follow-up", "data-testid": "solve-advice" },
    h("h3", {}, "Recommended mounts"),
    h("p", {}, advised.says),
    h("p", {}, h("a", { href: `#/?${plan}` }, "Start a run with these mounts")),
  );
}

function figures({ before, final, noise, stage, held_out: heldOut, level_known: levelKnown, level_std_deg: level }) {
  const error = stage.map.error_deg.filter((value) => value !== null);
  return figureList([
    ["Held-out RMS, without the map", significant(before.held_out_rms_deg, 3, "°")],
    ["Held-out RMS, with the map", significant(final.held_out_rms_deg, 3, "°")],
    ["Held out", heldOut.how],
    ["Noise of a pose", significant(noise.std_deg, 2, "°")],
    ["Map", `${fixed(Math.min(...error), 3)} to ${fixed(Math.max(...error), 3, "°")}`],
    ["Backlash", stage.backlash_deg ? plusMinus(stage.backlash_deg.value, stage.backlash_deg.std, "°") : "not fitted"],
    ["Level", levelKnown ? `known to ${significant(level, 2, "°")}` : "not known: elevations are relative to their mean"],
  ]);
}

/** The button that puts the map in force; only if stage and units are separable, as any other map would bias its users. */
function inForce(found) {
  const { id, separable, rig } = found;
  if (!separable || !rig || !may("admin")) return null;
  const state = h("p", { id: "map-state", class: "muted", role: "status", "aria-live": "polite" });
  const question = {
    title: `Use this map for rig ${rig}?`,
    text:
      "New runs use it as their reference instead of the stage's certificate. Earlier runs stay unchanged." +
      (isBetter(found) ? "" : " It does not predict held-out poses better: something else changed between these runs."),
    action: "Use the map",
  };
  const done = () => (state.textContent = `Map in force for rig ${rig}.`);
  const put = () => putInForce(rig, id);
  return h("div", { class: "buttons" }, confirmButton("Use this map for the rig…", question, put, done, { id: "use-map" }), state);
}

async function putInForce(rig, id) {
  try {
    await post(`/api/rigs/${encodeURIComponent(rig)}/map`, { solve: id });
  } catch (error) {
    if (![404, 405].includes(error.status)) throw error;
    error.message = `This service has no rig ${rig}, or stores no maps: download the map and name it in calrig.toml.`;
    throw error;
  }
}

function mountTable(mounts) {
  const rows = mounts.map(({ mount, unit, mount_axis: axis = "x", mount_deg: stated, angle_deg: found }) => {
    const apart = ((((found.value - stated + 180) % 360) + 360) % 360) - 180;
    const angles = [`${short(stated)}°`, plusMinus(stated + apart, found.std, "°"), fixed(apart, 3, "°")];
    return tableRow(mount, [unitLink(unit), axis, ...angles.map(numberCell)]);
  });
  const names = ["Mount", "Unit", "Unit axis", "#Stated", "#Fitted", "#Difference"];
  return dataTable("Mounts", names, rows, { id: "mounts" });
}

function orderTable({ harmonics }) {
  const rows = harmonics.map(({ order, amplitude_deg: amplitude, phase_deg: phase, std_deg: std, separable }) =>
    tableRow(short(order), [
      numberCell(plusMinus(amplitude, std, "°")),
      numberCell(fixed(phase, 1, "°")),
      separable ? "yes" : "no: confounded with units or other orders",
    ]),
  );
  const names = ["Order", "#Amplitude", "#Phase", "Separable"];
  return dataTable("Orders of the map", names, rows, { id: "orders" });
}

function unitCard(found, { id, separable, units }, path) {
  const { unit, parameters, range_deg: bounds, elevation_std_deg: worth, accelerometer, gyro } = found;
  const [least, most] = [Math.min(...worth.std_deg), Math.max(...worth.std_deg)];
  const rows = [
    ["Standard error of an elevation", `${significant(least, 2)} to ${significant(most, 2, "°")}`],
    ["Range", range(...bounds, 0, "°")],
    ["Quantity", isKnown(found.level?.deg.std) ? "elevation" : "elevation relative to its mean"],
  ];
  if (found.level) rows.push(["Level, sensor to case", plusMinus(found.level.deg.value, found.level.deg.std, "°")]);
  const table = parameterTable(unit, parameters);
  const file = download(`${path}/units/${encodeURIComponent(unit)}`, `${unit}.json`, "Calibration (JSON)");
  return h(
    "section",
    { class: "card solution", "data-unit": unit },
    h("h2", {}, "Unit ", unitLink(unit)),
    figureList(rows),
    units.length > 3 ? h("details", {}, h("summary", {}, "Parameters"), table) : table,
    accelerometer && axes(`Accelerometer of ${unit}`, "Bias, mg", accelerometer.bias_g.map((g) => 1000 * g), accelerometer.matrix),
    gyro && axes(`Gyro of ${unit}`, "Bias, °/s", gyro.bias_dps, gyro.matrix),
    h("p", { class: "downloads" }, file),
    drafting(unit, id, separable),
  );
}

/** The button that drafts a revision of the unit's calibration from this solution. */
function drafting(unit, id, separable) {
  if (!separable || !may("operator")) return null;
  const state = h("p", { class: "muted", role: "status", "aria-live": "polite" });
  const question = {
    title: `Draft a calibration of unit ${unit} by this solution?`,
    text: "It becomes the unit's next revision, in force at once if the rig releases automatically.",
    action: "Draft",
  };
  let made;
  const draft = async () => (made = await post(`/api/units/${encodeURIComponent(unit)}/calibrations`, { solve: id }));
  const done = () => fill(state, `Revision ${made.revision} (${made.status.replaceAll("_", " ")}) of `, unitLink(unit), ".");
  return h("div", { class: "buttons" }, confirmButton(`Draft a calibration of ${unit}…`, question, draft, done), state);
}

function parameterTable(unitName, parameters) {
  const rows = Object.entries(parameters).map(([name, { value, std }]) => {
    const [title, unit] = PARAMETERS[name] ?? [name.replaceAll("_", " "), ""];
    return tableRow(title, [...[significant(value, 4), isKnown(std) ? significant(std, 2) : "–"].map(numberCell), unit]);
  });
  return dataTable(`Parameters of unit ${unitName}`, ["Parameter", "#Value", "#Standard error", "Unit"], rows);
}

/** Bias and matrix of a three-axis sensor: true = matrix·(raw − bias). */
function axes(title, name, bias, matrix) {
  const rows = ["x", "y", "z"].map((axis, k) =>
    tableRow(axis, [
      numberCell(significant(bias?.[k], 4)),
      ...[0, 1, 2].map((column) => numberCell(significant(matrix?.[k][column], 6))),
    ]),
  );
  const head = headings("Axis", `#${name}`, "#Matrix, x", "#y", "#z");
  return tableBox(title, h("table", {}, h("caption", {}, title), head, h("tbody", {}, rows)));
}
