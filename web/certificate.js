// A unit's certificate, and how the unit was handed in, which the certificate states.

import { get, getBlob, put } from "./api.js";
import { askConfirmation } from "./ask.js";
import { errorLine, field, h, held } from "./dom.js";
import { may } from "./me.js";

const FIELDS = [
  ["customer", "Customer", {}],
  ["address", "Customer's address", {}],
  ["order", "Order number", {}],
  ["received_at", "Date of receipt", { type: "date" }],
  ["condition", "Condition at receipt", {}],
  ["description", "Description", {}],
  ["interval_agreed_months", "Months until the next calibration, where agreed", { type: "number", min: 1, max: 600 }],
];

/** Buttons for the certificate of a revision: to make it, and to say what it states of the unit. */
export function certificateButtons(path, { unit, revision }) {
  const error = errorLine("certificate-error");
  const make = h("button", { type: "button", id: "certificate-pdf" }, "Certificate (PDF)");
  make.addEventListener("click", async () => {
    const release = held(make);
    error.say(null);
    try {
      const file = await getBlob(`${path}/calibration?revision=${revision}&format=pdf`);
      hand(file, `certificate-${unit}-revision-${revision}.pdf`);
    } catch (problem) {
      error.say(problem);
    } finally {
      release();
    }
  });
  const say = h("button", { type: "button", id: "item", on: { click: () => askItem(path, error) } }, "Item as received…");
  return { buttons: [make, may("operator") && say], error: error.element };
}

function hand(blob, name) {
  const address = URL.createObjectURL(blob);
  h("a", { href: address, download: name }).click();
  URL.revokeObjectURL(address);
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
    const by = h("div", { class: "choice" }, h("label", {}, tick, h("span", {}, "by the customer", of)));
    return h("div", { class: "fields two" }, field(input.id, label, input), by);
  });
  const question = {
    title: "Item as received",
    text: "What its certificates state of it; what is left empty is not stated.",
    action: "Save",
    before: rows,
  };
  return askConfirmation(question, () => put(`${path}/item`, said(inputs, supplied)));
}

function said(inputs, supplied) {
  const document = { supplied: [] };
  for (const [name, input] of inputs) {
    const value = input.value.trim();
    document[name] = value === "" ? null : input.type === "number" ? Number(value) : value;
    if (value !== "" && supplied.get(name).checked) document.supplied.push(name);
  }
  return document;
}
