// The catalogue's names in plain words: effects, where they come from, their parameters with units.

import { plusMinus, significant } from "./format.js";

const EFFECTS = {
  backlash: "Backlash of the stage",
  stage_eccentricity: "Eccentricity of the stage",
  stage_periodic: "Periodic error of the stage",
  accelerometer_offset: "Offset of the accelerometer",
  axis_mismatch: "Mismatch of the accelerometer's axes",
  nonlinearity: "Nonlinearity of the accelerometer",
  temperature_bias: "Bias that follows temperature",
  temperature_curvature: "Bias that follows temperature squared",
  temperature_scale: "Scale that follows temperature",
  time_drift: "Drift in time",
  mount_slip: "Slip of the mount",
  settling: "Incomplete settling",
  gyro_scale: "Scale error of the gyro",
  latency: "Readings that come late",
};

const COVARIATES = {
  approach: "the sense of the last move",
  target_deg: "elevation",
  temperature_c: "temperature",
  time_s: "time",
  move_deg: "the last move",
  velocity: "velocity",
};

const ORIGINS = {
  sensor: "the sensor",
  stage: "the stage",
  mounting: "the mounting",
  process: "the procedure",
  environment: "the surroundings",
  unknown: "not known",
};

const PARAMETERS = {
  backlash_deg: ["Upward less downward", "°"],
  amplitude_deg: ["Amplitude", "°"],
  phase_deg: ["Phase", "°"],
  period_deg: ["Period", "°"],
  y_mg: ["Offset of y", "mg"],
  z_mg: ["Offset of z", "mg"],
  gain_pct: ["Gain error", "%"],
  skew_deg: ["Skew", "°"],
  deg_per_deg2: ["Of elevation²", "°/°²"],
  deg_per_deg3: ["Of elevation³", "°/°³"],
  deg_per_c: ["Coefficient", "°/°C"],
  deg_per_c2: ["Coefficient", "°/°C²"],
  per_c: ["Coefficient", "1/°C"],
  reference_c: ["Reference", "°C"],
  deg_per_s: ["Rate", "°/s"],
  step_deg: ["Step, after less before", "°"],
  at_s: ["At", "s"],
  fraction: ["Share of the move missing", ""],
  delay_s: ["Delay", "s"],
  size_deg: ["Size, peak to peak", "°"],
};

const SAID_IN_WORDS = new Set(["of_axis_y"]);

const CHANNELS = {
  accel_angle: "the accelerometer's angle",
  accel_norm: "|accelerometer|",
  gyro_move: "the gyro over the moves",
};

/** An effect's name for a heading; one that the page has no words for is shown as the service has it. */
export function effectTitle({ name, covariate }) {
  if (name === "unnamed") return `Something that follows ${covariateWords(covariate)}`;
  return EFFECTS[name] ?? words(name);
}

/** A candidate's name, such as `unnamed time_s`, inside a sentence or a table. */
export function candidateWords(label) {
  const [, covariate] = /^unnamed (.*)$/.exec(label) ?? [];
  return covariate === undefined ? words(label) : `a shape of ${covariateWords(covariate)}`;
}

export function covariateWords(covariate) {
  return COVARIATES[covariate] ?? covariate;
}

export function originWords(origin) {
  return ORIGINS[origin] ?? origin;
}

/** [name, value ± standard error with unit] of each parameter that is known and not said in the evidence. */
export function parameterRows({ parameters, covariate }) {
  return Object.entries(parameters)
    .filter(([key, found]) => found !== null && !SAID_IN_WORDS.has(key))
    .map(([key, { value, std }]) => {
      const [name, unit] = PARAMETERS[key] ?? placed(key, covariate);
      return [name, std === null ? significant(value, 4, unit) : plusMinus(value, std, unit)];
    });
}

/** Channels of the search in words; everything else of an evidence sentence as it came, as a sentence. */
export function evidenceWords(sentence) {
  const said = sentence.replace(/\b(accel_angle|accel_norm|gyro_move)\b/g, (name) => CHANNELS[name]);
  return `${said[0].toUpperCase()}${said.slice(1)}${/[.!?]$/.test(said) ? "" : "."}`;
}

/** `period` and `at` are in the covariate's own unit. */
function placed(key, covariate) {
  const unit = { _s: "s", _deg: "°", _c: "°C", _v: "V" }[/_[a-z]+$/.exec(covariate)?.[0]] ?? "";
  return [{ period: "Period", at: "At" }[key] ?? words(key), key === "period" || key === "at" ? unit : ""];
}

function words(name) {
  return name.replaceAll("_", " ");
}
