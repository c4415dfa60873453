// The trail: who did what, when and why; of all units, or of one.

import { get } from "./api.js";
import { errorLine, field, fill, h, headings, runLink, tableBox, unitLink } from "./dom.js";
import { moment } from "./format.js";

const PAGE = 50;
const WORDS = {
  started: "started a run",
  imported: "imported a run",
  excluded: "excluded a pose",
  included: "included a pose again",
  voided: "voided a run",
  unvoided: "had a run count again",
  noted: "noted",
  moved: "moved a run to another unit",
  accepted: "accepted effects",
  taken_back: "took accepted effects back",
  drafted: "drafted a calibration",
  released: "released a calibration",
  withdrawn: "withdrew a calibration",
  limits_changed: "changed limits",
  check_unit_changed: "changed a check unit",
  item_changed: "said how a unit came",
  map_put_in_force: "put a stage's map in force",
  map_withdrawn: "withdrew a stage's map",
  user_added: "added a user",
  user_changed: "changed a user",
  unit_removed: "removed an empty unit",
  bench_added: "let a bench join",
  bench_enrolled: "joined as a bench",
  bench_revoked: "let a bench in no more",
};

export async function trailView({ root, query, signal }) {
  const unit = h("input", {
    id: "trail-unit",
    type: "search",
    autocomplete: "off",
    placeholder: "any",
    value: query.get("unit"),
  });
  const what = h(
    "select",
    { id: "trail-what" },
    h("option", { value: "" }, "anything"),
    Object.entries(WORDS).map(([value, text]) => h("option", { value }, text)),
  );
  const body = h("tbody");
  const state = h("p", { id: "trail-state", role: "status" });
  const more = h("button", { type: "button", hidden: true, on: { click: () => load(last) } }, "Show older entries");
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
      if (mine !== asked) return; // a later question has been asked meanwhile
      if (after) body.append(...entries.map(row));
      else fill(body, entries.map(row));
      last = entries.at(-1)?.seq;
      more.hidden = entries.length < PAGE;
      fill(state, intact ? INTACT : `Entry ${brokenAt} is not what was written there, or one before it is missing.`);
      state.className = intact ? "muted" : "error";
      error.say(null);
    } catch (problem) {
      if (!signal.aborted) error.say(problem);
    }
  }

  for (const input of [unit, what]) input.addEventListener("input", () => load(null));
  fill(
    root,
    h("h1", {}, "Audit trail"),
    h(
      "section",
      { class: "card" },
      h(
        "div",
        { class: "filters" },
        field("trail-unit", "Unit (whole serial number)", unit),
        field("trail-what", "What", what),
      ),
      error.element,
      state,
      tableBox(
        "Trail",
        h("table", { id: "trail-table" }, headings("When", "Who", "What", "Unit", "Run", "Why"), body),
      ),
      more,
    ),
  );
  await load(null);
}

const INTACT = "Every entry carries the hash of the one before it: none of them was changed or taken out.";

function row({ seq, at, who, what, unit, rig, run_id: run, revision, reason, detail }) {
  return h(
    "tr",
    { "data-entry": seq },
    h("th", { scope: "row" }, moment(at)),
    h("td", {}, who ?? "–"),
    h("td", {}, `${WORDS[what]}${details(what, detail)}${revision ? `, revision ${revision}` : ""}`),
    h("td", {}, unit ? unitLink(unit) : (rig ?? "–")),
    h("td", {}, run ? runLink(run) : "–"),
    h("td", {}, reason ?? detail.note ?? "–"),
  );
}

function details(what, { pose, effects, from, to, name, role }) {
  if (pose !== undefined) return `: ${pose}`;
  if (effects) return `: ${effects.join(", ")}`;
  if (what === "moved") return `: from ${from} to ${to}`;
  if (name) return `: ${[name, role].filter(Boolean).join(", ")}`;
  return "";
}
