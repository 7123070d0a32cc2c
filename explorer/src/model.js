/**
 * What is shown: a packaged scenario with changes by dotted key, its address (URL) and its YAML.
 *
 * A value is a number, a list of numbers (row by row), null, or text (names, and the seed of 64 bits).
 */

const data = globalThis.HEXSERVO_DATA ?? JSON.parse(globalThis.document.getElementById("data").textContent);

export const { laws, twist_laws: twistLaws, keys, metrics, presets, version, most_delay: mostDelay } = data;

/** What `hexservo explore` wrote into the page: a packaged scenario's name, or a scenario as one more preset. */
const own = JSON.parse(globalThis.document?.getElementById("own").textContent ?? "null");
if (own?.preset) presets.unshift(own.preset);
export const start = own ? `#${encodeURIComponent(own.start)}` : "";

export const keyOf = Object.fromEntries(keys.map((key) => [key.key, key]));
keyOf["controller.law"] = { key: "controller.law", type: "choice", unit: "", choices: laws, default: laws[0], mode: "any", meaning: "control law" };

const lawOfKey = (name) => {
  const law = name.startsWith("controller.") ? name.split(".")[1] : "";
  return laws.includes(law) ? law : null;
};

const LOGGING = "simulation.log_every";

export const presetOf = (name) => presets.find((preset) => preset.name === name) ?? presets[0];

/** The group of the list that a preset is in: of its name, of how its description begins, or of whether its robot has another mass. */
function groupOf(preset) {
  const { name, description, values } = preset;
  if (preset === own?.preset) return "From a file";
  if (/^paper\b/.test(name)) return "The paper";
  if (/^(task|textbook)-/.test(name)) return "Tasks";
  if (description.startsWith("Fails,")) return "Failures";
  return "robot.mass" in values ? "Machines" : "Cameras and loops";
}

/** Groups of the list, and the presets in each. */
export const groups = ["From a file", "The paper", "Cameras and loops", "Machines", "Failures", "Tasks"]
  .map((title) => [title, presets.filter((preset) => groupOf(preset) === title)])
  .filter(([, members]) => members.length);

/** Value of a key where nothing is changed. */
export const presetValue = (preset, key) => (key in presetOf(preset).values ? presetOf(preset).values[key] : keyOf[key].default);

export const valueOf = (state, key) => (key in state.changes ? state.changes[key] : presetValue(state.preset, key));

/** A value with as many entries as the preset has: of an array one number stands for all of them. */
export function whole(preset, key, value) {
  const usual = presetValue(preset, key);
  return Array.isArray(usual) && value?.length === 1 ? usual.map(() => value[0]) : value;
}

/** The keys that a law has. */
export const keysOf = (law) => keys.filter((key) => (lawOfKey(key.key) ?? law) === law);

/** Keys that a user finds: how often samples are logged is the page's own choice. */
export const listedKeysOf = (law) => keysOf(law).filter(({ key }) => key !== LOGGING);

/** Kinds of actuators that have a key, or null where all have it: the core takes no other value than the default where another kind is. */
function kindsOf(key) {
  if (key.startsWith("actuators.motor.")) return ["position_torque"];
  if (/^(actuators\.position|controller\.virtual_platform)\./.test(key)) return ["position", "position_torque"];
  return /^(actuators\.(?!kind$|delay$)\w+|controller\.safe\.\w+)$/.test(key) ? ["force"] : null;
}

const isOfItsKind = (state, key) => kindsOf(key)?.includes(valueOf(state, "actuators.kind")) ?? true;

/** Keys that another key, where it is given, replaces. */
const REPLACED = [
  [/^camera\.(focal_length|pixel_scale)$/, "camera.focal_pixels"],
  [/^target\.(initial_features|depth)$/, "target.points"],
  [/^robot\.platform_(radius|angles)$/, "robot.platform_joints"],
  [/^robot\.base_(radius|angles)$/, "robot.base_joints"],
];

/** Whether other keys have one of the values with which a key acts (`hexservo check`), such as its law, and none is given that replaces it. */
const isNeeded = (state, { key, needs = {} }) =>
  Object.entries(needs).every(([other, values]) => values.includes(valueOf(state, other))) && REPLACED.every(([names, by]) => !names.test(key) || valueOf(state, by) === null);

