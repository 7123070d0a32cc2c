/** Two keys against each other: a run for every pixel, coarse first. */
import { element, fromPlace, shown, sliders, toPlace } from "./controls.js";
import { Crew } from "./engine.js";
import { borders, drawBorders, settledAround } from "./borders.js";
import { short, withUnit } from "./format.js";
import { isBeyondLimits, unitOfMetric, wordsOfMetric } from "./limits.js";
import { actingChanges, drawn, metrics, same, valueOf } from "./model.js";
import { cleared, colours, isShortcut, pointIn, write } from "./view.js";

const SIZE = 64;
const LEFT = 64, BOTTOM = 34;
const COLOURS = {
  settled: [56, 150, 90],
  "settled, beyond a limit": [176, 206, 84],
  "not settled": [214, 160, 60],
  "no value": [128, 128, 128],
  diverged: [150, 40, 50],
  "behind camera": [120, 60, 130],
  "feature lost": [60, 70, 150],
  "leg limit": [180, 90, 40],
  singular: [90, 90, 90],
  "solver failed": [40, 110, 120],
  refused: [70, 70, 78],
};
const ROUNDING = 1e-3; // of the entries that a slider moves together: it reads their factor with four digits
const PALE = 0.3;
const MOST_OF_SCALE = 0.98; // of the numbers of a map are on its scale: a few large ones would leave one colour to all others
const FINGER = 3; // cells that a second tap may be beside the first one

/** Places of a grid, those of a coarse one first, each with the width of what it stands for until finer ones come. */
export function coarseFirst(size = SIZE) {
  const order = [];
  const seen = new Set();
  for (let step = size / 8; step >= 1; step /= 2)
    for (let y = 0; y < size; y += step)
      for (let x = 0; x < size; x += step) {
        const place = y * size + x;
        if (!seen.has(place)) order.push(place);
        seen.add(place);
      }
  return order;
}

const HEAT = [[32, 48, 112], [28, 120, 142], [70, 176, 120], [180, 210, 70], [250, 225, 60]];
const css = (colour) => `rgb(${colour.join(" ")})`;

/** Dark blue to yellow, as a share of 0 to 1. */
export function heat(share) {
  const place = Math.max(0, Math.min(1, share)) * (HEAT.length - 1);
  const low = Math.min(Math.floor(place), HEAT.length - 2);
  return HEAT[low].map((c, i) => Math.round(c + (place - low) * (HEAT[low + 1][i] - c)));
}

/** Whether two values of a key are the same but for the last digits of numbers. */
const alike = (a, b) => {
  const [first, second] = [a, b].map((value) => [value].flat());
  return first.length === second.length && first.every((x, i) => x === second[i] || Math.abs(x - second[i]) <= ROUNDING * Math.abs(x));
};

