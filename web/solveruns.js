// Which runs are worth solving together: those of one unit that was clamped at several angles.

import { plural } from "./format.js";

/** The angles at which a run's unit was clamped, as its plan has them; null of a file's, whose poses say. */
export function anglesOf({ plan }) {
  return plan && (plan.mounts_deg ?? [0]);
}

/** Ids to be ticked, and why: those that the address names, else those of the unit with the most mounts. */
export function suggested(runs, { runs: named, unit }) {
  if (!runs.length) return { ids: [], says: "No completed run counts here yet." };
  if (named.length) {
    const ids = named.filter((id) => runs.some((run) => run.id === id));
    const missing = named.length - ids.length;
    return { ids, says: missing ? `${plural(missing, "run")} of those asked for cannot be taken.` : "" };
  }
  if (unit) return { ids: of(runs, unit), says: `All of unit ${unit} are ticked.` };
  const best = ranked(runs)[0];
  if (best.mounts > 1)
    return { ids: of(runs, best.unit), says: `Suggested: unit ${best.unit} (${best.words}).` };
  const says =
    "No unit was clamped at several angles: with one mount, stage and unit are separable only where the unit is stated " +
    "to be linear. Take a run with the unit turned by 120°, and one at 240°.";
  return { ids: [], says };
}

function of(runs, unit) {
  return runs.filter((run) => run.unit === unit).map(({ id }) => id);
}

/** Units, the one with the most mounts first: angles that plans name, and files that may have one each. */
function ranked(runs) {
  const units = new Map();
  for (const run of runs) {
    const one = units.get(run.unit) ?? { unit: run.unit, angles: new Set(), files: 0 };
    const angles = anglesOf(run);
    if (angles) angles.forEach((angle) => one.angles.add(angle));
    else one.files += 1;
    units.set(run.unit, one);
  }
  const counted = [...units.values()].map(({ unit, angles, files }) => {
    const planned = angles.size > 0 && `clamped at ${[...angles].map((angle) => `${angle}°`).join(", ")}`;
    const read = files > 0 && `${plural(files, "file")}, each perhaps clamped at another angle`;
    return { unit, words: [planned, read].filter(Boolean).join("; "), mounts: angles.size + files };
  });
  return counted.sort((a, b) => b.mounts - a.mounts);
}
