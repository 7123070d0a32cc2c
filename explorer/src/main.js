/** The page: a state, the run of it, and what is drawn of that. */
import { incomparable, isSameRun, pinnedLabel, referenceOf } from "./against.js";
import { borderOf, firstOutside, hasLens, inWords } from "./imageborder.js";
import { Chart, FIGURES } from "./charts.js";
import { Controls, KeyList, element } from "./controls.js";
import { Runner } from "./engine.js";
import { short, withUnit } from "./format.js";
import { Happenings } from "./happenings.js";
import { ImageView } from "./image.js";
import { bounds, happenings, middles, passedLimits, restAtStroke, unitOfMetric, valueAtStop, wordsOfMetric } from "./limits.js";
import { ParameterMap } from "./map.js";
import { actingChanges, changed, drawn, full, groups, laws, metrics, presetOf, presets, readAddress, same, start, textOf, toAddress, toYaml, valueOf, version } from "./model.js";
import { endsAt, targetAt } from "./machine.js";
import { MachineView } from "./scene.js";
import { dark, write } from "./view.js";

const $ = (id) => document.getElementById(id);
const SETTLE = 300; // milliseconds of rest after which the address follows
const LONG = 200; // milliseconds after which a run that is not there yet is one that is waited for

let { state, ignored } = readAddress(location.hash || start);
let result = null;
let reference = null;
let share = 1; // of the run's time that is shown
let playing = 0;
let addressTimer = 0;
let waitTimer = 0;
const latencies = []; // from a change to its picture [ms], for the test that measures them

// --- from a change to a picture

function change(how, final = true) {
  let next;
  try {
    next = how(state);
  } catch (error) {
    say(error.message);
    return;
  }
  if (next === state) return;
  ignored = [];
  const other = !same(referenceOf(next), referenceOf(state));
  state = next;
  run(!final);
  if (other) compare();
  refresh();
  clearTimeout(addressTimer);
  addressTimer = setTimeout(() => writeAddress(final), final && performance.now() - written > SETTLE ? 0 : SETTLE);
}

let goesOn = false; // the change of the newest entry of the history
let written = -Infinity; // [ms]

/** One entry of the history for each change, however long it is dragged: Back undoes it. */
function writeAddress(final) {
  clearTimeout(addressTimer);
  const address = toAddress(state);
  const isNew = address !== location.hash;
  if (isNew) history[goesOn ? "replaceState" : "pushState"](null, "", address);
  goesOn = !final && (goesOn || isNew);
  written = performance.now();
}

/** Shows what an address says. */
function goTo(address) {
  const { state: found, ignored: left } = readAddress(address);
  change(() => found);
  ignored = left;
}

/** Asks for the run of the state: with fewer samples while something is dragged. */
function run(isDragged = false) {
  if (!runner) return;
  waitTimer ||= setTimeout(wait, LONG);
  runner.run(drawn(state, isDragged), { asked: performance.now(), state }, isDragged);
}

/** What is shown is of an older state, for longer than one notices. */
function wait() {
  $("busy").hidden = false;
  document.body.classList.add("stale");
}

function waitNoLonger() {
  clearTimeout(waitTimer);
  waitTimer = 0;
  $("busy").hidden = true;
  $("share").removeAttribute("value");
}

function refresh() {
  $("preset").value = state.preset;
  $("law").value = valueOf(state, "controller.law");
  write($("about-preset"), presetOf(state.preset).description);
  controls.show(state);
  keyList.show(state);
  write($("pin"), state.pinned ? "Compare with the preset" : "Compare with this run");
  if (document.body.dataset.map) map.show(state); // at once, also where the core will refuse the state
  const [all, acting] = [Object.keys(state.changes).length, actingChanges(state).length];
  const count = acting || all;
  $("reset").disabled = count === 0;
  $("reset").textContent = count ? `Reset ${count} ${count === 1 ? "change" : "changes"}${acting ? "" : " without effect"}` : "No changes";
}

