// The live timeline: new readings in the layout of the service's figure.

const MOST_POINTS = 4000;
const REDRAW_MS = 250;

export class Timeline {
  /** `figure` is the service's, whose points the event stream repeats. */
  constructor(chart, figure, signal) {
    this.chart = chart;
    this.figure = figure;
    this.scale = figure.layout.meta.time_scale; // of the rig's clocks; the axis is time on the wall
    this.time = [];
    this.stage = [];
    this.reading = [];
    signal.addEventListener("abort", () => clearTimeout(this.timer));
  }

  add({ time_s, stage_deg, reading_deg }) {
    this.time.push(time_s / this.scale);
    this.stage.push(stage_deg);
    this.reading.push(reading_deg);
    if (this.time.length > MOST_POINTS) this.#thin();
    this.timer ??= setTimeout(() => this.#draw(), REDRAW_MS);
  }

  stop() {
    clearTimeout(this.timer);
  }

  #thin() {
    const everyOther = (_, k) => k % 2 === 0;
    this.time = this.time.filter(everyOther);
    this.stage = this.stage.filter(everyOther);
    this.reading = this.reading.filter(everyOther);
  }

  #draw() {
    this.timer = undefined;
    const [stage, reading] = this.figure.data;
    const data = [
      { ...stage, x: [...this.time], y: [...this.stage] },
      { ...reading, x: [...this.time], y: [...this.reading] },
    ];
    this.chart.draw({ data, layout: this.figure.layout });
  }
}
