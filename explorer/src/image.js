/** The image plane: paths of the features, their goals, which can be dragged, and where they are now. */
import { isPointOutside } from "./imageborder.js";
import { short } from "./format.js";
import { Line, cleared, colours, isShortcut, lineColour, pale, pointIn, ticks } from "./view.js";

const NEAR = 22; // pixels within which a goal is taken
const PAD = 34;

export class ImageView {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {(goals: number[], final: boolean) => void} drag what moved goals come to [px]
   */
  constructor(canvas, drag) {
    this.canvas = canvas;
    this.drag = drag;
    this.held = -1;
    this.chosen = 0;
    canvas.addEventListener("pointerdown", (event) => this.take(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) canvas.addEventListener(name, (event) => this.release(event));
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  /** @param {object} shown a result of the core, with `goals` [px] and whether they are `movable`, `border`: sides of the image [px] or null, and `ghost`: another run of as many points or null */
  show(shown) {
    this.shown = shown;
    if (this.held < 0) this.fit();
  }

  fit() {
    const { goals, samples, rows, points } = this.shown;
    const errors = samples.feature_error;
    let [left, right, low, high] = [Infinity, -Infinity, Infinity, -Infinity];
    const take = (x, y) => {
      if (!(Math.abs(x) < 1e5 && Math.abs(y) < 1e5)) return;
      if (x < left) left = x;
      if (x > right) right = x;
      if (y < low) low = y;
      if (y > high) high = y;
    };
    for (let i = 0; i < points; ++i) {
      const [x, y] = [goals[2 * i], goals[2 * i + 1]];
      take(x, y);
      for (let at = 2 * i; at < 2 * points * rows; at += 2 * points) take(x - errors[at], y - errors[at + 1]);
    }
    const half = 0.56 * Math.max(right - left, high - low, 2);
    this.view = { x: (left + right) / 2, y: (low + high) / 2, half };
  }

  feature(samples, row, point) {
    const { goals, points } = this.shown;
    const at = 2 * points * row + 2 * point;
    return [goals[2 * point] - samples.feature_error[at], goals[2 * point + 1] - samples.feature_error[at + 1]];
  }

  place(x, y) {
    return [this.middle[0] + (x - this.view.x) * this.scale, this.middle[1] - (y - this.view.y) * this.scale];
  }

  /** @param {number} row the sample of now */
  draw(row) {
    if (!this.shown) return;
    this.row = row;
    const [c, width, height] = cleared(this.canvas);
    const { goals, samples, points } = this.shown;
    const colour = colours();
    this.middle = [PAD / 2 + width / 2, (height - PAD / 2) / 2];
    this.scale = Math.min(width - PAD, height - PAD) / (2 * this.view.half);
    this.grid(c, width, height);
    c.lineJoin = "round";
    c.lineWidth = 1.6;
    const { ghost } = this.shown;
    if (ghost) this.paths(c, { ...ghost, goals: ghost.scene.goal }, (i) => pale(lineColour(i)));
    this.paths(c, this.shown, lineColour);
    this.showsBorder = this.shown.border !== null && this.frame(c, this.shown.border, width, height);
    c.setLineDash([4, 4]);
    c.strokeStyle = colour.faint;
    c.lineWidth = 1;
    this.outline(c, (i) => this.feature(samples, row, i));
    c.setLineDash([]);
    for (let i = 0; i < points; ++i) {
      const [startX, startY] = this.place(...this.feature(samples, 0, i));
      const goal = this.place(goals[2 * i], goals[2 * i + 1]);
      const now = this.place(...this.feature(samples, row, i));
      c.strokeStyle = lineColour(i);
      c.lineWidth = 1.5;
      c.beginPath(); // a diamond: squares are goals in the figures of the package, and circles what is seen now
      c.moveTo(startX, startY - 6);
      for (const [x, y] of [[6, 0], [0, 6], [-6, 0]]) c.lineTo(startX + x, startY + y);
      c.closePath();
      c.stroke();
      c.beginPath();
      c.arc(...now, 4.5, 0, 7);
      const looks = [lineColour(i), colour.panel];
      [c.fillStyle, c.strokeStyle] = isPointOutside(this.shown, row, i) ? looks.reverse() : looks;
      c.fill();
      c.lineWidth = 1.5;
      c.stroke();
      c.strokeStyle = lineColour(i);
      const arm = i === this.held ? 14 : 11;
      c.lineWidth = 2.2;
      c.beginPath();
      c.moveTo(goal[0] - arm, goal[1]);
      c.lineTo(goal[0] + arm, goal[1]);
      c.moveTo(goal[0], goal[1] - arm);
      c.lineTo(goal[0], goal[1] + arm);
      c.stroke();
      if (i === this.held || (document.activeElement === this.canvas && i === this.chosen)) {
        c.beginPath();
        c.arc(...goal, 14, 0, 7);
        c.strokeStyle = colour.accent;
        c.stroke();
      }
    }
  }

  paths(c, run, colourOf) {
    for (let i = 0; i < run.points; ++i) {
      c.beginPath();
      this.path(c, run, i);
      c.strokeStyle = colourOf(i);
      c.stroke();
    }
  }

  /** Where a feature went: a line for each piece of way that can be seen, and to what was the last finite place. */
  path(c, { goals, samples, rows, points, stride = 1 }, point) {
    const errors = samples.feature_error;
    const [goalX, goalY] = this.place(goals[2 * point], goals[2 * point + 1]);
    const line = new Line(c);
    const to = (at) => line.to(goalX - this.scale * errors[at], goalY + this.scale * errors[at + 1]);
    const last = 2 * points * (rows - 1) + 2 * point;
    for (let at = 2 * point; at < last; at += 2 * points * stride) to(at);
    to(last);
    line.end();
  }

  /** The border of the camera's image; returns whether a side of it is in the picture. */
  frame(c, [left, right, low, high], width, height) {
    const [[x, y], [farX, farY]] = [this.place(left, high), this.place(right, low)];
    c.strokeStyle = colours().good;
    c.lineWidth = 1.5;
    c.strokeRect(x, y, farX - x, farY - y);
    const crosses = (at, end, from, to, otherEnd) => at > 0 && at < end && to > 0 && from < otherEnd;
    return [x, farX].some((at) => crosses(at, width, y, farY, height)) || [y, farY].some((at) => crosses(at, height, x, farX, width));
  }

  /** Around the features, in the order of their direction from the middle. */
  outline(c, feature) {
    const corners = Array.from({ length: this.shown.points }, (_, i) => feature(i));
    const [x, y] = [0, 1].map((k) => corners.reduce((sum, corner) => sum + corner[k], 0) / corners.length);
    corners.sort((a, b) => Math.atan2(a[1] - y, a[0] - x) - Math.atan2(b[1] - y, b[0] - x));
    c.beginPath();
    for (const corner of corners) c.lineTo(...this.place(...corner));
    c.closePath();
    c.stroke();
  }

  grid(c, width, height) {
    const colour = colours();
    const [left, right] = [this.view.x - (this.middle[0] - PAD) / this.scale, this.view.x + (width - this.middle[0]) / this.scale];
    const [low, high] = [this.view.y - (height - PAD / 2 - this.middle[1]) / this.scale, this.view.y + this.middle[1] / this.scale];
    c.font = "11px system-ui, sans-serif";
    c.fillStyle = colour.faint;
    c.strokeStyle = colour.line;
    c.lineWidth = 1;
    c.textAlign = "center";
    for (const x of ticks(left, right, 6)[0]) {
      const at = this.place(x, 0)[0];
      c.beginPath();
      c.moveTo(at, 0);
      c.lineTo(at, height - PAD / 2);
      c.stroke();
      if (at > PAD && at < width - 12) c.fillText(short(x), at, height - 3);
    }
    c.textAlign = "right";
    for (const y of ticks(low, high, 6)[0]) {
      const at = this.place(0, y)[1];
      c.beginPath();
      c.moveTo(PAD, at);
      c.lineTo(width, at);
      c.stroke();
      if (at > 8 && at < height - PAD / 2) c.fillText(short(y), PAD - 4, at + 4);
    }
  }

  // --- dragging

  at(event) {
    const [x, y] = pointIn(this.canvas, event);
    return [this.view.x + (x - this.middle[0]) / this.scale, this.view.y - (y - this.middle[1]) / this.scale];
  }

  gripped(event) {
    return this.at(event).map((under, k) => under + this.grip[k]);
  }

  near(event) {
    if (!this.shown.movable) return -1;
    const [x, y] = pointIn(this.canvas, event);
    let best = [-1, NEAR];
    for (let i = 0; i < this.shown.points; ++i) {
      const [gx, gy] = this.place(this.shown.goals[2 * i], this.shown.goals[2 * i + 1]);
      const distance = Math.hypot(gx - x, gy - y);
      if (distance < best[1]) best = [i, distance];
    }
    return best[0];
  }

  take(event) {
    if (!this.shown || this.held >= 0 || event.button !== 0) return; // a second finger, or the button of a menu
    const point = this.near(event);
    if (point < 0) return;
    this.held = this.chosen = point;
    this.pointer = event.pointerId;
    this.last = this.shown.goals.slice(2 * point, 2 * point + 2);
    const under = this.at(event);
    this.grip = [this.last[0] - under[0], this.last[1] - under[1]]; // a goal is taken where the pointer is, not moved there
    this.moved = false;
    this.canvas.setPointerCapture(event.pointerId);
    event.preventDefault();
  }

  move(event) {
    if (!this.shown || !this.middle) return;
    if (this.held < 0) {
      this.canvas.style.cursor = this.near(event) < 0 ? "default" : "grab";
      return;
    }
    if (event.pointerId !== this.pointer) return;
    this.last = this.gripped(event);
    this.moved = true;
    this.set(this.held, this.last, false);
  }

  release(event) {
    if (this.held < 0 || event.pointerId !== this.pointer) return;
    const point = this.held;
    this.held = -1;
    if (this.moved) this.set(point, event.type === "pointerup" ? this.gripped(event) : this.last, true); // one that was cancelled is at no place
  }

  set(point, [x, y], final) {
    const goals = [...this.shown.goals];
    goals[2 * point] = Math.round(10 * x) / 10;
    goals[2 * point + 1] = Math.round(10 * y) / 10;
    this.drag(goals, final);
  }

  key(event) {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    if (!this.shown?.movable || isShortcut(event)) return;
    if (event.key in steps) {
      const size = event.shiftKey ? 10 : 1;
      const [dx, dy] = steps[event.key];
      const { goals } = this.shown;
      this.set(this.chosen, [goals[2 * this.chosen] + size * dx, goals[2 * this.chosen + 1] + size * dy], true);
      event.preventDefault();
    } else if (/^[1-9]$/.test(event.key) && Number(event.key) <= this.shown.points) {
      this.chosen = Number(event.key) - 1;
      this.draw(this.row);
    }
  }
}
