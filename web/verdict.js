// "Is this good?" in words: what is left after calibration against what noise alone would leave.

import { fixed, isKnown, plural, significant } from "./format.js";

const AS_NOISE = 1.5;
const CLEARLY_MORE = 3;
const FEW_POSES = 6;

/**
 * @returns {{grade: "good"|"fair"|"poor"|"unknown", headline: string, sentences: string[]}}
 */
export function verdict(run) {
  const use = run.voided ? [] : calibration(run.result);
  return { ...grade(run), sentences: [...left(run.result), ...use, ...cautions(run)] };
}

function grade(run) {
  const { result } = run;
  if (run.voided) return { grade: "unknown", headline: "Voided: not to be used" };
  if (run.status !== "completed")
    return { grade: "unknown", headline: "Not finished: figures of the poses so far" };
  const ratio = excess(result);
  if (ratio === null) return { grade: "unknown", headline: "Cannot be judged: the noise is not known" };
  if (ratio <= AS_NOISE) return { grade: "good", headline: "Good: only noise is left" };
  if (ratio <= CLEARLY_MORE) return { grade: "fair", headline: "Fair: a little more than noise is left" };
  return { grade: "poor", headline: "Not yet: something is left that bias and scale do not explain" };
}

/** How many times the residual exceeds what noise alone would leave; null where the noise is not known. */
function excess({ rms_calibrated_deg: rms, noise_deg: noise, n_poses: poses, scale }) {
  const free = poses - (isKnown(scale) ? 2 : 1);
  if (!isKnown(noise) || noise <= 0 || free < 1) return null;
  return rms / (noise * Math.sqrt(free / poses));
}

function left(result) {
  const [raw, calibrated] = [result.rms_raw_deg, result.rms_calibrated_deg];
  const before = `As it came the reading was off by ${significant(raw, 2, "°")} RMS; `;
  const factor = calibrated > 0 ? raw / calibrated : null;
  const times = factor > 1.05 ? `, ${fixed(factor, factor < 10 ? 1 : 0)} times less` : "";
  const sentences = [`${before}calibrated, by ${significant(calibrated, 2, "°")}${times}.`];
  const ratio = excess(result);
  if (ratio === null) return sentences;
  sentences.push(`A reading's own standard error is ${significant(result.noise_deg, 2, "°")}.`);
  if (ratio <= AS_NOISE) return [...sentences, "What is left is about what such noise leaves."];
  return [
    ...sentences,
    `What is left is ${fixed(ratio, 1)} times what such noise alone would leave; ` +
      "its shape against elevation and approach is drawn below.",
  ];
}

function calibration({ scale, scale_std: std, reference }) {
  if (!isKnown(scale))
    return ["All poses stand at one elevation, so the scale is not known and counts as 1."];
  if (!isKnown(std) || std <= 0) return [];
  const off = Math.abs(scale - 1);
  if (off <= 3 * std) return ["The scale cannot be told from 1 with these poses."];
  const sigmas = `The scale differs from 1 by ${fixed(off / std, 0)} standard errors`;
  return off > 3 * Math.hypot(std, reference?.scale_std ?? 0)
    ? [`${sigmas}: it is worth applying.`]
    : [`${sigmas}, but by no more than an error of the stage itself could make.`];
}

function cautions({ result, faults }) {
  const sentences = [];
  if (result.n_poses < FEW_POSES) sentences.push(`It rests on only ${plural(result.n_poses, "pose")}.`);
  const count = Object.values(faults).reduce((sum, n) => sum + n, 0);
  if (count) sentences.push(`${plural(count, "fault")} counted on the wire and kept out of the readings.`);
  return sentences;
}
