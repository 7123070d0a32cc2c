/**
 * The core in WebAssembly, through its C interface (cpp/include/hexservo.h).
 *
 * A refusal leaves the module as an exception of JavaScript, `Refusal`, and loses some of its memory: after many of
 * them the next run begins with a new instance.
 */

/** What the core says about a scenario that cannot run: "key: expected ..., got ...". */
export class Refusal extends Error {}

/** Names and places of what a sample consists of, in the order of `hexservo_quantity`. */
export const QUANTITIES = [
  "time",
  "feature_error",
  "depth",
  "position",
  "quaternion",
  "twist",
  "wrench",
  "fuzzy_output",
  "leg_lengths",
  "leg_forces",
];

/** What a leg may be beyond, in the order of `hexservo_limit`. */
const LIMITS = ["stroke", "force", "speed", "base_joint", "platform_joint"];

const INTERFACE = 3;
const MOST_REFUSALS = 300;
const SCRATCH_BYTES = 65536;
const MOST_LETTERS = 1024; // of a key's text: names, and a number of 64 bits
const SCENE = { base_joints: 18, platform_joints: 18, home_position: 3, home_quaternion: 4, camera_position: 3, camera_attitude: 9, focal: 1 };
const SCENE_BYTES = 8 * Object.values(SCENE).reduce((sum, count) => sum + count, 0);
const NO_SUCH_CALL = 52;

/** One scenario and its runs. Keys are set with numbers, lists of numbers, null, or text. */
export class Core {
  /** @param {WebAssembly.Module} module */
  constructor(module) {
    this.module = module;
    this.start();
  }

  /** Begins with a new instance, which knows nothing of the runs and keys of the last one. */
  start() {
    const system = new Proxy({}, { get: () => () => NO_SUCH_CALL });
    const refuse = (at, size) => {
      throw new Refusal(this.read(at, size));
    };
    const instance = new WebAssembly.Instance(this.module, { wasi_snapshot_preview1: system, env: system, hexservo: { refuse } });
    this.c = instance.exports;
    this.c._initialize();
    if (this.c.hexservo_interface() !== INTERFACE) throw new Error("hexservo: page and core do not belong together");
    this.stack = this.c.__stack_pointer.value;
    this.scratch = this.c.malloc(SCRATCH_BYTES);
    this.run = 0;
    this.handle = this.c.hexservo_scenario_create();
    this.refusals = 0;
    /** @type {Map<string, unknown>} */
    this.known = new Map();
    this.defaults = new Map();
    this.metrics = [];
    for (let i = 0; i < this.c.hexservo_metric_count(); ++i) this.metrics.push(this.text(this.c.hexservo_metric_name(i)));
  }

  read(at, size) {
    return new TextDecoder().decode(new Uint8Array(this.c.memory.buffer, at, size));
  }

  text(at) {
    const bytes = new Uint8Array(this.c.memory.buffer, at);
    return this.read(at, bytes.indexOf(0));
  }

  doubles(at, count) {
    return new Float64Array(this.c.memory.buffer, at, count);
  }

  /** Writes text with its final zero; returns what follows it. */
  write(text, at) {
    const bytes = new TextEncoder().encode(text + "\0");
    new Uint8Array(this.c.memory.buffer, at, bytes.length).set(bytes);
    return at + bytes.length;
  }

  /** Calls what may refuse. */
  guarded(call) {
    try {
      return call();
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      this.c.__stack_pointer.value = this.stack;
      this.refusals += 1;
      throw error;
    }
  }

  set(key, value) {
    if (typeof value === "string" && value.length > MOST_LETTERS) throw new Refusal(`${key}: expected text of at most ${MOST_LETTERS} letters, got ${value.length}: shorten it`);
    const end = this.write(key, this.scratch);
    const aligned = (end + 7) & ~7;
    this.guarded(() => {
      if (typeof value === "string") {
        this.write(value, aligned);
        return this.c.hexservo_scenario_set_text(this.handle, this.scratch, aligned);
      }
      const numbers = value === null ? [] : [value].flat(2).map(Number);
      const room = numbers.length > 4096 ? this.c.malloc(8 * numbers.length) : aligned;
      if (!room) throw new Refusal(`${key}: expected numbers that fit into memory, got ${numbers.length}: give fewer`);
      this.doubles(room, numbers.length).set(numbers);
      const status = this.c.hexservo_scenario_set_numbers(this.handle, this.scratch, room, numbers.length);
      if (room !== aligned) this.c.free(room);
      return status;
    });
  }

  /** Text of any key. */
  get(key) {
    const end = (this.write(key, this.scratch) + 7) & ~7;
    this.guarded(() => this.c.hexservo_scenario_get_text(this.handle, this.scratch, end));
    return this.text(new Uint32Array(this.c.memory.buffer, end, 1)[0]);
  }

