// One effect of a diagnosis: a line, and folded below it parameters, evidence, chart and acceptance.

import { post } from "./api.js";
import { askConfirmation, askReason } from "./ask.js";
import { Chart } from "./charts.js";
import { bullets, dataTable, figureList, h, numberCell, runName, tableRow } from "./dom.js";
import {
  candidateWords,
  covariateWords,
  effectTitle,
  evidenceWords,
  explainedWords,
  formulaOf,
  originWords,
  parameterRows,
  scopeOf,
  sizeOf,
  suspectWords,
} from "./effects.js";
import { onOpen } from "./fold.js";
import { moment, significant } from "./format.js";
import { may } from "./me.js";

/** Its element; the chart is loaded when it is unfolded. `decides` is what finds out which candidate it is, if any. */
export function effectCard(effect, k, { path, run }, decides, signal) {
  const chart = new Chart(
    `effect-${k}`,
    `Partial residual against ${covariateWords(effect.covariate)}, and the fitted effect`,
    { low: true, signal },
  );
  const { reference } = run.diagnosis;
  const title = effectTitle(effect, reference);
  const [word, look] = effect.accepted_at ? ["accepted", "in"] : [effect.verdict, effect.verdict];
  const folded = h(
    "details",
    { "data-fold": effect.name },
    h(
      "summary",
      {},
      h("h3", {}, title),
      h("span", { class: "size" }, sizeOf(effect)),
      h("span", { class: "muted" }, ownerWords(effect, run)),
      h("span", { class: "muted share" }, explainedWords(effect)),
      h("span", { class: `pill ${look}` }, word),
    ),
    h(
      "div",
      { class: "effect-details" },
      h(
        "div",
        {},
        change(effect),
        figures(effect),
        bullets(effect.evidence.map(evidenceWords), { class: "evidence" }),
        h("p", {}, h("strong", {}, "Remedy: "), `${effect.remedy}.`),
        considered(effect, reference),
        (effect.corrects || effect.verdict === "named") && !effect.changed && acceptance(effect, title, path, run),
      ),
      chart.element,
    ),
  );
  onOpen(folded, () => chart.load(`${path}/figures/effect-${k}`), signal);
  const props = { class: "effect", "data-effect": effect.name, "aria-label": title };
  return h("article", props, folded, suspects(effect, reference), decides);
}

/** Whose error it is. */
function ownerWords(effect, run) {
  if (effect.changed) return "between runs";
  if (effect.verdict !== "named" && !effect.corrects) return effect.verdict === "ambiguous" ? "not decided" : "not known";
  return { unit: `unit ${run.unit}`, rig: `rig ${run.rig ?? "not known"}`, run: "this run" }[scopeOf(effect)];
}

function figures(effect) {
  const formula = formulaOf(effect);
  const rows = [
    ...parameterRows(effect),
    ["Origin", originWords(effect.origin)],
    ["Family-wise p-value", pValue(effect)],
  ];
  const added = formula && h("div", { class: "formula" }, h("dt", {}, "Added to the reading"), h("dd", {}, formula));
  return figureList(rows, {}, added);
}

/** The runs between which it changed; null if it was constant. */
function change({ changed }) {
  if (!changed) return null;
  const [from, to] = [changed.from, changed.to].map(runName);
  const words = `Changed from run ${from} to run ${to}. The values are differences, later minus earlier.`;
  return h("p", { class: "changed", "data-testid": "changed" }, words);
}

function pValue({ p_value: p, least_p_value: least }) {
  return (p <= least ? "≤ " : "") + significant(p, 2);
}

function suspects(effect, reference) {
  if (effect.verdict !== "ambiguous" || !effect.confusable_with.length) return null;
  return h("p", { class: "suspects" }, "May be ", suspectWords(effect, reference), ".");
}

function considered(effect, reference) {
  const rows = effect.considered.map(({ name, behind, why }) =>
    tableRow(candidateWords(name, reference), [numberCell(significant(behind, 3)), why ?? "–"]),
  );
  return h(
    "details",
    { "data-fold": `${effect.name} considered`, "data-testid": `considered-${effect.name}` },
    h("summary", {}, "Candidates rejected"),
    h(
      "p",
      { class: "muted" },
      "ΔBIC: Bayesian information criterion of the candidate minus that of the best one, with all other effects in the ",
      "model.",
    ),
    dataTable("Candidates considered", ["Candidate", "#ΔBIC", "Why"], rows),
  );
}

/**
 * The button, or the time of acceptance and the button that revokes it. The effect's scope decides whether unit or rig
 * keeps it. The service refuses what cannot be accepted.
 */
function acceptance(effect, title, path, run) {
  const ofRig = scopeOf(effect) === "rig";
  if (ofRig && !run.rig) return h("p", { class: "muted" }, "An error of the rig: import the poses on a rig to store it.");
  const stored = ofRig
    ? `Stored as an error of rig ${run.rig}; not exported with the unit.`
    : `Stored with the calibration of unit ${run.unit}; exported with it.`;
  const offer = (id, text, click) => {
    const label = `${text.slice(0, -1)}: ${title}`;
    return may("releaser") && h("button", { type: "button", id, "aria-label": label, on: { click } }, text);
  };
  if (effect.accepted_at) {
    const words = ["Accepted ", moment(effect.accepted_at), `. ${stored}`];
    const back = () =>
      askReason(
        {
          title: `Revoke the acceptance of “${title}”?`,
          text: "The effect is no longer in force; an earlier acceptance applies again.",
          action: "Revoke",
        },
        (reason) => post(`${path}/diagnosis/withdraw`, { effects: [effect.name], reason }),
      );
    return h(
      "div",
      { class: "buttons" },
      h("p", { class: "accepted", role: "status" }, words),
      offer(`take-back-${effect.name}`, "Revoke…", back),
    );
  }
  const question = { title: `Accept “${title}”?`, text: stored, action: "Accept" };
  const accept = () => askConfirmation(question, () => post(`${path}/diagnosis/accept`, { effects: [effect.name] }));
  return h("div", { class: "buttons" }, offer(`accept-${effect.name}`, "Accept…", accept));
}