function answer(message, tag) {
  if (message.progress !== undefined) {
    $("share").value = message.progress;
    return;
  }
  waitNoLonger();
  if (tag.state !== state) waitTimer = setTimeout(wait, LONG); // for the one that was asked for since
  if (message.refusal) {
    document.body.classList.add("stale");
    globalThis.explorer.refusal = message.refusal;
    if (result) {
      result.state = { ...result.state, pinned: tag.state.pinned }; // what it is compared with is nothing that the core refused
      show();
    }
    say(reasonOf(message), ...ignored);
    globalThis.explorer.shown = toAddress(tag.state);
    return;
  }
  globalThis.explorer.refusal = null;
  document.body.classList.remove("stale");
  const before = result;
  result = arrived(message.result, tag.state);
  show();
  say(...ignored, ...unmet());
  if (before) runner.reuse(before);
  queueMicrotask(() => latencies.push(performance.now() - tag.asked)); // after the charts, which draw in microtasks
  globalThis.explorer.shown = toAddress(tag.state);
}

/** A run of a state, with the border of its image and the first point outside of that: a search of all samples, once for each run. */
function arrived(run, of) {
  const border = borderOf(of);
  return { ...run, state: of, border, outside: firstOutside({ ...run, border }) };
}

const reasonOf = ({ refusal, known }) => (known ? refusal : `The core failed: ${refusal}`);

/** What came of the run that a state is compared with. */
function compared(message, against) {
  if (message.progress !== undefined) return;
  reference = message.refusal ? { refusal: reasonOf(message), state: against } : arrived(message.result, against);
  if (!result) return;
  show();
  if (globalThis.explorer.refusal === null) say(...ignored, ...unmet());
}

/** A sentence where what is shown has nothing to be compared with, for the core refused that. */
function unmet() {
  const refusal = isOfResult() ? reference.refusal : "";
  return refusal ? [`${result.state.pinned ? "pinned run" : "preset"}: ${refusal}`] : [];
}

function say(...sentences) {
  const words = sentences.join(". ");
  write($("message"), words);
  $("message").hidden = !words;
}

/** Draws the result, with what the state that it is of says: the page's state may be one that is computed, or was refused. */
function show() {
  const { state: of } = result;
  const gravity = [valueOf(of, "robot.gravity")].flat();
  const down = gravity.length === 3 && gravity.some((g) => g !== 0) ? gravity : [0, 0, 1];
  const mass = valueOf(of, "robot.mass") + (valueOf(of, "robot.payload.known") ? valueOf(of, "robot.payload.mass") : 0);
  result.weight = gravity.map((g) => -mass * g);
  result.shown = shown();
  result.step = valueOf(of, "simulation.step");
  result.cranks = cranks(of);
  result.stroke = valueOf(of, "robot.stroke");
  result.middle = middles(of, result);
  write($("border"), result.border ? "green: border" : "");
  result.bounds = bounds(of, result.middle);
  result.band = valueOf(of, "metrics.band");
  result.isChanged = !isSameRun(of, referenceOf(of));
  result.ghost = ghost();
  document.body.dataset.ghost = result.ghost ? "yes" : "";
  for (const note of document.querySelectorAll("small.ghost")) write(note, of.pinned ? "pale: pinned run" : "pale: the preset");
  result.targetMoves = valueOf(of, "target.motion.kind") !== "none";
  image.show({ ...result, goals: result.scene.goal, movable: pixelsAreFeatures(of) });
  scene.show(result, down.map((g) => -g));
  for (const chart of charts) chart.show(result);
  happened.show(happenings(of, result, result.outside));
  at(share);
  verdict();
  table();
}

/** Cranks of rotary legs: length [m], axes and directions at angle 0, (6, 3) unit vectors in B each; null: prismatic legs. */
function cranks(of) {
  if (valueOf(of, "robot.legs") !== "rotary") return null;
  const rows = (name) => [valueOf(of, `robot.cranks.${name}`)].flat(3);
  return { length: valueOf(of, "robot.cranks.length"), axes: rows("axes"), zero: rows("zero") };
}

/** Whether the camera's pixels are what its pinhole would have: only then a goal can be dragged to one. */
const pixelsAreFeatures = (of) => valueOf(of, "camera.principal_point") === null && !hasLens(of);

/** Time up to which charts go [s]: all of it, or three times what settling takes, on a scale of 1, 2, 5. */
function shown() {
  const end = result.samples.time[result.rows - 1] || 1;
  const wanted = 3 * result.metrics.settling_time;
  if ($("span").value === "all" || !(wanted > 0)) return end;
  const power = 10 ** Math.floor(Math.log10(wanted));
  return Math.min(end, [1, 2, 5, 10].find((factor) => factor * power >= wanted) * power);
}

