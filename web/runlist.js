// The list of runs, newest first, with filters.

import { getRuns } from "./api.js";
import { dataTable, errorLine, fill, h, numberCell, runLink, statusPill, suspectTag, unitLink } from "./dom.js";
import { moment, plusMinus, significant } from "./format.js";
import { headline, verifiedRms } from "./headline.js";
import { runFilters, verdictWords } from "./runfilters.js";

const PAGE = 20;
const NO_RUNS = ["No runs yet. Start a calibration above, or ", h("a", { href: "#/import" }, "import poses"), "."];
const KINDS = { sweep: "sweep", verification: "verification", static: "static log" };

/** The kind of a run that is not a calibration by dwells on a rig. */
export function kindTag({ plan, follows }) {
  const kind = follows ? "follow-up" : plan ? KINDS[plan.kind] : "import";
  return kind && h("span", { class: "tag" }, kind);
}

/** One run as a table row; a voided one is struck through and says why. */
export function runRow(run, { withUnit = true } = {}) {
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
    figures(run).map(numberCell),
  );
}

const FIGURES = ["#Bias", "#Scale", "#RMS error, raw", "#RMS error, calibrated"];

/** The values under `FIGURES`, with accepted effects; a verification measures no bias and no scale. */
function figures({ result, plan }) {
  if (!result) return FIGURES.map(() => "–");
  const raw = significant(result.rms_raw_deg, 3, "°");
  if (plan?.kind === "verification") return ["–", "–", raw, significant(verifiedRms(result), 3, "°")];
  const judged = headline(result);
  return [
    plusMinus(judged.bias_deg, judged.bias_std_deg, "°"),
    plusMinus(judged.scale, judged.scale_std),
    raw,
    significant(judged.rms_deg, 3, "°"),
  ];
}

/** The headings of such rows. */
export function runHeadings({ withUnit = true } = {}) {
  return ["Run", ...(withUnit ? ["Unit"] : []), "Rig", "Status, verdict", "When", ...FIGURES];
}

/** The list with its filters; `refresh()` fetches the first page again. */
export function runList(rigs, query, signal) {
  const filters = runFilters(rigs, query, () => load(null), signal);
  const body = h("tbody");
  const state = h("p", { id: "runs-told", class: "muted", role: "status" });
  const more = h("button", { type: "button", hidden: true }, "Show older runs");
  const stop = h("button", { type: "button", id: "runs-stop", hidden: true, on: { click: () => (isStopped = true) } }, "Stop searching");
  const error = errorLine("runs-error");
  let cursor = null;
  let asked = 0;
  let isStopped = false;

  /** Loads a page. Verdicts are evaluated in portions, until the page is full, no run is left, or the user stops. */
  async function load(from) {
    const mine = ++asked;
    const wanted = filters.asked();
    if (!from) fill(body);
    const before = body.childElementCount;
    cursor = from;
    isStopped = false;
    more.hidden = true;
    stop.hidden = true;
    fill(state, wanted.verdict && "Evaluating verdicts, newest runs first…");
    let seen;
    try {
      do {
        const left = PAGE - body.childElementCount + before;
        seen = await getRuns(new URLSearchParams({ ...wanted, limit: left, ...(cursor && { cursor }) }), signal);
        if (mine !== asked) return; // superseded by a later request
        body.append(...seen.items.map((run) => runRow(run)));
        cursor = seen.next_cursor;
        stop.hidden = false;
        fill(state, "Evaluating verdicts of older runs, back to ", moment(seen.backTo), ".");
      } while (cursor && !isStopped && body.childElementCount - before < PAGE);
      stop.hidden = true;
      more.hidden = !cursor;
      filters.element.hidden = !body.childElementCount && filters.isAny();
      fill(state, outcome(seen));
      error.say(null);
    } catch (problem) {
      if (signal.aborted || mine !== asked) return;
      stop.hidden = true;
      state.textContent = "";
      error.say(problem);
    }
  }

  function outcome({ backTo }) {
    if (cursor && isStopped) return ["Stopped at runs of ", moment(backTo), "."];
    if (body.childElementCount) return null;
    return filters.isAny() ? NO_RUNS : "No run matches.";
  }

  /** Reloads the first page, unless a search is in progress, which would never reach older runs. */
  const refresh = () => stop.hidden && load(null);
  more.addEventListener("click", () => load(cursor));
  const element = h(
    "section",
    { class: "card", "aria-labelledby": "runs-title" },
    h("h2", { id: "runs-title" }, "Runs"),
    filters.element,
    error.element,
    dataTable("Runs", runHeadings(), body, { id: "runs-table" }),
    state,
    stop,
    more,
  );
  return { element, refresh };
}
