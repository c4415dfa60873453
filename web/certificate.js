// A unit's certificate, and the item as received, which the certificate states.

import { get, getBlob, put } from "./api.js";
import { askConfirmation } from "./ask.js";
import { attempt, errorLine, field, h, saveFile } from "./dom.js";
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

/** Buttons for the certificate of a revision: to save it, and to edit the item as received. */
export function certificateButtons(path, { unit, revision }) {
  const error = errorLine("certificate-error");
  const make = h("button", { type: "button", id: "certificate-pdf" }, "Certificate (PDF)");
  make.addEventListener("click", () =>
    attempt([make], error, async () => {
      const file = await getBlob(`${path}/calibration?revision=${revision}&format=pdf`);
      saveFile(file, `certificate-${unit}-revision-${revision}.pdf`);
    }),
  );
  const say = h("button", { type: "button", id: "item", on: { click: () => askItem(path, error) } }, "Item as received…");
  return { buttons: [make, may("operator") && say], error: error.element };
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
