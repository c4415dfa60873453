// A run's result: figures with standard errors, and the verdict.

import { figureList, h, paragraphs, unitHref } from "./dom.js";
import { NOT_KNOWN, isKnown, plusMinus, range, significant } from "./format.js";

// By the answer to the limits; without limits by the residual.
const COLOURS = {
  pass: "good",
  conditional_pass: "fair",
  conditional_fail: "fair",
  fail: "poor",
  undecided: "fair",
  noise: "good",
  more_than_noise: "poor",
};

/** The card's content for a unit that was not clamped with its x axis along the stage axis. */
export function noResultAbout(axis) {
  return [
    h("h2", {}, "Result"),
    h("p", {}, `The unit's ${axis} axis lay along the stage axis, but bias and scale refer to elevations about x.`),
    h("p", {}, "Use these poses in a joint solution of stage and unit."),
  ];
}

/** The card's content for a run that has a result. */
export function resultCard(run) {
  const counts = run.status === "completed" && !run.voided;
  const { answer, left, reliable } = run.verdict;
  const judged = reliable === false ? "fail" : answer === "no_limits" ? left : answer;
  const colour = (counts && COLOURS[judged]) || "unknown";
  const [headline, ...sentences] = [...reservation(run), ...run.verdict.says];
  return [
    h("h2", {}, "Result"),
    h(
      "div",
      { class: "columns outcome" },
      figureList(figures(run.result, run.plan?.mounts_deg)),
      h(
        "div",
        { class: `verdict ${colour}`, "data-testid": "verdict" },
        h("h3", {}, "Verdict"),
        h("p", { class: "headline" }, headline),
        paragraphs(sentences),
        reliable === false && counts && h("p", {}, h("a", { href: unitHref(run.unit) }, "Drafts of this unit")),
      ),
    ),
  ];
}

/** The headline above the verdict of a run that is voided or not completed. */
function reservation(run) {
  if (run.voided) return ["Voided: not to be used."];
  return run.status === "completed" ? [] : ["Not finished: figures of the poses so far."];
}

function posesOf({ n_poses: poses }, mounts) {
  if (!(mounts?.length > 1)) return poses.toLocaleString();
  return `${poses.toLocaleString()}, of the first mounting (${mounts[0]}°)`;
}

function figures(result, mounts) {
  const gyro = result.gyro;
  const temperature = result.temperature_c;
  const rows = [
    ["Bias", besideStage(result.bias_deg, result.bias_std_deg, result.reference?.bias_std_deg, "°")],
    ["Scale", besideStage(result.scale, result.scale_std, result.reference?.scale_std)],
    ["RMS error, raw", significant(result.rms_raw_deg, 3, "°")],
    ["RMS error, calibrated", significant(result.rms_calibrated_deg, 3, "°")],
    ["Standard error of a reading", significant(result.noise_deg, 2, "°")],
    ["Poses", posesOf(result, mounts)],
    ["Temperature", range(temperature?.min, temperature?.max, 1, "°C")],
  ];
  if (isKnown(result.rms_with_effects_deg))
    rows.push(["RMS error, with effects", significant(result.rms_with_effects_deg, 3, "°")]);
  if (![gyro?.scale, ...(gyro?.bias_dps ?? [])].some(isKnown)) return [...rows, ["Gyro", NOT_KNOWN]];
  const bias = ["x", "y", "z"].map((axis, k) => [
    `Gyro bias ${axis}`,
    plusMinus(gyro.bias_dps[k], gyro.bias_std_dps[k], "°/s"),
  ]);
  return [...rows, ...bias, ["Gyro scale", plusMinus(gyro.scale, gyro.scale_std)]];
}

/** A figure with its type A standard error, and the type B uncertainty of the stage, which more poses do not reduce. */
function besideStage(value, std, ofStage, unit) {
  const own = plusMinus(value, std, unit);
  if (!isKnown(value) || !isKnown(ofStage)) return own;
  return [
    h("span", {}, own),
    isKnown(std) && h("small", {}, " (type A, noise)"),
    " ",
    h("small", {}, `± ${significant(ofStage, 2, unit)} (type B, stage)`),
  ];
}
