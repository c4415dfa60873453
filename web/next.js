// The next step of a run that has ended: one primary button, which gets the focus once the step before is done.

import { get, post, serviceError } from "./api.js";
import { isOutdated } from "./diagnosis.js";
import { attempt, button, errorLine, fill, h, keepingFocus, rigHref, solveHref, unitHref } from "./dom.js";
import { isKnown, range } from "./format.js";
import { may } from "./me.js";
import { guarded } from "./queuekeys.js";

const NOT_PRESSED = "Enter ignored: it came with a scan, or before the button could be read. Press Enter again.";
const SEARCH = "Searches a catalogue of physical effects for causes of the residual. Takes a few seconds.";

/** `diagnosis` is the panel whose button is the first step; `done()` reads the run after another one. */
export class NextStep {
  constructor(path, signal, diagnosis, done) {
    this.path = path;
    this.signal = signal;
    this.diagnosis = diagnosis;
    this.done = done;
    this.row = h("div", { class: "buttons" });
    this.says = h("div");
    this.error = errorLine("next-error");
    this.element = h("div", { id: "next", class: "next", hidden: true }, this.row, this.error.element, this.says);
    this.calm = guarded(diagnosis.button, () => this.#refuse());
  }

  show(run) {
    const step = stepOf(run);
    const effects = run.diagnosis?.effects.map(({ name, accepted_at: at }) => [name, at]);
    const key = JSON.stringify([step, run.unit, run.result?.n_poses, run.verdict?.reliable, effects]);
    this.run = run;
    if (key === this.key) return;
    this.key = key;
    this.element.hidden = step === "none";
    this.diagnosis.lend(step === "diagnose" ? this.row : undefined);
    this.drawn = this.#draw(step, key).catch((error) => this.error.say(serviceError(error, this.signal)));
  }

  /** Puts the focus on the button of the step that comes now, unless somebody is at something else. */
  async focus() {
    await this.drawn;
    const at = document.activeElement;
    const isOwn = this.element.contains(at) || at === this.diagnosis.button;
    const isFree = !at || at === document.body || at.matches("main") || isOwn || !at.checkVisibility();
    if (isFree && !document.querySelector("dialog[open]")) this.row.querySelector(".primary")?.focus({ preventScroll: true });
  }

  async #draw(step, key) {
    const { buttons = [], says = [] } = (await STEPS[step]?.(this.run, this)) ?? {};
    if (key !== this.key || this.signal.aborted) return;
    this.error.say(null);
    keepingFocus(this.element, () => {
      fill(this.row, step === "diagnose" ? this.diagnosis.button : buttons);
      fill(this.says, says);
    });
    if (step === "diagnose") return this.calm();
    const primary = this.row.querySelector(".primary");
    if (primary) guarded(primary, () => this.#refuse());
  }

  #refuse() {
    this.error.say({ message: NOT_PRESSED });
  }

  /** Accepts effects, in one revision. */
  acceptButton(offered) {
    const names = offered.map(({ name }) => name);
    const isNamed = offered.every(({ verdict }) => verdict === "named");
    const which = isNamed ? " named" : "";
    const text = names.length > 1 ? `Accept all${which} (${names.length})` : `Accept the${which} effect`;
    const accept = button(text, () =>
      attempt([accept], this.error, async () => {
        await post(`${this.path}/diagnosis/accept`, { effects: [...new Set(names)] });
        await this.done();
      }),
    );
    accept.id = "accept-all";
    accept.className = "primary";
    return accept;
  }
}

const STEPS = {
  diagnose: () => ({ says: [h("p", { class: "muted" }, SEARCH)] }),
  accept: toAccept,
  use: toUse,
  again: ({ unit, rig }) => ({
    buttons: [link(`#/?${new URLSearchParams({ unit, ...(rig && { rig }) })}`, "Start again", "again")],
  }),
  noise: ({ id }) => ({ buttons: [link(`#/noise/${encodeURIComponent(id)}`, "Noise analysis of this log", "study")] }),
  solve: ({ unit, rig }) => ({ buttons: [link(solveHref({ rig, unit }), "Separate errors of stage and unit", "to-solve")] }),
  unit: ({ unit }) => ({ buttons: [link(unitHref(unit), `Open unit ${unit}`, "to-unit")] }),
};

function link(href, text, id, props = {}) {
  return h("a", { href, id, class: "button primary", ...props }, text);
}

function stepOf(run) {
  const { status, voided, result, plan, diagnosis, verdict } = run;
  if (voided) return "again";
  if (status !== "completed") return "none"; // a run that did not complete has its buttons in its head
  if (!result) return plan?.kind === "static" ? "noise" : "solve";
  const isClean = verdict.left === "noise" && ["no_limits", "pass"].includes(verdict.answer);
  const isInDoubt = verdict.reliable === false; // its draft is for a person to look at
  const isOpen = diagnosis ? isOutdated(run) : !isClean && !isInDoubt;
  if (isOpen && may("operator")) return "diagnose";
  if (plan?.kind === "verification") return "unit";
  return diagnosis && offeredOf(run).length && may("releaser") ? "accept" : "use";
}

