/** The workers of the page: one for the run that is shown, more for maps. */

import { unpacked } from "./unpack.js";

let parts = null;
const load = () =>
  (parts ??= (async () => ({
    module: await WebAssembly.compile(await unpacked("core").arrayBuffer()),
    script: URL.createObjectURL(new Blob([document.getElementById("worker").textContent], { type: "text/javascript" })),
  }))());

/** Starts a worker; `answer` gets its messages. */
async function worker(answer) {
  const { module, script } = await load();
  const made = new Worker(script);
  await new Promise((resolve, reject) => {
    made.onmessage = resolve;
    made.onerror = (event) => reject(new Error(event.message));
    made.postMessage({ module });
  });
  made.onmessage = ({ data }) => answer(data);
  return made;
}

const PATIENCE = 200; // milliseconds that a run may take before a newer request replaces it

/** Runs one scenario at a time; while one runs, only the newest request waits, and that no longer than `PATIENCE`. */
export class Runner {
  /** @param {(answer: {result?: object, refusal?: string, progress?: number}, tag: unknown) => void} answer */
  static async make(answer) {
    const runner = new Runner();
    runner.id = 0;
    runner.busy = false;
    runner.waiting = null;
    runner.spare = {};
    runner.worker = await worker((message) => {
      if (message.id !== runner.id) return;
      if (message.progress !== undefined) {
        runner.slow = performance.now() - runner.began > PATIENCE;
        answer(message);
        if (runner.slow && runner.waiting) runner.start(...runner.waiting);
        return;
      }
      runner.busy = false;
      const { tag } = runner;
      if (runner.waiting) runner.start(...runner.waiting); // first, so that it runs while the answer is drawn, or cannot be
      answer(message, tag);
    });
    return runner;
  }

  /**
   * @param {unknown} tag what the answer is handed over with
   * @param {boolean} isDragged whether the next one is there soon, and pictures are to come fast
   */
  run(scenario, tag, isDragged = false) {
    if (this.busy && !this.slow) this.waiting = [scenario, tag, isDragged];
    else this.start(scenario, tag, isDragged);
  }

  start(scenario, tag, isDragged) {
    this.tag = tag;
    this.waiting = null;
    this.busy = true;
    this.slow = false;
    this.began = performance.now();
    this.id += 1;
    this.worker.postMessage({ id: this.id, scenario, spare: this.spare, isDragged }, Object.values(this.spare).map(({ buffer }) => buffer));
    this.spare = {};
  }

  /** Takes a result that is no longer shown, for a later run to write over. */
  reuse(result) {
    this.spare = result.samples;
  }
}

/** Runs many scenarios that differ in some keys. */
export class Crew {
  constructor() {
    this.count = Math.max(1, Math.min(8, navigator.hardwareConcurrency ?? 2));
    this.workers = [];
    this.id = 0;
  }

  /** Once: a map that is asked for while the first one waits for its workers has the same. */
  start() {
    this.started ??= Promise.all(Array.from({ length: this.count }, () => worker((message) => this.answer?.(message)))).then((workers) => {
      this.workers = workers;
    });
    return this.started;
  }

  /**
   * @param {object} scenario what they have in common
   * @param {string[]} names keys that differ
   * @param {Array<[number, ...unknown[]]>} cells number of each, and its values, the first ones first
   * @param {(cells: Array<[number, string, object, string?]>, finished: boolean) => void} answer
   * @param {(words: string) => void} refuse what they have in common cannot run
   */
  async map(scenario, names, cells, answer, refuse) {
    const id = ++this.id;
    try {
      await this.start();
    } catch (error) {
      if (id === this.id) refuse(`Maps cannot run here: ${error.message}.`);
      return;
    }
    if (id !== this.id) return;
    let running = this.count;
    this.answer = (message) => {
      if (message.id !== this.id) return;
      if (message.refusal) {
        this.stop(); // the other workers refuse the same
        refuse(message.known ? message.refusal : `The core failed: ${message.refusal}`);
        return;
      }
      if (message.finished) running -= 1;
      answer(message.cells, running === 0);
    };
    this.workers.forEach((made, k) => made.postMessage({ id, map: { scenario, names, cells: cells.filter((_, i) => i % this.count === k) } }));
  }

  stop() {
    this.id += 1;
    for (const made of this.workers) made.postMessage({ id: this.id });
  }
}