  /** Whether refusals have lost so much memory that `apply` begins with a new instance. */
  isWorn() {
    return this.refusals > MOST_REFUSALS;
  }

  /**
   * Sets every key of a scenario; those that did not change since the last time are left alone.
   * @param {Record<string, unknown>} scenario all keys of its law, "controller.law" among them
   */
  apply(scenario) {
    if (this.isWorn()) this.start();
    if (this.known.get("controller.law") !== scenario["controller.law"]) {
      this.known.clear();
      this.set("controller.law", scenario["controller.law"]);
      this.known.set("controller.law", scenario["controller.law"]);
    }
    this.change(scenario);
  }

  /** Sets some keys of the law that acts. */
  change(values) {
    for (const [key, value] of Object.entries(values)) {
      const text = typeof value === "object" ? JSON.stringify(value) : value;
      if (this.known.get(key) === text) continue;
      this.known.delete(key);
      this.set(key, value);
      this.known.set(key, text);
    }
  }

  /** Starts a run of what was applied; `advance` and `result` belong to it. */
  begin() {
    this.end();
    const place = this.scratch;
    this.guarded(() => this.c.hexservo_run_create(this.handle, place));
    this.run = new Uint32Array(this.c.memory.buffer, place, 1)[0];
  }

  /** Goes on by so many steps, to the end without a number; returns whether the run goes on still. `taken` are the steps since the start. */
  advance(steps = -1) {
    this.taken = Number(this.c.hexservo_run_advance(this.run, BigInt(steps)));
    return this.c.hexservo_run_outcome(this.run) < 0;
  }

  end() {
    if (this.run) this.c.hexservo_run_destroy(this.run);
    this.run = 0;
  }

  metricsNow() {
    const numbers = this.doubles(this.c.hexservo_run_metrics(this.run), this.metrics.length);
    return Object.fromEntries(this.metrics.map((name, i) => [name, numbers[i]]));
  }

  outcome() {
    return this.text(this.c.hexservo_outcome_name(this.c.hexservo_run_outcome(this.run)));
  }

  /** Limits that legs of a run passed, in the order of first times: limit, leg from 1, first time [s], largest value and what the limit allows [SI]. */
  events() {
    return Array.from({ length: this.c.hexservo_run_event_count(this.run) }, (_, i) => {
      this.c.hexservo_run_event(this.run, i, this.scratch);
      const [limit, leg] = new Int32Array(this.c.memory.buffer, this.scratch, 2);
      const [time, peak, most] = this.doubles(this.scratch + 8, 3);
      return { limit: LIMITS[limit], leg: leg + 1, time, peak, most };
    });
  }

  /**
   * All that is known of a run, copied out of the module.
   * @param {Record<string, Float64Array>} spare samples of an older run, which are written over where they are as long: new memory takes a millisecond
   */
  result(spare = {}) {
    const { c, run } = this;
    const rows = c.hexservo_run_rows(run);
    const samples = {};
    QUANTITIES.forEach((name, i) => {
      const found = this.doubles(c.hexservo_run_samples(run, i), rows * c.hexservo_run_width(run, i));
      samples[name] = spare[name]?.length === found.length ? spare[name] : new Float64Array(found.length);
      samples[name].set(found);
    });
    c.hexservo_run_scene(run, this.scratch);
    const numbers = this.doubles(this.scratch, SCENE_BYTES / 8);
    const scene = {};
    let place = 0;
    for (const [name, count] of Object.entries(SCENE)) {
      scene[name] = Array.from(numbers.subarray(place, place + count));
      place += count;
    }
    scene.camera_on_base = new Int32Array(c.memory.buffer, this.scratch + SCENE_BYTES, 1)[0] === 1;
    const points = c.hexservo_scenario_points(this.handle);
    c.hexservo_run_target(run, this.scratch);
    scene.target = Array.from(this.doubles(this.scratch, 3 * points));
    c.hexservo_run_goal(run, this.scratch);
    scene.goal = Array.from(this.doubles(this.scratch, 2 * points));
    return {
      rows,
      points,
      samples,
      scene,
      metrics: this.metricsNow(),
      events: this.events(),
      outcome: this.outcome(),
      detail: this.text(c.hexservo_run_detail(run)),
      time: c.hexservo_run_time(run), // of the last sample; a run that ends early ends in the step after it
      steps: this.taken,
    };
  }

  /** A whole run of a scenario. */
  simulate(scenario) {
    this.apply(scenario);
    this.begin();
    this.advance();
    const result = this.result();
    this.end();
    return result;
  }
}
