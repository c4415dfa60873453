// A run's result: whether it is good, the calibration, then all figures with standard errors and the whole verdict.

import { figureList, h, paragraphs, unitHref } from "./dom.js";
import { NOT_KNOWN, fixed, isKnown, plusMinus, range, significant } from "./format.js";
import { headline, verifiedRms } from "./headline.js";

// By the answer to the limits; without limits by the residual. The word that answers, and its colour.
const ANSWERS = {
  pass: ["PASS", "good"],
  conditional_pass: ["CONDITIONAL", "fair"],
  conditional_fail: ["CONDITIONAL", "fair"],
  fail: ["FAIL", "poor"],
  undecided: ["UNDECIDED", "unknown"],
  noise: ["GOOD", "good"],
  more_than_noise: ["NOT GOOD", "poor"],
};

/** The card's content for a unit that was not clamped with its x axis along the stage axis. */
export function noResultAbout(axis) {
  return [
    h("h2", {}, "Result"),
    h("p", {}, `The unit's ${axis} axis lay along the stage axis, but bias and scale refer to elevations about x.`),
    h("p", {}, "Use these poses in a joint solution of stage and unit."),
  ];
}

/** What is seen first of a run that ended without a result. */
export function noResult({ status }) {
  const how = status === "failed" ? "failed" : "was aborted";
  return answer("NO RESULT", "unknown", `The run ${how}: it made no calibration.`);
}

function answer(word, colour, sentence) {
  return h(
    "div",
    { class: `verdict answer ${colour}`, "data-testid": "answer" },
    h("h2", { class: "word" }, word),
    h("p", {}, sentence),
  );
}

/** Whether a run's result is good: one word, one colour, one sentence. */
function judged({ status, voided, verdict }) {
  if (voided) return ["VOIDED", "unknown", `Not to be used: ${voided.reason}`];
  if (status !== "completed") return ["NOT FINISHED", "unknown", "Figures of the poses so far."];
  const { answer: ofLimits, left, reliable, says } = verdict;
  const isDoubtful = reliable === false && ofLimits !== "fail";
  const by = isDoubtful ? "more_than_noise" : ofLimits === "no_limits" ? (left ?? "undecided") : ofLimits;
  const [word, colour] = ANSWERS[by];
  return [word, colour, sentenceAfter(word, says[0])];
}

/** The first sentence of the verdict: of "Good: only noise is left." what follows the word GOOD. */
function sentenceAfter(word, says) {
  const [sentence] = says.split(/(?<=\.) (?=[A-Z])/);
  const [first, ...rest] = sentence.split(": ");
  const said = rest.join(": ");
  return said && first.toUpperCase() === word ? said[0].toUpperCase() + said.slice(1) : sentence;
}

/** What is seen first of a run that has a result: whether it is good, and the calibration. */
export function answerOf(run) {
  return h("div", { class: "first-sight" }, answer(...judged(run)), figureList(headlineFigures(run), { id: "headline" }));
}

function headlineFigures({ result, plan, provenance }) {
  if (plan?.kind === "verification") return verified(result, provenance.verifies_revision).slice(0, 4);
  const found = headline(result);
  const { expanded_uncertainty_deg: expanded, coverage_factor: k } = result.over_range ?? {};
  return [
    ["Bias", plusMinus(found.bias_deg, found.bias_std_deg, "°")],
    ["Scale", plusMinus(found.scale, found.scale_std)],
    [found.name, significant(found.rms_deg, 3, "°")],
    ["Expanded uncertainty", isKnown(expanded) ? `${significant(expanded, 2, "°")} (k = ${significant(k, 3)})` : NOT_KNOWN],
  ];
}

/** All figures and the whole verdict of a run that has a result. */
export function resultDetails(run) {
  const { reliable } = run.verdict;
  const isValid = run.status === "completed" && !run.voided;
  const [first, ...sentences] = [...reservation(run), ...run.verdict.says];
  return h(
    "div",
    { class: "columns outcome" },
    figureList(figures(run)),
    h(
      "div",
      { class: `verdict ${judged(run)[1]}`, "data-testid": "verdict" },
      h("h3", {}, "Verdict"),
      h("p", { class: "headline" }, first),
      paragraphs(sentences),
      reliable === false && isValid && h("p", {}, h("a", { href: unitHref(run.unit) }, "Drafts of this unit")),
    ),
  );
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

function calibrated(result) {
  const judged = headline(result);
  return [
    ["Bias", besideStage(judged.bias_deg, judged.bias_std_deg, result.reference?.bias_std_deg, "°")],
    ["Scale", besideStage(judged.scale, judged.scale_std, result.reference?.scale_std)],
    ["RMS error, raw", significant(result.rms_raw_deg, 3, "°")],
    [judged.name, significant(judged.rms_deg, 3, "°")],
  ];
}

/** What bias and scale alone give, of a result that has effects too. */
function plainFit(result) {
  if (headline(result).isPlain) return [];
  return [
    ["Plain fit: bias", plusMinus(result.bias_deg, result.bias_std_deg, "°")],
    ["Plain fit: scale", plusMinus(result.scale, result.scale_std)],
    ["Plain fit: RMS error", significant(result.rms_calibrated_deg, 3, "°")],
  ];
}

/** Errors of indication: a verification applies a bias and a scale and measures neither. */
function verified(result, revision) {
  const { lowest_error_deg: lowest, highest_error_deg: highest, mean_error_deg: mean } = result.over_range ?? {};
  const ends = lowest ? [Math.min(...lowest), Math.max(...highest)].map((end) => fixed(end, 3, "°")) : [NOT_KNOWN];
  return [
    ["Revision applied", revision ?? NOT_KNOWN],
    ["Mean error of indication", fixed(mean, 3, "°")],
    ["Errors of indication", ends.join(" to ")],
    ["RMS error of indication", significant(verifiedRms(result), 3, "°")],
    ["RMS error, raw", significant(result.rms_raw_deg, 3, "°")],
  ];
}

function figures({ result, plan, provenance }) {
  const gyro = result.gyro;
  const temperature = result.temperature_c;
  const isVerified = plan?.kind === "verification";
  const rows = [
    ...(isVerified ? verified(result, provenance.verifies_revision) : calibrated(result)),
    ["Standard error of a reading", significant(result.noise_deg, 2, "°")],
    ["Poses", posesOf(result, plan?.mounts_deg)],
    ["Temperature", range(temperature?.min, temperature?.max, 1, "°C")],
    ...(isVerified ? [] : plainFit(result)),
  ];
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