/** Shows a time of the run, as a share of it. */
function at(next) {
  share = Math.max(0, Math.min(1, next));
  const row = Math.round(share * (result.rows - 1));
  const time = result.samples.time[row];
  image.draw(row);
  $("border").style.visibility = image.showsBorder ? "" : "hidden"; // has its place, so that the views stay
  scene.draw(row);
  for (const chart of charts) chart.at(time, row);
  $("time").value = share;
  write($("now"), `${time.toFixed(3)} s`);
  $("time").setAttribute("aria-valuetext", `${time.toFixed(3)} seconds`);
}

// --- words and numbers

/** How a run of a state went: good, bad or warn, and a sentence, at whose end is what it does beyond the limits of the legs. */
function ending(of, run) {
  const { outcome, metrics: values, time, detail, outside } = run;
  const beyond = [...(outside ? [inWords(outside)] : []), ...passedLimits(of, run), ...restAtStroke(of, run)].join(", ");
  if (outcome !== "completed") return ["bad", `Ends early, ${outcome.replaceAll("_", " ")}${detail ? `: ${detail}` : ""}${valueAtStop(of, run)}${beyond && `; before that ${beyond}`}`];
  const band = withUnit(valueOf(of, "metrics.band"), "px");
  if (Number.isNaN(values.settling_time)) return ["warn", `Does not settle: ${withUnit(values.final_error, "px")} from the goal after ${withUnit(time, "s")}${beyond && `, and ${beyond}`}`];
  return [beyond ? "warn" : "good", `Settles within ${band} after ${withUnit(values.settling_time, "s")}${beyond && `, but ${beyond}`}`];
}

/** Whether the reference that is there is that of what is shown: another one may be computed. */
const isOfResult = () => reference !== null && same(reference.state, referenceOf(result.state));

/** The run that what is shown is compared with, the preset's or the one that is pinned; null while that is computed, or where it was refused. */
const itsReference = () => (isOfResult() && !reference.refusal ? reference : null);

const FEWEST_PALE = 100; // samples of a pale run that are drawn, however far apart those of the run before it are

/** That run where it is another one than what is shown, and its features are as many; `stride`: samples from one that is drawn to the next, `step` [s]. */
function ghost() {
  const against = itsReference();
  if (!against || !result.isChanged || against.points !== result.points) return null;
  const [own, other] = [result, against].map(({ samples: { time } }) => time[1] - time[0]);
  const most = Math.floor(against.rows / FEWEST_PALE);
  const stride = Math.max(1, Math.min(Math.round(own / other) || 1, most)); // two runs that are compared are drawn alike, where the pale one has the samples
  return { ...against, stride, step: valueOf(against.state, "simulation.step") };
}

/** Offers all of the words where some lines of them are cut, or are there since that was chosen. */
function cut() {
  const isCut = ["verdict", "against"].some((name) => $(name).scrollHeight > $(name).clientHeight + 1);
  $("more").hidden = !isCut && !$("words").classList.contains("whole");
}

function verdict() {
  const [kind, words] = ending(result.state, result);
  $("verdict").className = `verdict ${kind}`;
  write($("verdict"), words);
  const against = itsReference();
  const before = against && result.isChanged ? ending(against.state, { ...against, detail: "" })[1] : "";
  write($("against"), before && `${result.state.pinned ? "Pinned run" : "Preset"}: ${before.replace(/^./, (letter) => letter.toLowerCase())}`);
  requestAnimationFrame(cut); // with the layout of the frame
  image.canvas.setAttribute("aria-label", `Image plane: paths of ${result.points} features to their goals. ${words}. Arrow keys move a goal, digits choose it.`);
  write($("origin"), origin(result.state));
}

/** What a printed page is of. */
function origin(of) {
  const changes = actingChanges(of).map(([key, value]) => `${key} = ${textOf(value)}`);
  const law = valueOf(of, "controller.law").replaceAll("_", " ");
  const address = location.href.split("#")[0] + toAddress(of);
  return [`Scenario ${of.preset}`, `law ${law}`, changes.length ? `changed: ${changes.join(", ")}` : "nothing changed", `hexservo ${version}`, address].join("; ");
}

