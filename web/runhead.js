// The head of a run: name, status and notes; and what its folds hold of downloads and data faults.

import { h, rigHref, runLink, runName, solveHref, statusPill, unitHref, unitLink } from "./dom.js";
import { candidateWords } from "./effects.js";
import { moment, plural } from "./format.js";
import { interruptions } from "./interrupted.js";
import { kindTag } from "./runlist.js";
import { solutionLinks } from "./solutions.js";

export function heading(run) {
  return h(
    "div",
    {},
    h("h1", { class: run.voided && "voided", title: run.id }, `Run ${runName(run.id)} · `, unitLink(run.unit)),
    h(
      "p",
      { class: "facts" },
      statusPill(run.status, { id: "status" }),
      !run.follows && kindTag(run),
      run.follows && h("span", { id: "follows" }, "follow-up of ", runLink(run.follows, "run "), asked(run)),
      h("span", {}, run.rig ? `rig ${run.rig}` : "no rig"),
      run.operator && h("span", {}, `by ${run.operator}`),
      h("span", {}, run.finished_at ? "finished " : "created ", moment(run.finished_at ?? run.created_at)),
    ),
    run.note && h("p", { class: "note" }, run.note),
    interruptions(run),
    (run.provenance.warnings ?? []).map((text) => h("p", { class: "cautions", "data-testid": "warning" }, text)),
    run.error && h("p", { class: "error", id: "run-reason", role: "alert" }, run.error),
    run.suspect &&
      h(
        "p",
        { class: "void-reason", id: "suspect-reason" },
        `Suspect: ${run.suspect.reason}. `,
        h("a", { href: rigHref(run.rig) }, `Checks of rig ${run.rig}`),
      ),
    run.voided &&
      h("p", { class: "void-reason", id: "void-reason" }, "Voided ", moment(run.voided.at), `: ${run.voided.reason}`),
  );
}

/** The candidates that a follow-up is to distinguish. */
function asked({ provenance }) {
  const { separates = [], reference } = provenance.follow_up ?? {};
  return separates.length > 0 && `: ${separates.map((name) => candidateWords(name, reference)).join(" or ")}?`;
}

export function downloads(run, path) {
  const link = (href, text) => h("a", { href, download: "" }, text);
  return h(
    "p",
    { class: "downloads" },
    link(`${path}/poses?format=csv`, "Poses (CSV)"),
    run.plan && link(`${path}/samples`, "Raw samples (CSV)"),
    run.plan && link(`${path}/samples?format=npz`, "Raw samples (NPZ)"),
    h("a", { href: unitHref(run.unit) }, "History and calibration of this unit"),
    h("a", { href: solveHref({ rig: run.rig, unit: run.unit }) }, "Separate errors of stage and unit"),
    solutionLinks({ rig: run.rig, run: run.id }),
  );
}

export function faultLine(faults) {
  const { move_mismatch: mismatches, ...ofData } = faults;
  const counted = Object.entries(ofData).filter(([, count]) => count > 0);
  return [
    mismatches && h("p", {}, h("strong", {}, "Move mismatches, unit against stage: "), mismatches),
    counted.length
      ? h("p", {}, h("strong", {}, "Data faults, excluded from the readings: "), counted.map(faultWords))
      : h("p", { class: "muted" }, "No data faults."),
  ];
}

/** The faults in one line. */
export function faultSummary({ move_mismatch: mismatches, ...ofData }) {
  const count = Object.values(ofData).reduce((sum, one) => sum + one, 0);
  const parts = [mismatches && plural(mismatches, "move mismatch", "move mismatches"), count && plural(count, "data fault")];
  return parts.filter(Boolean).join(", ") || "none";
}

function faultWords([kind, count], place) {
  return `${place ? ", " : ""}${count.toLocaleString()} × ${kind.replaceAll("_", " ")}`;
}
