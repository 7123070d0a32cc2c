/** Where the machine is seen from: a camera that pointer, wheel and keys turn, and that always sees all of some points. */
import { Box3, PerspectiveCamera, Quaternion, Spherical, Vector3 } from "three";
import { isShortcut } from "./view.js";

const MARGIN = 26; // pixels
const DISTANCE = 4.2; // of the camera, of half the diagonal of what it sees
const Y = new Vector3(0, 1, 0);
const between = (low, value, high) => Math.max(low, Math.min(high, value));

export class Viewpoint {
  /**
   * @param {HTMLElement} box whose keys and wheel are listened to
   * @param {() => void} changed
   */
  constructor(box, changed) {
    this.camera = new PerspectiveCamera(30);
    this.from = new Spherical(1, Math.PI / 2 - 0.32, 0.6 - Math.PI / 2);
    this.zoom = 1;
    this.changed = changed;
    box.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && document.activeElement !== box) return; // the page scrolls
      event.preventDefault();
      this.turn(0, 0, Math.exp(-0.0015 * event.deltaY));
    }, { passive: false });
    box.addEventListener("keydown", (event) => {
      const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1], "+": [0, 0, 1.2], "=": [0, 0, 1.2], "-": [0, 0, 1 / 1.2] };
      if (!(event.key in turns) || isShortcut(event)) return;
      event.preventDefault();
      this.turn(...turns[event.key]);
    });
  }

  /** Turns the machine by angles [rad], and enlarges it. */
  turn(right, down, larger = 1) {
    this.from.theta -= right;
    this.from.phi = between(0.17, this.from.phi - down, Math.PI - 0.17);
    this.zoom = between(0.3, this.zoom * larger, 8);
    this.changed();
  }

  get direction() {
    return this.camera.getWorldDirection(new Vector3());
  }

  /** Makes points fill a picture of so many pixels; returns how many pixels 1 m has in their middle. */
  fit(points, up, width, height) {
    const { camera } = this;
    const extent = new Box3().setFromPoints(points);
    const middle = extent.getCenter(new Vector3());
    this.from.radius = 0.5 * DISTANCE * extent.getSize(new Vector3()).length() || DISTANCE;
    camera.near = 0.01 * this.from.radius;
    camera.far = 100 * this.from.radius;
    camera.up.copy(up);
    camera.position.setFromSpherical(this.from).applyQuaternion(new Quaternion().setFromUnitVectors(Y, up)).add(middle);
    camera.lookAt(middle);
    camera.setViewOffset(2, 2, 0, 0, 2, 2); // all of a square, whose coordinates go from -1 to 1
    camera.updateMatrixWorld();
    const seen = new Box3().setFromPoints(points.map((point) => point.clone().project(camera)));
    const [at, size] = [seen.getCenter(new Vector3()), seen.getSize(new Vector3())];
    const pixels = this.zoom * Math.min((width - MARGIN) / size.x, (height - MARGIN) / size.y);
    const [w, h] = [width / pixels, height / pixels];
    camera.setViewOffset(2, 2, 1 + at.x - w / 2, 1 - at.y - h / 2, w, h);
    return (0.5 * height * camera.projectionMatrix.elements[5]) / this.from.radius;
  }
}
