/** Sliders for the keys that matter, and the list of all keys. */
import { readable, rounded, short } from "./format.js";
import { write } from "./view.js";
import { acts, changed, keyOf, keysOf, listedKeysOf, mostDelay, parsed, presetValue, same, textOf, valueOf, whole } from "./model.js";

const element = (name, attributes = {}, ...children) => {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children);
  return made;
};
export { element };

// --- what sliders there are

const GAIN_DECADES = 1.5;
const ROUNDING = 1e-6; // of a number of steps
const NAMED = { "controller.switching.kind": "switching", "actuators.kind": "drives take", "target.motion.kind": "motion" };

/** A slider of one number, or of entries of an array: it sets equal ones, and moves different ones together. */
function slider(state, key, { label, from = 0, to = Infinity, min, max, step = 0, log = false, percent = false, mark = "" }) {
  const spec = keyOf[key];
  const unit = spec.unit.includes(";") ? spec.unit.split(";")[from >= 3 ? 1 : 0].trim() : spec.unit;
  const presets = presetValue(state.preset, key);
  const isPart = Number.isFinite(to) && Array.isArray(presets);
  const all = (value) => (isPart ? whole(state.preset, key, value) : value);
  const entries = (value) => (Array.isArray(value) ? all(value).slice(from, to) : [value ?? 0]);
  const before = entries(presets);
  const current = entries(valueOf(state, key));
  const put = (now, numbers) => {
    const old = all(valueOf(now, key));
    return changed(now, key, Array.isArray(old) ? old.map((x, i) => numbers[i - from] ?? x) : numbers[0]);
  };
  const isMixed = [before, current].some((numbers) => numbers.some((x) => x !== numbers[0]));
  const { get, move, ...others } = !isMixed ? COMMON : log ? factorOf(before) : shiftOf(current, min, max);
  return {
    key,
    id: key + mark,
    unit,
    min,
    max: step ? rounded(min + step * Math.ceil((max - min) / step - ROUNDING)) : max, // a whole number of steps above the least value
    step,
    log,
    percent,
    ...others,
    label: label + (others.suffix ?? ""),
    get: (now) => get(entries(valueOf(now, key))),
    set: (now, number) => put(now, move(entries(valueOf(now, key)), number)),
    range: (now) => [Math.min, Math.max].map((most) => most(...entries(valueOf(now, key)))),
    differs: (now) => !same(entries(valueOf(now, key)), before),
    reset: (now) => put(now, before),
  };
}

/** How a slider reads and sets equal entries. */
const COMMON = { get: ([x]) => x, move: (numbers, number) => numbers.map(() => number) };

/** How it moves different errors: all by as much, as far as each stays within the bounds. */
function shiftOf(current, min, max) {
  const tidy = (x) => Math.round(1e9 * x) / 1e9;
  const mean = (numbers) => tidy(numbers.reduce((sum, x) => sum + x, 0) / numbers.length);
  const [below, above] = [mean(current) - Math.min(...current), Math.max(...current) - mean(current)];
  const move = (numbers, number) => numbers.map((x) => tidy(x + number - mean(numbers)));
  return { get: mean, move, min: rounded(min + below, 6), max: rounded(max - above, 6), suffix: ", mean", shifts: true };
}

/** How it moves different gains: all by one factor of the preset's; their ratios stay where others were set. */
function factorOf(before) {
  const largest = before.reduce((best, x, i) => (Math.abs(x) > Math.abs(before[best]) ? i : best), 0);
  const get = (numbers) => rounded(numbers[largest] / before[largest], 4);
  const move = (numbers, number) => {
    const old = get(numbers);
    const isPresets = numbers.every((x, i) => Math.abs(x - old * before[i]) <= 1e-3 * Math.abs(x));
    const [from, factor] = isPresets ? [before, number] : [numbers, number / old];
    return factor === 1 ? from : from.map((x) => rounded(factor * x, 6));
  };
  const spread = 10 ** GAIN_DECADES;
  return { get, move, min: 1 / spread, max: spread, unit: "", suffix: ", factor", isFactor: true };
}

/** Sliders of a gain, on a logarithmic scale about its value in the preset; of six entries one for each half. */
function gainSliders(state, spec) {
  const value = [presetValue(state.preset, spec.key)].flat();
  const leaf = spec.key.split(".").slice(2).join(" ").replaceAll("_", " ");
  const one = (numbers, more) => {
    const size = Math.max(...numbers.map(Math.abs));
    if (!(size > 0) || !Number.isFinite(size)) return [];
    const spread = 10 ** GAIN_DECADES;
    const most = spec.maximum ?? Infinity;
    return [slider(state, spec.key, { ...more, min: size / spread, max: Math.min(size * spread, most), log: true })];
  };
  if (value.length !== 6) return one(value, { label: leaf });
  const [linear, angular] = spec.unit.startsWith("N") ? ["force", "moment"] : ["translation", "rotation"];
  return [
    ...one(value.slice(0, 3), { label: `${leaf}, ${linear}`, from: 0, to: 3, mark: "/linear" }),
    ...one(value.slice(3), { label: `${leaf}, ${angular}`, from: 3, to: 6, mark: "/angular" }),
  ];
}

