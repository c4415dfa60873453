// Who answers on which port, and what to write into calrig.toml for it.

import { post } from "./api.js";
import { errorLine, fill, h, headings, held, tableBox } from "./dom.js";

export function portsLook() {
  const error = errorLine("ports-error");
  const shown = h("div", { "data-testid": "ports", "aria-live": "polite" });
  const look = h("button", { type: "button", id: "look-at-ports" }, "Scan serial ports");
  look.addEventListener("click", async () => {
    const release = held(look);
    error.say(null);
    fill(shown, h("p", { class: "muted" }, "Scanning every port, about seven seconds…"));
    try {
      show(shown, await post("/api/rigs/scan"));
    } catch (problem) {
      fill(shown);
      error.say(problem);
    } finally {
      release();
    }
  });
  return h(
    "div",
    {},
    h("div", { class: "buttons" }, look),
    h("p", { class: "muted" }, "Nothing moves; the scan resets boards that are not in a run."),
    error.element,
    shown,
  );
}

function show(place, { found, stanza }) {
  if (found.length === 0) {
    fill(place, h("p", { class: "muted" }, "There is no serial port: is the USB cable plugged in?"));
    return;
  }
  const table = h(
    "table",
    {},
    headings("Port", "Device", "Identity", "USB adapter"),
    h("tbody", {}, found.map(row)),
  );
  fill(
    place,
    tableBox("Ports", table),
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