/**
 * Whether a key has an effect: not one that is not needed, of the other mode or of another kind of actuators, nor what makes a
 * wrench of a twist where legs follow that by themselves.
 */
export function acts(state, spec) {
  const { key, mode } = spec;
  if (!isNeeded(state, spec) || !isOfItsKind(state, key)) return false;
  const sampled = valueOf(state, "simulation.mode") === "sampled";
  if (mode === "sampled" && !sampled) return false;
  const follow = sampled && valueOf(state, "actuators.kind") !== "force";
  return !(follow && twistLaws.some((name) => key === `controller.${name}.ki`));
}

/** The changes that act: [key, value] of each. The address has the others too, which sleep until the law, the mode or the kind has them. */
export const actingChanges = (state) => Object.entries(state.changes).filter(([key]) => acts(state, keyOf[key]));

/** All keys of the law that acts, as the core takes them: of another kind of actuators the defaults. */
export function full(state) {
  const law = valueOf(state, "controller.law");
  const scenario = { "controller.law": law };
  for (const { key, default: usual } of keysOf(law)) scenario[key] = isOfItsKind(state, key) ? valueOf(state, key) : usual;
  return scenario;
}

export const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

/** The state with a key changed, to null by the number that stands for it; a value that the preset has is no change. */
export function changed(state, key, number) {
  const changes = { ...state.changes };
  const value = number === keyOf[key].none ? null : number;
  if (same(value, presetValue(state.preset, key))) delete changes[key];
  else changes[key] = value;
  return { ...state, changes };
}

// --- text of values

export const textOf = (value) => (value === null ? "none" : [value].flat().join(" "));

const FLAGS = { 1: 1, 0: 0, true: 1, false: 0 };

/** Reads what a user types; throws a sentence. */
export function parsed(key, text) {
  const { type, optional } = keyOf[key];
  const words = text.trim().split(/[\s,;[\]]+/).filter(Boolean);
  if (type === "choice" || type === "seed") return text.trim();
  if (type === "flag" && words.length === 1 && Object.hasOwn(FLAGS, words[0])) return FLAGS[words[0]];
  if (optional && (words.length === 0 || /^(none|null)$/.test(words.join(" ")))) return null;
  const numbers = words.map(Number);
  const wanted = type === "flag" ? "1 or 0" : `finite numbers${optional ? " or none" : ""}`;
  if (type === "flag" || !numbers.length || !numbers.every(Number.isFinite)) throw new Error(`${key}: expected ${wanted}, got "${text}"`);
  return ["number", "whole"].includes(type) && numbers.length === 1 ? numbers[0] : numbers;
}

// --- address

const PINNED = "pinned=";

/** The address of a state, with that of the run it is compared with, where one is pinned, as one more part. */
export function toAddress({ preset, changes, pinned }) {
  const parts = [encodeURIComponent(preset)];
  for (const [key, value] of Object.entries(changes)) parts.push(`${key}=${encodeURIComponent(textOf(value).replaceAll(" ", ","))}`);
  if (pinned) parts.push(`${PINNED}${encodeURIComponent(toAddress(pinned).slice(1))}`);
  return `#${parts.join("&")}`;
}

