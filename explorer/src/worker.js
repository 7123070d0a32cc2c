/**
 * Runs scenarios away from the page. Of two requests for a run the newer one counts: the older one is left where it is.
 *
 * In: {module}; {id, scenario, spare, isDragged}: a run, and samples to write over; {id, map: {scenario, names, cells: [[index, a, b]...]}}; {id}: stop.
 * Out: {ready}; {id, result} or {id, refusal}, {id, progress}; {id, cells: [[index, outcome, metrics, refusal]...]} or {id, refusal}.
 */
import { Core, Refusal } from "./core.js";

const LOGGING = "simulation.log_every";
const PIECE = 40; // milliseconds between two answers of a map
const BREATH = 30; // milliseconds of a run between two looks at what else is asked for
const FIRST_STEPS = 20; // of a run, by which the time of a step is measured
const GROWTH = 10; // from one advance to the next, at most: the clock is coarse
const CLOCK = 0.1; // milliseconds

let core = null;
let newest = 0;
const pending = [];
const channel = new MessageChannel();
channel.port1.onmessage = () => pending.shift()();
const breath = () =>
  new Promise((resolve) => {
    pending.push(resolve);
    channel.port2.postMessage(0);
  });

/** Runs a scenario to its end of so many steps; returns whether it got there: a newer request stops it. */
async function finished(id, scenario, steps) {
  core.apply(scenario);
  core.begin();
  let count = FIRST_STEPS;
  let [since, before] = [performance.now(), performance.now()];
  while (core.advance(count)) {
    const now = performance.now();
    count = Math.max(1, Math.floor(count * Math.min(GROWTH, BREATH / Math.max(CLOCK, now - before))));
    before = now;
    if (now - since < 0.9 * BREATH) continue;
    postMessage({ id, progress: core.taken / steps });
    await breath();
    if (newest !== id) return false;
    since = before = performance.now();
  }
  return true;
}

/**
 * Whether a run that ended early is computed again, for samples that were left out: while something is dragged only one so short
 * that both take no more than a quarter of a whole run, for a longer one has samples enough, and would be late.
 */
const isAgain = (every, scenario, steps, isDragged) => (isDragged ? every < scenario[LOGGING] && 8 * core.taken <= steps : 2 * every <= scenario[LOGGING]);

async function run(id, { scenario, spare, isDragged }) {
  const steps = scenario["simulation.duration"] / scenario["simulation.step"];
  if (!(await finished(id, scenario, steps))) return;
  const every = Math.ceil((scenario[LOGGING] * core.taken) / steps); // that gives a run of the steps that were taken as many samples
  if (isAgain(every, scenario, steps, isDragged) && !(await finished(id, { ...scenario, [LOGGING]: Math.max(1, every) }, core.taken))) return;
  const result = core.result(spare);
  core.end();
  postMessage(
    { id, result },
    Object.values(result.samples).map((samples) => samples.buffer),
  );
}

async function map(id, { scenario, names, cells }) {
  const base = { ...scenario, [LOGGING]: 1e9 };
  for (const name of names) delete base[name]; // every cell sets them, so what the core refuses here it refuses of each
  core.apply(base);
  let done = [];
  let since = performance.now();
  for (const [index, ...values] of cells) {
    try {
      if (core.isWorn()) core.apply(base);
      core.change(Object.fromEntries(names.map((name, i) => [name, values[i]])));
      core.begin();
      core.advance();
      done.push([index, core.outcome(), core.metricsNow()]);
      core.end();
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      done.push([index, "refused", {}, error.message]);
    }
    if (performance.now() - since > PIECE) {
      postMessage({ id, cells: done });
      done = [];
      await breath();
      since = performance.now();
      if (newest !== id) return;
    }
  }
  postMessage({ id, cells: done, finished: true });
}

onmessage = async ({ data }) => {
  if (data.module) {
    core = new Core(data.module);
    postMessage({ ready: true });
    return;
  }
  newest = data.id;
  try {
    if (data.scenario) await run(data.id, data);
    else if (data.map) await map(data.id, data.map);
  } catch (error) {
    if (!(error instanceof Refusal)) core.start(); // what failed has left this one in no state to go on from
    postMessage({ id: data.id, refusal: error.message, known: error instanceof Refusal });
  }
};
