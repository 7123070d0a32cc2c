/** The machine in space, on a plain canvas: base, legs, platform, camera with what it sees, target. */
import { cleared, colours, lineColour, pointIn } from "./view.js";

const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const norm = (a) => Math.sqrt(dot(a, a));
const unit = (a) => add([0, 0, 0], a, 1 / (norm(a) || 1));
const triple = (numbers, i) => [numbers[3 * i], numbers[3 * i + 1], numbers[3 * i + 2]];
const mean = (points) => points.reduce((sum, point) => add(sum, point, 1 / points.length), [0, 0, 0]);

/** Rows of the rotation matrix of a quaternion (w, x, y, z). */
function rotation([w, x, y, z]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}
const turned = (R, v) => [dot(R[0], v), dot(R[1], v), dot(R[2], v)];

/** Points in the order in which they go round their middle. */
function ring(points) {
  const middle = mean(points);
  let normal = [0, 0, 0];
  for (let i = 1; i < points.length; ++i) {
    const n = cross(add(points[0], middle, -1), add(points[i], middle, -1));
    if (norm(n) > norm(normal)) normal = n;
  }
  const u = unit(add(points[0], middle, -1));
  const v = unit(cross(normal, u));
  const angle = (p) => Math.atan2(dot(add(p, middle, -1), v), dot(add(p, middle, -1), u));
  return [[...points].sort((a, b) => angle(a) - angle(b)), unit(normal)];
}

