/** Quantities against time. */
import uPlot from "uplot";
import { drawBounds, drawErrors, drawSettling } from "./behind.js";
import { element } from "./controls.js";
import { axisNumber, readable, short, withUnit } from "./format.js";
import { colours, dark, lookOf, strip, write } from "./view.js";

const WIDEST_GAP = 3; // pixels between two samples, above which their distance is stated
const AXES = ["x", "y", "z", "about x", "about y", "about z"];
const legs = (_, i) => `leg ${i + 1}`;
const names = (list) => (_, i) => list[i];

/** What can be shown: title, quantity, unit (of rotary legs `rotary`), its columns and their names. */
export const FIGURES = {
  errors: { title: "Feature errors", quantity: "feature_error", unit: "px", name: (_, i) => `${"xy"[i % 2]}${(i >> 1) + 1}`, isOfErrors: true, each: 2 },
  forces: { title: "Force beyond the weight", quantity: "wrench", unit: "N", from: 0, to: 3, name: names(AXES), weight: true },
  moments: { title: "Moment", quantity: "wrench", unit: "N m", from: 3, to: 6, name: names(AXES.map((name) => name.replace("about ", ""))) },
  legs: { title: "Leg forces, torques of cranks", quantity: "leg_forces", unit: "N", rotary: "N m", name: legs },
  lengths: { title: "Leg lengths, angles of cranks", quantity: "leg_lengths", unit: "m", rotary: "rad", name: legs },
  position: { title: "Displacement from the start", quantity: "position", unit: "m", name: names(AXES), change: true },
  velocity: { title: "Velocity", quantity: "twist", unit: "m/s", from: 0, to: 3, name: names(AXES) },
  turning: { title: "Angular velocity", quantity: "twist", unit: "rad/s", from: 3, to: 6, name: names(AXES) },
  fuzzy: { title: "Output of the fuzzy systems, force", quantity: "fuzzy_output", unit: "N", from: 0, to: 3, name: names(AXES) },
  depth: { title: "Depths", quantity: "depth", unit: "m", name: (_, i) => `point ${i + 1}` },
};

export class Chart {
  /**
   * @param {HTMLElement} box
   * @param {string} figure of `FIGURES`
   * @param {(time: number) => void} pick a time that is pointed at
   */
  constructor(box, figure, pick) {
    this.box = box;
    this.figure = figure;
    this.pick = pick;
    this.now = 0;
    this.row = 0;
    this.note = element("small", { class: "ghost" }, "pale: the preset");
    this.spacing = element("small", { class: "spacing" });
    box.append(this.spacing); // beside the name of the axis: a note that comes and goes moves nothing
    box.parentElement.querySelector("figcaption").append(this.note);
    new ResizeObserver(() => this.fit()).observe(box);
    dark.addEventListener("change", () => {
      this.count = -1;
      if (this.result) this.show(this.result);
    });
  }

  fit() {
    this.plot?.setSize(this.size());
  }

  size() {
    return { width: Math.max(this.box.clientWidth, 80), height: Math.max(this.box.clientHeight, 60) };
  }

  choose(figure) {
    this.figure = figure;
    this.count = -1;
    if (this.result) this.show(this.result);
  }

  /**
   * @param {object} result of the core, with `weight` (3,) [N in B], `cranks` of rotary legs, `band` of settling [px], `bounds` of the
   * legs by quantity [SI], `step` of the run [s], `ghost`, a run of as many points that is drawn pale, or null, and `shown`, the time up to which it is drawn [s]
   */
  show(result) {
    this.result = result;
    const { quantity, unit, rotary, from = 0, to, change, weight } = FIGURES[this.figure];
    const values = result.samples[quantity];
    const width = values.length / result.rows;
    const used = result.cranks ? rotary ?? unit : unit;
    if (this.unit !== used) this.count = -1;
    this.unit = used;
    const scale = readable(used)[1];
    const columns = [];
    for (let j = from; j < Math.min(to ?? width, width); ++j) {
      const column = new Float64Array(result.rows);
      const zero = change ? values[j] : weight ? result.weight[j] : 0;
      for (let k = 0; k < result.rows; ++k) column[k] = scale * (values[width * k + j] - zero);
      columns.push(column);
    }
    const data = [result.samples.time, ...columns];
    if (this.count === columns.length) this.plot.setData(data);
    else this.build(data);
  }

