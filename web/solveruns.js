// Suggests runs for a joint solution: those of one unit that was clamped at several angles.

import { plural } from "./format.js";

/** The mounting angles in a run's plan; null for an import, whose poses have them. */
export function anglesOf({ plan }) {
  return plan && (plan.mounts_deg ?? [0]);
}

/** The ids to tick and the reason: those that the address names, else those of the unit with the most mounts. */
export function suggested(runs, { runs: named, unit }) {
  if (!runs.length) return { ids: [], says: "No valid completed run yet." };
  if (named.length) {
    const ids = named.filter((id) => runs.some((run) => run.id === id));
    const missing = named.length - ids.length;
    return { ids, says: missing ? `${plural(missing, "requested run")} cannot be used.` : "" };
  }
  if (unit) return { ids: of(runs, unit), says: `All runs of unit ${unit} are ticked.` };
  const best = ranked(runs)[0];
  if (best.mounts > 1)
    return { ids: of(runs, best.unit), says: `Suggested: unit ${best.unit} (${best.words}).` };
  const says =
    "No unit was clamped at several angles. With one mount, stage and unit are separable only if the unit is stated to " +
    "be linear. Add a run with the unit clamped at 120°, and one at 240°.";
  return { ids: [], says };
}

function of(runs, unit) {
  return runs.filter((run) => run.unit === unit).map(({ id }) => id);
}

/** Units by number of mounts, most first: angles of the plans, and files, which may have one each. */
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
    const read = files > 0 && `${plural(files, "file")}, possibly each at another angle`;
    return { unit, words: [planned, read].filter(Boolean).join("; "), mounts: angles.size + files };
  });
  return counted.sort((a, b) => b.mounts - a.mounts);
}
