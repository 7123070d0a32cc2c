/** What the robot limits of its legs, and where a run is beyond it. The core reports limits and stops at none, as a rule. */
import { withUnit } from "./format.js";
import { framesAt, vectors } from "./machine.js";
import { valueOf } from "./model.js";

const ROTARY_UNITS = { m: "rad", "m/s": "rad/s", N: "N m" };

/** Unit of a metric: those of rotary legs are angles and torques. */
export const unitOfMetric = (state, { name, unit }) => (valueOf(state, "robot.legs") === "rotary" && name.startsWith("peak_leg_") ? ROTARY_UNITS[unit] : unit);

/** Limits that the robot of a state has: metric, largest value [SI], and what a leg does beyond it. */
function limits(state) {
  const [base, platform] = valueOf(state, "robot.joint_limit") ?? [null, null];
  const effort = valueOf(state, "robot.legs") === "rotary" ? "torque" : "force";
  return [
    { name: "peak_leg_excursion", unit: "m", most: valueOf(state, "robot.stroke"), does: "travels" },
    { name: "peak_leg_force", unit: "N", most: valueOf(state, "robot.force_limit"), does: `takes a ${effort} of` },
    { name: "peak_leg_speed", unit: "m/s", most: valueOf(state, "robot.speed_limit"), does: "moves at" },
    { name: "peak_base_joint", unit: "rad", most: base, does: "tilts at the base by" },
    { name: "peak_platform_joint", unit: "rad", most: platform, does: "tilts at the platform by" },
  ].filter(({ most }) => most !== null);
}

/**
 * Lengths of the legs, or angles of their cranks, in the middle of the stroke [m or rad], (6,). Angles at home are those
 * of a run that starts there; null where it does not.
 */
export function middles(state, result) {
  const centre = valueOf(state, "robot.stroke_centre");
  if (valueOf(state, "robot.legs") === "rotary") {
    const atHome = valueOf(state, "simulation.start.pose").every((x) => x === 0);
    return atHome ? Array.from(result.samples.leg_lengths.subarray(0, 6), (angle) => angle + centre) : null;
  }
  const { home_position: position, home_quaternion: quaternion } = result.scene;
  const { platform } = framesAt({ scene: result.scene, samples: { position, quaternion: Float64Array.from(quaternion) } }, 0);
  const feet = vectors(result.scene.base_joints);
  return vectors(result.scene.platform_joints).map((joint, i) => platform.localToWorld(joint).distanceTo(feet[i]) + centre);
}

/** Limits that differ by less are one line of a chart, as a share of the stroke. */
const ALIKE = 0.01;
const LEGS = [0, 1, 2, 3, 4, 5];

/**
 * Limits of what a sample has of the legs, by quantity: values [SI], each with the legs, from 0, that have it.
 * @param {number[] | null} middle of the strokes [m or rad]
 */
export function bounds(state, middle) {
  const about = (centres, most) => {
    const values = centres.flatMap((centre) => [centre - most, centre + most]);
    const different = values.filter((value, i) => values.findIndex((other) => Math.abs(other - value) < ALIKE * most) === i);
    return different.map((value) => ({ value, legs: LEGS.filter((leg) => Math.abs(Math.abs(value - centres[leg]) - most) < ALIKE * most) }));
  };
  return {
    leg_forces: about(LEGS.map(() => 0), valueOf(state, "robot.force_limit")),
    leg_lengths: middle === null ? [] : about(middle, valueOf(state, "robot.stroke")),
  };
}

/** How far a leg is from the middle of its stroke at a sample [m or rad]. */
const travel = ({ samples, middle }, row, leg) => Math.abs(samples.leg_lengths[6 * row + leg] - middle[leg]);

/** Which legs are beyond their stroke at a sample; none where the middle of it is not known. */
export const legsBeyond = (result, row) => (result.middle ? LEGS.filter((leg) => travel(result, row, leg) > result.stroke) : []);

/** The first leg beyond its stroke, from 1, and when [s], between two samples; null where no sample is beyond. */
function firstBeyond(result) {
  const { rows, samples, stroke } = result;
  for (let row = 0; row < rows; ++row) {
    const [leg] = legsBeyond(result, row);
    if (leg === undefined) continue;
    if (row === 0) return { leg: leg + 1, time: samples.time[0] };
    const [before, after] = [row - 1, row].map((at) => travel(result, at, leg));
    const share = (stroke - before) / (after - before);
    return { leg: leg + 1, time: samples.time[row - 1] + share * (samples.time[row] - samples.time[row - 1]) };
  }
  return null;
}

/** Whether a run of a state is beyond one of its limits. */
export const isBeyondLimits = (state, values) => limits(state).some(({ name, most }) => values[name] > most);

/**
 * The limits that a run passes, as clauses that follow "but"; empty where it passes none.
 * @param {object} state
 * @param {object} result of the core, with `stroke` and `middle` of the legs where its samples are to be searched
 */
export function passedLimits(state, result) {
  const passed = limits(state).filter(({ name, most }) => result.metrics[name] > most);
  return passed.map((limit) => {
    const [peak, most] = [result.metrics[limit.name], limit.most].map((value) => withUnit(value, unitOfMetric(state, limit)));
    const first = limit.name === "peak_leg_excursion" && result.middle ? firstBeyond(result) : null;
    return first ? `leg ${first.leg} passes its stroke of ${most} at ${withUnit(first.time, "s", 3)}` : `a leg ${limit.does} ${peak} of ${most}`;
  });
}
