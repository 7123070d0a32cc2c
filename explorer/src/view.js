/** Canvases that are as sharp as the screen, and the colours of the page. */

const COLOURS = ["ink", "faint", "line", "paper", "panel", "accent", "good", "bad", "warn", "c0", "c1", "c2", "c3", "c4", "c5", "c6", "c7"];
let palette = null;

/** Whether the page is drawn in dark colours: paper is light. */
export const dark = matchMedia("screen and (prefers-color-scheme: dark)");

/** Colours by name, those of light or dark. */
export function colours() {
  if (palette) return palette;
  const style = getComputedStyle(document.documentElement);
  palette = Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  return palette;
}
dark.addEventListener("change", () => (palette = null));

const LINE_COLOURS = 8;

/** One colour for each line of a figure, or point of the target; they begin again after eight. */
export const lineColour = (i) => colours()[`c${i % LINE_COLOURS}`];

const DASHES = [undefined, [6, 4], [2, 3], [8, 3, 2, 3]]; // pixels

/**
 * Colour and dash of a line of a figure: those of one point have its colour in the image, and each time that colours begin again there are other dashes.
 * @param {number} i line, from 0
 * @param {number} each lines of a point: the first and second coordinate
 */
export function lookOf(i, each = 1) {
  const point = Math.floor(i / each);
  return { stroke: lineColour(point), dash: DASHES[(each * Math.floor(point / LINE_COLOURS) + (i % each)) % DASHES.length] };
}

/** A line of a look as the background of a short piece of it. */
export function strip({ stroke, dash }) {
  if (!dash) return stroke;
  const ends = dash.map((_, k) => dash.slice(0, k + 1).reduce((sum, length) => sum + length, 0));
  return `repeating-linear-gradient(90deg, ${ends.map((end, k) => `${k % 2 ? "transparent" : stroke} ${ends[k - 1] ?? 0}px ${end}px`).join(", ")})`;
}

const PALE = 0.3; // share of a colour, the rest of which is that of the panel

/** The colour of what is behind a line of a colour, pale where lines lie one on the other too. */
export function pale(colour) {
  const [own, panel] = [colour, colours().panel].map((hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16)));
  return `rgb(${own.map((part, k) => Math.round(PALE * part + (1 - PALE) * panel[k])).join(" ")})`;
}

/** Writes a text where it is another one: what stays the same need not be laid out again. */
export function write(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/**
 * Clears a canvas that fills its box.
 * @returns {[CanvasRenderingContext2D, number, number]} the context in CSS pixels, width and height
 */
export function cleared(canvas) {
  const scale = Math.min(devicePixelRatio || 1, 2);
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.clearRect(0, 0, width, height);
  return [context, width, height];
}

const FINE = 0.3; // pixels that a line may be longer or shorter for being drawn with fewer pieces

/** Adds a line through many places to the path of a context: those that can be told apart, and the last one. Places that are not finite are left out. */
export class Line {
  constructor(context) {
    Object.assign(this, { context, x: NaN, y: NaN, drawnX: NaN, drawnY: NaN });
  }

  to(x, y) {
    if (!Number.isFinite(x + y)) return;
    this.x = x;
    this.y = y;
    if (Math.abs(x - this.drawnX) + Math.abs(y - this.drawnY) < FINE) return;
    this.context.lineTo(x, y);
    this.drawnX = x;
    this.drawnY = y;
  }

  end() {
    if (Number.isFinite(this.x)) this.context.lineTo(this.x, this.y);
  }
}

/** Where a pointer is in a canvas [CSS pixels]. */
export function pointIn(canvas, event) {
  const box = canvas.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}

/** Whether a key is one of the browser's own, to go back or to enlarge the page. */
export const isShortcut = (event) => event.ctrlKey || event.metaKey || event.altKey;

/** Numbers for about `count` ticks between two limits. */
export function ticks(low, high, count) {
  const raw = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= raw * 0.999);
  const found = [];
  for (let i = Math.ceil(low / step); i * step <= high + 1e-9 * step; ++i) found.push(i * step);
  return [found, step];
}
