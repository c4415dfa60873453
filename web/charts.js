// Figures as the service draws them, in the colours of the page's theme.

import { fill, h } from "./dom.js";
import { ApiError, get } from "./api.js";

const CONFIG = { responsive: true, displayModeBar: false, doubleClick: "reset" };
const TOUCH = window.matchMedia("(pointer: coarse)");
const DARK = window.matchMedia("(prefers-color-scheme: dark)");

const SCRIPT = new URL("./vendor/plotly-partial.min.js", import.meta.url);

let library;

/** Plotly's own script, asked for with the first chart, while that chart's data are still under way. */
function plotly() {
  library ??= new Promise((resolve, reject) => {
    const script = h("script", { src: SCRIPT.href });
    script.addEventListener("load", () => resolve(window.Plotly));
    script.addEventListener("error", () => {
      library = undefined;
      script.remove();
      reject(new ApiError(`The charts' script ${SCRIPT.pathname} could not be loaded.`, 0));
    });
    document.head.append(script);
    import("./paper.js");
  });
  return library;
}

/** A chart with its caption. `draw(figure)` shows a figure, `load(path)` fetches one and shows it. */
export class Chart {
  constructor(testid, title, { tall = false, low = false, signal } = {}) {
    this.plot = h("div", {
      class: ["plot", tall && "tall", low && "low"].filter(Boolean).join(" "),
      "data-testid": testid,
      role: "img",
      "aria-label": title,
    });
    this.problem = h("p", { class: "error", role: "alert", hidden: true });
    this.element = h("figure", { class: "chart" }, h("figcaption", {}, title), this.plot, this.problem);
    DARK.addEventListener("change", () => this.figure && this.draw(this.figure), { signal });
    signal?.addEventListener("abort", () => window.Plotly?.purge(this.plot));
    this.signal = signal;
  }

  async load(path) {
    try {
      const [figure] = await Promise.all([get(path, this.signal), plotly()]);
      await this.draw(figure);
    } catch (error) {
      this.#say(error);
    }
  }

  async draw(figure) {
    this.figure = figure;
    try {
      const Plotly = await plotly();
      if (this.signal?.aborted || !this.plot.isConnected) return;
      this.problem.hidden = true;
      await Plotly.react(this.plot, figure.data, themed(figure.layout), CONFIG);
    } catch (error) {
      this.#say(error);
    }
  }

  #say(error) {
    if (this.signal?.aborted) return;
    if (!(error instanceof ApiError)) throw error;
    fill(this.problem, error.message);
    this.problem.hidden = false;
  }
}

function themed(layout) {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name).trim();
  const dressed = {
    ...layout,
    font: { ...layout.font, color: colour("--muted"), family: getComputedStyle(document.body).fontFamily },
    hoverlabel: {
      bgcolor: colour("--card"),
      bordercolor: colour("--line"),
      font: { color: colour("--text") },
    },
    dragmode: TOUCH.matches ? false : "zoom", // a finger scrolls the page
  };
  for (const name of Object.keys(layout).filter((key) => /^[xy]axis\d*$/.test(key))) {
    const axis = { gridcolor: colour("--grid"), linecolor: colour("--line"), tickcolor: colour("--line") };
    dressed[name] = { ...layout[name], ...axis, zerolinecolor: colour("--muted") };
  }
  return dressed;
}
