/** The border of the camera's image, among features: those of a pinhole, in pixels from the principal point, y up. */
import { withUnit } from "./format.js";
import { acts, keyOf, valueOf } from "./model.js";

/** Whether a lens bends the camera's image. */
export const hasLens = (state) => ["brown_conrady", "kannala_brandt"].some((lens) => [valueOf(state, `camera.distortion.${lens}`) ?? 0].flat().some((number) => number !== 0));

/**
 * Sides of the image: [left, right, low, high] [px]; null where it has none, or none that acts, or where a lens bends them.
 * Features have the scale of the first focal length, and pixels count from the middle of the first one where there is a principal point.
 */
export function borderOf(state) {
  const size = valueOf(state, "camera.image_size");
  if (size === null || !acts(state, keyOf["camera.image_size"]) || hasLens(state)) return null;
  const [first, second = first] = [valueOf(state, "camera.focal_pixels") ?? 1].flat();
  const principal = valueOf(state, "camera.principal_point");
  const [right, down] = principal ? principal.map((at, k) => (size[k] - 1) / 2 - at) : [0, 0]; // of the middle of the image
  const tall = first / second;
  return [right - size[0] / 2, right + size[0] / 2, tall * (-down - size[1] / 2), tall * (-down + size[1] / 2)];
}

/** Whether a point is outside of the image at a sample. */
export function isPointOutside({ border, scene, samples, points }, row, point) {
  if (!border) return false;
  const [left, right, low, high] = border;
  const at = 2 * (points * row + point);
  const [x, y] = [scene.goal[2 * point] - samples.feature_error[at], scene.goal[2 * point + 1] - samples.feature_error[at + 1]];
  return x < left || x > right || y < low || y > high;
}

/** The first sample at which a point is outside of the image: the point, from 1, and the time [s]; null where none is. */
export function firstOutside(run) {
  if (!run.border) return null;
  for (let row = 0; row < run.rows; ++row) {
    for (let point = 0; point < run.points; ++point) if (isPointOutside(run, row, point)) return { point: point + 1, time: run.samples.time[row] };
  }
  return null;
}

/** A clause on that, which follows "but". */
export const inWords = ({ point, time }) => (time > 0 ? `point ${point} leaves the image at ${withUnit(time, "s")}` : `point ${point} is outside of the image at the start`);