/** Of sampled mode: what the legs take, and how they follow where that is positions. */
function drives(state) {
  const step = valueOf(state, "simulation.step");
  const delay = slider(state, "actuators.delay", { label: "delay", min: 0, max: mostDelay * step, step });
  const positions = ["bandwidth", "damping"].flatMap((name) => gainSliders(state, keyOf[`actuators.position.${name}`]));
  return [{ key: "actuators.kind", choice: true }, delay, ...(valueOf(state, "actuators.kind") === "position" ? positions : [])];
}

function targetMotion(state) {
  const along = (key, most, step) => ["x", "y", "z"].map((axis, i) => slider(state, `target.motion.${key}`, { label: `${key} ${axis}`, from: i, to: i + 1, min: -most, max: most, step, mark: `/${i}` }));
  const frequency = slider(state, "target.motion.frequency", { label: "frequency", min: 0.1, max: 5, step: 0.05 });
  const sliders = { velocity: along("velocity", 0.1, 0.001), sinusoid: [...along("amplitude", 0.05, 0.0005), frequency] };
  return [{ key: "target.motion.kind", choice: true }, ...(sliders[valueOf(state, "target.motion.kind")] ?? [])];
}

/** All groups of sliders and choices: [title, open, entries]; an entry without `get` is a key with choices. */
export function groups(state) {
  const law = valueOf(state, "controller.law");
  const sampled = valueOf(state, "simulation.mode") === "sampled";
  const step = valueOf(state, "simulation.step");
  const has = (key) => keyOf[key] !== undefined;
  const relative = (key, label, more = {}) => (has(key) ? [slider(state, key, { label, min: -0.5, max: 0.5, step: 0.005, percent: true, ...more })] : []);
  const gains = keysOf(law).filter(({ key, type }) => key.startsWith(`controller.${law}.`) && (type === "number" || type === "array")).filter((spec) => acts(state, spec));
  const main = gains.filter(({ key }) => !key.includes(".fuzzy."));
  const switches = acts(state, keyOf["controller.switching.kind"]);
  const width = keyOf["controller.switching.width"];
  const fuzzy = gains.filter(({ key }) => /fuzzy\.(adaptation|error_scale|rate_scale|leakage|weight_limit)$/.test(key));
  const choices = (names) => names.filter((key) => has(key) && acts(state, keyOf[key])).map((key) => ({ key, choice: true }));
  const start = ["x", "y", "z"].map((axis, i) => slider(state, "simulation.start.pose", { label: `start ${axis}`, from: i, to: i + 1, min: -0.05, max: 0.05, step: 0.0005, mark: `/${i}` }));
  const turn = ["x", "y", "z"].map((axis, i) => slider(state, "simulation.start.pose", { label: `start about ${axis}`, from: i + 3, to: i + 4, min: -0.35, max: 0.35, step: 0.0025, mark: `/${i + 3}` }));
  const scale = Math.max(1, ...[presetValue(state.preset, "robot.platform_radius") ?? 0.1].map((radius) => radius / 0.1));
  for (const entry of start) Object.assign(entry, { min: entry.min * scale, max: entry.max * scale, step: entry.step * scale });
  const camera = [
    slider(state, "camera.period", { label: "frame period", min: 0, max: Math.max(0.1, 50 * step), step }),
    slider(state, "camera.latency", { label: "latency", min: 0, max: Math.max(0.1, 50 * step), step }),
    slider(state, "camera.noise", { label: "noise", min: 0, max: 3, step: 0.01 }),
    slider(state, "camera.dropout", { label: "dropout", min: 0, max: 0.9, step: 0.01 }),
  ];
  return [
    ["Model errors", true, [
      ...relative("uncertainty.gravity", "mass in gravity"),
      ...relative("uncertainty.inertia", "inertia"),
      ...relative("uncertainty.coriolis", "Coriolis terms"),
      ...relative("uncertainty.depth", "depth", { min: -0.9, max: 0.9 }),
      ...(sampled ? relative("uncertainty.focal_length", "focal length") : []),
    ]],
    [`Gains of ${law.replaceAll("_", " ")}`, true, [
      ...main.flatMap((spec) => gainSliders(state, spec)),
      ...choices([`controller.${law}.fuzzy.enabled`, `controller.${law}.adaptive`, `controller.${law}.jacobian_at`, `controller.${law}.follow`]),
    ]],
    ["Camera and servo", true, [...choices(["simulation.mode", ...(sampled ? ["camera.prediction"] : [])]), ...(sampled ? camera : [])]],
    ["Drives", false, sampled ? drives(state) : []],
    ["Motion of the target", false, sampled ? targetMotion(state) : []],
    ["Start", false, [...start, ...turn]],
    ["Fuzzy systems", false, fuzzy.flatMap((spec) => gainSliders(state, spec))],
    [switches ? "Switching, duration" : "Duration", false, [
      ...choices(["controller.switching.kind"]),
      ...(acts(state, width) ? gainSliders(state, width) : []),
      slider(state, "simulation.duration", { label: "duration", min: Math.min(1, presetValue(state.preset, "simulation.duration")), max: Math.max(20, presetValue(state.preset, "simulation.duration")), step: 0.5 }),
      ...choices(["controller.jacobian"]),
    ]],
  ].filter(([, , entries]) => entries.length);
}

