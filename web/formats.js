// A unit's calibration for other programs: a file made when it is asked for, or why it cannot be made.

import { getText } from "./api.js";
import { fill, h } from "./dom.js";

const FORMATS = [
  ["px4", "PX4", "params"],
  ["ardupilot", "ArduPilot", "param"],
  ["imu-tk", "imu_tk", "txt"],
  ["imucal", "imucal", "json"],
  ["kalibr", "Kalibr (noise)", "yaml"],
  ["vins", "VINS (noise)", "yaml"],
];

/** Buttons beside `file`, the address of a revision, and a line for what is refused. */
export function formats(file) {
  const said = h("p", { class: "muted", role: "status", id: "format-refused" });
  const fetched = async (name, ending) => {
    fill(said);
    try {
      save(await getText(`${file}&format=${name}`), `${name}.${ending}`);
    } catch (error) {
      fill(said, error.message);
    }
  };
  const button = ([name, title, ending]) =>
    h("button", { type: "button", "data-format": name, on: { click: () => fetched(name, ending) } }, title);
  return [
    h("div", { class: "buttons formats" }, h("span", { class: "muted" }, "For other programs: "), FORMATS.map(button)),
    said,
  ];
}

function save(text, name) {
  const address = URL.createObjectURL(new Blob([text], { type: "text/plain" }));
  h("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}
