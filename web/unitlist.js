// The list of units, with filters.

import { get } from "./api.js";
import { certificateSearch } from "./certificate.js";
import { card, dataTable, errorLine, fill, h, NO_UNITS, numberCell, tableRow, unitLink } from "./dom.js";
import { choice, filterForm, searchField } from "./filters.js";
import { day, plural } from "./format.js";
import { VERDICTS, verdictWords } from "./runfilters.js";

const CHOICES = {
  verdict: [...VERDICTS, ["none", "none in force"]],
  due: [
    ["overdue", "overdue"],
    ["soon", "within 30 days"],
    ["later", "later"],
    ["none", "no date"],
  ],
  change: [
    ["changed", "changed"],
    ["unchanged", "unchanged"],
    ["not_known", "not known"],
  ],
};
const HEADINGS = ["Unit", "Verdict", "In force since", "Due", "Last change", "#Runs", "Last run"];

export async function unitsView({ root, query, signal }) {
  const all = await get("/api/units", signal);
  if (!all.length) {
    fill(root, h("h1", {}, "Units"), h("p", { class: "card muted" }, NO_UNITS));
    return;
  }
  const field = (key) => choice(`units-${key}`, CHOICES[key], query.get(key));
  const inputs = {
    q: ["Part of a serial number", searchField("units-text", query.get("q"))],
    verdict: ["Verdict", field("verdict")],
    due: ["Due", field("due")],
    change: ["Change", field("change")],
  };
  const filters = filterForm("Filter units", inputs, () => load(), signal);
  const body = h("tbody");
  const state = h("p", { id: "units-told", class: "muted", role: "status" });
  const csv = h("a", { id: "units-csv", download: "units.csv" }, "These units (CSV)");
  const error = errorLine("units-error");
  let asked = 0;

  async function load() {
    const mine = ++asked;
    const wanted = new URLSearchParams(filters.values());
    csv.href = `/api/units?${new URLSearchParams([...wanted, ["format", "csv"]])}`;
    try {
      const units = wanted.size ? await get(`/api/units?${wanted}`, signal) : all;
      if (mine !== asked) return; // superseded by a later request
      fill(body, units.map(row));
      fill(state, wanted.size > 0 && (units.length ? `${units.length} of ${plural(all.length, "unit")}` : "No unit matches."));
      error.say(null);
    } catch (problem) {
      if (!signal.aborted && mine === asked) error.say(problem);
    }
  }

  fill(
    root,
    h("h1", {}, "Units"),
    h(
      "section",
      { class: "card" },
      h("p", { id: "units-today" }, h("strong", {}, "Today: "), yieldOf(all)),
      filters.element,
      error.element,
      dataTable("Units", HEADINGS, body, { id: "units-table" }),
      state,
      h("p", { class: "downloads" }, csv, all.length > 1 && h("a", { href: "#/compare" }, "Compare units")),
    ),
    card("find-certificate", "Find a certificate", certificateSearch(signal)),
  );
  await load();
}

/** How many of the units calibrated today passed, by the latest calibration of each. */
function yieldOf(units) {
  const now = new Date();
  const since = new Date(now.getFullYear(), now.getMonth(), now.getDate());
  const today = units.filter(({ last_calibrated_at: at }) => at && new Date(at) >= since);
  if (!today.length) return "no unit calibrated yet.";
  const limited = today.filter(({ last_verdict: answer }) => answer && answer !== "no_limits");
  const without = today.length - limited.length;
  if (!limited.length) return `${plural(without, "unit")} calibrated, without limits.`;
  const counts = VERDICTS.map(([answer, words]) => [limited.filter((unit) => unit.last_verdict === answer).length, words]);
  const passed = counts[0][0];
  const others = counts.slice(1).flatMap(([count, words]) => (count ? [`${count} ${words}`] : []));
  if (without) others.push(`${without} more without limits`);
  return `${passed} of ${plural(limited.length, "unit")} passed${others.length ? `; ${others.join(", ")}` : ""}.`;
}

function row(unit) {
  return tableRow(unitLink(unit.serial), [
    verdictCell(unit),
    unit.revision_in_force === null
      ? "–"
      : [day(unit.in_force_since), h("small", { class: "under" }, `revision ${unit.revision_in_force}`)],
    [day(unit.due_at), unit.overdue && h("span", { class: "tag warns" }, "overdue")],
    changeCell(unit),
    numberCell(unit.n_runs.toLocaleString()),
    day(unit.last_run_at),
  ]);
}

/** The verdict of the revision in force; if the latest calibration has another one, that one below. */
function verdictCell({ verdict, left, last_verdict: lastAnswer, last_left: lastLeft }) {
  const answer = verdict === null ? null : h("span", { class: `answer ${verdict}` }, verdictWords({ answer: verdict, left }));
  const last = lastAnswer !== null && lastAnswer !== verdict && verdictWords({ answer: lastAnswer, left: lastLeft });
  return [answer ?? h("span", { class: "muted" }, "none in force"), last && h("small", { class: `under ${lastAnswer}` }, `latest run: ${last}`)];
}

function changeCell({ change, changed_at: at }) {
  if (change === "changed") return [day(at), h("span", { class: "tag warns" }, "changed")];
  if (change === null) return h("span", { class: "muted", title: "Evaluated from two valid calibrations on." }, "–");
  return change.replace("_", " ");
}
