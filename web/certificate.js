// A unit's certificates: a preview, those that were issued, and what they state of customer and receipt.

import { get, getBlob, post, put } from "./api.js";
import { askConfirmation, askReason } from "./ask.js";
import { attempt, button, dataTable, errorLine, field, fill, h, saveFile, tableRow, unitLink } from "./dom.js";
import { moment } from "./format.js";
import { may } from "./me.js";

const FIELDS = [
  ["customer", "Customer", {}],
  ["address", "Customer's address", {}],
  ["order", "Order number", {}],
  ["received_at", "Date of receipt", { type: "date" }],
  ["condition", "Condition at receipt", {}],
  ["description", "Description", {}],
  ["interval_agreed_months", "Agreed interval, months", { type: "number", min: 1, max: 600 }],
];

/** Buttons for the certificate of a revision: to preview it, to issue it, and to edit the item as received. */
export function certificateButtons(path, { unit, revision }) {
  const error = errorLine("certificate-error");
  const make = h("button", { type: "button", id: "certificate-pdf" }, "Preview certificate (PDF)");
  make.addEventListener("click", () =>
    attempt([make], error, async () => {
      const file = await getBlob(`${path}/calibration?revision=${revision}&format=pdf`);
      saveFile(file, `preview-${unit}-revision-${revision}.pdf`);
    }),
  );
  const say = h("button", { type: "button", id: "item", on: { click: () => askItem(path, error) } }, "Customer and receipt…");
  const question = {
    title: `Issue the certificate of revision ${revision}?`,
    text: "It gets a number and is kept unchanged. A correction is a new certificate.",
    action: "Issue",
  };
  const issue = button("Issue certificate…", () =>
    askConfirmation(question, () => post(`${path}/certificates`, { revision })),
  );
  return { buttons: [make, may("releaser") && issue, may("operator") && say], error: error.element };
}

/** The issued certificates of a unit, newest first, for the revision in force with a button that corrects one. */
export function issuedTable(path, issued, current) {
  const rows = issued.map((one) => {
    const file = `/api/certificates/${one.number}?format=`;
    const link = (form) =>
      one.sha256[form] && [h("a", { href: file + form, download: "" }, form.toUpperCase()), " "];
    const said = [
      one.replaces && `Replaces ${one.replaces}: ${one.reason}`,
      one.replaced_by && `Replaced by ${one.replaced_by}`,
    ].filter(Boolean);
    return tableRow(
      one.number,
      [
        [moment(one.issued_at), one.issued_by && ` by ${one.issued_by}`],
        one.revision,
        h("td", { class: "wrap" }, said.join(". ") || "–"),
        h("td", {}, ["pdf", "dcc", "json"].map(link)),
        h("td", { class: "buttons" }, may("releaser") && current && !one.replaced_by && correct(path, one, current)),
      ],
      { class: one.replaced_by && "voided", "data-certificate": one.number },
    );
  });
  const names = ["Certificate", "Issued", "Revision", "Corrections", "Files", ""];
  return dataTable("Issued certificates of this unit", names, rows, { id: "certificates-table" });
}

/** A field that finds issued certificates of all units by a part of their number. */
export function certificateSearch(signal) {
  const input = h("input", { id: "certificate-number", type: "search", autocomplete: "off", required: true, maxlength: 100 });
  const error = errorLine("certificate-search-error");
  const results = h("div", { role: "status" });
  const find = async () => {
    const found = await get(`/api/certificates?number=${encodeURIComponent(input.value.trim())}`, signal);
    const rows = found.map((one) =>
      tableRow(h("a", { href: `/api/certificates/${one.number}?format=${one.sha256.pdf ? "pdf" : "dcc"}` }, one.number), [
        unitLink(one.unit),
        one.revision,
        moment(one.issued_at),
        one.replaced_by ? `Replaced by ${one.replaced_by}` : "–",
      ]),
    );
    const names = ["Certificate", "Unit", "Revision", "Issued", "Corrections"];
    const options = { id: "certificates-found" };
    fill(
      results,
      found.length ? dataTable("Issued certificates", names, rows, options) : h("p", { class: "muted" }, "No certificate has this number."),
    );
  };
  const search = h("button", { type: "submit" }, "Find certificate");
  const form = h("form", { role: "search" }, field("certificate-number", "Certificate number", input), search);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (input.value.trim()) attempt([search], error, find);
  });
  return [form, error.element, results];
}

function correct(path, { number }, { revision }) {
  const question = {
    title: `Replace certificate ${number}?`,
    text: `A new certificate of revision ${revision} is issued, which names this one and the reason.`,
    action: "Issue",
  };
  const act = (reason) => post(`${path}/certificates`, { revision, replaces: number, reason });
  return button("Correct…", () => askReason(question, act));
}

async function askItem(path, error) {
  let known;
  try {
    known = await get(`${path}/item`);
  } catch (problem) {
    return error.say(problem);
  }
  const inputs = new Map();
  const supplied = new Map();
  const rows = FIELDS.map(([name, label, look]) => {
    const input = h("input", { id: `item-${name}`, name, maxlength: 500, value: known[name], ...look });
    const tick = h("input", { type: "checkbox", name: "supplied", checked: known.supplied.includes(name) });
    inputs.set(name, input);
    supplied.set(name, tick);
    const of = h("span", { class: "for-screen-readers" }, `: ${label}`);
    const by = h("div", { class: "choice" }, h("label", {}, tick, h("span", {}, "stated by the customer", of)));
    return h("div", { class: "fields two" }, field(input.id, label, input), by);
  });
  const question = {
    title: "Customer and receipt",
    text: "Stated on the unit's certificates. Empty fields are omitted.",
    action: "Save",
    before: rows,
  };
  return askConfirmation(question, () => put(`${path}/item`, documentOf(inputs, supplied)));
}

function documentOf(inputs, supplied) {
  const document = { supplied: [] };
  for (const [name, input] of inputs) {
    const value = input.value.trim();
    document[name] = value === "" ? null : input.type === "number" ? Number(value) : value;
    if (value !== "" && supplied.get(name).checked) document.supplied.push(name);
  }
  return document;
}
