// All rigs of all benches by hall: state, queued runs, failures and overdue checks.

import { getNews, get } from "./api.js";
import { BenchFilters } from "./benchfilters.js";
import { Halls } from "./benchtable.js";
import { errorLine, fill, h, unitLink } from "./dom.js";
import { moment, plural } from "./format.js";
import { rigsAre } from "./rigs.js";

const LOOK_MS = 2000;
const OVERDUE_MS = 600_000;
const MOST_OVERDUE = 8;

export async function benchesView({ root, query, signal }) {
  const error = errorLine("benches-error");
  const announced = h("p", { class: "for-screen-readers", role: "status" });
  const shown = h("p", { id: "benches-shown", class: "muted", role: "status" });
  const overdue = h("section", { class: "card", id: "overdue", "aria-labelledby": "overdue-title", hidden: true });
  const halls = new Halls((text) => (announced.textContent = text));
  const filters = new BenchFilters(query, () => apply());
  let benches = [];
  let tag = null;

  function apply() {
    const { rigs, count } = filters.choose(benches);
    halls.choose(rigs);
    const text = count ? `${rigs.size} of ${plural(count, "rig")} shown.` : "No bench has reported a rig yet.";
    if (shown.textContent !== text) shown.textContent = text; // else it would be read out each time
  }

  async function look() {
    const news = await getNews("/api/benches/overview", tag, signal);
    error.say(null);
    if (news) {
      tag = news.tag;
      benches = news.answer;
      halls.show(benches);
      apply();
    }
    rigsAre(listed(benches));
  }

  await look();
  fill(root, h("h1", {}, "Benches"), filters.element, shown, error.element, announced, halls.element, overdue);
  again(look, LOOK_MS, error, signal);
  again(() => showOverdue(overdue, signal), OVERDUE_MS, error, signal, 0);
}

/** Calls `act` after `first_ms` and then periodically while the page is visible, until `signal` aborts. */
function again(act, every_ms, error, signal, first_ms = every_ms) {
  let timer;
  let began = Date.now();
  const go = async () => {
    clearTimeout(timer);
    began = Date.now();
    try {
      if (!document.hidden) await act();
    } catch (problem) {
      if (signal.aborted || problem.status === 401) return;
      if (problem.status === undefined) throw problem; // a fault of this page
      error.say(problem.status === 0 ? null : problem); // the banner reports the lost connection
    }
    if (!signal.aborted) timer = setTimeout(go, every_ms);
  };
  const back = () => {
    if (!document.hidden && Date.now() - began >= every_ms) go();
  };
  document.addEventListener("visibilitychange", back, { signal });
  signal.addEventListener("abort", () => clearTimeout(timer));
  timer = setTimeout(go, first_ms);
}

/** The rigs as `GET /api/rigs` lists them, for the stop buttons, which need no request of their own. */
function listed(benches) {
  return benches.flatMap(({ name: bench, hall, silent_since: last_seen_at, rigs }) =>
    rigs.map(({ name, stage, imu, simulated, state, run_id }) => {
      return { name, stage, imu, simulated, state, run_id, bench, hall, last_seen_at };
    }),
  );
}

async function showOverdue(place, signal) {
  const units = await get(`/api/overdue?limit=${MOST_OVERDUE + 1}`, signal);
  const lines = units.slice(0, MOST_OVERDUE).map(({ unit, due_at, due_says }) => {
    return h("li", {}, unitLink(unit), " was due ", moment(due_at), h("span", { class: "muted" }, `. ${due_says}`));
  });
  place.hidden = units.length === 0;
  fill(
    place,
    h("h2", { id: "overdue-title" }, "Overdue units"),
    h("ul", {}, lines),
    units.length > MOST_OVERDUE && h("p", {}, h("a", { href: "#/units" }, "All units and due dates")),
  );
}