/** Every slider that there is now. */
export const sliders = (state) => groups(state).flatMap(([, , entries]) => entries.filter((entry) => entry.get));

// --- position of a slider

const FINE = 1000;
export const toPlace = ({ min, max, log }, value) => (log ? Math.log(value / min) / Math.log(max / min) : (value - min) / (max - min));
export function fromPlace({ min, max, log, step }, place) {
  if (log) return rounded(min * (max / min) ** place, 4);
  const raw = place * (max - min);
  return rounded(Math.min(max, min + (step ? Math.round(raw / step) * step : raw)));
}

/** A value of a slider, with its unit. */
export const shown = (entry, value) => {
  if (entry.isFactor) return `× ${short(value, 3)}`;
  if (entry.percent) return `${short(100 * value, 3)} %`;
  const [name, scale] = entry.unit === "s" && entry.max <= 1 ? ["ms", 1e3] : readable(entry.unit);
  const unit = name.replaceAll("^2", "²");
  const space = unit && unit !== "°" ? " " : "";
  return `${short(value * scale, 3)}${space}${unit}`;
};

/** What a slider stands at, with the range of entries that it shifts. */
const told = (entry, state) => shown(entry, entry.get(state)) + (entry.shifts ? ` (${entry.range(state).map((x) => shown(entry, x)).join(" to ")})` : "");

// --- the panel of sliders

export class Controls {
  /**
   * @param {HTMLElement} box
   * @param {(change: (state: object) => object, final: boolean) => void} change
   */
  constructor(box, change) {
    this.box = box;
    this.change = change;
    this.open = {};
  }

  show(state) {
    const now = groups(state);
    const shape = state.preset + JSON.stringify(now.map(([title, , entries]) => [title, entries.map((entry) => [entry.id ?? entry.key, entry.label, entry.min, entry.max])]));
    if (shape !== this.shape) this.build(state, now);
    this.shape = shape;
    for (const update of this.updates) update(state);
  }

  build(state, now) {
    const focus = document.activeElement?.dataset?.id;
    this.updates = [];
    this.box.replaceChildren(
      ...now.map(([title, open, entries]) => {
        const group = title.startsWith("Gains") ? "Gains" : title;
        const details = element("details", { open: this.open[group] ?? open, ontoggle: (event) => (this.open[group] = event.target.open) }, element("summary", {}, title));
        details.append(...entries.map((entry) => (entry.get ? this.slider(entry) : this.choice(entry.key))));
        return details;
      }),
    );
    if (focus) this.box.querySelector(`[data-id="${CSS.escape(focus)}"]`)?.focus();
  }

  slider(entry) {
    const id = `slider-${entry.id}`;
    const output = element("output", { for: id });
    const set = (final) => () => this.change((state) => entry.set(state, fromPlace(entry, input.value / FINE)), final);
    const step = entry.step && !entry.log ? Math.floor((1e6 * FINE * entry.step) / (entry.max - entry.min)) / 1e6 : 1; // a whole number of them reaches the end
    const input = element("input", { type: "range", id, min: 0, max: FINE, step, "data-id": entry.id, oninput: set(false), onchange: set(true) });
    const reset = element("button", { type: "button", class: "reset", title: "back to the preset", "aria-label": `${entry.label}: back to the preset`, onclick: () => this.change((state) => entry.reset(state), true) }, "↺");
    this.updates.push((state) => {
      const value = entry.get(state);
      const place = Math.max(0, Math.min(1, toPlace(entry, value)));
      if (document.activeElement !== input || Math.abs(fromPlace(entry, input.value / FINE) - value) > 1e-9 * Math.abs(value)) input.value = FINE * place;
      const text = told(entry, state);
      if (output.textContent !== text) input.setAttribute("aria-valuetext", text);
      write(output, text);
      const differs = entry.differs(state);
      reset.style.visibility = differs ? "visible" : "hidden";
      row.classList.toggle("changed", differs);
    });
    const row = element("div", { class: "slider", title: `${entry.key}: ${keyOf[entry.key].meaning}` }, element("label", { for: id }, entry.label), output, reset, input);
    return row;
  }