/** Text of a part of an address; as it stands where it was cut within a letter. */
function decoded(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

/**
 * Reads an address as far as it is understood.
 * @returns {{state: object, ignored: string[]}} the state, and a sentence for each part that is left out
 */
export function readAddress(hash) {
  const [name = "", ...parts] = hash.replace(/^#/, "").split("&").filter(Boolean).map(decoded);
  let state = { preset: presetOf(name).name, changes: {} };
  const ignored = [];
  if (name && state.preset !== name) ignored.push(`address: expected a scenario of the list, got "${name}": this is ${state.preset}`);
  for (const part of parts) {
    if (part.startsWith(PINNED)) {
      const { state: pinned, ignored: left } = readAddress(part.slice(PINNED.length));
      state = { ...state, pinned: { preset: pinned.preset, changes: pinned.changes } };
      ignored.push(...left.map((sentence) => `pinned run: ${sentence}`));
      continue;
    }
    const place = part.indexOf("=");
    const key = part.slice(0, Math.max(place, 0));
    try {
      if (place < 1) throw new Error(`address: expected key=value, got "${part}"`);
      if (!Object.hasOwn(keyOf, key) || key === LOGGING) throw new Error(`address: expected a key of "All parameters", got "${key}"`);
      state = changed(state, key, parsed(key, part.slice(place + 1).replaceAll(",", " ")));
    } catch (error) {
      ignored.push(`${error.message}: left out`);
    }
  }
  return { state, ignored };
}

// --- YAML

const MOST_LETTERS_OF_NAME = 60;

/** What is exact: a scenario file has "true" for it. */
const EXACT = { "sensors.pose": "truth", "sensors.rate": "true_rates" };

/** A value as a scenario file has it. */
function yamlValue(spec, value) {
  if (value === null) return "null";
  if (spec.type === "flag") return value ? "true" : "false";
  if (spec.type === "choice") return value === EXACT[spec.key] ? "true" : value;
  if (spec.type === "seed" || !Array.isArray(value)) return yamlNumber(value);
  const rows = spec.shape?.length === 2 && value.length > 3 ? spec.shape[1] : 0;
  const list = (numbers) => `[${numbers.map(yamlNumber).join(", ")}]`;
  if (!rows) return value.length === 1 ? yamlNumber(value[0]) : list(value);
  const parts = [];
  for (let i = 0; i < value.length; i += rows) parts.push(list(value.slice(i, i + rows)));
  return `[${parts.join(", ")}]`;
}

const yamlNumber = (number) => String(number);

/**
 * A scenario file with the same numbers: every key that acts and differs from its default. The name is that of the
 * preset, marked where something that acts is changed.
 */
export function toYaml(state) {
  const scenario = full(state);
  const tree = {};
  const put = (key, text) => {
    const path = key.split(".");
    const leaf = path.pop();
    let place = tree;
    for (const block of path) place = place[block] ??= {};
    place[leaf] = text;
  };
  for (const key of keysOf(scenario["controller.law"])) {
    const value = scenario[key.key];
    const fixed = key.key.startsWith("robot.") || ["target.initial_features", "target.desired_features", "target.depth"].includes(key.key);
    if (!acts(state, key)) continue;
    if (fixed || !same(value, key.default)) put(key.key, yamlValue(key, value));
  }
  put("controller.law", scenario["controller.law"]);
  const mark = actingChanges(state).length ? "-changed" : "";
  const name = JSON.stringify(state.preset.slice(0, MOST_LETTERS_OF_NAME - mark.length) + mark); // in quotes, for it may be 1 or true
  const lines = [`# Made with the hexservo explorer ${version}: hexservo run FILE`, `name: ${name}`];
  const write = (block, depth) => {
    for (const [key, value] of Object.entries(block)) {
      if (typeof value === "string") lines.push(`${"  ".repeat(depth)}${key}: ${value}`);
      else {
        lines.push(`${"  ".repeat(depth)}${key}:`);
        write(value, depth + 1);
      }
    }
  };
  write(tree, 0);
  return `${lines.join("\n")}\n`;
}

// --- runs

/** Samples that are drawn, at most, and while something is dragged: then each picture is to be there with the next one of the screen. */
const MOST_ROWS = 10000;
const MOST_ROWS_OF_A_DRAG = 800;

/** Steps between two samples, at most: no sample but the first and the last is drawn. */
const MOST_EVERY = 1e9;

/** The scenario of a run whose samples are drawn. */
export function drawn(state, isDragged = false) {
  const scenario = full(state);
  const steps = scenario["simulation.duration"] / scenario["simulation.step"];
  const every = Math.ceil(steps / (isDragged ? MOST_ROWS_OF_A_DRAG : MOST_ROWS)) || 1; // of a quotient that is no number the core refuses a key of it
  return { ...scenario, [LOGGING]: Math.max(1, Math.min(MOST_EVERY, every)) };
}
