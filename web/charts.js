// Figures as the service draws them, in the colours of the page's theme.

import { fill, h } from "./dom.js";
import { ApiError, get, serviceError } from "./api.js";
import { localDigits } from "./format.js";

const CONFIG = { responsive: true, displayModeBar: false, doubleClick: "reset" };
const TOUCH = window.matchMedia("(pointer: coarse)");
const DARK = window.matchMedia("(prefers-color-scheme: dark)");

const SCRIPT = new URL("./vendor/plotly-partial.min.js", import.meta.url);

const HALF_DAY_MS = 43_200_000;
const EMPTY = "Nothing to plot: no values are known.";
export const NONE_VALID = "No valid calibration yet. Only completed calibrations that are not voided are plotted.";

let library;

/** Plotly's script, loaded with the first chart, in parallel to that chart's data. */
function plotly() {
  import("./paper.js").catch(() => {}); // if the service does not answer, the next chart requests it again
  library ??= new Promise((resolve, reject) => {
    const script = h("script", { src: SCRIPT.href });
    script.addEventListener("load", () => resolve(window.Plotly));
    script.addEventListener("error", () => {
      library = undefined;
      script.remove();
      reject(new ApiError(`The chart script ${SCRIPT.pathname} could not be loaded.`, 0));
    });
    document.head.append(script);
  });
  return library;
}

/** A chart with its caption, or the reason why it is empty. `draw(figure)` shows a figure, `load(path)` fetches it first. */
export class Chart {
  #loads = 0;

  constructor(testid, title, { tall = false, low = false, empty = EMPTY, beside = null, signal } = {}) {
    this.plot = h("div", {
      class: ["plot", tall && "tall", low && "low"].filter(Boolean).join(" "),
      "data-testid": testid,
      role: "img",
      "aria-label": title,
    });
    this.problem = h("p", { class: "error", role: "alert", hidden: true });
    this.empty = h("p", { class: "muted", hidden: true }, empty);
    const caption = h("figcaption", {}, title, beside);
    this.element = h("figure", { class: "chart" }, caption, this.empty, this.plot, this.problem);
    DARK.addEventListener("change", () => this.figure && this.draw(this.figure), { signal });
    signal?.addEventListener("abort", () => window.Plotly?.purge(this.plot));
    this.signal = signal;
  }

  async load(path) {
    const number = ++this.#loads;
    try {
      const [figure] = await Promise.all([get(path, this.signal), plotly()]);
      if (number === this.#loads) await this.draw(figure); // an answer to an earlier request may arrive later
    } catch (error) {
      if (number === this.#loads) this.#say(error);
    }
  }

  async draw(figure) {
    this.figure = figure;
    try {
      const Plotly = await plotly();
      if (this.signal?.aborted || !this.plot.isConnected) return;
      this.problem.hidden = true;
      this.plot.hidden = !figure.data.some(hasPoints); // empty axes say nothing
      this.empty.hidden = !this.plot.hidden;
      if (this.plot.hidden) return;
      const { data, layout } = inLocalTime(figure);
      await Plotly.react(this.plot, data, themed(layout), CONFIG);
    } catch (error) {
      this.#say(error);
    }
  }

  #say(error) {
    const problem = serviceError(error, this.signal);
    if (!problem) return;
    fill(this.problem, problem.message);
    this.problem.hidden = false;
  }
}

function hasPoints({ x, y, z }) {
  return [y ?? x, z].some((values) => values?.some((value) => value !== null));
}

/** Times in the local time zone, as everywhere on the page; the service's figures are in UTC. */
function inLocalTime({ data, layout }) {
  if (layout.xaxis?.type !== "date") return { data, layout };
  const local = data.map((trace) => ({ ...trace, x: trace.x.map(localDigits) }));
  const moments = new Set(data.flatMap(({ x }) => x.map(Date.parse)));
  const [only] = moments;
  const range = moments.size === 1 && [only - HALF_DAY_MS, only + HALF_DAY_MS].map(localDigits); // not milliseconds
  const title = { ...layout.xaxis.title, text: layout.xaxis.title.text.replace(" (UTC)", "") };
  return { data: local, layout: { ...layout, xaxis: { ...layout.xaxis, title, ...(range && { range }) } } };
}

function themed(layout) {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name).trim();
  const dressed = {
    ...layout,
    font: { ...layout.font, color: colour("--muted"), family: getComputedStyle(document.body).fontFamily },
    hoverlabel: { bgcolor: colour("--card"), bordercolor: colour("--line"), font: { color: colour("--text") } },
    dragmode: TOUCH.matches ? false : "zoom", // a finger scrolls the page
  };
  for (const name of Object.keys(layout).filter((key) => /^[xy]axis\d*$/.test(key))) {
    const axis = { gridcolor: colour("--grid"), linecolor: colour("--line"), tickcolor: colour("--line") };
    dressed[name] = { ...layout[name], ...axis, zerolinecolor: colour("--muted") };
  }
  return dressed;
}