  choice(key) {
    const spec = keyOf[key];
    const id = `choice-${key}`;
    const label = key.split(".").slice(-1)[0].replaceAll("_", " ");
    const text = NAMED[key] ?? { enabled: "fuzzy systems" }[label] ?? label;
    if (spec.type === "flag") {
      const input = element("input", { type: "checkbox", id, "data-id": key, onchange: () => this.change((state) => changed(state, key, input.checked ? 1 : 0), true) });
      this.updates.push((state) => (input.checked = valueOf(state, key) !== 0));
      return element("div", { class: "choice", title: `${key}: ${spec.meaning}` }, element("label", { for: id }, text), input);
    }
    const input = element(
      "select",
      { id, "data-id": key, onchange: () => this.change((state) => changed(state, key, input.value), true) },
      ...spec.choices.map((name) => element("option", { value: name }, name.replaceAll("_", " "))),
    );
    this.updates.push((state) => (input.value = valueOf(state, key)));
    return element("div", { class: "choice", title: `${key}: ${spec.meaning}` }, element("label", { for: id }, text), input);
  }
}

// --- the list of all keys

const bounds = ({ minimum, maximum, exclusive = [] }) =>
  [
    minimum === null || minimum === undefined ? "" : `${exclusive.includes("minimum") ? ">" : "≥"} ${short(minimum)}`,
    maximum === null || maximum === undefined ? "" : `${exclusive.includes("maximum") ? "<" : "≤"} ${short(maximum)}`,
  ]
    .filter(Boolean)
    .join(", ");

export class KeyList {
  constructor(box, search, change) {
    this.box = box;
    this.search = search;
    this.change = change;
    search.addEventListener("input", () => this.filter());
  }

  show(state) {
    this.state = state;
    if (!this.box.closest("details").open) return;
    const law = valueOf(state, "controller.law");
    if (law !== this.law) {
      this.law = law;
      this.rows = listedKeysOf(law).map((spec) => this.row(spec));
      this.box.replaceChildren(...this.rows.map(({ row }) => row));
      this.filter();
    }
    for (const entry of this.rows) {
      const { spec, row, input } = entry;
      if (!entry.isUnsent || document.activeElement !== input) this.write(entry);
      row.classList.toggle("changed", spec.key in state.changes);
      row.classList.toggle("asleep", !acts(state, spec));
    }
  }

  /** Writes into a field the value that its key has, in place of what was typed and not sent or not understood. */
  write(entry) {
    const { spec, input } = entry;
    const text = textOf(valueOf(this.state, spec.key));
    if (input.value !== text) input.value = text;
    input.setCustomValidity("");
    entry.isUnsent = false;
  }

  row(spec) {
    const id = `key-${spec.key}`;
    const set = () => {
      input.setCustomValidity("");
      try {
        const value = parsed(spec.key, input.value);
        entry.isUnsent = false;
        this.change((state) => changed(state, spec.key, value), true);
      } catch (error) {
        input.setCustomValidity(error.message);
        input.reportValidity();
      }
    };
    const names = spec.type === "flag" ? [["1", "yes"], ["0", "no"]] : spec.type === "choice" ? spec.choices.map((name) => [name, name]) : null;
    const input = names
      ? element("select", { id, onchange: set }, ...names.map(([value, text]) => element("option", { value }, text)))
      : element("input", { id, type: "text", inputmode: "text", autocomplete: "off", spellcheck: "false", onchange: set });
    const about = [spec.unit && spec.unit !== "1" ? `[${spec.unit}]` : "", bounds(spec), spec.optional ? "or none" : "", spec.mode === "sampled" ? "sampled mode" : ""].filter(Boolean).join(" · ");
    const row = element("div", { class: "key" }, element("label", { for: id }, spec.key), input, element("p", {}, spec.meaning, element("small", {}, about ? ` ${about}` : "")));
    const entry = { spec, row, input, isUnsent: false };
    input.addEventListener("input", () => (entry.isUnsent = true));
    input.addEventListener("blur", () => input.validationMessage || this.write(entry)); // what was refused stays, with why
    return entry;
  }

  filter() {
    const words = this.search.value.toLowerCase().split(/\s+/);
    for (const { spec, row } of this.rows ?? []) {
      const text = `${spec.key} ${spec.meaning} ${spec.unit}`.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
    }
  }
}
