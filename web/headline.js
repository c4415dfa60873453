// The figures of a run that stand first: those in force, with effects.

import { isKnown } from "./format.js";

/** Bias, scale and RMS error that the verdict judges: with accepted effects where a result has them. */
export function headline(result) {
  const { covariance, bias_deg, scale } = result.over_range ?? {};
  if (!isKnown(result.rms_with_effects_deg) || !isKnown(covariance))
    return { ...result, name: "RMS error, calibrated", rms_deg: result.rms_calibrated_deg, isPlain: true };
  const [bias_std_deg, scale_std] = covariance.map((row, k) => Math.sqrt(row[k]));
  const name = "RMS error, with effects";
  return { bias_deg, bias_std_deg, scale, scale_std, name, rms_deg: result.rms_with_effects_deg, isPlain: false };
}

/** The RMS error that a verification found with the revision applied. */
export function verifiedRms(result) {
  return result.verified ? result.verified.rms_deg : (result.rms_with_effects_deg ?? result.rms_calibrated_deg);
}