export class ParameterMap {
  /**
   * @param {HTMLElement} box of the section
   * @param {(change: (state: object) => object) => void} take a point that was chosen
   */
  constructor(box, take) {
    this.box = box;
    this.take = take;
    this.crew = new Crew();
    this.canvas = box.querySelector("canvas");
    this.words = box.querySelector("[data-words]");
    this.here = box.querySelector("[data-here]");
    this.legend = box.querySelector(".legend");
    this.x = box.querySelector("[name=x]");
    this.y = box.querySelector("[name=y]");
    this.by = box.querySelector("[name=metric]");
    this.button = box.querySelector("button");
    this.by.append(...metrics.map(({ name }) => element("option", { value: name })), element("option", { value: "outcome" }, "outcome"));
    this.refusal = "";
    this.button.addEventListener("click", () => (this.running ? this.stop() : this.start()));
    this.by.addEventListener("change", () => this.draw());
    for (const select of [this.x, this.y]) select.addEventListener("change", () => this.forget());
    this.canvas.addEventListener("click", (event) => (event.pointerType === "touch" ? this.tap(this.cellAt(event)) : this.pick(this.cellAt(event))));
    this.canvas.addEventListener("pointermove", (event) => this.look(this.cellAt(event)));
    this.canvas.addEventListener("keydown", (event) => this.key(event));
    this.cursor = [SIZE / 2, SIZE / 2];
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  show(state) {
    if (state !== this.state) this.refusal = "";
    this.state = state;
    metrics.forEach((metric, i) => write(this.by.options[i], wordsOfMetric(state, metric)[0]));
    this.isStale = Boolean(this.cells) && this.isOfAnother(state);
    if (this.isStale && this.running) this.stop();
    const list = sliders(state);
    const shape = list.map(({ id, label }) => [id, label]).join();
    if (shape !== this.shape) {
      this.shape = shape;
      const gain = list.find(({ log }) => log) ?? list[0];
      for (const [select, fallback] of [[this.x, gain.id], [this.y, "uncertainty.depth"]]) {
        const old = select.value;
        select.replaceChildren(...list.map(({ id, label }) => element("option", { value: id }, label)));
        select.value = list.some(({ id }) => id === old) ? old : fallback;
      }
      const hasAxes = this.cells && !this.isStale && this.axes.every(({ id }) => list.some((entry) => entry.id === id));
      if (hasAxes) [this.x.value, this.y.value] = this.axes.map(({ id }) => id); // of the map that is in colour again
    }
    this.draw();
  }

  /** Whether the map is not that of a state: more differs than the two keys that it varies. */
  isOfAnother(state) {
    if (state.preset !== this.base.preset) return true;
    const varied = this.axes.map(({ key }) => key);
    const [cell, other] = [this.base, state].map((of) => this.at(of, 0, 0)); // what else such a key has stays
    const isOffAxis = ({ key, get, set }) => !alike(valueOf(set(state, get(state)), key), valueOf(state, key));
    if (this.axes.some(isOffAxis)) return true; // its entries differ in another way than those of a cell
    const keys = [cell, other].flatMap(actingChanges).map(([key]) => key);
    return keys.some((key) => !(varied.includes(key) ? alike : same)(valueOf(cell, key), valueOf(other, key)));
  }

  forget() {
    this.stop();
    this.cells = null;
    this.draw();
  }

  stop() {
    this.crew.stop();
    this.running = false;
    this.seconds = (performance.now() - this.began) / 1000;
    this.button.textContent = "Compute the map";
  }

  refuse(words) {
    this.refusal = words;
    this.forget();
  }

  start() {
    const list = sliders(this.state);
    this.axes = [this.x.value, this.y.value].map((id) => list.find((entry) => entry.id === id));
    if (this.axes[0].id === this.axes[1].id) {
      this.words.textContent = "Choose two different keys.";
      return;
    }
    const base = this.state;
    this.base = base;
    this.isStale = false;
    this.cells = new Array(SIZE * SIZE).fill(null);
    this.count = 0;
    this.refusal = "";
    this.running = true;
    this.button.textContent = "Stop";
    this.began = performance.now();
    const names = [...new Set(this.axes.map(({ key }) => key))];
    const cells = coarseFirst().map((place) => {
      const state = this.at(base, place % SIZE, Math.floor(place / SIZE));
      return [place, ...names.map((key) => valueOf(state, key))];
    });
    const take = (answers, finished) => {
      for (const [place, outcome, values, refusal] of answers) this.cells[place] = { outcome, values, refusal, ending: this.ending(outcome, values) };
      this.count += answers.length;
      if (finished) this.stop();
      this.soon();
    };
    this.crew.map(drawn(base), names, cells, take, (words) => this.refuse(words));
  }

  /** Draws once for all answers of the next tenth of a second. */
  soon() {
    this.timer ??= setTimeout(() => {
      this.timer = undefined;
      this.draw();
    }, 100);
  }

  /** The state at a cell of the grid; y counts from below. */
  at(state, x, y) {
    const [first, second] = this.axes;
    return second.set(first.set(state, fromPlace(first, x / (SIZE - 1))), fromPlace(second, y / (SIZE - 1)));
  }

  /** How a run ended, as the verdict has it: a name of `COLOURS`. */
  ending(outcome, values) {
    if (outcome !== "completed") return outcome.replaceAll("_", " ");
    if (Number.isNaN(values.settling_time)) return "not settled";
    return isBeyondLimits(this.base, values) ? "settled, beyond a limit" : "settled";
  }

  /** What colours a cell: the number of a metric, or a name where there is none. */
  value({ outcome, values, ending }) {
    const by = this.by.value;
    if (by === "outcome" || outcome !== "completed") return ending;
    if (Number.isFinite(values[by])) return values[by];
    return by === "settling_time" ? "not settled" : "no value";
  }

  /** Ends of the scale of colours, and the largest number, which has the colour of the upper end. */
  range() {
    const numbers = this.cells.filter(Boolean).map((cell) => this.value(cell)).filter((value) => typeof value === "number").sort((a, b) => a - b);
    if (!numbers.length) return { low: 0, high: 1, most: 1, log: false };
    const low = numbers[0], high = numbers[Math.floor(MOST_OF_SCALE * (numbers.length - 1))];
    return { low, high, most: numbers.at(-1), log: low > 0 && high / low > 30 };
  }

  colour(cell, { low, high, log }) {
    const value = this.value(cell);
    if (typeof value === "string") return COLOURS[value] ?? COLOURS["no value"];
    const share = log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low || 1);
    return heat(share);
  }

