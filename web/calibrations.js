// A unit's issued calibrations: the document of the revision in force, and every revision with its status.

import { get, getOnce, getText, post } from "./api.js";
import { askReason } from "./ask.js";
import { certificateButtons, issuedTable } from "./certificate.js";
import {
  button,
  dataTable,
  figureList,
  fill,
  h,
  paragraphs,
  runLink,
  runName,
  saveFile,
  statusPill,
  tableRow,
} from "./dom.js";
import { correctionTitles, knowEffects } from "./effects.js";
import { isKnown, moment, plusMinus, range, significant } from "./format.js";
import { may } from "./me.js";

/** Three cards that reload after each release, withdrawal, draft or certificate. */
export class Calibrations {
  constructor(serial, signal) {
    this.path = `/api/units/${encodeURIComponent(serial)}`;
    this.signal = signal;
    this.inForce = h("section", { class: "card", id: "calibration", "aria-labelledby": "in-force-title" });
    this.revisions = h("section", { class: "card", id: "revisions", "aria-labelledby": "revisions-title" });
    this.certificates = h("section", { class: "card", "aria-labelledby": "certificates-title" });
    this.elements = [this.inForce, this.certificates, this.revisions];
    this.serial = serial;
    window.addEventListener("calrig:done", () => this.#readAgain(), { signal });
  }

  /** After a change, unless the view was left in between. */
  async #readAgain() {
    if (this.unitIsGone) return;
    try {
      await this.read();
    } catch (error) {
      if (!this.signal.aborted) throw error;
    }
  }

  async read() {
    const [revisions] = await Promise.all([get(`${this.path}/calibrations`, this.signal), knowEffects()]);
    const current = revisions.find(({ status }) => status === "in_force");
    const file = current && `${this.path}/calibration?revision=${current.revision}`;
    const document = current && (await get(file, this.signal));
    const otherPrograms = current && (await formats(file));
    fill(
      this.inForce,
      h("h2", { id: "in-force-title" }, "Calibration in force"),
      this.#waiting(revisions, current),
      document ? this.#document(document, current, otherPrograms) : none(revisions),
    );
    const issued = await get(`/api/certificates?unit=${encodeURIComponent(this.serial)}`, this.signal);
    this.certificates.hidden = !issued.length;
    fill(
      this.certificates,
      h("h2", { id: "certificates-title" }, "Certificates"),
      issuedTable(this.path, issued, current),
    );
    this.revisions.hidden = !revisions.length;
    fill(
      this.revisions,
      h("h2", { id: "revisions-title" }, "Revisions"),
      this.#table(revisions),
    );
  }

  /** The newest draft, if it has warnings and awaits a decision. */
  #waiting([newest], current) {
    if (newest?.status !== "draft" || !newest.warnings.length) return null;
    const stays = current ? `Revision ${current.revision} stays in force until then.` : "None is in force until then.";
    return h(
      "div",
      { class: "verdict poor", role: "status", "data-testid": "draft-warnings" },
      h("p", { class: "headline" }, `Revision ${newest.revision} is a draft and needs a manual release. ${stays}`),
      paragraphs(newest.warnings),
      h("p", {}, runLink(newest.run_id, "From run ")),
      may("releaser") && h("p", { class: "buttons" }, this.#release(newest, current)),
    );
  }

  #document(document, { stale, verdict }, otherPrograms) {
    const file = `${this.path}/calibration?revision=${document.revision}`;
    const certificate = certificateButtons(this.path, document);
    return [
      stale.length > 0 &&
        h(
          "div",
          { class: "verdict unknown", role: "status", "data-testid": "stale" },
          h("p", { class: "headline" }, "Outdated basis: it has changed since this calibration was issued."),
          paragraphs(stale),
          may("operator") && this.#redraft(document.run_id),
        ),
      figureList(figures(document, verdict)),
      h("p", { class: "muted sha" }, "SHA-256 ", h("code", { id: "sha256" }, document.sha256)),
      h(
        "p",
        { class: "downloads" },
        h("a", { href: file, download: "calibration.json", id: "calibration-json" }, "Calibration (JSON)"),
        h("a", { href: `${file}&format=dcc`, download: "", id: "certificate-dcc" }, "Preview certificate (DCC)"),
        certificate.buttons,
      ),
      certificate.error,
      otherPrograms,
    ];
  }

  #table(revisions) {
    const current = revisions.find(({ status }) => status === "in_force");
    const rows = revisions.map((one) =>
      tableRow(
        one.revision,
        [
          statusPill(one.status.replace("_", " "), { "data-status": one.status }),
          [moment(one.issued_at), one.issued_by && ` by ${one.issued_by}`],
          runLink(one.run_id),
          h("td", { class: "result" }, rowFigures(one)),
          h(
            "td",
            { class: "wrap" },
            paragraphs([one.reason, ...one.warnings, ...one.acts.map(actInWords), ...one.stale].filter(Boolean)),
          ),
          h("td", {}, h("div", { class: "buttons" }, this.#actions(one, current))),
        ],
        { class: one.status === "withdrawn" && "voided", "data-revision": one.revision },
      ),
    );
    const names = ["Revision", "Status", "Issued", "From run", "Result", "Reasons and warnings", ""];
    return dataTable("Revisions of this unit's calibration", names, rows, { id: "revisions-table", class: "dense" });
  }

  #actions(one, current) {
    if (!may("releaser")) return [];
    const withdrawn = "It is kept, struck through, and cannot be released again.";
    return [
      (one.status === "draft" || one.status === "superseded") && this.#release(one, current),
      one.status !== "withdrawn" && this.#action("Withdraw", one.revision, withdrawn),
    ];
  }

  #release({ revision, warnings }, current) {
    const superseded = current ? `revision ${current.revision}` : "nothing: no revision is in force";
    const text = [`It comes into force and supersedes ${superseded}.`, ...warnings].join(" ");
    return this.#action("Release", revision, text);
  }

  #action(verb, revision, text) {
    const question = { title: `${verb} revision ${revision}?`, text, action: verb };
    const act = (reason) => post(`${this.path}/calibrations/${revision}/${verb.toLowerCase()}`, { reason });
    return button(`${verb}…`, () => askReason(question, act));
  }

  #redraft(runId) {
    const question = {
      title: `New draft from run ${runName(runId)}?`,
      text: "Computed from the poses and effects currently included, with a new number and hash.",
      action: "Make the draft",
    };
    const make = (reason) => post(`${this.path}/calibrations`, { run_id: runId, reason });
    return button("New draft…", () => askReason(question, make));
  }
}

