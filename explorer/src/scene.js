/** The machine in space: base, legs, platform, camera with what it sees, target. Three projects it, and draws it as SVG. */
import { AmbientLight, Color, DirectionalLight, Plane, PolarGridHelper, Raycaster, Scene, Vector2, Vector3 } from "three";
import { SVGRenderer } from "three/addons/renderers/SVGRenderer.js";
import { endsAt, framesAt, isFinitePoint, positionAt, targetAt, vectors } from "./machine.js";
import { BEHIND, ball, pane, path, plate, pyramid, rod } from "./shapes.js";
import { colours, lineColour, pointIn } from "./view.js";
import { Viewpoint } from "./viewpoint.js";

const TRAIL = 150; // pieces, at most
const SHARES = [0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1]; // of the time, at which a moving target is kept in the view

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
    box.append(this.renderer.domElement);
    this.viewpoint = new Viewpoint(box, () => this.draw(this.row));
    box.addEventListener("pointerdown", (event) => this.take(event));
    box.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) box.addEventListener(name, () => this.release());
  }

  /** @param {object} result of the core, with `up`: the direction against gravity in B */
  show(result, up) {
    this.result = result;
    this.up = new Vector3(...up).normalize();
    this.base = vectors(result.scene.base_joints);
    this.middle = this.base.reduce((sum, foot) => sum.addScaledVector(foot, 1 / 6), new Vector3());
    this.radius = Math.max(...this.base.map((foot) => foot.distanceTo(this.middle)));
    if (this.held) return; // the view rests
    const { scene, rows, targetMoves } = result;
    const ways = targetMoves ? SHARES.flatMap((share) => targetAt(result, Math.round(share * (rows - 1)))) : [];
    const far = vectors(scene.camera_on_base ? scene.camera_position : scene.target); // what is away from the machine
    const floor = this.floor();
    const circles = vectors(floor.geometry.attributes.position.array).map((point) => floor.localToWorld(point));
    this.kept = [...circles, ...far, ...ways, positionAt(result, 0)].filter(isFinitePoint);
  }

  /** @param {number} row the sample of now */
  draw(row) {
    if (!this.result) return;
    this.row = row;
    const { result, up, base } = this;
    const { clientWidth: width, clientHeight: height } = this.box;
    this.renderer.setSize(width, height);
    this.thick = Math.max(2.5, Math.min(9, 0.075 * this.radius * this.viewpoint.fit(this.kept, up, width, height)));
    while (row > 0 && !isFinitePoint(positionAt(result, row))) row -= 1; // the last ones of a run that diverged
    const { panel, accent, c7, warn } = colours();
    const frames = framesAt(result, row);
    const joints = vectors(result.scene.platform_joints);
    const upInE = up.clone().applyQuaternion(frames.platform.quaternion.clone().invert());
    this.platform = plate(joints, 0.05 * this.radius, upInE, accent);
    frames.platform.add(this.platform);
    const ground = plate(base, -0.04 * this.radius, up, c7);
    ground.renderOrder = this.viewpoint.from.phi < Math.PI / 2 ? BEHIND : 0; // the legs stand on it
    const light = new DirectionalLight("white", 0.4);
    light.position.copy(up);
    const scene = new Scene().add(frames.base, this.floor(), ground, light, new AmbientLight(new Color(0.6, 0.6, 0.6)));
    scene.background = new Color(panel);
    this.legs(scene, joints.map((joint) => frames.platform.localToWorld(joint)), row);
    this.sight(scene, frames.eye, row);
    const every = Math.max(1, Math.floor(row / TRAIL));
    scene.add(path(Array.from({ length: 1 + row / every }, (_, k) => positionAt(result, k * every)), warn, 2));
    this.renderer.render(scene, this.viewpoint.camera);
  }

  floor() {
    const floor = new PolarGridHelper(1.5 * this.radius, 4, 2, 48);
    floor.position.copy(this.middle);
    floor.quaternion.setFromUnitVectors(floor.up, this.up);
    floor.material.color.set(colours().line);
    floor.renderOrder = BEHIND;
    floor.updateMatrixWorld();
    return floor;
  }

  /** Legs to the platform's joints in B: cylinder and rod, or crank and rod. */
  legs(scene, joints, row) {
    const { result, base, thick } = this;
    const { ink, faint, bad, panel } = colours();
    const lost = result.outcome !== "completed" && row === result.rows - 1;
    const ends = endsAt(result, row);
    base.forEach((foot, i) => {
      const end = ends?.[i] ?? foot.clone().lerp(joints[i], 0.55);
      scene.add(rod(foot, end, faint, thick), rod(end, joints[i], lost ? bad : ink, 0.5 * thick));
      if (ends) scene.add(ball(end, 0.5 * thick, ink, panel));
      scene.add(ball(foot, 0.6 * thick, faint, panel), ball(joints[i], 0.5 * thick, ink, panel));
    });
  }

  /** The camera's pyramid, and lines to the points of the target. */
  sight(scene, eye, row) {
    const { good, line, panel, c1 } = colours();
    const target = targetAt(this.result, row).filter(isFinitePoint);
    const seen = target.map((point) => eye.worldToLocal(point.clone()));
    const half = Math.max(0.15, ...seen.flatMap(({ x, y, z }) => [Math.abs(x / z), Math.abs(y / z)]));
    const far = seen.length ? seen.reduce((sum, { z }) => sum - z / seen.length, 0) : 2 * this.radius;
    eye.add(pyramid(1.25 * half, Math.min(0.45 * far, 1.2 * this.radius), good), ball(new Vector3(), 4, good, panel));
    if (target.length > 2) scene.add(pane(target, c1));
    const from = eye.getWorldPosition(new Vector3());
    target.forEach((point, i) => scene.add(rod(from, point, line, 1, 24, 0.5), ball(point, 6, lineColour(i), panel)));
  }

  // --- the pointer turns the view, or moves the platform

  /** The ray under a pointer. */
  ray(event) {
    const [x, y] = pointIn(this.box, event);
    const caster = new Raycaster();
    caster.setFromCamera(new Vector2((2 * x) / this.box.clientWidth - 1, 1 - (2 * y) / this.box.clientHeight), this.viewpoint.camera);
    return caster;
  }

  isOnPlatform = (event) => this.ray(event).intersectObject(this.platform).length > 0;

  take(event) {
    if (!this.platform) return;
    this.box.setPointerCapture(event.pointerId);
    this.held = { x: event.clientX, y: event.clientY };
    if (!this.isOnPlatform(event)) return;
    const towards = this.viewpoint.camera.getWorldDirection(new Vector3());
    const plane = new Plane().setFromNormalAndCoplanarPoint(towards, positionAt(this.result, 0));
    this.held.place = (at) => this.ray(at).ray.intersectPlane(plane, new Vector3());
    this.held.start = this.held.place(event);
    this.drag([0, 0, 0], "begin");
  }

  move(event) {
    if (!this.platform) return;
    if (!this.held) this.box.style.cursor = this.isOnPlatform(event) ? "move" : "grab";
    else if (this.held.start) this.drag(this.held.place(event).sub(this.held.start).toArray(), "move");
    else {
      const { x, y } = this.held;
      this.held = { x: event.clientX, y: event.clientY };
      this.viewpoint.turn(0.008 * (event.clientX - x), 0.008 * (event.clientY - y));
    }
  }

  release() {
    const moved = this.held?.start;
    this.held = null;
    if (moved) this.drag(null, "end");
  }
}
