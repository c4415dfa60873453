// Scans the serial ports: devices found, and their lines for calrig.toml.

import { post } from "./api.js";
import { attempt, dataTable, errorLine, fill, h, tableBox } from "./dom.js";

export function portsLook() {
  const error = errorLine("ports-error");
  const shown = h("div", { "data-testid": "ports", "aria-live": "polite" });
  const look = h("button", { type: "button", id: "look-at-ports" }, "Scan serial ports");
  look.addEventListener("click", () => {
    fill(shown, h("p", { class: "muted" }, "Scanning every port, about seven seconds…"));
    const scan = async () => show(shown, await post("/api/rigs/scan"));
    return attempt([look], error, scan, () => fill(shown));
  });
  return h(
    "div",
    {},
    h("div", { class: "buttons" }, look),
    h("p", { class: "muted" }, "Nothing moves. The scan resets boards that are not in a run."),
    error.element,
    shown,
  );
}

function show(place, { found, stanza }) {
  if (!found.length) return fill(place, h("p", { class: "muted" }, "No serial port found. Check the USB cable."));
  fill(
    place,
    dataTable("Ports", ["Port", "Device", "Identity", "USB adapter"], found.map(row)),
    stanza && h("p", { class: "muted" }, "For calrig.toml:"),
    stanza && tableBox("For calrig.toml", h("pre", { "data-testid": "stanza" }, stanza)),
  );
}

function row({ port, kind, driver, identity, usb_id, usb_serial }) {
  return h(
    "tr",
    {},
    h("td", {}, port),
    h("td", {}, kind),
    h("td", {}, driver ? `${driver}: ${identity}` : identity),
    h("td", {}, [usb_id, usb_serial].filter(Boolean).join(", ")),
  );
}