  /** How far apart samples are that are drawn, of the run or of the pale one behind it where those are farther apart; "" where lines between them leave out nothing that is to be seen. */
  gaps(plot) {
    const ghost = FIGURES[this.figure].isOfErrors ? this.result.ghost : null;
    const [own, behind] = [this.gap(plot, this.result), ghost ? this.gap(plot, ghost) : 0];
    const widest = Math.max(own, behind);
    return widest > 0 ? `${behind > own ? "pale " : ""}samples ${withUnit(widest, "s", 2)} apart` : "";
  }

  /** From one sample of a run that is drawn to the next [s]; 0 where every step is, or no gap is to be seen. */
  gap(plot, { samples: { time }, rows, step, stride = 1 }) {
    const apart = rows > 2 ? stride * (time[1] - time[0]) : 0;
    const pixels = (apart / this.result.shown) * (plot.bbox.width / devicePixelRatio);
    return apart > 1.5 * step && pixels > WIDEST_GAP ? apart : 0;
  }

  build(data) {
    this.plot?.destroy();
    this.count = data.length - 1;
    const { name, each } = FIGURES[this.figure];
    const colour = colours();
    const axis = { stroke: colour.faint, grid: { stroke: colour.line, width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif", size: 26, labelSize: 14, labelFont: "11px system-ui, sans-serif", values: (_, splits) => splits.map((value) => (value === null ? "" : axisNumber(value))) };
    const series = data.slice(1).map((_, i) => ({ label: name(null, i), ...lookOf(i, each), width: 1.4, points: { show: false } }));
    this.looks = series;
    this.plot = new uPlot(
      {
        ...this.size(),
        padding: [8, 8, 0, 0],
        cursor: { drag: { x: false, y: false }, points: { show: false }, sync: { key: "time" } },
        legend: { show: false },
        scales: { x: { time: false, range: () => [0, this.result.shown] } },
        axes: [
          { ...axis, space: 60, label: "time [s]" },
          { ...axis, size: 46, space: 28, label: readable(this.unit)[0] },
        ],
        series: [{}, ...series],
        hooks: {
          drawAxes: [(plot) => this.behind(plot)],
          draw: [(plot) => this.line(plot)],
          setCursor: [() => this.tell()],
          ready: [(plot) => plot.over.addEventListener("click", () => plot.cursor.left >= 0 && this.pick(plot.posToVal(plot.cursor.left, "x")))],
        },
      },
      data,
      this.box,
    );
    this.box.setAttribute("role", "img");
    this.box.setAttribute("aria-label", `${FIGURES[this.figure].title} against time`);
    this.legend?.remove();
    this.legend = document.createElement("div");
    this.legend.className = "legend";
    this.when = element("i");
    this.values = series.map(() => element("b"));
    this.legend.append(
      this.when,
      ...series.map(({ label, ...look }, i) => element("span", { style: `--colour: ${strip(look)}` }, label, this.values[i])),
    );
    this.note.hidden = !FIGURES[this.figure].isOfErrors;
    this.box.after(this.legend);
  }

  behind(plot) {
    const { quantity, isOfErrors } = FIGURES[this.figure];
    write(this.spacing, this.gaps(plot));
    if (isOfErrors && this.result.ghost) drawErrors(plot, this.result.ghost, this.looks);
    if (isOfErrors) drawSettling(plot, this.result);
    const scale = readable(this.unit)[1];
    drawBounds(plot, (this.result.bounds[quantity] ?? []).map(({ value, legs }) => ({ value: scale * value, legs })));
  }

  /** The time of now. */
  line(plot) {
    const x = Math.round(plot.valToPos(this.now, "x", true));
    plot.ctx.save();
    plot.ctx.strokeStyle = colours().accent;
    plot.ctx.lineWidth = 1.5 * devicePixelRatio;
    plot.ctx.setLineDash([]);
    plot.ctx.beginPath();
    plot.ctx.moveTo(x, plot.bbox.top);
    plot.ctx.lineTo(x, plot.bbox.top + plot.bbox.height);
    plot.ctx.stroke();
    plot.ctx.restore();
  }

  /** The values where the pointer is, in any of the charts, else those of now. */
  tell() {
    const { data, cursor } = this.plot;
    const row = Math.min(cursor.idx ?? this.row, data[0].length - 1); // of a pointer in what was a longer run
    write(this.when, `${data[0][row].toFixed(3)} s`);
    this.values.forEach((value, i) => write(value, short(data[i + 1][row], 3)));
  }

  /** @param {number} time of now [s], and its row of the samples */
  at(time, row) {
    this.now = time;
    this.row = row;
    this.plot?.redraw(false);
    if (this.plot) this.tell();
  }
}
