// Runs, newest first, by unit, rig and status.

import { get } from "./api.js";
import { errorLine, fill, h, headings, runLink, statusPill, suspectTag, tableBox, unitLink } from "./dom.js";
import { moment, plusMinus, significant } from "./format.js";

const STATUSES = ["queued", "running", "paused", "completed", "failed", "aborted", "interrupted"];
const PAGE = 20;

/** One run as a table row; a voided one is struck through and says why. */
export function runRow(run, { withUnit = true } = {}) {
  const result = run.result ?? {};
  return h(
    "tr",
    { class: run.voided && "voided", "data-run": run.id },
    h("th", { scope: "row" }, runLink(run.id)),
    withUnit && h("td", {}, unitLink(run.unit)),
    h("td", {}, run.rig ?? "–"),
    h(
      "td",
      { class: "plain" },
      statusPill(run.status),
      run.voided && h("span", { class: "tag", title: run.voided.reason }, "voided"),
      suspectTag(run.suspect),
    ),
    h("td", {}, moment(run.finished_at ?? run.started_at ?? run.created_at)),
    h("td", { class: "number" }, run.result ? plusMinus(result.bias_deg, result.bias_std_deg, "°") : "–"),
    h("td", { class: "number" }, run.result ? plusMinus(result.scale, result.scale_std) : "–"),
    h("td", { class: "number" }, run.result ? significant(result.rms_raw_deg, 3, "°") : "–"),
    h("td", { class: "number" }, run.result ? significant(result.rms_calibrated_deg, 3, "°") : "–"),
  );
}

export function runHeadings({ withUnit = true } = {}) {
  const names = [
    "Run",
    withUnit && "Unit",
    "Rig",
    "Status",
    "When",
    "#Bias",
    "#Scale",
    "#RMS error, raw",
    "#RMS error, calibrated",
  ];
  return headings(...names.filter(Boolean));
}

/** The list with its filters; `refresh()` fetches the first page again. */
export function runList(rigs, signal) {
  const serials = h("datalist", { id: "known-units" });
  const unit = h("input", {
    id: "filter-unit",
    type: "search",
    list: serials.id,
    autocomplete: "off",
    placeholder: "any",
  });
  const rig = h(
    "select",
    { id: "filter-rig" },
    h("option", { value: "" }, "any"),
    rigs.map(({ name }) => h("option", {}, name)),
  );
  const status = h(
    "select",
    { id: "filter-status" },
    h("option", { value: "" }, "any"),
    STATUSES.map((name) => h("option", {}, name)),
  );
  const body = h("tbody");
  const empty = h("p", { class: "muted", hidden: true }, "No runs yet.");
  const more = h("button", { type: "button", hidden: true }, "Show older runs");
  const error = errorLine("runs-error");
  let cursor = null;
  let asked = 0;

  async function load(from) {
    const mine = ++asked;
    const query = new URLSearchParams({ limit: PAGE });
    const wanted = { unit: unit.value.trim(), rig: rig.value, status: status.value, cursor: from };
    for (const [name, value] of Object.entries(wanted)) if (value) query.set(name, value);
    try {
      const page = await get(`/api/runs?${query}`, signal);
      if (mine !== asked) return; // a later question has been asked meanwhile
      const rows = page.items.map((run) => runRow(run));
      if (from) body.append(...rows);
      else fill(body, rows);
      cursor = page.next_cursor;
      more.hidden = !cursor;
      empty.hidden = body.childElementCount > 0;
      empty.textContent = wanted.unit || wanted.rig || wanted.status ? "No run matches." : "No runs yet.";
      error.say(null);
    } catch (problem) {
      if (!signal.aborted) error.say(problem);
    }
  }

  const refresh = () => load(null);
  unit.addEventListener("focus", async () => {
    try {
      const units = await get("/api/units", signal);
      fill(serials, ...units.map(({ serial }) => h("option", { value: serial })));
    } catch (problem) {
      if (!signal.aborted) error.say(problem);
    }
  });
  for (const input of [unit, rig, status]) input.addEventListener("input", refresh);
  more.addEventListener("click", () => load(cursor));
  const filter = (id, label, input) => h("div", { class: "field" }, h("label", { for: id }, label), input);
  const element = h(
    "section",
    { class: "card", "aria-labelledby": "runs-title" },
    h("h2", { id: "runs-title" }, "Runs"),
    h(
      "div",
      { class: "filters" },
      filter("filter-unit", "Unit (whole serial number)", [unit, serials]),
      filter("filter-rig", "Rig", rig),
      filter("filter-status", "Status", status),
    ),
    error.element,
    tableBox("Runs", h("table", { id: "runs-table" }, runHeadings(), body)),
    empty,
    more,
  );
  return { element, refresh };
}