let rows = null;
function table() {
  rows ??= metrics.map((metric) => {
    const cells = [element("td"), element("td")];
    const words = [element("summary"), element("span")];
    $("metrics").append(element("tr", {}, element("th", { scope: "row" }, element("details", {}, ...words)), ...cells));
    return { metric, words, cells };
  });
  const { pinned } = result.state;
  const against = itsReference();
  const reason = against ? incomparable(result, against) : "";
  const differs = against && result.isChanged && !reason;
  const label = pinned ? pinnedLabel(result.state, pinned) : "preset";
  write($("of-preset"), unmet().length ? `${label}, refused` : reason ? `${label}, not comparable: ${reason}` : label);
  for (const { metric, words, cells } of rows) {
    const { name } = metric;
    const unitOf = (state) => unitOfMetric(state, metric); // of two kinds of legs they differ
    wordsOfMetric(result.state, metric).forEach((text, i) => write(words[i], text));
    cells[0].parentElement.title = words[1].textContent;
    const [value, before] = [result.metrics[name], against?.metrics[name] ?? NaN];
    cells[0].parentElement.hidden = Number.isNaN(value) && Number.isNaN(before) && name !== "settling_time";
    write(cells[0], withUnit(value, unitOf(result.state)));
    write(cells[1], against ? withUnit(before, unitOf(against.state)) : "");
    const ratio = value / before;
    const alike = Math.abs(ratio - 1) < 0.01 || (Number.isNaN(value) && Number.isNaN(before));
    cells[0].className = !differs || alike ? "" : ratio < 1 || (Number.isNaN(before) && !Number.isNaN(value)) ? "good" : ratio > 1 || Number.isNaN(value) ? "bad" : "";
  }
}

function compare() {
  reference = null;
  const against = referenceOf(state);
  referee?.run(drawn(against), against);
}

// --- time

const STILL = 500; // milliseconds that a picture stays where a reader asks for less motion
const lessMotion = matchMedia("(prefers-reduced-motion: reduce)");

function play() {
  cancelAnimationFrame(playing);
  const running = $("play").dataset.on === "yes";
  $("play").dataset.on = running ? "" : "yes";
  $("play").textContent = running ? "▶" : "❚❚";
  $("play").setAttribute("aria-label", running ? "Play" : "Pause");
  if (running || !result) return;
  if (share >= 1) share = 0;
  let before = null; // until the first frame: the time of a frame may be before the click
  const step = (now) => {
    const duration = result.samples.time[result.rows - 1] || 1;
    if (before === null || !lessMotion.matches || now - before >= STILL) {
      at(share + (Number($("speed").value) * (now - (before ?? now))) / 1000 / duration);
      before = now;
    }
    if (share >= 1) play();
    else if ($("play").dataset.on === "yes") playing = requestAnimationFrame(step);
  };
  playing = requestAnimationFrame(step);
}

const pick = (time) => result && at(time / (result.samples.time[result.rows - 1] || 1));

// --- parts

const image = new ImageView($("image"), (goals, final) => change((now) => changed(now, "target.desired_features", goals), final));
let held = null;
const scene = new MachineView($("scene"), (shift, phase) => {
  if (phase === "begin") {
    held = valueOf(state, "simulation.start.pose");
    at(0);
  } else if (phase === "move") {
    change((now) => changed(now, "simulation.start.pose", held.map((x, i) => (i < 3 ? Math.round(1e5 * (x + shift[i])) / 1e5 : x))), false);
  } else {
    writeAddress(true);
    run();
  }
});
const charts = ["errors", "forces", "moments"].map((figure, i) => {
  const chart = new Chart($(`chart-${i}`), figure, pick);
  const select = $(`figure-${i}`);
  select.append(...Object.entries(FIGURES).map(([name, { title }]) => element("option", { value: name }, title)));
  select.value = figure;
  select.addEventListener("change", () => {
    chart.choose(select.value);
    if (result) at(share);
  });
  return chart;
});
const happened = new Happenings($("happenings"), pick);
const controls = new Controls($("controls"), change);
const keyList = new KeyList($("keys"), $("search"), change);
const map = new ParameterMap($("map"), change);

