// Runs, newest first, and those of them that somebody looks for.

import { getRuns } from "./api.js";
import { errorLine, fill, h, headings, runLink, statusPill, suspectTag, tableBox, unitLink } from "./dom.js";
import { moment, plusMinus, significant } from "./format.js";
import { runFilters, verdictWords } from "./runfilters.js";

const PAGE = 20;
const KINDS = { sweep: "sweep", verification: "verification", static: "static log" };

/** What a run is, where it is no calibration by dwells on a rig. */
export function kindTag({ plan, follows }) {
  const kind = follows ? "follow-up" : plan ? KINDS[plan.kind] : "import";
  return kind && h("span", { class: "tag" }, kind);
}

/** One run as a table row; a voided one is struck through and says why. */
export function runRow(run, { withUnit = true } = {}) {
  const result = run.result ?? {};
  return h(
    "tr",
    { class: run.voided && "voided", "data-run": run.id },
    h("th", { scope: "row" }, runLink(run.id), kindTag(run)),
    withUnit && h("td", {}, unitLink(run.unit)),
    h("td", {}, run.rig ?? "–"),
    h(
      "td",
      { class: "plain" },
      statusPill(run.status),
      run.voided && h("span", { class: "tag", title: run.voided.reason }, "voided"),
      suspectTag(run.suspect),
      run.verdict && h("small", { class: `under ${run.verdict.answer}` }, verdictWords(run.verdict)),
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
    "Status, verdict",
    "When",
    "#Bias",
    "#Scale",
    "#RMS error, raw",
    "#RMS error, calibrated",
  ];
  return headings(...names.filter(Boolean));
}

/** The list with its filters; `refresh()` fetches the first page again. */
export function runList(rigs, query, signal) {
  const filters = runFilters(rigs, query, () => load(null), signal);
  const body = h("tbody");
  const told = h("p", { id: "runs-told", class: "muted", role: "status" });
  const more = h("button", { type: "button", hidden: true }, "Show older runs");
  const stop = h("button", { type: "button", id: "runs-stop", hidden: true, on: { click: () => (isStopped = true) } }, "Stop looking");
  const error = errorLine("runs-error");
  let cursor = null;
  let asked = 0;
  let isStopped = false;

  /** A verdict is looked for some runs at a time: on until there is a page of them, no older run, or somebody's stop. */
  async function load(from) {
    const mine = ++asked;
    const wanted = filters.asked();
    if (!from) fill(body);
    const before = body.childElementCount;
    cursor = from;
    isStopped = false;
    more.hidden = true;
    stop.hidden = true;
    fill(told, wanted.verdict && "Judging runs, the newest first…");
    let seen;
    try {
      do {
        const left = PAGE - body.childElementCount + before;
        seen = await getRuns(new URLSearchParams({ ...wanted, limit: left, ...(cursor && { cursor }) }), signal);
        if (mine !== asked) return; // a later question has been asked meanwhile
        body.append(...seen.items.map((run) => runRow(run)));
        cursor = seen.next_cursor;
        stop.hidden = false;
        fill(told, "Judging older and older runs, back to ", moment(seen.backTo), ".");
      } while (cursor && !isStopped && body.childElementCount - before < PAGE);
      stop.hidden = true;
      more.hidden = !cursor;
      fill(told, outcome(seen));
      error.say(null);
    } catch (problem) {
      if (signal.aborted || mine !== asked) return;
      stop.hidden = true;
      told.textContent = "";
      error.say(problem);
    }
  }

  function outcome({ backTo }) {
    if (cursor && isStopped) return ["Looked no further back than ", moment(backTo), "."];
    if (body.childElementCount) return null;
    return filters.isAny() ? "No runs yet." : "No run matches.";
  }

  /** The first page anew, unless somebody waits for it: what is looked for far back would never be found. */
  const refresh = () => stop.hidden && load(null);
  more.addEventListener("click", () => load(cursor));
  const element = h(
    "section",
    { class: "card", "aria-labelledby": "runs-title" },
    h("h2", { id: "runs-title" }, "Runs"),
    filters.element,
    error.element,
    tableBox("Runs", h("table", { id: "runs-table" }, runHeadings(), body)),
    told,
    stop,
    more,
  );
  return { element, refresh };
}