export class Scene {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {(shift: number[], final: boolean) => void} drag the platform was moved [m in B]
   */
  constructor(canvas, drag) {
    this.canvas = canvas;
    this.drag = drag;
    this.turn = -0.6;
    this.tilt = 0.32;
    this.zoom = 1;
    canvas.addEventListener("pointerdown", (event) => this.take(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => this.release(event));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  /** @param {object} result of the core, with `up`: the direction against gravity in B */
  show(result, up) {
    this.result = result;
    this.up = unit(up);
    const { scene, samples } = result;
    const home = samples.position.subarray(0, 3);
    this.base = Array.from({ length: 6 }, (_, i) => triple(scene.base_joints, i));
    const target = Array.from({ length: result.points }, (_, i) => triple(scene.target, i));
    if (this.held) return;
    this.machine = Math.max(...this.base.map((p) => norm(add(p, mean(this.base), -1))));
    const ways = result.targetMoves ? [0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1].flatMap((share) => this.targetAt(Math.round(share * (result.rows - 1)))) : [];
    const far = scene.camera_on_base ? [Array.from(scene.camera_position)] : target; // what is away from the machine
    this.all = [...this.floorCircle(1.5), ...far, ...ways, Array.from(home)].filter((point) => point.every(Number.isFinite));
    const low = [0, 1, 2].map((k) => Math.min(...this.all.map((p) => p[k])));
    const high = [0, 1, 2].map((k) => Math.max(...this.all.map((p) => p[k])));
    this.middle = low.map((value, k) => (value + high[k]) / 2);
    this.size = 0.5 * norm(add(high, low, -1)) || 1;
  }

  /** Ends of the cranks in B at a sample: b + r (cos q e + sin q (a x e)); null where the legs have none. */
  ends(row) {
    const { cranks, samples } = this.result;
    if (!cranks) return null;
    return this.base.map((foot, i) => {
      const [axis, zero] = [triple(cranks.axes, i), triple(cranks.zero, i)];
      const angle = samples.leg_lengths[6 * row + i];
      return add(add(foot, zero, cranks.length * Math.cos(angle)), cross(axis, zero), cranks.length * Math.sin(angle));
    });
  }

  /** Place of the platform at a sample: position, rotation, and a point of E in B. */
  pose(row) {
    const { samples } = this.result;
    const position = Array.from(samples.position.subarray(3 * row, 3 * row + 3));
    const R = rotation(samples.quaternion.subarray(4 * row, 4 * row + 4));
    return { position, R, inBase: (point) => add(position, turned(R, point)) };
  }

  /** Place of the camera at a sample in B, and its directions there. */
  cameraAt(row) {
    const { scene } = this.result;
    const { R, inBase } = this.pose(row);
    const A = [0, 1, 2].map((k) => triple(scene.camera_attitude, k));
    return scene.camera_on_base
      ? { eye: [...scene.camera_position], along: (v) => turned(A, v) }
      : { eye: inBase(scene.camera_position), along: (v) => turned(R, turned(A, v)) };
  }

  /** Points of the target in B at a sample, from their image and depth: where it moves, it moves here too. */
  targetAt(row) {
    const { scene, samples, points } = this.result;
    const { eye, along } = this.cameraAt(row);
    return Array.from({ length: points }, (_, i) => {
      const at = points * row + i;
      const [x, y] = [0, 1].map((k) => scene.goal[2 * i + k] - samples.feature_error[2 * at + k]);
      const depth = samples.depth[at];
      return add(eye, along([(-depth / scene.focal) * x, (-depth / scene.focal) * y, depth]));
    });
  }

  /** A circle about the base, of so many times its radius. */
  floorCircle(share) {
    const middle = mean(this.base);
    const side = unit(cross(this.up, Math.abs(this.up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]));
    const front = cross(side, this.up);
    const radius = share * this.machine;
    return Array.from({ length: 49 }, (_, k) => {
      const angle = (2 * Math.PI * k) / 48;
      return add(add(middle, side, radius * Math.cos(angle)), front, radius * Math.sin(angle));
    });
  }

  /** Chooses scale and middle so that base and target fill the canvas. */
  fit(width, height) {
    [this.centre, this.pixels] = [[0, 0], 1];
    const flat = this.all.map((point) => this.project(point));
    const [xs, ys] = [0, 1].map((k) => flat.map((p) => p[k]));
    const [left, right, top, bottom] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    this.pixels = this.zoom * Math.min((width - 24) / (right - left), (height - 28) / (bottom - top));
    this.centre = [width / 2 - (this.pixels * (left + right)) / 2, height / 2 - (this.pixels * (top + bottom)) / 2];
  }

  axes() {
    const up = this.up;
    const side = unit(cross(up, Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]));
    const front = cross(side, up);
    const [cos, sin] = [Math.cos(this.turn), Math.sin(this.turn)];
    const right = add(add([0, 0, 0], side, cos), front, sin);
    const ahead = add(add([0, 0, 0], front, cos), side, -sin);
    const [ct, st] = [Math.cos(this.tilt), Math.sin(this.tilt)];
    return { right, upward: add(add([0, 0, 0], up, ct), ahead, st), depth: add(add([0, 0, 0], ahead, ct), up, -st) };
  }

  project(point) {
    const p = add(point, this.middle, -1);
    const distance = 4.2 * this.size + dot(p, this.camera.depth);
    const scale = (this.pixels * 4.2 * this.size) / Math.max(distance, 0.05 * this.size);
    return [this.centre[0] + scale * dot(p, this.camera.right), this.centre[1] - scale * dot(p, this.camera.upward), distance, scale];
  }

  /** @param {number} row the sample of now */
  draw(row) {
    if (!this.result) return;
    const [c, width, height] = cleared(this.canvas);
    const { scene, samples, rows } = this.result;
    const colour = colours();
    this.camera = this.axes();
    this.fit(width, height);
    this.row = row;
    const { inBase } = this.pose(row);
    const joints = Array.from({ length: 6 }, (_, i) => inBase(triple(scene.platform_joints, i)));
    const things = [];
    const push = (points, paint) => {
      const flat = points.map((point) => this.project(point));
      things.push([flat.reduce((sum, p) => sum + p[2], 0) / flat.length, () => paint(flat)]);
    };
    const shape = (fill, stroke, alpha = 1) => (flat) => {
      c.beginPath();
      for (const [x, y] of flat) c.lineTo(x, y);
      c.closePath();
      c.globalAlpha = alpha;
      c.fillStyle = fill;
      if (fill) c.fill();
      c.globalAlpha = 1;
      c.strokeStyle = stroke;
      c.lineWidth = 1;
      if (stroke) c.stroke();
    };
    const stroke = (style, width, dash = []) => (flat) => {
      c.beginPath();
      for (const [x, y] of flat) c.lineTo(x, y);
      c.setLineDash(dash);
      c.lineCap = "round";
      c.strokeStyle = style;
      c.lineWidth = width;
      c.stroke();
      c.setLineDash([]);
    };
    const ball = (point, radius, fill) =>
      push([point], ([[x, y]]) => {
        c.beginPath();
        c.arc(x, y, radius, 0, 7);
        c.fillStyle = fill;
        c.fill();
        c.strokeStyle = colour.panel;
        c.lineWidth = 1;
        c.stroke();
      });
    this.floor(push, stroke, colour);
    this.plate(push, shape, ring(this.base), -0.04 * this.machine, colour.c7, colour);
    const [platform, normal] = ring(joints);
    this.plate(push, shape, [platform, normal], 0.05 * this.machine * Math.sign(dot(normal, this.up) || 1), colour.accent, colour);
    this.hit = platform.map((point) => this.project(point));
    const thick = Math.max(2.5, Math.min(9, 0.075 * this.machine * this.pixels));
    const lost = this.result.outcome !== "completed" && row === rows - 1;
    this.base.forEach((foot, i) => {
      const middle = this.ends(row)?.[i] ?? add(foot, add(joints[i], foot, -1), 0.55); // end of the crank, or of the cylinder
      push([foot, middle], stroke(colour.faint, thick));
      push([middle, joints[i]], stroke(lost ? colour.bad : colour.ink, 0.5 * thick));
      if (this.result.cranks) ball(middle, 0.5 * thick, colour.ink);
      ball(foot, 0.6 * thick, colour.faint);
      ball(joints[i], 0.5 * thick, colour.ink);
    });
    this.sight(push, shape, stroke, ball, colour);
    if (rows > 1) {
      const trail = [];
      for (let k = 0; k <= row; k += Math.max(1, Math.floor(row / 150))) trail.push(Array.from(samples.position.subarray(3 * k, 3 * k + 3)));
      push(trail, stroke(colour.warn, 2));
    }
    things.sort((a, b) => b[0] - a[0]);
    for (const [, paint] of things) paint();
  }

  floor(push, stroke, colour) {
    for (const share of [0.75, 1.5]) push(this.floorCircle(share), stroke(colour.line, 1));
    const circle = this.floorCircle(1.5);
    for (const k of [0, 12]) push([circle[k], circle[k + 24]], stroke(colour.line, 1));
  }

  plate(push, shape, [corners, normal], height, fill, colour) {
    const above = corners.map((corner) => add(corner, normal, height));
    const light = 0.5 + 0.5 * Math.abs(dot(normal, this.camera.upward));
    corners.forEach((corner, i) => {
      const j = (i + 1) % corners.length;
      push([corner, corners[j], above[j], above[i]], shape(fill, colour.panel, 0.75));
    });
    push(corners, shape(fill, colour.panel, 0.55 + 0.3 * light));
    push(above, shape(fill, colour.panel, 0.6 + 0.35 * light));
  }

  /** The camera's pyramid, and lines to the points of the target. */
  sight(push, shape, stroke, ball, colour) {
    const { eye, along } = this.cameraAt(this.row);
    const ahead = along([0, 0, -1]);
    const known = this.targetAt(this.row).filter((point) => point.every(Number.isFinite));
    const far = known.length ? dot(add(mean(known), eye, -1), ahead) : 2 * this.machine;
    const half = known.reduce((most, point) => {
      const p = add(point, eye, -1);
      return Math.max(most, ...[along([1, 0, 0]), along([0, 1, 0])].map((axis) => Math.abs(dot(p, axis) / dot(p, ahead))));
    }, 0.15);
    const reach = Math.min(0.45 * far, 1.2 * this.machine);
    const corner = (x, y) => add(eye, along([1.25 * half * x, 1.25 * half * y, -1]), reach);
    const corners = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
    corners.forEach((point, i) => push([eye, point, corners[(i + 1) % 4]], shape(colour.good, colour.good, 0.1)));
    ball(eye, 4, colour.good);
    if (known.length > 2) push(known, shape(colour.c1, "", 0.12));
    known.forEach((point, i) => {
      push([eye, point], stroke(colour.line, 1, [3, 4]));
      ball(point, 6, lineColour(i));
    });
  }

  // --- pointer and keys

  inside([x, y]) {
    let odd = false;
    this.hit.forEach(([ax, ay], i) => {
      const [bx, by] = this.hit[(i + 1) % this.hit.length];
      if (ay > y !== by > y && x < ax + ((y - ay) / (by - ay)) * (bx - ax)) odd = !odd;
    });
    return odd;
  }

  take(event) {
    if (!this.hit) return;
    const at = pointIn(this.canvas, event);
    this.held = { at, platform: this.inside(at), camera: this.camera, scale: this.project(Array.from(this.result.samples.position.subarray(0, 3)))[3] };
    if (this.held.platform) this.drag([0, 0, 0], "begin");
    this.canvas.setPointerCapture(event.pointerId);
  }

  move(event) {
    if (!this.hit) return;
    const at = pointIn(this.canvas, event);
    if (!this.held) {
      this.canvas.style.cursor = this.inside(at) ? "move" : "grab";
      return;
    }
    const [dx, dy] = [at[0] - this.held.at[0], at[1] - this.held.at[1]];
    if (this.held.platform) {
      const { camera, scale } = this.held;
      this.drag(add(add([0, 0, 0], camera.right, dx / scale), camera.upward, -dy / scale), "move");
      return;
    }
    this.turn += 0.008 * dx;
    this.tilt = Math.max(-1.4, Math.min(1.4, this.tilt + 0.008 * dy));
    this.held.at = at;
    this.draw(this.row);
  }

  release() {
    const platform = this.held?.platform;
    this.held = null;
    if (platform) this.drag(null, "end");
  }

  wheel(event) {
    if (!event.ctrlKey && document.activeElement !== this.canvas) return; // the page scrolls
    event.preventDefault();
    this.zoom = Math.max(0.3, Math.min(8, this.zoom * Math.exp(-0.0015 * event.deltaY)));
    this.draw(this.row);
  }

  key(event) {
    const moves = { ArrowLeft: ["turn", -0.1], ArrowRight: ["turn", 0.1], ArrowUp: ["tilt", 0.1], ArrowDown: ["tilt", -0.1] };
    if (event.key in moves) {
      const [name, step] = moves[event.key];
      this[name] += step;
    } else if (event.key === "+" || event.key === "=") this.zoom = Math.min(8, this.zoom * 1.2);
    else if (event.key === "-") this.zoom = Math.max(0.3, this.zoom / 1.2);
    else return;
    event.preventDefault();
    this.draw(this.row);
  }
}