$("preset").append(...groups.map(([label, members]) => element("optgroup", { label }, ...members.map(({ name }) => element("option", { value: name }, name)))));
$("law").append(...laws.map((name) => element("option", { value: name }, name.replaceAll("_", " "))));
$("preset").addEventListener("change", () => change((now) => ({ ...now, preset: $("preset").value, changes: {} })));
$("law").addEventListener("change", () => change((now) => changed(now, "controller.law", $("law").value)));
$("reset").addEventListener("click", () => change((now) => ({ ...now, changes: {} })));
$("pin").addEventListener("click", () => result && change(({ pinned, ...now }) => (pinned ? now : { ...now, pinned: { preset: result.state.preset, changes: result.state.changes } })));
$("time").addEventListener("input", () => result && at(Number($("time").value)));
$("play").addEventListener("click", play);
$("span").addEventListener("change", () => result && show());
$("all-keys").addEventListener("toggle", () => keyList.show(state));
$("map-section").addEventListener("toggle", () => {
  document.body.dataset.map = $("map-section").open ? "yes" : "";
  if ($("map-section").open) map.show(state);
});
addEventListener("hashchange", () => {
  if (toAddress(state) === location.hash) return;
  goTo(location.hash || start);
  clearTimeout(addressTimer); // the history has it
  goesOn = false;
});
addEventListener("resize", () => result && at(share));
dark.addEventListener("change", () => result && (show(), refresh()));
matchMedia("print").addEventListener("change", () => {
  for (const chart of charts) chart.fit(); // no observer of sizes is asked before a page is printed
  if (result) at(share);
});
for (const name of ["focus", "blur"]) $("image").addEventListener(name, () => result && at(share));

new ResizeObserver(([{ target }]) => {
  document.documentElement.style.setProperty("--words", `${target.getBoundingClientRect().height}px`);
  cut();
}).observe($("words"));
for (const name of ["verdict", "against", "more"]) $(name).addEventListener("click", () => $("more").hidden || $("more").setAttribute("aria-expanded", $("words").classList.toggle("whole")));

// --- out of the page

/** @param {() => string} byHand what a reader is asked to do where the browser gives the page no clipboard */
async function copied(text, button, byHand) {
  button.dataset.label ??= button.textContent;
  try {
    await navigator.clipboard.writeText(text);
    button.textContent = "Copied";
  } catch {
    button.textContent = byHand();
  }
  setTimeout(() => (button.textContent = button.dataset.label), 1500);
}

function select() {
  $("yaml").select();
  return "Select and copy";
}

$("as-yaml").addEventListener("click", () => {
  $("yaml").value = toYaml(state);
  $("save").href = URL.createObjectURL(new Blob([$("yaml").value], { type: "application/yaml" }));
  $("save").download = `${state.preset}-explored.yaml`;
  $("yaml-box").showModal();
});
$("copy").addEventListener("click", () => copied($("yaml").value, $("copy"), select));
$("link").addEventListener("click", () => {
  writeAddress(true);
  copied(location.href, $("link"), () => "Copy it from the address bar");
});

// --- start

globalThis.explorer = {
  get state() {
    return state;
  },
  get result() {
    return result;
  },
  get reference() {
    return reference;
  },
  latencies,
  refusal: null,
  shown: null,
  go: goTo,
  full: (address) => full(address ? readAddress(address).state : state),
  yaml: (address) => toYaml(address ? readAddress(address).state : state),
  ends: (row) => endsAt(result, row)?.map((end) => end.toArray()) ?? null,
  charts: () => charts.map(({ plot }) => plot),
  target: (row) => targetAt(result, row).map((point) => point.toArray()),
  place: (x, y) => image.place(x, y),
  viewer: () => scene.viewpoint.camera.position.toArray(),
  presets: presets.map(({ name }) => name),
  set: (key, value) => change((now) => changed(now, key, value)),
};

let runner = null;
let referee = null;
refresh();
try {
  [runner, referee] = await Promise.all([
    Runner.make(answer),
    Runner.make(compared),
  ]);
  run();
  compare();
} catch (error) {
  $("verdict").className = "verdict bad";
  write($("verdict"), "Does not run in this browser");
  say(`The explorer cannot run here: ${error.message}.`);
}
