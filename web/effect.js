// One effect of a diagnosis: what it is, how sure that is, what it looks like, and putting it in force.

import { post } from "./api.js";
import { askConfirmation, askReason } from "./ask.js";
import { Chart } from "./charts.js";
import { h, headings, runName, tableBox } from "./dom.js";
import {
  candidateWords,
  covariateWords,
  effectTitle,
  evidenceWords,
  formulaOf,
  originWords,
  parameterRows,
  scopeOf,
} from "./effects.js";
import { moment, significant } from "./format.js";
import { may } from "./me.js";

/** Its element, and the chart in it that is loaded once the element is on the page. */
export function effectCard(effect, k, { path, run }, signal) {
  const chart = new Chart(
    `effect-${k}`,
    `Partial residual against ${covariateWords(effect.covariate)}, and the fitted effect`,
    { low: true, signal },
  );
  const title = effectTitle(effect);
  const element = h(
    "article",
    { class: "effect", "data-effect": effect.name, "aria-label": title },
    h(
      "div",
      {},
      h("h3", {}, title, h("span", { class: `pill ${effect.verdict}` }, effect.verdict)),
      change(effect),
      figures(effect),
      suspects(effect),
      h(
        "ul",
        { class: "evidence" },
        effect.evidence.map((sentence) => h("li", {}, evidenceWords(sentence))),
      ),
      h("p", {}, h("strong", {}, "Remedy: "), `${effect.remedy}.`),
      considered(effect),
      effect.verdict === "named" && !effect.changed && acceptance(effect, title, path, run),
    ),
    chart.element,
  );
  return { element, chart };
}

function figures(effect) {
  const formula = formulaOf(effect);
  const rows = [
    ...parameterRows(effect),
    ["Origin", originWords(effect.origin)],
    ["Family-wise p-value", pValue(effect)],
  ];
  return h(
    "dl",
    { class: "figures" },
    rows.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value))),
    formula && h("div", { class: "formula" }, h("dt", {}, "Added to the reading"), h("dd", {}, formula)),
  );
}

/** Between which runs it changed; nothing of what was the same in all of them. */
function change({ changed }) {
  if (!changed) return null;
  const [from, to] = [changed.from, changed.to].map(runName);
  const words = `Changed from run ${from} to run ${to}: the values are the later less the earlier ones.`;
  return h("p", { class: "changed", "data-testid": "changed" }, words);
}

function pValue({ p_value: p, least_p_value: least }) {
  return (p <= least ? "≤ " : "") + significant(p, 2);
}

function suspects({ verdict, name, confusable_with: others }) {
  if (verdict !== "ambiguous" || !others.length) return null;
  const listed = [name, ...others].map(candidateWords).join(", ");
  return h("p", { class: "suspects" }, h("strong", {}, "Indistinguishable by these poses: "), listed, ".");
}

function considered(effect) {
  const rows = effect.considered.map(({ name, behind, why }) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, candidateWords(name)),
      h("td", { class: "number" }, significant(behind, 3)),
      h("td", {}, why ?? "–"),
    ),
  );
  return h(
    "details",
    { "data-testid": `considered-${effect.name}` },
    h("summary", {}, "Candidates rejected"),
    h(
      "p",
      { class: "muted" },
      "ΔBIC: −2 log likelihood, with log n for each parameter, beyond that of the best; all the other effects are ",
      "in the model.",
    ),
    tableBox(
      "Candidates considered",
      h("table", {}, headings("Candidate", "#ΔBIC", "Why"), h("tbody", {}, rows)),
    ),
  );
}

/**
 * The button, or since when it is accepted and the way back. Where an accepted effect goes depends on where it
 * comes from; what cannot be accepted the service says. "calrig:done" has all of it shown anew.
 */
function acceptance(effect, title, path, run) {
  const ofRig = scopeOf(effect) === "rig";
  const keeper = ofRig ? `the error map of rig ${run.rig}` : `the calibration of unit ${run.unit}`;
  const offer = (id, text, click) => {
    const label = `${text.slice(0, -1)}: ${title}`;
    return may("releaser") && h("button", { type: "button", id, "aria-label": label, on: { click } }, text);
  };
  if (effect.accepted_at) {
    const words = ["Accepted ", moment(effect.accepted_at), `: from then on it belongs to ${keeper}.`];
    const back = () =>
      askReason(
        {
          title: `Withdraw “${title}”?`,
          text: `It belongs to ${keeper} no more; what was accepted before it is in force again.`,
          action: "Withdraw it",
        },
        (reason) => post(`${path}/diagnosis/withdraw`, { effects: [effect.name], reason }),
      );
    return h(
      "div",
      { class: "buttons" },
      h("p", { class: "accepted", role: "status" }, words),
      offer(`take-back-${effect.name}`, "Withdraw…", back),
    );
  }
  const accept = () =>
    askConfirmation(
      {
        title: `Accept “${title}”?`,
        text:
          `From now on it belongs to ${keeper}` +
          (ofRig ? "; a rig's error is never applied in flight." : ", as it is exported and applied in flight."),
        action: "Accept it",
      },
      () => post(`${path}/diagnosis/accept`, { effects: [effect.name] }),
    );
  return h("div", { class: "buttons" }, offer(`accept-${effect.name}`, "Accept…", accept));
}
