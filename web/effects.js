// Titles, units and formulas of effects, from the service's catalogue (`GET /api/effects`).

import { getOnce } from "./api.js";
import { plusMinus, significant } from "./format.js";

let catalogue = new Map();

/** Loads the catalogue, which the other functions use. */
export async function knowEffects() {
  catalogue = new Map((await getOnce("/api/effects")).map((effect) => [effect.name, effect]));
}

/** An effect's title for a heading; one that the catalogue no longer has is shown as it was stored. */
export function effectTitle({ name, covariate, origin }) {
  if (name === "unnamed") return `Something that follows ${covariateWords(covariate)}`;
  const known = catalogue.get(name);
  const ofSensor = origin === "sensor" && known?.origin !== "sensor";
  return (ofSensor && known?.sensor_title) || (known?.title ?? words(name));
}

/** A candidate's name, such as `unnamed time_s`, inside a sentence or a table. */
export function candidateWords(label) {
  const [, kind, changed = ""] = /^(.*?)( from run .* to run .*)?$/.exec(label);
  const [, covariate] = /^unnamed (.*)$/.exec(kind) ?? [];
  return (covariate === undefined ? words(kind) : `a shape of ${covariateWords(covariate)}`) + changed;
}

export function covariateWords(covariate) {
  return following(covariate)?.covariate_title ?? covariate;
}

export function originWords(origin) {
  return [...catalogue.values()].find((effect) => effect.origin === origin)?.origin_title ?? origin;
}

/** What the effect adds to the reading, in symbols; undefined if the catalogue does not have it. */
export function formulaOf({ name }) {
  return catalogue.get(name)?.formula;
}

/** `unit`, `rig` or `run`: what the effect stays with. */
export function scopeOf({ name, corrects }) {
  return corrects ?? catalogue.get(name)?.scope;
}

/** [name, value ± standard error with unit] of each parameter that is known and not said in the evidence. */
export function parameterRows({ name, parameters, covariate }) {
  const known = new Map((catalogue.get(name)?.parameters ?? []).map((one) => [one.name, one]));
  return Object.entries(parameters)
    .filter(([key, found]) => found !== null && !known.get(key)?.flag)
    .map(([key, { value, std }]) => {
      const { title, unit } = known.get(key) ?? { title: words(key), unit: "" };
      const shown = unit ?? following(covariate)?.covariate_unit ?? "";
      return [title, std === null ? significant(value, 4, shown) : plusMinus(value, std, shown)];
    });
}

/** An evidence sentence as a sentence. */
export function evidenceWords(sentence) {
  return `${sentence[0].toUpperCase()}${sentence.slice(1)}${/[.!?]$/.test(sentence) ? "" : "."}`;
}

/** An effect that follows the covariate. */
function following(covariate) {
  return [...catalogue.values()].find((effect) => effect.covariate === covariate);
}

function words(name) {
  return name.replaceAll("_", " ");
}
