// The audit log: who did what, when and why; of all units, or of one.

import { get } from "./api.js";
import { dataTable, errorLine, field, fill, h, runLink, select, tableRow, unitLink } from "./dom.js";
import { moment } from "./format.js";

const PAGE = 50;
const WORDS = {
  started: "started a run",
  imported: "imported a run",
  excluded: "excluded a pose",
  included: "included a pose again",
  voided: "voided a run",
  unvoided: "reinstated a run",
  noted: "added a note",
  moved: "moved a run to another unit",
  accepted: "accepted effects",
  taken_back: "revoked accepted effects",
  paused: "paused a run",
  resumed: "resumed a run",
  aborted: "aborted a run",
  mended: "completed a half-done change",
  certificate_issued: "issued a certificate",
  backed_up: "made a backup",
  drafted: "drafted a calibration",
  released: "released a calibration",
  withdrawn: "withdrew a calibration",
  limits_changed: "changed limits",
  check_unit_changed: "changed a check unit",
  item_changed: "changed an item as received",
  map_put_in_force: "put a stage map in force",
  map_withdrawn: "withdrew a stage map",
  user_added: "added a user",
  user_changed: "changed a user",
  unit_removed: "removed an empty unit",
  bench_added: "added a bench",
  bench_enrolled: "enrolled as a bench",
  bench_revoked: "revoked a bench",
  stop_withdrawn: "withdrew a stop",
};

export async function trailView({ root, query, signal }) {
  const unit = h("input", {
    id: "trail-unit",
    type: "search",
    autocomplete: "off",
    placeholder: "any",
    value: query.get("unit"),
  });
  const what = select({ id: "trail-what" }, [["", "anything"], ...Object.entries(WORDS)]);
  const body = h("tbody");
  const state = h("p", { id: "trail-state", role: "status" });
  const more = h("button", { type: "button", hidden: true, on: { click: () => load(last) } }, "Show older entries");
  const none = h("p", { id: "trail-none", class: "muted" });
  const error = errorLine("trail-error");
  let last = null;
  let asked = 0;

  async function load(after) {
    const mine = ++asked;
    const wanted = { unit: unit.value.trim(), what: what.value, after };
    const search = new URLSearchParams({ newest_first: true, limit: PAGE });
    for (const [name, value] of Object.entries(wanted)) if (value) search.set(name, value);
    try {
      const { entries, intact, broken_at: brokenAt } = await get(`/api/trail?${search}`, signal);
      if (mine !== asked) return; // superseded by a later request
      if (after) body.append(...entries.map(row));
      else fill(body, entries.map(row));
      fill(none, !body.childElementCount && (wanted.unit || wanted.what ? "No entry matches." : NONE));
      last = entries.at(-1)?.seq;
      more.hidden = entries.length < PAGE;
      fill(state, intact ? INTACT : `Hash chain broken at entry ${brokenAt}: it was changed, or an earlier entry is missing.`);
      state.className = intact ? "muted" : "error";
      error.say(null);
    } catch (problem) {
      if (!signal.aborted) error.say(problem);
    }
  }

  for (const input of [unit, what]) input.addEventListener("input", () => load(null));
  fill(
    root,
    h("h1", {}, "Audit log"),
    h(
      "section",
      { class: "card" },
      h("div", { class: "filters" }, field("trail-unit", "Serial number", unit), field("trail-what", "What", what)),
      error.element,
      state,
      dataTable("Audit log", ["When", "Who", "What", "Unit", "Run", "Why"], body, { id: "trail-table" }),
      none,
      more,
    ),
  );
  await load(null);
}

const NONE = "No entries yet. Each run, import, release and correction adds one.";
const INTACT = "Hash chain intact: no entry was changed or removed.";

function row({ seq, at, who, what, unit, rig, run_id: run, revision, reason, detail }) {
  const action = `${WORDS[what]}${details(what, detail)}${revision ? `, revision ${revision}` : ""}`;
  const about = [unit ? unitLink(unit) : (rig ?? "–"), run ? runLink(run) : "–"];
  return tableRow(moment(at), [who ?? "–", action, ...about, h("td", { class: "wrap" }, reason ?? detail.note ?? "–")], { "data-entry": seq });
}

function details(what, { pose, effects, from, to, name, role }) {
  if (pose !== undefined) return `: ${pose}`;
  if (effects) return `: ${effects.join(", ")}`;
  if (what === "moved") return `: from ${from} to ${to}`;
  if (name) return `: ${[name, role].filter(Boolean).join(", ")}`;
  return "";
}
