/** What a run is compared with, the preset's or one that is pinned, and whether their metrics compare. */
import { withUnit } from "./format.js";
import { actingChanges, keys, same, textOf, valueOf, whole } from "./model.js";

/** The state whose run is the reference of a state. */
export const referenceOf = ({ preset, pinned }) => pinned ?? { preset, changes: {} };

/** Whether two states have the same value of a key. */
function agree(key, one, other) {
  const [first, second] = [one, other].map((state) => whole(state.preset, key, valueOf(state, key)));
  return same(first, second);
}

/** Keys whose values differ between two states, of those that act in either and that either has changed. */
function differences(one, other) {
  const changed = new Set([one, other].flatMap(actingChanges).map(([key]) => key));
  return [...changed].filter((key) => !agree(key, one, other));
}

/** Whether two states are those of one run. */
export const isSameRun = (one, other) => one.preset === other.preset && differences(one, other).length === 0;

/** What metrics measure that a key defines; "" where it defines nothing of that. */
function measured(key) {
  if (key === "target.desired_features") return "goal";
  if (key === "target.points") return "target";
  if (key === "robot.legs") return "kind of legs";
  if (key === "target.initial_features" || key.startsWith("simulation.start.")) return "start";
  const [block, leaf] = key.split(".");
  return block === "metrics" ? leaf.replaceAll("_", " ") : "";
}
const MEASURED = keys.map(({ key }) => [key, measured(key)]).filter(([, name]) => name);

/** Why metrics of two runs measure different things, which makes them no better or worse; "" where they measure the same. */
export function incomparable(one, other) {
  if (one.outcome !== other.outcome) return `outcome ${one.outcome} against ${other.outcome}`.replaceAll("_", " ");
  const alike = Math.abs(one.time - other.time) <= 0.001 * other.time; // ends are whole steps
  if (!alike) return `${withUnit(one.time, "s")} against ${withUnit(other.time, "s")}`;
  const different = MEASURED.find(([key]) => !agree(key, one.state, other.state));
  return different ? `another ${different[1]}` : "";
}

const MOST_NAMED = 3; // differences of a pinned run that its label has
const MOST_LETTERS = 24; // of a value there

function brief(value) {
  const alike = Array.isArray(value) && value.every((x) => x === value[0]);
  const text = textOf(alike ? value[0] : value);
  return text.length > MOST_LETTERS ? `${text.slice(0, MOST_LETTERS)}…` : text;
}

/** What a pinned run has that differs from the run that is shown. */
export function pinnedLabel(shown, pinned) {
  const found = differences(shown, pinned);
  const named = found.slice(0, MOST_NAMED).map((key) => `${key} = ${brief(valueOf(pinned, key))}`);
  const parts = [...(shown.preset === pinned.preset ? [] : [`scenario ${pinned.preset}`]), ...named];
  const more = found.length - MOST_NAMED;
  return `pinned: ${parts.join(", ") || "the same"}${more > 0 ? ` and ${more} more` : ""}`;
}