function none(revisions) {
  const draft = revisions.find(({ status }) => status === "draft");
  const words = draft
    ? `None: revision ${draft.revision} is a draft and has not been released.`
    : "None: no valid completed run determines the scale, or all revisions were withdrawn.";
  return h("p", { class: "muted" }, words);
}

/** What a revision says of the unit, and how far that is from the revision in force. */
function rowFigures({ verdict, change, ...one }) {
  const difference = (value, unit) => (isKnown(value) ? significant(value, 2, unit) : "not known");
  const rows = [
    isKnown(one.bias_std_deg) && ["Bias", plusMinus(one.bias_deg, one.bias_std_deg, "°")],
    isKnown(one.scale_std) && ["Scale", plusMinus(one.scale, one.scale_std)],
    one.effects.length && ["Effects", correctionTitles(one.effects).join(", ")],
    ["U", isKnown(one.expanded_uncertainty_deg) ? significant(one.expanded_uncertainty_deg, 2, "°") : "not known"],
    ["Verdict", (verdict.answer ?? "none").replaceAll("_", " ")],
    change && [
      `Less revision ${change.revision}`,
      `bias ${difference(change.bias_deg, "°")}, scale ${difference(change.scale)}`,
    ],
  ];
  return rows.filter(Boolean).map(([name, value]) => h("div", {}, `${name}: `, value));
}

function actInWords({ what, at, by, reason, supersedes }) {
  const who = by ? ` by ${by}` : "";
  const why = reason ? `: ${reason}` : "";
  const instead = what === "withdrawn" ? "" : ` It superseded ${supersedes ? `revision ${supersedes}` : "nothing"}.`;
  const said = `${who}${why}.${instead}`.replace("..", ".");
  return [what === "withdrawn" ? "Withdrawn " : "Released ", moment(at), said];
}

const LEVEL_UNKNOWN = "as clamped: the level is not known";

/** Whether a document is of a joint solution, which has all errors of the unit in its effects. */
function isSolved(document) {
  return "elevation_std_deg" in document;
}

function figures(document, verdict) {
  const [bias, scale] = document.covariance?.map((row, k) => Math.sqrt(row[k])) ?? [];
  const effects = document.effects.map(({ name, formula }) => h("div", { title: formula }, correctionTitles([name])));
  const expanded = document.expanded_uncertainty_deg;
  return [
    ["Revision", document.revision],
    ...(isSolved(document)
      ? [["Bias", document.level_known ? plusMinus(document.bias_deg, document.level_std_deg, "°") : LEVEL_UNKNOWN]]
      : [
          ["Bias", plusMinus(document.bias_deg, bias, "°")],
          ["Scale", plusMinus(document.scale, scale)],
        ]),
    ["Effects applied", effects.length ? effects : "none"],
    isKnown(document.rms_with_effects_deg) && ["RMS error, with effects", significant(document.rms_with_effects_deg, 3, "°")],
    isKnown(document.rms_calibrated_deg) && [
      isKnown(document.rms_with_effects_deg) ? "RMS error, plain fit" : "RMS error, calibrated",
      significant(document.rms_calibrated_deg, 3, "°"),
    ],
    [
      "Expanded uncertainty",
      expanded === null
        ? ["not known", h("small", { class: "words" }, "the rig has no reference")]
        : `${significant(expanded, 2, "°")} (k = ${significant(document.coverage_factor, 3)})`,
    ],
    ["Elevations", range(...document.range_deg, 0, "°")],
    ["Temperature", range(document.temperature_c?.min, document.temperature_c?.max, 1, "°C")],
    ["Issued", moment(document.issued_at)],
    ["From run", runLink(document.run_id)],
    ["Verdict", h("span", { class: "words" }, verdict.says[0] ?? "no verdict")],
  ];
}

/** Buttons for `file`, the address of a revision, and a line for a refusal. */
async function formats(file) {
  const refusal = h("p", { class: "muted", role: "status", id: "format-refused" });
  const fetched = async ({ name, file_name: fileName }) => {
    fill(refusal);
    try {
      saveFile(new Blob([await getText(`${file}&format=${name}`)], { type: "text/plain" }), fileName);
    } catch (error) {
      fill(refusal, error.message);
    }
  };
  const button = (format) =>
    h("button", { type: "button", "data-format": format.name, on: { click: () => fetched(format) } }, format.title);
  const buttons = (await getOnce("/api/calibration-formats")).map(button);
  return [h("div", { class: "buttons formats" }, h("span", { class: "muted" }, "For other programs: "), buttons), refusal];
}
