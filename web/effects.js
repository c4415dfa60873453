// Titles, units and formulas of effects, from the service's catalogue (`GET /api/effects`).

import { getOnce } from "./api.js";
import { fixed, isKnown, plusMinus, significant } from "./format.js";

let catalogue = new Map();

/** Loads the catalogue, which the other functions use. */
export async function knowEffects() {
  catalogue = new Map((await getOnce("/api/effects")).map((effect) => [effect.name, effect]));
}

/**
 * An effect's title for a heading; one that the catalogue no longer has is shown as it was stored. `reference` is the
 * diagnosis's: if it is good, the stage does not err.
 */
export function effectTitle({ name, covariate }, reference) {
  if (name === "unnamed") return `Something that follows ${covariateWords(covariate)}`;
  const known = catalogue.get(name);
  return (reference === "good" && known?.sensor_title) || (known?.title ?? name.replaceAll("_", " "));
}

/** A candidate's name, such as `unnamed time_s`, inside a sentence or a table. */
export function candidateWords(label, reference) {
  const [, kind, changed = ""] = /^(.*?)( from run .* to run .*)?$/.exec(label);
  const [, covariate] = /^unnamed (.*)$/.exec(kind) ?? [];
  const known = kind.split(" + ").map((name) => words(name, reference));
  return (covariate === undefined ? known.join(" + ") : `a shape of ${covariateWords(covariate)}`) + changed;
}

/** What an ambiguous effect may be; by another period of its own if only the spacing of the poses could tell them. */
export function suspectWords({ name, confusable_with: others }, reference) {
  const shown = (other) => (other === name ? "the same at another period" : candidateWords(other, reference));
  return [candidateWords(name, reference), ...others.map(shown)].join(" or ");
}

/** Titles of corrections of a unit: an error of the angle is among them only where the reference is good. */
export const correctionTitles = (names) => names.map((name) => effectTitle({ name, covariate: "target_deg" }, "good"));

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
export function parameterRows(effect) {
  return known(effect).map((one) => [one.title, shown(one)]);
}

/** Parameters that say where an effect is, and not how large. */
const PLACES = /^(phase|period|reference|at|lag|began|middle|knot)(_|$)/;

/** The size of an effect in one text: of several in one unit, such as those of two axes, the most certain one. */
export function sizeOf(effect) {
  const sizes = known(effect).filter(({ name }) => !PLACES.test(name));
  const alike = sizes.filter(({ unit }) => unit === sizes[0].unit);
  const certainty = ({ value, std }) => (std ? Math.abs(value) / std : 0);
  alike.sort((one, other) => certainty(other) - certainty(one));
  return alike.length ? shown(alike[0]) : "";
}

/**
 * The share of the residual that an effect explains, which is negative where other effects outweigh it; null in
 * diagnoses that were stored before it was computed.
 */
export function explainedWords({ explained }) {
  if (!isKnown(explained)) return null;
  if (explained < 0) return "masked by other effects";
  const share = explained < 0.01 ? "< 1" : fixed(100 * explained, 0);
  return `${share}\u00a0% of the residual`;
}

/** Whether some candidate for an effect follows the temperature. */
export function followsTemperature({ name, covariate, confusable_with: others }) {
  const follows = (one) => catalogue.get(one)?.covariate === "temperature_c";
  return covariate === "temperature_c" || [name, ...others].some(follows);
}

function known({ name, parameters, covariate }) {
  const titles = new Map((catalogue.get(name)?.parameters ?? []).map((one) => [one.name, one]));
  return Object.entries(parameters)
    .filter(([key, found]) => found !== null && !titles.get(key)?.flag)
    .map(([key, found]) => {
      const { title, unit } = titles.get(key) ?? { title: key.replaceAll("_", " "), unit: "" };
      return { ...found, name: key, title, unit: unit ?? following(covariate)?.covariate_unit ?? "" };
    });
}

function shown({ value, std, unit }) {
  return std === null ? significant(value, 4, unit) : plusMinus(value, std, unit);
}

/** An evidence sentence as a sentence. */
export function evidenceWords(sentence) {
  return `${sentence[0].toUpperCase()}${sentence.slice(1)}${/[.!?]$/.test(sentence) ? "" : "."}`;
}

/** An effect that follows the covariate. */
function following(covariate) {
  return [...catalogue.values()].find((effect) => effect.covariate === covariate);
}

function words(name, reference) {
  if (name === "unnamed") return "an unknown effect";
  const title = effectTitle({ name }, reference);
  return title[0].toLowerCase() + title.slice(1);
}
