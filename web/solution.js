// A joint solution: the stage's map before and after, mounts, units, what it cannot tell and what would help.

import { get, post } from "./api.js";
import { askConfirmation } from "./ask.js";
import { Chart } from "./charts.js";
import { fill, h, headings, rigHref, runLink, solveHref, tableBox, unitLink } from "./dom.js";
import { fixed, isKnown, moment, plural, plusMinus, range, significant } from "./format.js";
import { may } from "./me.js";

const NAMED = 12; // of the runs
const SAID = 5; // of the units
/** What parameters of CONTRACT section 8 are called, and their units. */
const PARAMETERS = {
  y_mg: ["Offset of y", "mg"],
  z_mg: ["Offset of z", "mg"],
  gain_pct: ["Gain of y against z", "%"],
  skew_deg: ["Skew of y against z", "°"],
  y_mg_per_g2: ["Quadratic term of y", "mg/g²"],
  y_mg_per_g3: ["Cubic term of y", "mg/g³"],
  z_mg_per_g2: ["Quadratic term of z", "mg/g²"],
  z_mg_per_g3: ["Cubic term of z", "mg/g³"],
  y_mg_per_c: ["Offset of y, per °C", "mg/°C"],
  z_mg_per_c: ["Offset of z, per °C", "mg/°C"],
  reference_c: ["At", "°C"],
  deg_per_deg2: ["Quadratic term of the angle", "°/°²"],
  deg_per_deg3: ["Cubic term of the angle", "°/°³"],
};
const TITLES = {
  map: "Map of the stage, two standard errors to each side",
  before: "Residual angle without the map",
  after: "Residual angle with the map",
};

export async function solutionView({ root, parts: [id], signal }) {
  const path = `/api/solve/${encodeURIComponent(id)}`;
  const found = await get(path, signal);
  const drawn = isWhole(found) ? [["map", TITLES.map]] : Object.entries(TITLES); // of whole units no poses are drawn
  const charts = drawn.map(([name, title]) => [name, new Chart(`solve-${name}`, title, { signal })]);
  const [[, map], ...left] = charts;
  fill(
    root,
    heading(found),
    h(
      "section",
      { class: "card solution", "aria-labelledby": "told-title" },
      h("h2", { id: "told-title" }, "Separation of stage and units"),
      verdict(found),
      advice(found),
      figures(found),
      inForce(found),
      h("p", { class: "downloads" }, download(`${path}/map`, "stage-map.json", "Stage map (JSON)")),
    ),
    map.element,
    left.length > 0 && h("div", { class: "charts" }, left.map(([, chart]) => chart.element)),
    card("Mounts", tableBox("Mounts", mountTable(found.mounts))),
    card("Orders of the map", tableBox("Orders of the map", orderTable(found.stage))),
    found.units.map((unit) => unitCard(unit, found, path)),
  );
  await Promise.all(charts.map(([name, chart]) => chart.load(`${path}/figures/${name}`)));
}

const download = (href, name, text) => h("a", { href, download: name }, text);
const cell = (text) => h("td", { class: "number" }, text);
const card = (title, ...content) => h("section", { class: "card" }, h("h2", {}, title), content);
const short = (value) => fixed(value, 3).replace(/\.?0+$/, "");
const pairs = (rows) =>
  h("dl", { class: "figures" }, rows.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value))));

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
      runs.slice(0, NAMED).map((run) => runLink(run)),
      runs.length > NAMED && `and ${runs.length - NAMED} more`,
    ),
  );
}

/** Whether units were clamped by several faces. */
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
  const more = units.length > SAID ? `; ${plural(units.length - SAID, "more unit")} below` : "";
  return [
    h(
      "div",
      { class: `verdict ${separable && isBetter(found) ? "good" : "fair"}`, "data-testid": "solve-verdict" },
      h("p", { class: "headline" }, headline(found)),
      h("p", {}, `Standard error of a calibrated elevation: ${known.slice(0, SAID).join("; ")}${more}.`),
      h("p", {}, `Standard deviation of one pose: ${significant(noise.std_deg, 2, "°")}.`),
    ),
    warnings.length > 0 &&
      h(
        "div",
        { class: "cautions", "data-testid": "solve-warnings" },
        h("h3", {}, "Warnings"),
        h("ul", {}, warnings.map((sentence) => h("li", {}, sentence))),
      ),
  ];
}

/** The mounts that would help, and the plan that has them. */
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
  const { error_deg: error } = stage.map;
  return pairs([
    ["Held-out RMS, without the map", significant(before.held_out_rms_deg, 3, "°")],
    ["Held-out RMS, with the map", significant(final.held_out_rms_deg, 3, "°")],
    ["Held out", heldOut.how],
    ["Noise of a pose", significant(noise.std_deg, 2, "°")],
    ["Map", `${fixed(Math.min(...error), 3)} to ${fixed(Math.max(...error), 3, "°")}`],
    ["Backlash", stage.backlash_deg ? plusMinus(stage.backlash_deg.value, stage.backlash_deg.std, "°") : "not solved for"],
    ["Level", levelKnown ? `known to ${significant(level, 2, "°")}` : "not known: elevations are relative to their mean"],
  ]);
}

/** Offered where stage and units are separable: a map of anything less would bias whatever it is used for. */
function inForce(found) {
  const { id, separable, rig } = found;
  if (!separable || !rig || !may("admin")) return null;
  const state = h("p", { id: "map-state", class: "muted", role: "status", "aria-live": "polite" });
  const button = h("button", { type: "button", id: "use-map" }, "Use this map for the rig…");
  const question = {
    title: `Use this map for rig ${rig}?`,
    text:
      "Runs from now on have it as their reference in place of what the stage's maker says. Earlier ones stay." +
      (isBetter(found) ? "" : " Held-out poses are predicted no better with it: something else moved between these runs."),
    action: "Use the map",
  };
  button.addEventListener("click", async () => {
    state.textContent = "";
    if (await askConfirmation(question, () => putInForce(rig, id)))
      state.textContent = `It is the map of rig ${rig} from now on.`;
  });
  return h("div", { class: "buttons" }, button, state);
}

