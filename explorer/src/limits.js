/** What the robot limits of its legs, and where a run is beyond it. The core reports limits, and stops there where `robot.on_limit` is stop. */
import { withUnit } from "./format.js";
import { framesAt, vectors } from "./machine.js";
import { valueOf } from "./model.js";

const ROTARY_UNITS = { m: "rad", "m/s": "rad/s", N: "N m" };

/** Unit of a metric: those of rotary legs are angles and torques. */
export const unitOfMetric = (state, { name, unit }) => (valueOf(state, "robot.legs") === "rotary" && name.startsWith("peak_leg_") ? ROTARY_UNITS[unit] : unit);

/** Name and meaning of a metric as people read them: cranks have torques and angles. */
export const wordsOfMetric = (state, { name, meaning, of_cranks: ofCranks }) =>
  ofCranks && valueOf(state, "robot.legs") === "rotary" ? ofCranks : [name.replaceAll("_", " "), meaning];

/** Limits of the core: metric that has the largest value, its unit, what a leg beyond it does where that is told with the largest value, and how the event is called. */
const LIMITS = {
  stroke: { name: "peak_leg_excursion", unit: "m", called: "stroke" },
  force: { name: "peak_leg_force", unit: "N", does: "takes a force of", called: "force limit" },
  torque: { name: "peak_leg_force", unit: "N", does: "takes a torque of", called: "torque limit" },
  speed: { name: "peak_leg_speed", unit: "m/s", does: "moves at", called: "speed limit" },
  base_joint: { name: "peak_base_joint", unit: "rad", does: "tilts at the base by", called: "tilt at the base" },
  platform_joint: { name: "peak_platform_joint", unit: "rad", does: "tilts at the platform by", called: "tilt at the platform" },
};

const limitOf = (state, limit) => LIMITS[limit === "force" && valueOf(state, "robot.legs") === "rotary" ? "torque" : limit];

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

const AT_END = 1e-6; // share of the stroke: commands end short of it by a billionth

/** What a run of a state ends with where its legs take positions, which stay within their stroke: a clause, or nothing. */
export function restAtStroke(state, run) {
  if (valueOf(state, "actuators.kind") !== "position") return [];
  const stroke = valueOf(state, "robot.stroke");
  const middle = run.middle ?? middles(state, run);
  const legs = middle ? LEGS.filter((leg) => travel({ ...run, middle }, run.rows - 1, leg) >= (1 - AT_END) * stroke).map((leg) => leg + 1) : [];
  if (!legs.length) return [];
  const which = legs.length > 1 ? `legs ${legs.join(", ")} are at the end of their` : `leg ${legs[0]} is at the end of its`;
  return [`${which} stroke of ${withUnit(stroke, unitOfMetric(state, LIMITS.stroke))}`];
}

/** Whether a run of a state, of which the metrics are known, is beyond one of its limits. */
export function isBeyondLimits(state, values) {
  const [base, platform] = valueOf(state, "robot.joint_limit") ?? [null, null];
  const [stroke, force, speed] = ["stroke", "force_limit", "speed_limit"].map((name) => valueOf(state, `robot.${name}`));
  const most = { stroke, force, speed, base_joint: base, platform_joint: platform };
  return Object.entries(most).some(([limit, value]) => value !== null && values[LIMITS[limit].name] > value);
}

/** The event that ended a run; null where none did. */
const stopOf = ({ outcome, events }) => (outcome === "leg_limit" ? events.at(-1) : null);

/** What the leg that ended a run of a state had, and its limit; "" where none did. */
export function valueAtStop(state, run) {
  const stop = stopOf(run);
  if (!stop) return "";
  const unit = unitOfMetric(state, limitOf(state, stop.limit));
  const digits = [4, 6, 8].find((count) => withUnit(stop.peak, unit, count) !== withUnit(stop.most, unit, count)) ?? 10;
  return ` (${withUnit(stop.peak, unit, digits)} of ${withUnit(stop.most, unit)})`;
}

/** Events of each limit that legs of a run passed before its end, in the order of the first ones. */
function byLimit(run) {
  const events = run.events.filter((event) => event !== stopOf(run));
  return [...new Set(events.map(({ limit }) => limit))].map((limit) => events.filter((event) => event.limit === limit));
}

/** The limits that a run of a state passes, as clauses that follow "but"; empty where it passes none. */
export function passedLimits(state, run) {
  return byLimit(run).map((events) => {
    const limit = limitOf(state, events[0].limit);
    const inWords = (value) => withUnit(value, unitOfMetric(state, limit));
    const [first] = events;
    if (limit === LIMITS.stroke) return `leg ${first.leg} passes its stroke of ${inWords(first.most)} at ${withUnit(first.time, "s")}`;
    const worst = events.reduce((one, other) => (other.peak > one.peak ? other : one));
    return `leg ${worst.leg} ${limit.does} ${inWords(worst.peak)} of ${inWords(worst.most)}`;
  });
}

/**
 * What happened in a run of a state, and when [s], in that order: limits that legs passed, a point that left the image, that it settled, its end.
 * @param {{point: number, time: number} | null} outside the first point outside of the image, from 1
 */
export function happenings(state, run, outside) {
  const limits = byLimit(run).map(([{ limit, leg, time }, ...more]) => {
    const others = more.length ? `, and ${more.length} more` : "";
    return { time, kind: "warn", words: `${limitOf(state, limit).called} of leg ${leg}${others}` };
  });
  const isEarly = run.outcome !== "completed";
  const stop = stopOf(run);
  const how = stop ? `: ${limitOf(state, stop.limit).called} of leg ${stop.leg}` : "";
  const settles = isEarly || Number.isNaN(run.metrics.settling_time) ? [] : [{ time: run.metrics.settling_time, kind: "good", words: "settles" }];
  const end = { time: isEarly ? run.steps * valueOf(state, "simulation.step") : run.time, kind: isEarly ? "bad" : "", words: isEarly ? `${run.outcome.replaceAll("_", " ")}${how}` : "end" };
  const leaves = outside ? [{ time: outside.time, kind: "warn", words: `point ${outside.point} outside of the image` }] : [];
  return [...limits, ...leaves, ...settles].sort((one, other) => one.time - other.time).concat(end);
}
