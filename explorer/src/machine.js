/** Where the parts of the machine are at a sample of a run: vectors and frames of three, in the base frame B. */
import { Group, Matrix3, Matrix4, Vector3 } from "three";

/** Numbers by three as points. */
export const vectors = (numbers) => Array.from({ length: numbers.length / 3 }, (_, i) => new Vector3().fromArray(numbers, 3 * i));
export const mean = (points) => points.reduce((sum, point) => sum.addScaledVector(point, 1 / points.length), new Vector3());
export const isFinitePoint = (point) => point.toArray().every(Number.isFinite);

/** Place of the platform at a sample. */
export const positionAt = ({ samples }, row) => new Vector3().fromArray(samples.position, 3 * row);

/** Platform frame E in B; in it, or in B, the camera's frame, which looks along -z, as three's cameras do. */
export function framesAt(result, row) {
  const { scene, samples } = result;
  const [base, platform, eye] = [new Group(), new Group(), new Group()];
  platform.position.copy(positionAt(result, row));
  const [w, x, y, z] = samples.quaternion.subarray(4 * row, 4 * row + 4);
  platform.quaternion.set(x, y, z, w);
  eye.position.fromArray(scene.camera_position);
  eye.setRotationFromMatrix(new Matrix4().setFromMatrix3(new Matrix3().set(...scene.camera_attitude)));
  base.add(platform);
  (scene.camera_on_base ? base : platform).add(eye);
  base.updateMatrixWorld();
  return { base, platform, eye };
}

/** Ends of the cranks at a sample: from the feet, the directions at angle 0 turned about the axes; null where the legs have none. */
export function endsAt({ cranks, scene, samples }, row) {
  if (!cranks) return null;
  const axes = vectors(cranks.axes);
  return vectors(cranks.zero).map((zero, i) =>
    zero.applyAxisAngle(axes[i], samples.leg_lengths[6 * row + i]).multiplyScalar(cranks.length).add(new Vector3().fromArray(scene.base_joints, 3 * i)),
  );
}

/** Points of the target at a sample, from their image and depth: where it moves, it moves here too. */
export function targetAt(result, row) {
  const { scene, samples, points } = result;
  const { eye } = framesAt(result, row);
  return Array.from({ length: points }, (_, i) => {
    const at = points * row + i;
    const [x, y] = [0, 1].map((k) => scene.goal[2 * i + k] - samples.feature_error[2 * at + k]);
    const depth = samples.depth[at];
    return eye.localToWorld(new Vector3((-depth / scene.focal) * x, (-depth / scene.focal) * y, depth));
  });
}