async function putInForce(rig, id) {
  try {
    await post(`/api/rigs/${encodeURIComponent(rig)}/map`, { solve: id });
  } catch (error) {
    if (![404, 405].includes(error.status)) throw error;
    error.message = `This service keeps no maps of rigs, or no rig ${rig}: download the map, and name it in calrig.toml.`;
    throw error;
  }
}

function mountTable(mounts) {
  const rows = mounts.map(({ mount, unit, mount_axis: axis = "x", mount_deg: stated, angle_deg: found }) => {
    const apart = ((((found.value - stated + 180) % 360) + 360) % 360) - 180;
    return h(
      "tr",
      {},
      h("th", { scope: "row" }, mount),
      h("td", {}, unitLink(unit)),
      h("td", {}, axis),
      cell(`${short(stated)}°`),
      cell(plusMinus(stated + apart, found.std, "°")),
      cell(fixed(apart, 3, "°")),
    );
  });
  const head = headings("Mount", "Unit", "Axis along the stage's", "#Stated", "#Found", "#Difference");
  return h("table", { id: "mounts" }, head, h("tbody", {}, rows));
}

function orderTable({ harmonics }) {
  const rows = harmonics.map(({ order, amplitude_deg: amplitude, phase_deg: phase, std_deg: std, separable }) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, short(order)),
      cell(plusMinus(amplitude, std, "°")),
      cell(fixed(phase, 1, "°")),
      h("td", {}, separable ? "yes" : "no: from the units, or other orders"),
    ),
  );
  const head = headings("Order", "#Amplitude", "#Phase", "Separable");
  return h("table", { id: "orders" }, head, h("tbody", {}, rows));
}

function unitCard(found, { id, separable, units }, path) {
  const { unit, parameters, range_deg: bounds, elevation_std_deg: worth, accelerometer, gyro } = found;
  const [least, most] = [Math.min(...worth.std_deg), Math.max(...worth.std_deg)];
  const said = [
    ["Standard error of an elevation", `${significant(least, 2)} to ${significant(most, 2, "°")}`],
    ["Over", range(...bounds, 0, "°")],
    ["Of", isKnown(found.level?.deg.std) ? "elevation" : "elevation less its mean over the range"],
  ];
  if (found.level) said.push(["Sensor in its case", plusMinus(found.level.deg.value, found.level.deg.std, "°")]);
  const table = tableBox(`Parameters of unit ${unit}`, parameterTable(parameters));
  const file = download(`${path}/units/${encodeURIComponent(unit)}`, `${unit}.json`, "Calibration (JSON)");
  return h(
    "section",
    { class: "card solution", "data-unit": unit },
    h("h2", {}, "Unit ", unitLink(unit)),
    pairs(said),
    units.length > 3 ? h("details", {}, h("summary", {}, "Parameters"), table) : table,
    accelerometer && axes(`Accelerometer of ${unit}`, "Bias, mg", accelerometer.bias_g.map((g) => 1000 * g), accelerometer.matrix),
    gyro && axes(`Gyro of ${unit}`, "Bias, °/s", gyro.bias_dps, gyro.matrix),
    h("p", { class: "downloads" }, file),
    drafting(unit, id, separable),
  );
}

/** Offers a unit's calibration by this solution as a revision, which has a certificate like any other. */
function drafting(unit, id, separable) {
  if (!separable || !may("operator")) return null;
  const state = h("p", { class: "muted", role: "status", "aria-live": "polite" });
  const button = h("button", { type: "button" }, `Draft a calibration of ${unit}…`);
  const question = {
    title: `Draft a calibration of unit ${unit} by this solution?`,
    text: "It becomes the unit's next revision, in force at once where its rig releases drafts by itself.",
    action: "Draft it",
  };
  button.addEventListener("click", async () => {
    let made;
    const draft = async () => (made = await post(`/api/units/${encodeURIComponent(unit)}/calibrations`, { solve: id }));
    if (await askConfirmation(question, draft))
      fill(state, `Revision ${made.revision} (${made.status.replaceAll("_", " ")}) of `, unitLink(unit), ".");
  });
  return h("div", { class: "buttons" }, button, state);
}

function parameterTable(parameters) {
  const rows = Object.entries(parameters).map(([name, { value, std }]) => {
    const [title, unit] = PARAMETERS[name] ?? [name.replaceAll("_", " "), ""];
    return h(
      "tr",
      {},
      h("th", { scope: "row" }, title),
      cell(significant(value, 4)),
      cell(isKnown(std) ? significant(std, 2) : "–"),
      h("td", {}, unit),
    );
  });
  return h("table", {}, headings("Parameter", "#Value", "#Standard error", "Unit"), h("tbody", {}, rows));
}

/** Bias and matrix of a sensor of three axes: true = matrix·(raw − bias). */
function axes(title, name, bias, matrix) {
  const rows = ["x", "y", "z"].map((axis, k) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, axis),
      cell(significant(bias?.[k], 4)),
      [0, 1, 2].map((column) => cell(significant(matrix?.[k][column], 6))),
    ),
  );
  const head = headings("Axis", `#${name}`, "#Matrix, x", "#y", "#z");
  return tableBox(title, h("table", {}, h("caption", {}, title), head, h("tbody", {}, rows)));
}