/**
 * The effects that can be accepted and have not been; older diagnoses do not state whose correction each is. Of an
 * ambiguous one that corrects the unit the name alone is in doubt. A curve without a name comes with the others, which
 * are sized beside it.
 */
function offeredOf({ rig, diagnosis }) {
  const hasOwner = ({ corrects }) => isKnown(corrects) && (corrects !== "rig" || isKnown(rig));
  const offered = diagnosis.effects.filter(
    (effect) => hasOwner(effect) && !effect.changed && !isKnown(effect.accepted_at),
  );
  return offered.some(({ verdict }) => verdict !== "unnamed") ? offered : [];
}

async function toAccept(run, next) {
  const { effectTitle, knowEffects, suspectWords } = await import("./effects.js");
  await knowEffects();
  const offered = offeredOf(run);
  const named = (effect) =>
    (effect.verdict === "ambiguous" ? suspectWords : effectTitle)(effect, run.diagnosis.reference);
  const listed = (scope) => [...new Set(offered.filter(({ corrects }) => corrects === scope).map(named))];
  const [ofUnit, ofRig] = [listed("unit"), listed("rig")];
  const sentences = [
    ofUnit.length && `Corrects unit ${run.unit} for: ${inSentence(ofUnit)}.`,
    ofRig.length && ["Stores as errors of ", rigLink(run.rig), `, not exported with the unit: ${inSentence(ofRig)}.`],
  ];
  return {
    buttons: [next.acceptButton(offered)],
    says: sentences.filter(Boolean).map((one) => h("p", { class: "muted" }, one)),
  };
}

const inSentence = (titles) => titles.map((title) => title[0].toLowerCase() + title.slice(1)).join(", ");
const rigLink = (rig) => h("a", { href: rigHref(rig) }, `rig ${rig}`);

/** The calibration that was made of the run: to be downloaded, certified and verified, or to be released first. */
async function toUse(run, { signal }) {
  const path = `/api/units/${encodeURIComponent(run.unit)}`;
  const revisions = (await get(`${path}/calibrations`, signal)).filter(({ run_id: id }) => id === run.id);
  const leftOut = await whatIsLeftOut(run);
  const current = revisions.find(({ status }) => status === "in_force");
  if (!current) {
    const draft = revisions.find(({ status }) => status === "draft");
    const words = draft
      ? `Revision ${draft.revision} is a draft: it is not in force before a person releases it.`
      : "No revision of this run is in force.";
    const open = link(unitHref(run.unit), draft ? "Review the draft" : `Open unit ${run.unit}`, "to-unit");
    return { buttons: [open], says: [h("p", { class: "muted" }, words), leftOut] };
  }
  const [unit, rigs, { verifying }, { certificateButtons }] = await Promise.all([
    get(path, signal),
    get("/api/rigs", signal),
    import("./units.js"),
    import("./certificate.js"),
  ]);
  const { revision } = current;
  const certificate = certificateButtons(path, { unit: run.unit, revision });
  const file = `${path}/calibration?revision=${revision}`;
  return {
    buttons: [
      link(file, "Download calibration", "download", { download: "calibration.json" }),
      certificate.buttons.slice(0, 2),
    ],
    says: [
      certificate.error,
      h("p", {}, `Revision ${revision} of `, h("a", { href: unitHref(run.unit) }, `unit ${run.unit}`), " is in force."),
      leftOut,
      rigs.length > 0 && may("operator") && verifying(unit, rigs),
    ],
  };
}

const LEFT_OUT = { ambiguous: "ambiguous", unnamed: "not in the catalogue", named: "not accepted" };

/** What the diagnosis has found and the calibration does not correct, and what that means where it is used. */
async function whatIsLeftOut({ diagnosis, result }) {
  const open = (diagnosis?.effects ?? []).filter(({ accepted_at: acceptedAt }) => !isKnown(acceptedAt));
  if (!open.length) return null;
  const { effectTitle, followsTemperature, knowEffects, sizeOf, suspectWords } = await import("./effects.js");
  await knowEffects();
  const { min, max } = result.temperature_c ?? {};
  const words = (effect) => {
    const title = effectTitle(effect, diagnosis.reference);
    const name = effect.verdict === "ambiguous" ? suspectWords(effect, diagnosis.reference) : title[0].toLowerCase() + title.slice(1);
    return `${LEFT_OUT[effect.verdict]}: ${name}, ${sizeOf(effect)}`;
  };
  const means = open.some(followsTemperature)
    ? `The calibration holds at the temperatures of this run, ${range(min, max, 1, "°C")}. At another temperature its ` +
      "error grows with the difference, and U does not contain that."
    : "It is not corrected: the residual and U contain it as these poses show it.";
  return h(
    "div",
    { class: "left-out", "data-testid": "left-out" },
    h("p", {}, h("strong", {}, "Left out: "), `${open.map(words).join("; ")}.`),
    h("p", {}, means),
  );
}
