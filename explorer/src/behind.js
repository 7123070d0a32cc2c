/** What a chart has behind its curves: the settling band and the settling time, limits of the legs, and the preset's errors. */
import { withUnit } from "./format.js";
import { Line, colours, lineColour, pale } from "./view.js";

const FAINTER = 0.15; // a band beside a line of its colour
const FONT = 11; // pixels
const GAP = 3; // pixels, between words and lines

/** Draws within the axes of a plot; `draw` gets the context, in whose pixels lines and letters are `size` times as large as on the screen. */
function within(plot, draw) {
  const { ctx, bbox } = plot;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.font = `${FONT * devicePixelRatio}px system-ui, sans-serif`;
  draw(ctx, devicePixelRatio);
  ctx.restore();
}

/**
 * Errors of another run, pale, as far as the plot's time goes.
 * @param {{rows: number, points: number, stride: number, samples: {time: Float64Array, feature_error: Float64Array}}} run stride: from one sample that is drawn to the next
 * @param {Array<{stroke: string, dash?: number[]}>} looks of its curves
 */
export function drawErrors(plot, { rows, points, stride, samples }, looks) {
  const { time, feature_error: errors } = samples;
  const [left, top] = [plot.valToPos(0, "x", true), plot.valToPos(0, "y", true)];
  const [right, up] = [plot.valToPos(1, "x", true) - left, plot.valToPos(1, "y", true) - top]; // of a second, and of a pixel of the image
  const later = time.findIndex((t) => t > plot.scales.x.max);
  const last = later < 0 ? rows - 1 : later;
  within(plot, (ctx, size) => {
    looks.forEach(({ stroke, dash = [] }, j) => {
      ctx.strokeStyle = pale(stroke);
      ctx.lineWidth = 1.4 * size;
      ctx.setLineDash(dash.map((length) => length * size));
      ctx.beginPath();
      const line = new Line(ctx);
      const to = (k) => line.to(left + right * time[k], top + up * errors[2 * points * k + j]);
      for (let k = 0; k < last; k += stride) to(k);
      to(last);
      line.end();
      ctx.stroke();
    });
  });
}

/**
 * The band that a settled run stays in, and when it entered that.
 * @param {{band: number, metrics: {settling_time: number}}} result band [px], time [s]
 */
export function drawSettling(plot, { band, metrics: { settling_time: time } }) {
  within(plot, (ctx, size) => {
    const { left, top, width, height } = plot.bbox;
    const [low, high] = [-band, band].map((value) => plot.valToPos(value, "y", true));
    ctx.fillStyle = colours().good;
    ctx.globalAlpha = FAINTER;
    ctx.fillRect(left, high, width, low - high);
    ctx.globalAlpha = 1;
    const isHigh = low + high < 2 * top + height; // then there is room for words below
    ctx.textAlign = "right";
    ctx.textBaseline = isHigh ? "top" : "bottom";
    ctx.fillText(`± ${withUnit(band, "px")}`, left + width - GAP * size, isHigh ? low + GAP * size : high - GAP * size);
    if (Number.isNaN(time)) return;
    const x = Math.round(plot.valToPos(time, "x", true));
    ctx.fillRect(x, top, size, height);
    const isLate = x > left + width / 2;
    ctx.textAlign = isLate ? "right" : "left";
    ctx.textBaseline = isHigh ? "bottom" : "top";
    ctx.fillText(withUnit(time, "s"), x + (isLate ? -GAP : GAP) * size, isHigh ? top + height - GAP * size : top + GAP * size);
  });
}

const nameOf = (legs) => (legs.length === 6 ? "limit" : `limit of leg${legs.length > 1 ? "s" : ""} ${legs.map((leg) => leg + 1).join(", ")}`);

/**
 * Limits of the legs, where the scale of the curves has them: a limit of one leg in its colour, one of more in that of a warning.
 * @param {Array<{value: number, legs: number[]}>} bounds in the unit of the plot
 */
export function drawBounds(plot, bounds) {
  const { min, max } = plot.scales.y;
  const { left, width } = plot.bbox;
  within(plot, (ctx, size) => {
    for (const { value, legs } of bounds) {
      if (!(value >= min && value <= max)) continue;
      const y = Math.round(plot.valToPos(value, "y", true));
      ctx.fillStyle = legs.length > 1 ? colours().warn : lineColour(legs[0]);
      ctx.fillRect(left, y, width, size);
      ctx.textAlign = "right";
      const isHigh = value > (min + max) / 2;
      ctx.textBaseline = isHigh ? "top" : "bottom";
      ctx.fillText(nameOf(legs), left + width - GAP * size, y + (isHigh ? GAP : -GAP) * size);
    }
  });
}
