// A unit's calibration for other programs: a file made when it is asked for, or why it cannot be made.

import { get, getText } from "./api.js";
import { fill, h } from "./dom.js";

let reading;

/** The formats that the service knows: `GET /api/calibration-formats`, read once. */
async function knownFormats() {
  reading ??= get("/api/calibration-formats");
  try {
    return await reading;
  } catch (error) {
    reading = undefined; // to be asked for again
    throw error;
  }
}

/** Buttons beside `file`, the address of a revision, and a line for what is refused. */
export async function formats(file) {
  const said = h("p", { class: "muted", role: "status", id: "format-refused" });
  const fetched = async ({ name, file_name: fileName }) => {
    fill(said);
    try {
      save(await getText(`${file}&format=${name}`), fileName);
    } catch (error) {
      fill(said, error.message);
    }
  };
  const button = (format) =>
    h(
      "button",
      { type: "button", "data-format": format.name, on: { click: () => fetched(format) } },
      format.title,
    );
  const buttons = (await knownFormats()).map(button);
  return [h("div", { class: "buttons formats" }, h("span", { class: "muted" }, "For other programs: "), buttons), said];
}

function save(text, name) {
  const address = URL.createObjectURL(new Blob([text], { type: "text/plain" }));
  h("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}