  /** What a place of the grid shows: its own run, or until that is there the one that stands for it; null where there is none. */
  cellFor(x, y) {
    for (let step = 1; step <= SIZE / 8; step *= 2) {
      const cell = this.cells[(y - (y % step)) * SIZE + x - (x % step)];
      if (cell) return cell;
    }
    return null;
  }

  draw() {
    const [c, width, height] = cleared(this.canvas);
    const colour = colours();
    const side = [width - LEFT - 8, height - BOTTOM - 8];
    this.area = [LEFT, 8, ...side];
    c.strokeStyle = colour.line;
    c.strokeRect(LEFT - 0.5, 7.5, side[0] + 1, side[1] + 1);
    c.font = "11px system-ui, sans-serif";
    c.fillStyle = colour.faint;
    if (!this.cells) {
      c.textAlign = "center";
      c.fillText("64 × 64 runs of this scenario", LEFT + side[0] / 2, 8 + side[1] / 2);
      this.explained = "";
      this.legend.replaceChildren();
      write(this.here, "");
      if (!this.running) this.words.textContent = this.refusal || "Each pixel will be a run of the scenario above with two keys varied.";
      return;
    }
    const range = this.range();
    const picture = new ImageData(SIZE, SIZE);
    for (let y = 0; y < SIZE; ++y)
      for (let x = 0; x < SIZE; ++x) {
        const cell = this.cellFor(x, y);
        const at = 4 * ((SIZE - 1 - y) * SIZE + x);
        picture.data.set(cell ? [...this.colour(cell, range), 255] : [128, 128, 128, 40], at);
      }
    const small = (this.small ??= new OffscreenCanvas(SIZE, SIZE));
    small.getContext("2d").putImageData(picture, 0, 0);
    c.imageSmoothingEnabled = false;
    c.globalAlpha = this.isStale ? PALE : 1;
    c.drawImage(small, LEFT, 8, ...side);
    this.borders = borders(SIZE, (x, y) => this.cellFor(x, y)?.ending);
    if (!this.isStale) drawBorders(c, this.borders, SIZE, this.area);
    c.globalAlpha = 1;
    write(this.here, this.extent());
    this.labels(c, width, height, colour);
    if (!this.isStale) this.marks(c, colour);
    this.explain(range);
    this.box.classList.toggle("stale", this.isStale);
    if (this.isStale) this.words.textContent = `${this.count} runs of another scenario: compute the map of this one, or go back to that one.`;
    else if (this.running) this.words.textContent = `${this.count} of ${SIZE * SIZE} runs`;
    else if (this.cells.every((cell) => cell?.refusal)) this.words.textContent = this.cells[0].refusal;
    else this.words.textContent = `${this.count} runs in ${short(this.seconds, 3)} s. Click a pixel to take its values.`;
    this.canvas.dataset.done = this.running ? "" : "yes";
  }

  /** The legend: a bar for the numbers, and the names that colour a cell. */
  explain({ low, high, most, log }) {
    const values = new Set(this.cells.filter(Boolean).map((cell) => this.value(cell)));
    const names = Object.keys(COLOURS).filter((name) => values.delete(name));
    const [from, to, largest] = values.size ? [low, high, most].map((number) => this.number(number, 3)) : [];
    const ends = values.size ? [from, largest === to ? to : `≥ ${to}, up to ${largest}`] : [];
    const bordered = this.borders.length > 0;
    const explained = [this.by.value, ends, log, names, bordered].join();
    if (explained === this.explained) return;
    this.explained = explained;
    const bar = element("i", { class: "bar", style: `--bar: linear-gradient(to right, ${HEAT.map(css).join(", ")})` });
    const numbers = ends.length ? [element("b", {}, ends[0], bar, `${ends[1]}${log ? ", logarithmic" : ""}`)] : [];
    const line = bordered ? [element("span", { class: "border" }, "border of runs that settle, within and beyond limits")] : [];
    this.legend.replaceChildren(...numbers, ...names.map((name) => element("span", { style: `--colour: ${css(COLOURS[name])}` }, name)), ...line);
  }

  /** A number of the metric that colours the map, with its unit. */
  number(value, digits) {
    return withUnit(value, unitOfMetric(this.base, metrics.find(({ name }) => name === this.by.value)), digits);
  }

