/** What the view of the machine consists of: objects of three with the look that they have there. */
import { BufferGeometry, DoubleSide, EdgesGeometry, Group, LineBasicMaterial, LineSegments, Mesh, MeshBasicMaterial, MeshLambertMaterial, Vector3 } from "three";
import { ConvexGeometry } from "three/addons/geometries/ConvexGeometry.js";
import { SVGObject } from "three/addons/renderers/SVGRenderer.js";

export const BEHIND = -1; // what is drawn before all others

const segments = (geometry, color, linewidth) => new LineSegments(geometry, new LineBasicMaterial({ color, linewidth }));

/** A way through points, `width` pixels wide. */
export function path(points, color, width) {
  const ends = points.slice(1).flatMap((point, i) => [points[i], point]);
  return segments(new BufferGeometry().setFromPoints(ends), color, width);
}

/** A rod in pieces, each of which hides, and is hidden, by its own distance; `drawn` is the share of each that is drawn. */
export function rod(from, to, color, width, pieces = 4, drawn = 1) {
  const ends = Array.from({ length: pieces }, (_, i) => [i, i + drawn].map((k) => new Vector3().lerpVectors(from, to, k / pieces)));
  return segments(new BufferGeometry().setFromPoints(ends.flat()), color, width);
}

/** A disc that faces the viewer, of so many pixels. */
export function ball(at, radius, fill, rim) {
  const disc = document.createElementNS("http://www.w3.org/2000/svg", "circle");
  for (const [name, value] of Object.entries({ r: radius, fill, stroke: rim })) disc.setAttribute(name, value);
  const object = new SVGObject(disc);
  object.position.copy(at);
  return object;
}

/** A plate of some height on joints, towards `up`. */
export function plate(joints, height, up, color) {
  const middle = joints.reduce((sum, joint) => sum.addScaledVector(joint, 1 / joints.length), new Vector3());
  const arms = joints.map((joint) => joint.clone().sub(middle));
  const normals = arms.map((arm) => arm.clone().cross(arms[0])).sort((a, b) => b.length() - a.length());
  const way = normals[0].setLength(height * Math.sign(normals[0].dot(up) || 1));
  return new Mesh(new ConvexGeometry([...joints, ...joints.map((joint) => joint.clone().add(way))]), new MeshLambertMaterial({ color }));
}

/** What a camera at the origin sees up to a distance, `half` its half width at distance 1. */
export function pyramid(half, reach, color) {
  const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) => new Vector3(half * x, half * y, -1).multiplyScalar(reach)); // prettier-ignore
  const geometry = new ConvexGeometry([new Vector3(), ...corners]);
  return new Group().add(new Mesh(geometry, new MeshBasicMaterial({ color, opacity: 0.1 })), segments(new EdgesGeometry(geometry), color, 1));
}

/** A polygon that shows what is behind it; before all others, so that its triangles become one shape. */
export function pane(corners, color) {
  const geometry = new BufferGeometry().setFromPoints(corners).setIndex(corners.slice(2).flatMap((_, i) => [0, i + 1, i + 2]));
  const mesh = new Mesh(geometry, new MeshBasicMaterial({ color, side: DoubleSide, opacity: 0.12 }));
  mesh.renderOrder = BEHIND;
  return mesh;
}
