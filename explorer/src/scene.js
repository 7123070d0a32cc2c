/** The machine in space: base, legs, platform, camera with what its image shows, target. Three projects it, and draws it as SVG. */
import { Color, Plane, Raycaster, Scene, Vector2, Vector3 } from "three";
import { SVGRenderer } from "three/addons/renderers/SVGRenderer.js";
import { isPointOutside } from "./imageborder.js";
import { element } from "./controls.js";
import { short } from "./format.js";
import { legsBeyond } from "./limits.js";
import { endsAt, framesAt, isFinitePoint, mean, positionAt, targetAt, vectors } from "./machine.js";
import { BEFORE, BEHIND, ball, floor, lights, pane, path, plate, pyramid, rays, rods } from "./shapes.js";
import { colours, lineColour, pointIn, write } from "./view.js";
import { Viewpoint } from "./viewpoint.js";

const SHARES = [0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1]; // of the time, at which a moving target is kept in the view

const NEAR = 3; // radii of the base, up to which the way of the platform is kept in the view

export class MachineView {
  /**
   * @param {HTMLElement} box
   * @param {(shift: number[] | null, phase: string) => void} drag the platform was moved [m in B]
   */
  constructor(box, drag) {
    this.box = box;
    this.drag = drag;
    this.renderer = new SVGRenderer();
    this.renderer.setPrecision(1);
    this.note = element("p");
    box.append(this.renderer.domElement, this.note);
    this.viewpoint = new Viewpoint(box, () => this.draw(this.row));
    box.addEventListener("pointerdown", (event) => this.take(event));
    box.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) box.addEventListener(name, (event) => this.release(event));
  }

  /** @param {object} result of the core, with `up`: the direction against gravity in B */
  show(result, up) {
    const { scene, rows, targetMoves } = result;
    const { line, panel, accent, c7 } = colours();
    this.result = result;
    this.up = new Vector3(...up).normalize();
    this.base = vectors(scene.base_joints);
    const upInPlatform = this.up.clone().applyQuaternion(framesAt(result, 0).platform.quaternion.conjugate());
    const plates = String([scene.base_joints, scene.platform_joints, up, upInPlatform.toArray(), line, accent, c7]);
    if (this.plates !== plates) this.build(scene, upInPlatform);
    this.plates = plates;
    this.scene = new Scene();
    this.scene.background = new Color(panel);
    if (this.held) return; // the view rests
    const ways = targetMoves ? SHARES.flatMap((share) => targetAt(result, Math.round(share * (rows - 1)))) : [];
    const far = vectors(scene.camera_on_base ? scene.camera_position : scene.target); // what is away from the machine
    const floorPoints = vectors(this.floor.geometry.attributes.position.array).map((point) => point.applyMatrix4(this.floor.matrixWorld));
    this.kept = [...floorPoints, ...far, ...ways, ...this.places()].filter(isFinitePoint);
  }

  /** Where the platform is at the start, and farthest to each side of B as long as it is near: what is kept in the view. */
  places() {
    const { rows, samples: { position } } = this.result;
    const [low, high] = [[0, 0, 0], [0, 0, 0]];
    for (let row = 0; row < rows; ++row) {
      if (!this.isNear(row)) continue;
      for (let k = 0; k < 3; ++k) {
        if (position[3 * row + k] < position[3 * low[k] + k]) low[k] = row;
        if (position[3 * row + k] > position[3 * high[k] + k]) high[k] = row;
      }
    }
    return [0, ...low, ...high].map((row) => positionAt(this.result, row));
  }

  /** Whether the platform is so near to its start at a sample that it is kept in the view. */
  isNear(row) {
    const { position } = this.result.samples;
    let square = 0;
    for (let k = 0; k < 3; ++k) square += (position[3 * row + k] - position[k]) ** 2;
    return square <= (NEAR * this.radius) ** 2;
  }

  /** States how far away a platform is that cannot be seen. */
  tell(row) {
    const place = positionAt(this.result, row);
    const { x, y } = place.clone().project(this.viewpoint.camera);
    const isSeen = this.isNear(row) || Math.max(Math.abs(x), Math.abs(y)) <= 1;
    const away = short(place.distanceTo(positionAt(this.result, 0)), 2);
    write(this.note, isSeen ? "" : `platform ${away} m away, out of view`);
  }

  /** Makes what stays as it is during a run, and from run to run while the machine is the same. */
  build({ platform_joints }, upInPlatform) {
    const { line, accent, c7 } = colours();
    const middle = mean(this.base);
    this.radius = Math.max(...this.base.map((foot) => foot.distanceTo(middle)));
    this.floor = floor(middle, this.up, 1.5 * this.radius, line);
    this.ground = plate(this.base, -0.04 * this.radius, this.up, c7);
    this.platform = plate(vectors(platform_joints), 0.05 * this.radius, upInPlatform, accent);
  }

  /** @param {number} row the sample of now */
  draw(row) {
    if (!this.result) return;
    this.row = row;
    const { result, viewpoint, scene } = this;
    const { clientWidth: width, clientHeight: height } = this.box;
    if (!width || !height) return; // a page that is not laid out yet, or too narrow
    this.renderer.setSize(width, height);
    this.thick = Math.max(2.5, Math.min(9, 0.075 * this.radius * viewpoint.fit(this.kept, this.up, width, height)));
    while (row > 0 && !isFinitePoint(positionAt(result, row))) row -= 1; // the last ones of a run that diverged
    const { base, platform, eye } = framesAt(result, row);
    platform.add(this.platform);
    const side = platform.position.clone().sub(this.floor.position); // of the base on which the legs are
    this.ground.renderOrder = viewpoint.direction.dot(side) < 0 ? BEHIND : BEFORE;
    scene.clear().add(...lights(this.up), this.floor, this.ground, base, path(this.trail(row), colours().warn, 2));
    this.legs(vectors(result.scene.platform_joints).map((joint) => platform.localToWorld(joint)), row);
    this.sight(eye, row);
    this.renderer.render(scene, viewpoint.camera);
    this.tell(row);
  }

  /** Where the platform was, as far as it moved. */
  trail(row) {
    const { position } = this.result.samples;
    const way = [];
    const at = new Vector3();
    for (let k = 0; k <= row; ++k) {
      at.fromArray(position, 3 * k);
      if (!k || at.distanceTo(way.at(-1)) > 0.02 * this.radius) way.push(at.clone());
    }
    return way;
  }

  /** Legs to the platform's joints in B: cylinder and rod, or crank and rod; those beyond their stroke in another colour. */
  legs(joints, row) {
    const { result, scene, base, thick } = this;
    const { ink, faint, warn, panel } = colours();
    const cranks = endsAt(result, row);
    const ends = cranks ?? base.map((foot, i) => foot.clone().lerp(joints[i], 0.55));
    const beyond = legsBeyond(result, row);
    const pairs = (from, to, wanted) => from.map((point, i) => [point, to[i]]).filter((_, i) => beyond.includes(i) === wanted);
    scene.add(rods(pairs(base, ends, false), faint, thick), rods(pairs(ends, joints, false), ink, 0.5 * thick));
    if (beyond.length) scene.add(rods(pairs(base, ends, true), warn, thick), rods(pairs(ends, joints, true), warn, 0.5 * thick));
    for (const foot of base) scene.add(ball(foot, 0.6 * thick, faint, panel));
    for (const joint of [...joints, ...(cranks ?? [])].filter(isFinitePoint)) scene.add(ball(joint, 0.5 * thick, ink, panel));
  }

  /** What the camera's image shows, where that has a border, and lines to the points of the target, hollow those that are outside. */
  sight(eye, row) {
    const { scene, result } = this;
    const { border } = result;
    const { good, line, panel, c1 } = colours();
    const target = targetAt(result, row).filter(isFinitePoint);
    const seen = target.map((point) => eye.worldToLocal(point.clone()));
    const far = seen.length ? seen.reduce((sum, { z }) => sum - z / seen.length, 0) : 2 * this.radius;
    eye.add(ball(new Vector3(), 4, good, panel));
    if (border) eye.add(pyramid(border.map((side) => side / result.scene.focal), Math.min(0.45 * far, 1.2 * this.radius), good));
    if (target.length > 2) scene.add(pane(target, c1));
    const from = eye.getWorldPosition(new Vector3());
    const looks = target.map((_, i) => (isPointOutside(result, row, i) ? [panel, lineColour(i)] : [lineColour(i), panel]));
    scene.add(rays(from, target, line), ...target.map((point, i) => ball(point, 6, ...looks[i])));
  }

  // --- the pointer turns the view, or moves the platform

  /** The ray under a pointer. */
  ray(event) {
    const [x, y] = pointIn(this.box, event);
    const caster = new Raycaster();
    caster.setFromCamera(new Vector2((2 * x) / this.box.clientWidth - 1, 1 - (2 * y) / this.box.clientHeight), this.viewpoint.camera);
    return caster;
  }

  isOnPlatform(event) {
    return this.ray(event).intersectObject(this.platform).length > 0;
  }

  take(event) {
    if (!this.platform || this.held || event.button !== 0) return; // a second finger, or the button of a menu
    this.box.setPointerCapture(event.pointerId);
    this.held = { pointer: event.pointerId, x: event.clientX, y: event.clientY };
    if (!this.isOnPlatform(event)) return;
    const plane = new Plane().setFromNormalAndCoplanarPoint(this.viewpoint.direction, positionAt(this.result, 0));
    this.held.place = (at) => this.ray(at).ray.intersectPlane(plane, new Vector3());
    this.held.start = this.held.place(event);
    this.drag([0, 0, 0], "begin");
  }

  move(event) {
    if (!this.platform) return;
    if (!this.held) this.box.style.cursor = this.isOnPlatform(event) ? "move" : "grab";
    else if (event.pointerId !== this.held.pointer) return;
    else if (this.held.start) this.drag(this.held.place(event).sub(this.held.start).toArray(), "move");
    else {
      const { x, y } = this.held;
      Object.assign(this.held, { x: event.clientX, y: event.clientY });
      this.viewpoint.turn(0.008 * (event.clientX - x), 0.008 * (event.clientY - y));
    }
  }

  release(event) {
    if (event.pointerId !== this.held?.pointer) return;
    const moved = this.held.start;
    this.held = null;
    if (moved) this.drag(null, "end");
  }
}