  labels(c, width, height, colour) {
    c.fillStyle = colour.faint;
    const text = (entry, place) => shown(entry, fromPlace(entry, place));
    const [left, top, wide, high] = this.area;
    for (const share of [0, 0.5, 1]) {
      c.textAlign = share === 0 ? "left" : share === 1 ? "right" : "center";
      c.fillText(text(this.axes[0], share), left + share * wide, height - BOTTOM + 8);
      c.textAlign = "right";
      c.fillText(text(this.axes[1], share), left - 5, top + (1 - share) * high + (share === 1 ? 9 : share === 0 ? 0 : 4));
    }
    c.fillStyle = colour.ink;
    c.textAlign = "center";
    c.fillText(this.axes[0].label, left + wide / 2, height - 5);
    c.save();
    c.translate(11, top + high / 2);
    c.rotate(-Math.PI / 2);
    c.fillText(this.axes[1].label, 0, 0);
    c.restore();
  }

  /** How far runs settle on both sides of the place of the sliders; "" where that is not on the map. */
  extent() {
    if (this.isStale) return "";
    const place = this.axes.map((entry) => toPlace(entry, entry.get(this.state)));
    if (!place.every((share) => share >= 0 && share <= 1)) return "";
    const at = place.map((share) => Math.round(share * (SIZE - 1)));
    const endingAt = (x, y) => this.cellFor(x, y)?.ending;
    if (endingAt(...at) === undefined) return "";
    const found = this.axes.map((_, axis) => settledAround(SIZE, endingAt, at, axis));
    if (found[0] === null) return "The run of the pixel at the ring does not settle.";
    const end = (entry, i) => (i === 0 || i === SIZE - 1 ? "the map's edge" : shown(entry, fromPlace(entry, i / (SIZE - 1))));
    const parts = this.axes.map((entry, axis) => `from ${end(entry, found[axis].first)} to ${end(entry, found[axis].last)} of ${entry.label}`);
    const beyond = found.some((range) => range.isBeyond) ? ", in part beyond a limit" : "";
    return `Here runs settle ${parts.join(", and ")}${beyond}.`;
  }

  /** Where the sliders are, and the cell of the keyboard. */
  marks(c, colour) {
    const [left, top, wide, high] = this.area;
    const [x, y] = this.axes.map((entry) => toPlace(entry, entry.get(this.state)));
    const ring = (px, py, size, style) => {
      c.beginPath();
      c.arc(px, py, size, 0, 7);
      c.strokeStyle = "#000a";
      c.lineWidth = 4;
      c.stroke();
      c.strokeStyle = style;
      c.lineWidth = 2;
      c.stroke();
    };
    if (x >= 0 && x <= 1 && y >= 0 && y <= 1) ring(left + x * wide, top + (1 - y) * high, 6, "#fff");
    if (document.activeElement === this.canvas) {
      const size = [wide / SIZE, high / SIZE];
      c.strokeStyle = colour.accent;
      c.lineWidth = 2;
      c.strokeRect(left + this.cursor[0] * size[0], top + (SIZE - 1 - this.cursor[1]) * size[1], ...size);
    }
  }

  cellAt(event) {
    if (!this.area) return null;
    const [px, py] = pointIn(this.canvas, event);
    const [left, top, wide, high] = this.area;
    const x = Math.floor(((px - left) / wide) * SIZE), y = SIZE - 1 - Math.floor(((py - top) / high) * SIZE);
    return x >= 0 && x < SIZE && y >= 0 && y < SIZE ? [x, y] : null;
  }

  look(at) {
    const cell = at && this.cells?.[at[1] * SIZE + at[0]];
    this.canvas.title = cell ? `${this.by.value === "outcome" ? "" : `${this.by.selectedOptions[0].textContent} `}${this.told(cell)}` : "";
  }

  told(cell) {
    const value = this.value(cell);
    return typeof value === "string" ? value : this.number(value);
  }

  /** A first tap tells the value of a cell, which a finger cannot point at, and a second one takes it. */
  tap(at) {
    if (!at || !this.cells || this.isStale) return;
    if (this.tapped && at.every((place, i) => Math.abs(place - this.tapped[i]) <= FINGER)) {
      this.pick(this.tapped);
      this.tapped = null;
      return;
    }
    const cell = this.cells[at[1] * SIZE + at[0]];
    this.tapped = this.cursor = at;
    this.draw();
    if (cell) this.words.textContent = `${this.told(cell)}; tap again to take its values`;
  }

  pick(at) {
    if (at && this.cells && !this.isStale) this.take((state) => this.at(state, ...at));
  }

  key(event) {
    if (isShortcut(event)) return;
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    if (event.key in moves) {
      this.cursor = this.cursor.map((value, i) => Math.max(0, Math.min(SIZE - 1, value + moves[event.key][i] * (event.shiftKey ? 8 : 1))));
      const cell = this.cells?.[this.cursor[1] * SIZE + this.cursor[0]];
      this.draw();
      if (cell) this.words.textContent = this.told(cell);
    } else if (event.key === "Enter" || event.key === " ") this.pick(this.cursor);
    else return;
    event.preventDefault();
  }
}
