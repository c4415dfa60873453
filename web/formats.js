// A unit's calibration for other programs: a file made on request, or why it cannot be made.

import { getOnce, getText } from "./api.js";
import { fill, h, saveFile } from "./dom.js";

/** Buttons for `file`, the address of a revision, and a line for a refusal. */
export async function formats(file) {
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
