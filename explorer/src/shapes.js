/** What the view of the machine consists of, as objects of three. Widths and radii of lines and discs are pixels. */
import * as three from "three";
import { ConvexGeometry } from "three/addons/geometries/ConvexGeometry.js";
import { SVGObject } from "three/addons/renderers/SVGRenderer.js";
import { isFinitePoint, mean } from "./machine.js";

// Orders of what is drawn before or after all others, whatever its distance.
export const BEHIND = -1;
export const BEFORE = 1;

function lines(geometry, color, linewidth) {
  const made = new three.LineSegments(geometry, new three.LineBasicMaterial({ color, linewidth }));
  made.frustumCulled = false; // to look whether they are in the picture takes longer than to draw them
  return made;
}

/** Lines between two points each, in pieces: each piece is drawn before what is nearer. */
export function rods(pairs, color, width, pieces = 2) {
  const known = pairs.filter((pair) => pair.every(isFinitePoint));
  const ends = known.flatMap(([from, to]) => Array.from({ length: 2 * pieces }, (_, k) => from.clone().lerp(to, Math.ceil(k / 2) / pieces)));
  return lines(new three.BufferGeometry().setFromPoints(ends), color, width);
}

export const path = (points, color, width) => rods(points.slice(1).map((to, i) => [points[i], to]), color, width, 1);

export function rays(from, points, color) {
  const made = rods(points.map((to) => [from, to]), color, 1);
  made.material = new three.LineDashedMaterial({ color, dashSize: 3, gapSize: 4 });
  return made;
}

/** Two circles about a place, and lines through it. */
export function floor(middle, up, radius, color) {
  const grid = new three.PolarGridHelper(radius, 4, 2, 32);
  grid.material.color.set(color);
  grid.position.copy(middle);
  grid.quaternion.setFromUnitVectors(grid.up, up);
  grid.updateMatrixWorld();
  grid.renderOrder = BEHIND - 1;
  return grid;
}

/** Light from above: what faces it has its own colour, all else a darker one. */
export function lights(up) {
  const sun = new three.DirectionalLight("white", 0.4);
  sun.position.copy(up);
  return [sun, new three.AmbientLight(new three.Color(0.6, 0.6, 0.6))];
}

/** A disc that faces the viewer. */
export function ball(at, radius, fill, rim) {
  const disc = document.createElementNS("http://www.w3.org/2000/svg", "circle");
  for (const [name, value] of Object.entries({ r: radius, fill, stroke: rim })) disc.setAttribute(name, value);
  const object = new SVGObject(disc);
  object.position.copy(at);
  return object;
}

const longestFirst = (arrows) => [...arrows].sort((a, b) => b.length() - a.length());

/** A plate of some height on joints, towards `up`. */
export function plate(joints, height, up, color) {
  const middle = mean(joints);
  const arms = joints.map((joint) => joint.clone().sub(middle));
  const [normal] = longestFirst(arms.map((arm) => arm.clone().cross(arms[0])));
  normal.setLength(height * Math.sign(normal.dot(up) || 1));
  return new three.Mesh(new ConvexGeometry([...joints, ...joints.map((joint) => joint.clone().add(normal))]), new three.MeshLambertMaterial({ color }));
}

const PYRAMID = new ConvexGeometry([new three.Vector3(), ...[-1, 1].flatMap((x) => [-1, 1].map((y) => new three.Vector3(x, y, -1)))]);
const PYRAMID_EDGES = new three.EdgesGeometry(PYRAMID);

/** What a camera at the origin sees up to a distance: left, right, low and high are the sides of its image at distance 1. */
export function pyramid([left, right, low, high], reach, color) {
  const glass = new three.MeshBasicMaterial({ color, opacity: 0.1 });
  const made = new three.Group().add(new three.Mesh(PYRAMID, glass), lines(PYRAMID_EDGES, color, 1));
  const [x, y] = [(left + right) / 2, (low + high) / 2];
  made.matrixAutoUpdate = false; // of place, turn and size: a pyramid whose middle is beside the axis is sheared
  made.matrix.set(right - x, 0, -x, 0, 0, high - y, -y, 0, 0, 0, 1, 0, 0, 0, 0, 1).premultiply(new three.Matrix4().makeScale(reach, reach, reach));
  return made;
}

/** Arrows from one point, in the order of their directions in the plane that they are in. */
function around(arrows) {
  const [x] = longestFirst(arrows);
  const normal = longestFirst(arrows.map((arrow) => x.clone().cross(arrow)))[0].normalize();
  const y = normal.cross(x);
  const angle = (arrow) => Math.atan2(arrow.dot(y), arrow.dot(x));
  return [...arrows].sort((a, b) => angle(a) - angle(b));
}

/** A polygon that shows what is behind it. Its triangles are drawn one after the other, so that they become one shape. */
export function pane(corners, color) {
  const middle = mean(corners);
  const arms = around(corners.map((corner) => corner.clone().sub(middle))); // points of a target come in any order
  const triangles = arms.flatMap((arm, i) => [new three.Vector3(), arm, arms[(i + 1) % arms.length]]);
  const geometry = new three.BufferGeometry().setFromPoints(triangles);
  const made = new three.Mesh(geometry, new three.MeshBasicMaterial({ color, side: three.DoubleSide, opacity: 0.12 }));
  made.position.copy(middle);
  made.renderOrder = BEHIND;
  return made;
}
