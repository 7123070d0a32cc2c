"""The explorer in a browser: the core's numbers, what sliders, map, address and file do, phones; and its command."""

from __future__ import annotations

import html
import importlib.util
import json
import math
import re
import runpy
import subprocess
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pytest
from typer.testing import CliRunner

import hexservo as hs
from browsers import CHROMIUM, chromium
from hexservo import _core
from hexservo.cli.commands import app
from hexservo.findings.check_keys import settings_needed
from hexservo.report import explorer
from hexservo.report.explorer import TITLE, ExplorerError, built_for, checked_page, explorer_page, preset_values
from hexservo.run.files import write_file
from hexservo.run.leg_limits import leg_limits
from hexservo.run.metrics import METRICS
from hexservo.run.publish import OutputError
from hexservo.run.variant import load_kernel
from hexservo.scenario.flat import core_values
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.schema import schema

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROOT = Path(__file__).parents[2]
MOST_ROWS = 10000  # that the page draws of a run at rest
PATIENCE = 120e3  # milliseconds: the machine may be busy
BUILT = (resources.files("hexservo") / "explorer.html").is_file()

built = pytest.mark.skipif(not BUILT, reason="the explorer was not built (make explorer)")
in_browser = pytest.mark.skipif(
    not BUILT or CHROMIUM is None, reason="the explorer was not built (make explorer), or chromium is not installed"
)

# Without switching term, so that nothing amplifies the last digit: the mathematical functions of the browser's module
# and of the system may differ by one unit there.
SMOOTH = [
    ("paper", "computed_torque"),
    ("paper", "kelly"),
    ("paper", "pbvs"),
    ("paper", "resolved_rate"),
    ("task-general", "pbvs"),
    ("task-tilt", "computed_torque"),
    ("task-rotation", "resolved_rate"),
    ("textbook-general", "kelly"),
    ("composite-30hz", "pbvs"),
    ("real-machine", "computed_torque"),
]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as running:
        yield running


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("explorer") / "explorer.html"
    path.write_text(explorer_page("paper"), encoding="utf-8")
    return path


class Visit:
    """The page opened from the disk, with everything that went wrong on it or was asked for over the network."""

    def __init__(self, browser: Browser, file: Path, address: str = "", **context: Any) -> None:
        self.context = browser.new_context(**context)
        self.context.set_default_timeout(PATIENCE)
        self.page: Page = self.context.new_page()
        self.problems: list[str] = []
        self.page.on("console", lambda message: self.problems.append(message.text))
        self.page.on("pageerror", lambda error: self.problems.append(str(error)))
        self.page.on("request", lambda request: self.asked(request.url))
        self.page.goto(file.as_uri() + address)
        self.page.wait_for_function("globalThis.explorer?.shown && explorer.reference")

    def asked(self, url: str) -> None:
        if not url.startswith(("file:", "blob:", "data:")):
            self.problems.append(f"asked for {url}")

    def go(self, address: str) -> dict[str, Any]:
        """Show a scenario, and return its end."""
        self.page.evaluate("address => { explorer.shown = null; explorer.go(address) }", address)
        self.page.wait_for_function("explorer.shown !== null")
        return self.end()

    def end(self) -> dict[str, Any]:
        """How the run that is shown ended; NaN is text in what a browser gives."""
        found: dict[str, Any] = json.loads(
            self.page.evaluate(
                "JSON.stringify({refusal: explorer.refusal, outcome: explorer.result.outcome, metrics: explorer.result"
                ".metrics, rows: explorer.result.rows}, (key, x) => Number.isNaN(x) ? 'NaN' : x)"
            )
        )
        found["metrics"] = {name: float(value) for name, value in found["metrics"].items()}
        return found


@pytest.fixture
def visit(browser: Browser, file: Path) -> Iterator[Visit]:
    visited = Visit(browser, file, viewport={"width": 1280, "height": 900})
    yield visited
    visited.context.close()
    assert visited.problems == []


def native(scenario: hs.Scenario) -> tuple[str, dict[str, float]]:
    """Outcome and metrics of the same arithmetic without a browser."""
    run = _core.simulate(core_parameters(scenario), load_kernel("baseline"))
    return run.outcome.name, {name: getattr(run.metrics, name) for name in METRICS}


# --- numbers


@in_browser
def test_smooth_runs_have_the_numbers_of_the_package(visit: Visit) -> None:
    worst = 0.0
    for name, law in SMOOTH:
        end = visit.go(f"#{name}&controller.law={law}")
        scenario = hs.load_scenario(name).updated({"controller.law": law})
        steps = scenario.simulation.duration / scenario.simulation.step
        every = math.ceil(steps / MOST_ROWS)
        run = _core.simulate(
            core_parameters(scenario.updated({"simulation.log_every": every})), load_kernel("baseline")
        )
        assert (end["refusal"], end["outcome"], end["rows"]) == (None, run.outcome.name, len(run.time)), (name, law)
        for quantity in ("time", "position", "quaternion", "feature_error"):
            samples = getattr(run, quantity)
            expected = samples[::10].ravel()
            width = samples[0].size
            every_tenth = f"explorer.result.samples.{quantity}.filter((_, i) => Math.floor(i / {width}) % 10 === 0)"
            found = np.array(visit.page.evaluate(f"Array.from({every_tenth})"))
            difference = float(np.abs(found - expected).max() / np.abs(expected).max())
            assert difference <= 1e-12, (name, law, quantity)
            worst = max(worst, difference)
    print(f"largest difference of a sample, of the largest one of the run: {worst:.1e}")


@in_browser
def test_packaged_scenarios_end_as_in_the_package(visit: Visit) -> None:
    """Switching terms and noise amplify the last digit: outcomes agree, and metrics as far as variants agree."""
    for name in hs.scenario_names():
        scenario = hs.load_scenario(name)
        if scenario.simulation.duration > 10:
            continue
        end = visit.go(f"#{name}")
        outcome, expected = native(scenario)
        assert (end["refusal"], end["outcome"]) == (None, outcome), name
        if outcome != "completed":
            continue
        settles, settled = end["metrics"]["settling_time"], expected["settling_time"]
        assert math.isnan(settles) == math.isnan(settled), name
        if not math.isnan(settled):
            assert settles == pytest.approx(settled, rel=0.05, abs=0.02), name
        assert end["metrics"]["peak_error"] == pytest.approx(expected["peak_error"], rel=0.02), name
        passed = any(expected[limit.metric] > limit.value for limit in leg_limits(scenario))
        beyond = ", and " if math.isnan(settled) else ", but "
        assert (beyond in visit.page.locator("#verdict").inner_text()) == passed, name


@in_browser
def test_samples_of_a_run_at_rest_are_as_many_as_it_needs(visit: Visit) -> None:
    """Of a run that ends early, of peaks, of a long run; their distance is stated while a slider is dragged."""
    page = visit.page
    few = visit.go("#fails-wrong-sign")["rows"]
    assert visit.go("#fails-wrong-sign&simulation.duration=20")["rows"] == few
    assert few > page.evaluate("explorer.result.time / explorer.result.step")
    peak = visit.go("#rubin-camera-hexapod")["metrics"]["peak_leg_force"]
    forces = page.evaluate("explorer.result.samples.leg_forces.reduce((most, x) => Math.max(most, Math.abs(x)), 0)")
    assert forces == pytest.approx(peak, rel=1e-3)
    spacing = "explorer.result.samples.time[1] - explorer.result.samples.time[0]"
    visit.go("#paper&simulation.duration=20")
    assert page.evaluate(spacing) == pytest.approx(0.002)
    height = "document.querySelector('.charts').getBoundingClientRect().height"
    before = page.evaluate(height)
    for event, expected, words in (("input", 0.025, "samples 0.025 s apart"), ("change", 0.002, "")):
        slide(page, "uncertainty.depth", event)
        assert page.evaluate(spacing) == pytest.approx(expected)
        apart = page.evaluate("explorer.result.ghost.stride * explorer.result.ghost.samples.time[1]")
        assert apart == pytest.approx(expected), "what is pale is drawn as coarse"
        assert page.locator("#chart-0 .spacing").inner_text() == words
        assert page.evaluate(height) == before, "charts stay where they are"


@in_browser
def test_of_a_long_pale_run_the_distance_of_samples_is_told(visit: Visit) -> None:
    """Where it is wider than that of the run before it, which has every step."""
    visit.go("#paper&pinned=paper%26simulation.duration%3D600")
    visit.page.wait_for_function("explorer.result.ghost")
    assert visit.page.evaluate("explorer.result.samples.time[1]") == pytest.approx(0.001)
    notes = visit.page.locator(".chart .spacing").all_inner_texts()
    assert notes == ["pale samples 0.06 s apart", "", ""]


def slide(page: Page, name: str, event: str) -> None:
    """Move a slider a little, as a drag does (event "input") or its end ("change")."""
    page.evaluate(
        """([name, event]) => {
          explorer.shown = null;
          const slider = document.querySelector(`[data-id="${name}"]`);
          slider.value = 510;
          slider.dispatchEvent(new Event(event));
        }""",
        [name, event],
    )
    page.wait_for_function("explorer.shown !== null")


@in_browser
@pytest.mark.parametrize(
    ("address", "in_a_drag"),
    [("#paper&uncertainty.gravity=0.2&simulation.duration=20", 0.025), ("#fails-wrong-sign", 0.001)],
)
def test_a_drag_computes_only_a_short_run_twice(visit: Visit, address: str, in_a_drag: float) -> None:
    """For the samples of one that ends early: twice the time of a longer one is seen. At rest every step is there."""
    page = visit.page
    visit.go(address)
    for event, expected in (("input", in_a_drag), ("change", 0.001)):
        slide(page, "uncertainty.inertia", event)
        times = page.evaluate("[...explorer.result.samples.time.slice(0, 2), explorer.result.time]")
        assert page.evaluate("explorer.result.outcome") != "completed"
        assert times[1] - times[0] == pytest.approx(expected), times


@in_browser
def test_a_long_run_leaves_the_page_alive(visit: Visit) -> None:
    """While a minute is computed, a newer change is answered first."""
    visit.page.evaluate("explorer.go('#unequal-depth-60s&simulation.duration=600')")
    visit.page.evaluate("explorer.shown = null; explorer.go('#paper')")
    visit.page.wait_for_function("explorer.shown === '#paper'")
    assert visit.end()["metrics"]["settling_time"] == pytest.approx(0.353)


@in_browser
def test_what_is_shown_is_named_and_measured_as_the_run_that_it_is_of(visit: Visit) -> None:
    """After a refusal the last good run stays, pale, with its own band, units and preset, redrawn or not."""
    page = visit.page
    visit.go("#paper")
    words = page.locator("#verdict").inner_text()
    numbers = page.evaluate("[...document.querySelectorAll('#metrics tr')].map(row => row.cells[1].textContent)")
    assert visit.go("#reachy-mini&metrics.dwell=-1&metrics.band=-3")["refusal"].startswith("metrics.")
    page.wait_for_function("explorer.reference")
    page.select_option("#span", "all")
    page.emulate_media(media="print")
    assert page.locator("#verdict").inner_text() == words
    found = page.evaluate(
        "[...document.querySelectorAll('#metrics tr')].map(row => [...row.cells].map(c => c.textContent))"
    )
    assert [cells[1] for cells in found] == numbers
    assert {cells[2] for cells in found} == {""}
    for name in ("#verdict", ".views", ".charts"):
        assert page.locator(name).evaluate("part => getComputedStyle(part).opacity") == "0.4", name


@in_browser
def test_a_run_that_takes_long_is_announced_and_what_is_shown_meanwhile_is_pale(visit: Visit) -> None:
    page = visit.page
    below = "document.querySelector('.words').getBoundingClientRect().height"
    place = page.evaluate(below)
    page.evaluate("explorer.go('#unequal-depth-60s&simulation.duration=600')")
    page.wait_for_function("document.body.classList.contains('stale')")
    page.wait_for_function("document.getElementById('share').value > 0")
    assert page.locator("#busy").is_visible()
    assert page.evaluate(below) == place, "views stay where the pointer has them"
    assert page.evaluate("explorer.shown") == "#paper"
    page.evaluate("explorer.go('#paper&uncertainty.gravity=0.01')")
    page.wait_for_function("explorer.shown.includes('gravity')")
    assert page.locator("#busy").is_hidden()
    assert page.evaluate("document.body.className") == ""


@in_browser
def test_a_request_that_waits_starts_whatever_became_of_the_one_before(visit: Visit) -> None:
    visit.go("#reachy-mini-head")
    visit.page.evaluate(
        """() => {
          explorer.shown = null;
          explorer.set('uncertainty.depth', [.1, .1, .1, .1]);
          explorer.set('robot.cranks.axes', [1, 2, 3, 4]);
        }"""
    )
    visit.page.wait_for_function("explorer.refusal !== null")
    assert visit.end()["refusal"] == "robot.cranks.axes: expected 18 numbers, got 4"


@in_browser
def test_play_begins_where_the_first_frame_is_before_the_click(visit: Visit) -> None:
    """The time of a frame is that of its begin, which a click may be later than."""
    page = visit.page
    page.evaluate("() => { const clock = performance.now.bind(performance); performance.now = () => clock() + 1000 }")
    page.click("#play")
    page.wait_for_function("parseFloat(document.getElementById('now').textContent) > 0.05")
    page.click("#play")
    assert page.evaluate("document.getElementById('now').textContent") != "5.000 s"


@in_browser
def test_play_goes_in_steps_where_less_motion_is_asked_for(visit: Visit) -> None:
    page = visit.page
    page.emulate_media(reduced_motion="reduce")
    times = page.evaluate(
        """async () => {
          document.getElementById('play').click();
          const [seen, end] = [[], performance.now() + 1600];
          while (performance.now() < end) {
            await new Promise(requestAnimationFrame);
            const time = parseFloat(document.getElementById('now').textContent);
            if (time !== seen.at(-1)) seen.push(time);
          }
          document.getElementById('play').click();
          return seen;
        }"""
    )
    steps = np.diff(times[1:])
    assert 1 <= len(steps) <= 4
    assert steps.min() >= 0.45


@in_browser
def test_the_page_is_answered_within_a_run_of_slow_steps(visit: Visit) -> None:
    """2000 substeps make a control step take milliseconds: looks at what is asked for are of time, not of steps."""
    page = visit.page
    page.evaluate("explorer.go('#composite-30hz&simulation.substeps=2000&simulation.duration=50')")
    page.wait_for_function("document.getElementById('share').value > 0")
    assert page.evaluate("document.getElementById('share').value") < 0.1
    visit.go("#paper")
    assert visit.end()["metrics"]["settling_time"] == pytest.approx(0.353)


@in_browser
def test_metrics_of_another_time_or_task_are_not_called_better(visit: Visit) -> None:
    page = visit.page
    coloured = "document.querySelectorAll('#metrics td:is(.good, .bad)').length"
    heading = page.locator("#of-preset")
    visit.go("#composite-30hz&uncertainty.gravity=0.05")
    page.wait_for_function("explorer.reference")
    assert page.evaluate(coloured) > 0
    assert heading.inner_text() == "preset"
    assert visit.go("#composite-30hz&robot.stroke=0.004&robot.on_limit=stop")["outcome"] == "leg_limit"
    assert page.evaluate(coloured) == 0
    assert heading.inner_text() == "preset, not comparable: outcome leg limit against completed"
    visit.go("#paper&simulation.duration=2")
    page.wait_for_function("explorer.reference")
    assert page.evaluate(coloured) == 0
    assert heading.inner_text() == "preset, not comparable: 2 s against 5 s"
    for change, reason in {
        "metrics.band=10": "another band",
        "metrics.rms_start=2": "another rms start",
        "target.desired_features=11,10,45,-73,-64,29,-30,-23": "another goal",
        "simulation.start.pose=0.001,0,0,0,0,0": "another start",
    }.items():
        assert visit.go(f"#paper&{change}")["refusal"] is None
        assert page.evaluate(coloured) == 0, change
        assert heading.inner_text() == f"preset, not comparable: {reason}"


@in_browser
def test_a_run_that_is_pinned_takes_the_place_of_the_presets(visit: Visit) -> None:
    """In sentence, table and pictures; its address shares it, and the same button takes it back."""
    page = visit.page
    heading, words, button = (page.locator(name) for name in ("#of-preset", "#against", "#pin"))
    gravity = "JSON.stringify(explorer.reference?.state.changes['uncertainty.gravity'])"
    pinned = visit.go("#paper&uncertainty.gravity=0.01,0.01,0.01,0.01,0.01,0.01")["metrics"]
    button.click()
    page.wait_for_function(f"explorer.result.state.pinned && {gravity} === '[0.01,0.01,0.01,0.01,0.01,0.01]'")
    assert (heading.inner_text(), words.inner_text()) == ("pinned: the same", "")
    page.evaluate("explorer.shown = null; explorer.set('uncertainty.gravity', [0.02, 0.02, 0.02, 0.02, 0.02, 0.02])")
    page.wait_for_function("explorer.shown !== null")

    def check() -> None:
        assert heading.inner_text() == "pinned: uncertainty.gravity = 0.01"
        assert words.inner_text().startswith("Pinned run: ")
        assert page.evaluate("explorer.result.ghost.samples === explorer.reference.samples")
        assert page.evaluate("explorer.reference.metrics.peak_error") == pytest.approx(pinned["peak_error"], rel=0.02)
        assert page.locator("small.ghost").first.inner_text() == "pale: pinned run"
        assert button.inner_text() == "Compare with the preset"

    check()
    address = page.evaluate("explorer.shown")
    visit.go("#task-tilt")
    page.wait_for_function("[explorer.reference, explorer.result].every(run => run?.state.preset === 'task-tilt')")
    assert heading.inner_text() == "preset"
    visit.go(address)
    page.wait_for_function("explorer.reference && explorer.result.ghost")
    check()
    assert "-changed" in page.evaluate("explorer.yaml()")
    button.click()
    page.wait_for_function("explorer.reference && !explorer.result.state.pinned && explorer.result.ghost")
    assert (heading.inner_text(), words.inner_text()[:8]) == ("preset", "Preset: ")
    assert page.evaluate("explorer.reference.state.changes") == {}


@in_browser
def test_a_pinned_run_of_legs_of_another_kind_has_its_own_units(visit: Visit) -> None:
    """Excursions are angles of cranks or lengths, forces of legs torques or forces: not comparable."""
    page = visit.page
    units = {"reachy-mini": ("°", "N m"), "paper": ("mm", "N")}
    names = {
        "reachy-mini": ("peak crank excursion", "peak crank torque"),
        "paper": ("peak leg excursion", "peak leg force"),
    }
    for own, pinned in ("reachy-mini", "paper"), ("paper", "reachy-mini"):
        visit.go(f"#{own}&simulation.duration=2&pinned={pinned}%26simulation.duration=2")
        page.wait_for_function("name => explorer.reference?.state.preset === name", arg=pinned)
        for place, name in enumerate(names[own]):
            cells = page.locator("#metrics tr", has_text=name).locator("td").all_inner_texts()
            found = [re.sub(r"^[\d.]+ ?", "", cell) for cell in cells]
            assert found == [units[own][place], units[pinned][place]], cells
        assert page.locator("#of-preset").inner_text().endswith(", not comparable: another kind of legs")


@in_browser
def test_a_preset_that_is_pinned_as_it_is_is_called_the_pinned_run(visit: Visit) -> None:
    """Its run is the reference already: only the words change."""
    page = visit.page
    visit.go("#paper")
    page.click("#pin")
    page.wait_for_function("explorer.shown.includes('pinned=')")
    assert page.locator("#pin").inner_text() == "Compare with the preset"
    visit.go("#task-tilt&pinned=paper")
    page.wait_for_function("explorer.result.ghost")
    assert page.locator(".ghost:visible").all_inner_texts() == ["pale: pinned run"] * 2
    page.click("#pin")
    page.wait_for_function("explorer.shown === '#task-tilt'")
    assert page.locator("#pin").inner_text() == "Compare with this run"


@in_browser
def test_one_number_for_all_entries_of_an_array_makes_no_other_run(visit: Visit) -> None:
    page = visit.page
    visit.go("#paper&uncertainty.gravity=0.02&pinned=paper%26uncertainty.gravity%3D0.02,0.02,0.02,0.02,0.02,0.02")
    page.wait_for_function("explorer.reference")
    assert page.locator("#of-preset").inner_text() == "pinned: the same"
    assert page.evaluate("explorer.result.ghost") is None


@in_browser
def test_a_pinned_run_that_is_refused_is_named(visit: Visit) -> None:
    page = visit.page
    assert visit.go("#paper&pinned=paper%26controller.hybrid.kp%3D-1")["refusal"] is None
    message = page.locator("#message")
    message.wait_for()
    assert message.inner_text().startswith("pinned run: controller.hybrid.kp[0]: expected ")
    assert page.locator("#of-preset").inner_text() == "pinned: controller.hybrid.kp = -1, refused"
    page.click("#pin")
    page.wait_for_function("explorer.shown === '#paper'")
    message.wait_for(state="hidden")
    assert page.locator("#of-preset").inner_text() == "preset"


@in_browser
def test_the_last_good_run_can_be_pinned_beside_a_refused_state(visit: Visit) -> None:
    page = visit.page
    visit.go("#paper&uncertainty.gravity=0.02")
    peaks = page.locator("#metrics tr:has(summary:text-is('peak error')) td")
    assert visit.go("#paper&metrics.band=-1")["refusal"] is not None
    page.click("#pin")
    page.wait_for_function("explorer.shown.includes('pinned=')")
    page.wait_for_function("explorer.reference?.state.changes['uncertainty.gravity']")
    assert page.locator("#of-preset").inner_text() == "pinned: the same"
    now, before = peaks.all_inner_texts()
    assert now == before != ""
    assert page.locator("#message").inner_text().startswith("metrics.band: expected ")


# --- scenarios in and out


@in_browser
def test_the_yaml_of_every_preset_is_the_same_scenario(visit: Visit) -> None:
    for name in hs.scenario_names():
        full = visit.page.evaluate("address => explorer.full(address)", f"#{name}")
        assert full == core_values(hs.load_scenario(name)), name
        again = hs.Scenario.from_yaml(visit.page.evaluate("address => explorer.yaml(address)", f"#{name}"))
        assert acting(core_values(again)) == acting(full), name


@in_browser
@pytest.mark.parametrize(
    "address",
    ["#paper", "#composite-30hz", "#pi-h824-positions&controller.law=resolved_rate", "#reachy-mini-head"],
)
def test_the_yaml_of_a_slider_anywhere_is_a_scenario(visit: Visit, address: str) -> None:
    """At both ends and in the middle of each, Python takes what the page runs."""
    visit.go(address)
    moved = visit.page.evaluate(
        """address => {
          const names = [...document.querySelectorAll('#controls input[type=range]')].map(input => input.dataset.id);
          return names.flatMap(name => [0, 500, 1000].map(place => {
            explorer.go(address);
            const input = document.querySelector(`[data-id="${name}"]`);
            input.value = place;
            input.dispatchEvent(new Event('change', { bubbles: true }));
            return [name, explorer.yaml(), structuredClone(explorer.state.changes)];
          }));
        }""",
        address,
    )
    assert len(moved) >= 30
    for name, text, changes in moved:
        words = refusal_of(text)
        if words:
            parts = [f"{key}={','.join(map(str, np.atleast_1d(value)))}" for key, value in changes.items()]
            refused = visit.go("&".join([address.partition("&")[0], *parts]))["refusal"]
            assert refused is not None, (name, parts, words)


def refusal_of(text: str) -> str:
    """Return why Python refuses a scenario's YAML; nothing where it takes it."""
    try:
        hs.Scenario.from_yaml(text)
    except hs.ScenarioError as error:
        return str(error)
    return ""


@in_browser
def test_the_yaml_has_what_acts_as_python_writes_it(visit: Visit) -> None:
    """Numbers for null, exact sensors, and an integral gain that legs which follow twists do not have."""

    def read(address: str) -> hs.Scenario:
        assert visit.go(address)["refusal"] is None, address
        return hs.Scenario.from_yaml(visit.page.evaluate("explorer.yaml()"))

    scenario = read("#composite-30hz&camera.period=0&sensors.period=0")
    assert scenario.camera.period is None
    assert visit.page.evaluate("explorer.state.changes") == {"camera.period": None}
    sensors = read("#composite-30hz&sensors.pose=encoders&sensors.rate=true_rates").sensors
    assert (sensors.pose, sensors.rate) == ("encoders", True)
    gains = read("#pi-h824-positions&controller.law=resolved_rate&controller.resolved_rate.ki=9").controller.gains
    assert gains.ki == type(gains)().ki
    assert visit.page.locator('[data-id^="controller.resolved_rate.ki"]').count() == 0
    visit.go("#paper&controller.law=resolved_rate")
    assert visit.page.locator('[data-id^="controller.resolved_rate.ki"]').count() == 2


@in_browser
def test_keys_of_another_kind_of_actuators_sleep(visit: Visit) -> None:
    """The core takes the defaults of such keys alone: a kind that is chosen after them is not refused."""
    page = visit.page
    numbers = "&actuators.position.bandwidth=300&actuators.motor.kp=900&actuators.bandwidth=200&actuators.saturation=1"
    for kind, takes in {
        "force": {"actuators.bandwidth": 200, "actuators.position.bandwidth": None, "actuators.motor.kp": None},
        "position": {"actuators.bandwidth": None, "actuators.position.bandwidth": 300, "actuators.motor.kp": None},
        "position_torque": {
            "actuators.bandwidth": None,
            "actuators.position.bandwidth": 300,
            "actuators.motor.kp": 900,
        },
    }.items():
        refusal = visit.go(f"#composite-30hz&actuators.kind={kind}{numbers}")["refusal"]
        assert "its default" not in (refusal or ""), kind
        usual = _core.Settings("composite")
        full = page.evaluate("explorer.full()")
        for key, value in takes.items():
            default = None if key == "actuators.bandwidth" else usual[key]
            assert full[key] == (default if value is None else value), (kind, key)
    assert visit.go("#reachy-mini&actuators.kind=force")["refusal"] is None
    assert hs.Scenario.from_yaml(page.evaluate("explorer.yaml()")).actuators.kind == "force"


@in_browser
def test_what_does_not_act_is_no_change_of_the_run(visit: Visit) -> None:
    """What other keys replace, gains of another law, and what a choice does not use stay in the address alone."""
    page = visit.page
    for preset, changes in {
        "reachy-mini": (
            "camera.focal_length=0.5",
            "camera.pixel_scale=1",
            "target.depth=2",
            "target.initial_features=1,2,3,4,5,6,7,8,9,10",
            "robot.platform_radius=0.3",
            "robot.base_radius=0.3",
            "target.motion.velocity=1,0,0",
            "controller.switching.kind=tanh",
        ),
        "rubin-camera-hexapod": ("robot.platform_angles=0.1,0.2,0.3,0.4,0.5,0.6",),
        "paper": ("controller.kelly.kp=1", "controller.switching.width=5"),
        "paper-no-fuzzy": ("controller.hybrid.fuzzy.adaptation=9", "controller.hybrid.fuzzy.error_scale=9"),
    }.items():
        metrics = visit.go(f"#{preset}")["metrics"]
        page.wait_for_function("explorer.reference")
        for change in changes:
            end = visit.go(f"#{preset}&{change}")
            assert end["refusal"] is None, change
            assert end["metrics"] == pytest.approx(metrics, rel=0, abs=0, nan_ok=True), change
            assert page.locator("#reset").inner_text() == "Reset 1 change without effect", change
            assert page.evaluate("document.body.dataset.ghost") == ""
            assert page.locator("#against").inner_text() == ""
            text = page.evaluate("explorer.yaml()")
            assert hs.Scenario.from_yaml(text).name == preset
            assert text == page.evaluate("address => explorer.yaml(address)", f"#{preset}")
    page.click("#reset")
    assert page.evaluate("explorer.state.changes") == {}


@in_browser
def test_what_does_not_act_has_no_slider(visit: Visit) -> None:
    """The width of sign, gains of fuzzy systems that are off, and the switching term of a law that has none."""
    fuzzy = ["adaptation", "error_scale", "rate_scale", "leakage"]
    smooth = "#paper&controller.switching.kind=tanh"
    for address, width, has_fuzzy in (
        ("#paper", False, True),
        (smooth, True, True),
        (f"{smooth}&controller.law=pbvs", False, False),
        ("#paper-no-fuzzy", False, False),
        ("#paper-no-fuzzy&controller.hybrid.fuzzy.enabled=1", False, True),
    ):
        visit.go(address)
        names = set(visit.page.evaluate("[...document.querySelectorAll('#controls [data-id]')].map(x => x.dataset.id)"))
        assert any(name.startswith("controller.switching.width") for name in names) == width, address
        law_switches = "pbvs" not in address
        assert ("controller.switching.kind" in names) == law_switches, address
        found = {leaf for leaf in fuzzy if any(f".fuzzy.{leaf}" in name for name in names)}
        assert bool(found) == has_fuzzy, (address, found)
        assert ("controller.hybrid.fuzzy.enabled" in names) == law_switches, address


@in_browser
def test_a_field_of_a_key_has_its_value_but_while_something_else_is_typed(visit: Visit) -> None:
    """Where Back undid what was sent from it, too; text that was refused stays, with why, until the next run."""
    page = visit.page
    visit.go("#composite-30hz")
    page.click("#all-keys > summary")
    field = page.locator("[id='key-camera.noise']")
    usual = field.input_value()
    field.fill("1.5")
    field.press("Enter")
    page.wait_for_function("explorer.shown.endsWith('camera.noise=1.5') && location.hash === explorer.shown")
    page.go_back()
    page.wait_for_function("explorer.shown === '#composite-30hz'")
    assert page.evaluate("document.activeElement.id") == "key-camera.noise"
    assert field.input_value() == usual
    field.fill("0.7")
    visit.go("#composite-30hz&uncertainty.gravity=0.01")
    assert field.input_value() == "0.7"
    field.fill("abc")
    field.press("Enter")
    page.keyboard.press("Tab")
    message = "document.getElementById('key-camera.noise').validationMessage"
    assert (field.input_value(), page.evaluate(message)) == ("abc", 'camera.noise: expected finite numbers, got "abc"')
    visit.go("#composite-30hz")
    assert (field.input_value(), page.evaluate(message)) == (usual, "")


@in_browser
def test_what_the_page_chooses_itself_is_no_parameter(visit: Visit) -> None:
    visit.go("#paper&simulation.log_every=7")
    assert visit.page.evaluate("explorer.state.changes") == {}
    assert "simulation.log_every" in visit.page.locator("#message").inner_text()
    visit.page.click("#all-keys > summary")
    visit.page.wait_for_selector("[id='key-simulation.duration']")
    assert visit.page.locator("[id='key-simulation.log_every']").count() == 0
    visit.go("#paper")


def acting(values: dict[str, Any]) -> dict[str, Any]:
    """Leave out what does not act: keys of the other mode, an image beside points, circles beside joints, and so on."""
    sampled = values["simulation.mode"] == "sampled"
    asleep = {key.name for key in _core.scenario_keys(values["controller.law"]) if key.sampled and not sampled}
    for key, needs in settings_needed().items():
        if key in values and any(values[other] not in allowed for other, allowed in needs.items() if other in values):
            asleep.add(key)
    if values["target.points"] is not None:
        asleep |= {"target.initial_features", "target.depth"}
    for side in ("platform", "base"):
        if values[f"robot.{side}_joints"] is not None:
            asleep |= {f"robot.{side}_radius", f"robot.{side}_angles"}
    return {key: value for key, value in values.items() if key not in asleep}


@in_browser
def test_rotary_legs_are_drawn_as_cranks_and_rods(visit: Visit) -> None:
    """Ends of the cranks are where the core has them, a rod's length from the platform joints."""
    visit.go("#reachy-mini-head")
    rows = visit.end()["rows"]
    scenario = hs.load_scenario("reachy-mini-head")
    hexapod = _core.Hexapod(core_parameters(scenario).robot)
    for row in (0, rows // 20, rows - 1):
        found = visit.page.evaluate(
            """row => {
              const { position, quaternion } = explorer.result.samples;
              const of = (values, n) => [...values.subarray(n * row, n * row + n)];
              return { ends: explorer.ends(row), position: of(position, 3), quaternion: of(quaternion, 4) };
            }""",
            row,
        )
        feet = hexapod.leg_feet(found["position"], found["quaternion"])
        np.testing.assert_allclose(found["ends"], feet, rtol=0, atol=1e-7)
    assert visit.page.evaluate("explorer.result.cranks.length") == scenario.robot.cranks.length
    visit.go("#paper")
    assert visit.page.evaluate("explorer.ends(0)") is None


@in_browser
@pytest.mark.parametrize("kind", ["none", "velocity", "sinusoid"])
@pytest.mark.parametrize("name", ["reachy-mini-head", "eye-to-hand"])
def test_the_target_is_drawn_where_it_is(visit: Visit, name: str, kind: str) -> None:
    """Points found from image and depth are those of the scenario: moved in B, or carried by the platform."""
    motions: dict[str, dict[str, Any]] = {
        "none": {},
        "velocity": {"target.motion.velocity": [0.01, -0.02, 0.005]},
        "sinusoid": {"target.motion.amplitude": [0.02, 0.01, -0.01], "target.motion.frequency": 0.4},
    }
    changes = motions[kind] | {"target.motion.kind": kind, "actuators.kind": "position"}
    scenario = hs.load_scenario(name)
    if scenario.camera.mount.on == "base" and kind != "none":
        refused = visit.go(f"#{name}&target.motion.kind={kind}")["refusal"]
        with pytest.raises(hs.ScenarioError) as error:
            scenario.updated({"target.motion.kind": kind})
        assert refused in str(error.value)
        return
    visit.go("#paper")
    words = [f"{key}={','.join(map(str, np.atleast_1d(value)))}" for key, value in changes.items()]
    end = visit.go("&".join([f"#{name}", *words]))
    assert end["refusal"] is None
    scenario = scenario.updated(changes)
    points = np.asarray(core_parameters(scenario)["target.points"]).reshape(-1, 3)
    for row in (0, end["rows"] // 3, end["rows"] - 1):
        found = visit.page.evaluate(
            """row => {
              const { time, position, quaternion } = explorer.result.samples;
              const of = (values, n) => [...values.subarray(n * row, n * row + n)];
              const pose = [of(position, 3), of(quaternion, 4)];
              return { target: explorer.target(row), time: time[row], pose };
            }""",
            row,
        )
        if scenario.camera.mount.on == "base":
            position, (w, *axis) = found["pose"]
            turned = points + 2 * np.cross(axis, np.cross(axis, points) + w * points)
            expected = position + turned
        else:
            motion = scenario.target.motion
            way = {
                "none": np.zeros(3),
                "velocity": np.multiply(motion.velocity, found["time"]),
                "sinusoid": np.multiply(motion.amplitude, np.sin(2 * np.pi * 0.4 * found["time"])),
            }[kind]
            expected = points + way
        np.testing.assert_allclose(found["target"], expected, rtol=0, atol=1e-9)


@in_browser
def test_a_run_beyond_a_limit_of_the_legs_is_not_called_good(visit: Visit) -> None:
    """The sentence has the events of the package, and legs beyond their stroke have the colour of a warning."""
    page = visit.page
    warned = """() => {
      const rgb = document.createElement('i');
      rgb.style.color = 'var(--warn)';
      document.body.append(rgb);
      const colour = getComputedStyle(rgb).color;
      rgb.remove();
      return [...document.querySelectorAll('#scene path')].filter(
        path => path.style.stroke === colour && parseFloat(path.style.strokeWidth) > 2
      ).length;
    }"""
    visit.go("#paper")
    assert page.locator("#verdict").get_attribute("class") == "verdict good"
    assert page.evaluate(warned) == 0
    for name, duration in (("fails-unequal-depth", None), ("fails-gravity", None), ("fails-gravity", 20)):
        changes = {} if duration is None else {"simulation.duration": duration}
        visit.go("&".join([f"#{name}", *(f"{key}={value}" for key, value in changes.items())]))
        first = hs.simulate(hs.load_scenario(name).updated(changes)).events[0]
        words = page.locator("#verdict").inner_text()
        said = re.search(r", (?:but|and) leg (\d) passes its stroke of 17 mm at ([\d.]+) s", words)
        assert said is not None, words
        assert (first.kind, int(said[1])) == ("stroke", first.leg)
        assert float(said[2]) == pytest.approx(first.time, rel=1e-4)
        assert page.locator("#verdict").get_attribute("class") == "verdict warn"
        assert page.evaluate(warned) > 0, name
    visit.go("#paper&robot.force_limit=0.05")
    worst = max(
        hs.simulate(hs.load_scenario("paper").updated({"robot.force_limit": 0.05})).events, key=lambda event: event.peak
    )
    assert f"but leg {worst.leg} takes a force of {worst.peak:.4g} N of 0.05 N" in page.locator("#verdict").inner_text()
    visit.go("#reachy-mini-head&robot.stroke=0.1")
    assert re.search(r", but leg \d passes its stroke of 5\.73°? at", page.locator("#verdict").inner_text())


@in_browser
def test_legs_that_take_positions_and_end_at_their_stroke_are_named(visit: Visit) -> None:
    """Commands of positions end there, and pass no limit; what is wrong is the goal, as the package's check finds."""
    page = visit.page
    visit.go("#pi-h824-positions")
    assert "stroke" not in page.locator("#verdict").inner_text()
    visit.go("#pi-h824-positions&robot.stroke=0.004")
    words = page.locator("#verdict").inner_text()
    scenario = hs.load_scenario("pi-h824-positions").updated({"robot.stroke": 0.004})
    lengths = hs.simulate(scenario).leg_lengths
    travel = np.abs(lengths[-1] - lengths[0])  # the run starts at home
    (leg,) = np.flatnonzero(travel > 0.004 - 1e-8) + 1
    assert words.endswith(f", and leg {leg} is at the end of its stroke of 4 mm"), words
    visit.go("#pi-h824-positions&robot.stroke=0.001")
    words = page.locator("#verdict").inner_text()
    assert re.search(r", and legs \d(, \d)+ are at the end of their stroke of 1 mm$", words), words


@in_browser
def test_a_leg_that_ends_a_run_is_named_with_its_value(visit: Visit) -> None:
    """At the time at which the run ended, once: no limit was passed before that."""
    page = visit.page
    visit.go("#fails-leg-limits")
    event = hs.simulate(hs.load_scenario("fails-leg-limits")).stop_event
    assert event is not None
    end = f"leg {event.leg} passed its stroke at t = {event.time:.12g} s ({1e3 * event.peak:.4g} mm of 17 mm)"
    assert page.locator("#verdict").inner_text() == f"Ends early, leg limit: {end}"
    told = page.locator("#happenings button:visible").all_inner_texts()
    assert told[-1] == f"{event.time:.4g} s leg limit: stroke of leg {event.leg}"
    assert not any("stroke" in item for item in told[:-1])


@in_browser
def test_metrics_of_cranks_have_their_names(visit: Visit) -> None:
    page = visit.page
    for name, words in (("reachy-mini-head", "peak crank torque"), ("paper", "peak leg force")):
        visit.go(f"#{name}")
        rows = page.locator("#metrics summary").all_text_contents()
        assert rows[list(METRICS).index("peak_leg_force")] == words


@in_browser
def test_a_run_that_ends_early_tells_the_limits_that_it_passed(visit: Visit) -> None:
    """In the sentence, and in the line of what happened, each item of which shows its time."""
    page = visit.page
    visit.go("#fails-wrong-sign")
    events = hs.simulate(hs.load_scenario("fails-wrong-sign")).events
    words = page.locator("#verdict").inner_text()
    assert words.startswith("Ends early, diverged")
    assert "; before that leg " in words
    assert " passes its stroke of 17 mm at 0.02" in words
    items = page.locator("#happenings button:visible")
    told = items.all_inner_texts()
    first = {event.kind: event for event in reversed(events)}
    kinds = sorted(first, key=lambda kind: first[kind].time)
    assert [float(item.split()[0]) for item in told[:-1]] == pytest.approx([first[kind].time for kind in kinds])
    assert f"stroke of leg {first['stroke'].leg}, and " in told[kinds.index("stroke")]
    assert told[-1] == "0.041 s diverged"
    items.nth(kinds.index("stroke")).click()
    assert float(page.locator("#now").inner_text().split()[0]) == pytest.approx(first["stroke"].time, abs=0.0011)
    visit.go("#paper")
    assert items.all_inner_texts() == ["0.353 s settles", "5 s end"]
    for name in ("fails-wrong-sign", "fails-leg-limits", "fails-coarse-step"):
        visit.go(f"#{name}")
        time = re.search(r" at t = ([\d.]+) s", page.locator("#verdict").inner_text())
        assert time is not None, name
        assert items.last.inner_text().startswith(f"{time[1]} s "), "as in the sentence"


# Colours [r, g, b, a] at places of a canvas: of a chart (time [s], value [unit of the chart]), or of the image [px].
AT_PLACES = """({ chart, places }) => {
  const plot = explorer.charts()[chart];
  const canvas = plot ? plot.ctx.canvas : document.getElementById('image');
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext('2d', { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  const place = (x, y) => plot ? [plot.valToPos(x, 'x', true), plot.valToPos(y, 'y', true)] : explorer.place(x, y);
  return places.map(([x, y]) => [...copy.getImageData(...place(x, y).map(Math.round), 1, 1).data]);
}"""


def chart_colours(page: Page, chart: int, places: list[tuple[float, float]]) -> list[list[int]]:
    """Return the colours [r, g, b, a] of a chart at places (time [s], value [unit of the chart])."""
    found: list[list[int]] = page.evaluate(AT_PLACES, {"chart": chart, "places": places})
    return found


def image_colours(page: Page, places: list[tuple[float, float]]) -> list[list[int]]:
    """Return the colours [r, g, b, a] of the image at places [px]."""
    found: list[list[int]] = page.evaluate(AT_PLACES, {"chart": None, "places": places})
    return found


def scale_of(page: Page, chart: int) -> tuple[float, float]:
    """Return the smallest and the largest value of a chart's vertical axis."""
    low, high = page.evaluate("chart => [explorer.charts()[chart].scales.y].flatMap(y => [y.min, y.max])", chart)
    return low, high


NAMED = "name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim()"  # a colour's text


def rgb(page: Page, name: str) -> list[int]:
    """Return a colour of the page by its name."""
    return [int(page.evaluate(NAMED, name)[i : i + 2], 16) for i in (1, 3, 5)]


@in_browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_chart_of_errors_has_the_settling_band_and_time(visit: Visit, scheme: Any) -> None:
    page = visit.page
    page.emulate_media(color_scheme=scheme)
    visit.go("#paper&metrics.band=4")
    good = rgb(page, "good")
    settles = visit.end()["metrics"]["settling_time"]
    low, _ = scale_of(page, 0)
    late = page.evaluate("explorer.result.shown") * 0.57  # beside the lines of the grid
    inside, outside, line, beside = chart_colours(
        page, 0, [(late, 3.3), (late, 6.5), (settles, 0.9 * low), (settles - 0.02, 0.9 * low)]
    )
    assert inside[:3] == pytest.approx(good, abs=3)
    assert 0 < inside[3] < 60 < 200 < line[3]
    assert outside != inside
    assert line[:3] == pytest.approx(good, abs=3)
    assert beside != line
    unsettled = visit.go("#paper&metrics.band=4&simulation.duration=0.3")["metrics"]["settling_time"]
    assert math.isnan(unsettled)
    assert chart_colours(page, 0, [(settles - 0.1, 0.9 * low)])[0][:3] != good


@in_browser
def test_limits_of_the_legs_are_drawn_where_the_scale_of_the_curves_has_them(visit: Visit) -> None:
    """A limit of all legs in the colour of a warning, those of one leg each in its colour; no limit changes a scale."""
    page = visit.page
    limit = hs.load_scenario("saturation").robot.force_limit
    page.select_option("#figure-1", "legs")
    visit.go("#saturation")
    low, high = scale_of(page, 1)
    assert low < limit < high
    middle = page.evaluate("explorer.result.shown") / 2
    assert chart_colours(page, 1, [(middle, limit)])[0] == [*rgb(page, "warn"), 255]
    visit.go("#saturation&robot.force_limit=0.2")
    assert scale_of(page, 1)[1] < 0.2
    visit.go("#fails-unequal-depth")
    page.select_option("#figure-1", "lengths")
    longest = page.evaluate("1e3 * (explorer.result.middle[0] + explorer.result.stroke)")
    assert scale_of(page, 1)[1] < longest, "none passes its stroke as long as it settles"
    page.select_option("#span", "all")
    low, high = scale_of(page, 1)
    assert low < longest < high
    assert chart_colours(page, 1, [(0.001, longest)])[0] == [*rgb(page, "warn"), 255]
    visit.go("#reachy-mini&robot.stroke=0.1")
    bounds = page.evaluate("explorer.result.bounds.leg_lengths")
    assert [bound["legs"] for bound in bounds] == [[0, 2, 4]] * 2 + [[1, 3, 5]] * 2, "cranks to both sides"
    scenario = hs.load_scenario("rubin-camera-hexapod")
    joints = np.array(scenario.robot.platform_joints) + [[0.01 * leg, 0, 0] for leg in range(6)]
    words = ",".join(map(str, joints.ravel()))
    visit.go(f"#rubin-camera-hexapod&robot.platform_joints={words}&robot.stroke=0.001")
    low, high = scale_of(page, 1)
    bounds = [
        bound for bound in page.evaluate("explorer.result.bounds.leg_lengths") if low < 1e3 * bound["value"] < high
    ]
    assert len(bounds) > 1
    for value, (leg,) in (tuple(bound.values()) for bound in bounds):
        assert chart_colours(page, 1, [(0.001, 1e3 * value)])[0] == [*rgb(page, f"c{leg}"), 255], leg


def features(page: Page, run: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the times [s] of a run, (n,), and its errors and features [px], (n, 2 points)."""
    time, errors, goals = page.evaluate(
        """run => {
          const { samples, scene } = explorer[run];
          return [samples.time, samples.feature_error, scene.goal].map(all => [...all]);
        }""",
        run,
    )
    errors = np.reshape(errors, (len(time), -1))
    return np.array(time), errors, np.array(goals) - errors


def pale_share(page: Page, found: list[list[int]]) -> float:
    """Return the share of places [r, g, b, a] that have the colour of a line, pale."""
    colours = np.array([rgb(page, f"c{i}") for i in range(8)])
    pale = 0.3 * colours + 0.7 * np.array(rgb(page, "panel"))
    return float(np.mean([np.abs(pale - place[:3]).max(axis=1).min() < 10 for place in found]))


@in_browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_behind_a_run_that_is_changed_is_that_of_the_preset(visit: Visit, scheme: Any) -> None:
    """Pale paths and curves, where the run is not near; none without a change, and none of another number of points."""
    page = visit.page
    page.emulate_media(color_scheme=scheme)
    note = page.locator("figure:has(#chart-0) .ghost")
    assert note.is_hidden()
    assert page.evaluate("explorer.result.ghost") is None
    visit.go("#paper&controller.law=kelly&simulation.duration=0.3")
    page.select_option("#span", "all")
    page.wait_for_function("explorer.result.ghost")
    time, errors, paths = features(page, "reference")
    times, error, now = features(page, "result")
    far = [row for row in range(len(time)) if np.abs(now[:, :2] - paths[row, :2]).max(axis=1).min() > 1.0]
    assert len(far) > 10
    places = [(float(x), float(y)) for x, y in paths[far, :2]]
    assert pale_share(page, image_colours(page, places)) > 0.5
    (low, high), end = scale_of(page, 0), page.evaluate("explorer.result.shown")
    apart = np.abs(errors[:, 0] - np.interp(time, times, error[:, 0])) > 3
    curve = [
        (float(at), float(value))
        for at, value in zip(time[apart], errors[apart, 0], strict=True)
        if at < end and low < value < high
    ]
    assert len(curve) >= 5
    assert pale_share(page, chart_colours(page, 0, curve)) > 0.5
    assert page.locator(".ghost:visible").all_inner_texts() == ["pale: the preset"] * 2
    page.click("#reset")
    page.wait_for_function("explorer.shown === '#paper'")
    assert note.is_hidden()
    assert pale_share(page, image_colours(page, places)) == 0
    visit.go("#reachy-mini")
    page.wait_for_function("explorer.reference")
    fewer = {
        "target.points": page.evaluate("explorer.full()['target.points']")[:12],
        "target.desired_features": page.evaluate("explorer.result.scene.goal")[:8],
        "target.weights": [1],
        "uncertainty.depth": [0],
    }
    words = [f"{key}={','.join(map(str, value))}" for key, value in fewer.items()]
    assert visit.go("&".join(["#reachy-mini", *words]))["refusal"] is None
    assert page.evaluate("[explorer.reference.points, explorer.result.points, explorer.result.ghost]") == [5, 4, None]


@in_browser
def test_a_pale_run_is_drawn_to_its_end(visit: Visit) -> None:
    """One of fewer samples than there are between two of the run before it."""
    page = visit.page
    pinned = "paper%26simulation.start.pose%3D0.003,0.003,0,0,0,0%26simulation.duration%3D0.05"
    visit.go(f"#paper&simulation.duration=600&pinned={pinned}")
    page.wait_for_function("explorer.result.ghost")
    _, _, paths = features(page, "reference")
    _, _, now = features(page, "result")
    far = np.abs(now[:, None, :2] - paths[None, :, :2]).max(axis=2).min(axis=0) > 1.0
    assert far.sum() > 10
    assert pale_share(page, image_colours(page, [(float(x), float(y)) for x, y in paths[far, :2]])) > 0.5


DISCS = """colours => colours.map(colour => {
  const fill = getComputedStyle(document.documentElement).getPropertyValue(`--${colour}`).trim();
  const disc = document.querySelector(`#scene circle[fill="${fill}"]`);
  return disc.getAttribute("transform").match(/-?[0-9][0-9.e-]*/g).map(Number);
})"""


@in_browser
def test_the_border_of_the_image_is_drawn_and_what_is_outside_is_told(visit: Visit) -> None:
    """Among features, wherever the principal point is; the camera has a field of view where its image has a border."""
    page = visit.page
    pyramids = "[...document.querySelectorAll('#scene path')].filter(path => path.style.fillOpacity === '0.1').length"
    visit.go("#paper")
    assert page.evaluate("explorer.result.border") is None
    assert page.evaluate(pyramids) == 0
    visit.go("#fails-lost-features")
    assert page.evaluate(pyramids) > 0
    assert page.evaluate("explorer.result.border") == [-68, 68, -68, 68]
    assert page.locator("#border").is_visible()
    on, beside = image_colours(page, [(68, 5), (66, 5)])
    assert on[:3] == pytest.approx(rgb(page, "good"), abs=10)
    assert beside[:3] != pytest.approx(rgb(page, "good"), abs=10)
    run = hs.simulate(hs.load_scenario("fails-lost-features"))
    outside = np.abs(run.features).reshape(len(run.time), -1, 2).max(axis=2) > 68
    row = int(np.argmax(outside.any(axis=1)))
    words = f"point {int(np.argmax(outside[row])) + 1} leaves the image at {run.time[row]:.4g} s"
    assert words in page.locator("#verdict").inner_text()
    assert "warn" in str(page.locator("#verdict").get_attribute("class"))
    assert any("outside of the image" in item for item in page.locator("#happenings button").all_inner_texts())
    _, _, paths = features(page, "result")
    now = paths[-1].reshape(-1, 2)
    found = image_colours(page, now.tolist())
    for i, place in enumerate(now):
        expected = "panel" if np.abs(place).max() > 68 else f"c{i}"
        assert found[i][:3] == rgb(page, expected), i
        discs = page.locator(f"#scene circle[stroke='{page.evaluate(NAMED, f'c{i}')}']").count()
        assert discs == (expected == "panel"), i
    for name, change in (("eye-to-hand", {}), ("reachy-mini", {"camera.focal_pixels": [150.0, 160.0]})):
        scenario = hs.load_scenario(name).updated(change)
        visit.go("&".join([f"#{name}", *(f"{key}={','.join(map(str, value))}" for key, value in change.items())]))
        run = hs.simulate(scenario)
        pixels, seen = (np.reshape(values, (-1, 2)) for values in (run.pixels, run.features))
        edges = np.array([[-0.5, -0.5], np.asarray(scenario.camera.image_size) - 0.5])
        (left, high), (right, low) = np.transpose(
            [np.polyval(np.polyfit(pixels[:, k], seen[:, k], 1), edges[:, k]) for k in (0, 1)]
        )
        assert page.evaluate("explorer.result.border") == pytest.approx([left, right, low, high], rel=1e-6), name
    visit.go("#eye-to-hand")
    assert page.locator("#border").is_hidden(), "its note is there where a side of it is in the picture"
    visit.go("#real-machine&camera.distortion.brown_conrady=-0.1,0,0,0,0")
    assert page.evaluate("explorer.result.border") is None, "a lens bends it"


@in_browser
def test_a_platform_that_goes_away_is_kept_in_view_or_told_of(visit: Visit) -> None:
    page = visit.page
    note = page.locator("#scene p")

    def height() -> tuple[float, float]:
        """Place of the camera on the platform, of the view's height from its middle; and the view's height."""
        box = page.locator("#scene").bounding_box()
        assert box is not None
        return page.evaluate(DISCS, ["good"])[0][1], box["height"]

    visit.go("#paper&uncertainty.gravity=0.2&simulation.duration=0.3")
    assert page.evaluate("explorer.result.samples.position.at(-1) - explorer.result.samples.position[2]") < -0.05
    at, whole = height()
    assert abs(at) < whole / 2
    assert note.inner_text() == ""
    visit.go("#paper&uncertainty.gravity=0.2")
    place = np.array(page.evaluate("Array.from(explorer.result.samples.position)")).reshape(-1, 3)
    away = float(np.linalg.norm(place[-1] - place[0]))
    assert note.inner_text() == f"platform {away:.2g} m away, out of view"
    at, whole = height()
    assert abs(at) > whole / 2
    page.locator("#happenings button").first.click()
    assert note.inner_text() == ""


@in_browser
def test_the_machine_is_not_drawn_as_in_a_mirror(visit: Visit) -> None:
    """Three points of the target go round on the screen, whose y points down, as the viewer sees them in space."""
    page = visit.page
    visit.go("#reachy-mini-head")
    last = visit.end()["rows"] - 1
    a, b, c = np.array(page.evaluate("row => explorer.target(row)", last))[:3]
    page.locator("#scene").focus()
    turns = 0
    for _ in range(16):
        for _ in range(4):
            page.keyboard.press("ArrowRight")
        side = np.dot(np.cross(b - a, c - a), np.array(page.evaluate("explorer.viewer()")) - a)
        p, q, r = np.array(page.evaluate(DISCS, ["c0", "c1", "c2"]))
        area = np.linalg.det([q - p, r - p])
        assert area * side < 0
        turns += side > 0
    assert 0 < turns < 16, "the viewer goes round the target"


@in_browser
def test_the_platform_follows_the_pointer(visit: Visit) -> None:
    """Before the button is released, the camera on the platform is drawn as far from where it was as the pointer."""
    page = visit.page
    page.evaluate(
        "() => { const time = document.getElementById('time'); time.value = 0; time.dispatchEvent(new Event('input')) }"
    )
    box = page.locator("#scene").bounding_box()
    assert box is not None
    centre = np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])
    before = np.array(page.evaluate(DISCS, ["good"])[0])
    page.mouse.move(*(centre + before + [0, 3]))
    assert page.evaluate("document.getElementById('scene').style.cursor") == "move"
    page.mouse.down()
    page.evaluate("explorer.shown = null")
    page.mouse.move(*(centre + before + [14, -7]))
    page.wait_for_function("explorer.shown !== null && explorer.state.changes['simulation.start.pose'] !== undefined")
    moved = np.array(page.evaluate(DISCS, ["good"])[0]) - before
    np.testing.assert_allclose(moved, [14, -10], atol=1)
    page.mouse.up()


class Fingers:
    """Fingers on the page: each call gives the places of those that are down after it."""

    def __init__(self, page: Page) -> None:
        self.session = page.context.new_cdp_session(page)

    def __call__(self, kind: str, *places: tuple[float, float]) -> None:
        points = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(places)]
        self.session.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})


def beside(place: tuple[float, float], right: float, down: float) -> tuple[float, float]:
    """Return a place some pixels away."""
    return place[0] + right, place[1] + down


def place_of(page: Page, name: str, cursor: str) -> tuple[float, float]:
    """Return the first place of a view, row by row, at which the pointer has a form."""
    box = page.locator(name).bounding_box()
    assert box is not None
    for down in range(20, int(box["height"]), 16):
        for right in range(20, int(box["width"]) - 20, 16):
            place = (box["x"] + right, box["y"] + down)
            page.mouse.move(*place)
            if page.locator(name).evaluate("view => view.style.cursor") == cursor:
                return place
    raise AssertionError(f"{name}: no place where the pointer is {cursor}")


@in_browser
def test_the_view_turns_with_one_pointer_and_the_first_button(visit: Visit) -> None:
    """Motion to the side turns it about the vertical, so that the viewer stays at one height."""
    page = visit.page
    fingers = Fingers(page)

    def viewer() -> list[float]:
        found: list[float] = page.evaluate("explorer.viewer()")
        return found

    def turned(before: list[float]) -> list[float]:
        page.wait_for_function("before => explorer.viewer().some((x, i) => x !== before[i])", arg=before)
        return viewer()

    free, platform = place_of(page, "#scene", "grab"), place_of(page, "#scene", "move")
    start = viewer()
    page.mouse.move(*free)
    page.mouse.down(button="right")
    page.mouse.move(*beside(free, 30, 20))
    page.mouse.up(button="right")
    fingers("Start", free)
    fingers("Move", beside(free, 20, 0))
    once = turned(start)
    fingers("Start", beside(free, 20, 0), platform)
    fingers("Move", beside(free, 20, 0), beside(platform, 0, 40))
    page.locator("#scene").dispatch_event("pointerup", {"pointerId": 99})
    fingers("Move", beside(free, 40, 0), beside(platform, 0, 40))
    twice = turned(once)
    fingers("End")
    assert [once[2], twice[2]] == pytest.approx([start[2]] * 2, rel=1e-9)
    assert page.evaluate("explorer.state.changes") == {}


@in_browser
def test_a_goal_follows_one_pointer_and_stays_where_that_is_lost(visit: Visit) -> None:
    page = visit.page
    fingers = Fingers(page)
    goal = place_of(page, "#image", "grab")
    page.mouse.move(*goal)
    page.mouse.down(button="right")
    page.mouse.move(*beside(goal, 30, 10))
    page.mouse.up(button="right")
    assert page.evaluate("explorer.state.changes") == {}
    fingers("Start", goal)
    page.evaluate("explorer.shown = null")
    fingers("Move", beside(goal, 20, 10))
    page.wait_for_function("explorer.shown !== null")
    dragged = page.evaluate("explorer.state.changes")
    assert list(dragged) == ["target.desired_features"]
    fingers("Start", beside(goal, 20, 10), beside(goal, 40, 50))
    fingers("Move", beside(goal, 20, 10), beside(goal, 80, 90))
    page.evaluate("explorer.shown = null")
    fingers("Cancel")
    page.wait_for_function("explorer.shown !== null")
    assert page.evaluate("explorer.state.changes") == dragged


@in_browser
def test_a_goal_is_not_moved_to_the_pointer_that_takes_it(visit: Visit) -> None:
    """A click changes nothing, and a motion to the right moves a goal to the right alone."""
    page = visit.page
    page.mouse.move(*place_of(page, "#image", "grab"))
    page.mouse.down()
    page.mouse.up()
    assert page.evaluate("explorer.state.changes") == {}
    taken = place_of(page, "#image", "grab")
    page.mouse.move(*taken)
    page.mouse.down()
    page.evaluate("explorer.shown = null")
    page.mouse.move(*beside(taken, 20, 0))
    page.mouse.up()
    page.wait_for_function("explorer.shown !== null")
    goals = np.asarray(hs.load_scenario("paper").target.desired_features, dtype=float)
    moved = np.asarray(page.evaluate("explorer.state.changes['target.desired_features']")) - goals
    assert np.abs(moved[1::2]).max() <= 0.051
    assert moved[::2].max() > 1.0


@in_browser
def test_the_pane_of_the_target_is_all_between_its_points(visit: Visit) -> None:
    """The points of `paper` do not go round it in the order of their numbers."""
    visit.go("#paper")
    corners = np.array(visit.page.evaluate(DISCS, ["c0", "c1", "c2", "c3"]))
    weights = np.random.default_rng(1).dirichlet(np.ones(4), 200)
    filled = visit.page.evaluate(
        """places => {
          const pane = [...document.querySelectorAll('#scene path')].find(path => path.style.fillOpacity === '0.12');
          return places.map(([x, y]) => pane.isPointInFill(new DOMPoint(x, y)));
        }""",
        (weights @ corners).tolist(),
    )
    assert all(filled)


@in_browser
def test_shortcuts_of_the_browser_are_left_to_it(visit: Visit) -> None:
    page = visit.page
    page.click("#map-section summary")
    for name in ("#scene", "#image", "#map canvas"):
        for held in ("ctrlKey", "metaKey", "altKey", None):
            taken = page.locator(name).evaluate(
                """(view, held) => !view.dispatchEvent(
                  new KeyboardEvent('keydown', { key: 'ArrowLeft', cancelable: true, ...(held && { [held]: true }) })
                )""",
                held,
            )
            assert taken == (held is None), (name, held)


@in_browser
def test_a_goal_that_is_chosen_leaves_the_time_alone(visit: Visit) -> None:
    page = visit.page
    page.evaluate(
        "() => { const time = document.getElementById('time'); time.value = 1; time.dispatchEvent(new Event('input')) }"
    )
    image = page.locator("#image")
    image.focus()
    before = image.evaluate("canvas => canvas.toDataURL()")
    page.keyboard.press("2")
    assert image.evaluate("canvas => canvas.toDataURL()") != before, "the ring is about another goal"
    page.keyboard.press("1")
    assert image.evaluate("canvas => canvas.toDataURL()") == before


@in_browser
def test_presets_are_in_groups(visit: Visit) -> None:
    """Each in one, by its name, its description or its mass."""
    groups = visit.page.locator("#preset optgroup").evaluate_all(
        "found => found.map(group => [group.label, [...group.children].map(option => option.value)])"
    )
    assert [label for label, _ in groups] == ["The paper", "Cameras and loops", "Machines", "Failures", "Tasks"]
    assert sorted(name for _, names in groups for name in names) == sorted(hs.scenario_names())
    scenarios = {name: hs.load_scenario(name) for name in hs.scenario_names()}
    mass = scenarios["paper"].robot.mass
    for label, names in groups:
        for name in names:
            fails = scenarios[name].description.startswith("Fails,")
            assert (label == "Failures") == fails, name
            assert (label == "The paper") == name.startswith("paper"), name
            assert (label == "Tasks") == name.startswith(("task-", "textbook-")), name
            assert (label == "Machines") == (scenarios[name].robot.mass != mass and not fails), name
    assert groups[0][1][0] == "paper"


@in_browser
def test_no_slider_of_a_preset_is_marked_as_changed(visit: Visit) -> None:
    """Where the sliders of two presets are alike too, each goes back to the preset's own values."""
    page = visit.page
    for name in hs.scenario_names():
        page.select_option("#preset", name)
        page.wait_for_function("name => explorer.shown === `#${name}`", arg=name)
        assert page.locator(".slider.changed").count() == 0, name


@in_browser
def test_changes_are_in_the_address_and_in_the_yaml(visit: Visit, browser: Browser, file: Path) -> None:
    page = visit.page
    before = visit.end()
    slider = page.locator('[data-id="uncertainty.depth"]')
    page.evaluate("explorer.shown = null")
    slider.focus()
    page.keyboard.press("ArrowLeft")
    page.wait_for_function("explorer.shown !== null && location.hash.includes('depth')")
    after = visit.end()
    assert after["metrics"] != before["metrics"]
    depth = page.evaluate("explorer.state.changes['uncertainty.depth'][0]")
    assert depth == pytest.approx(0.295)
    scenario = hs.Scenario.from_yaml(page.evaluate("explorer.yaml()"))
    assert scenario.uncertainty.depth == depth
    assert native(scenario)[1]["settling_time"] == pytest.approx(after["metrics"]["settling_time"], abs=0.02)
    again = Visit(browser, file, "#" + page.url.partition("#")[2])
    assert again.end()["metrics"] == pytest.approx(after["metrics"], rel=0, abs=0, nan_ok=True)
    assert again.problems == []
    again.context.close()
    page.click("#reset")
    page.wait_for_function("explorer.shown === '#paper'")
    assert visit.end()["metrics"] == pytest.approx(before["metrics"], rel=0, abs=0, nan_ok=True)


@in_browser
def test_the_buttons_that_copy_say_what_became_of_it_and_are_themselves_again(visit: Visit) -> None:
    """Clicked twice, and where the browser gives no clipboard, as over http."""
    page = visit.page
    patient = "document.querySelector('#link').textContent === 'Copy link'"
    page.evaluate(
        "Object.defineProperty(navigator, 'clipboard', {value: {writeText: async () => {}}, configurable: true})"
    )
    page.evaluate("for (let i = 0; i < 2; ++i) document.querySelector('#link').click()")
    page.wait_for_function("document.querySelector('#link').textContent === 'Copied'")
    page.click("#link")
    page.wait_for_function(patient)
    page.evaluate("Object.defineProperty(navigator, 'clipboard', {value: undefined})")
    page.click("#link")
    page.wait_for_function("document.querySelector('#link').textContent === 'Copy it from the address bar'")
    page.wait_for_function(patient)
    page.click("#as-yaml")
    page.click("#copy")
    page.wait_for_function("document.querySelector('#copy').textContent === 'Select and copy'")
    assert page.evaluate("document.querySelector('#yaml').selectionEnd") > 0
    page.wait_for_function("document.querySelector('#copy').textContent === 'Copy'")


@in_browser
def test_back_undoes_a_change(visit: Visit) -> None:
    """A drag is one entry of the history, however many values it goes through."""
    page = visit.page
    page.evaluate(
        """async () => {
          const slider = document.querySelector('[data-id="uncertainty.depth"]');
          const move = (value, kind) => { slider.value = value; slider.dispatchEvent(new Event(kind)); };
          const rest = () => new Promise(done => setTimeout(done, 400));
          move(600, 'input'); await rest(); move(650, 'input'); await rest(); move(700, 'change'); await rest();
        }"""
    )
    dragged = page.evaluate("location.hash")
    assert dragged == "#paper&uncertainty.depth=" + "%2C".join(["0.36"] * 4)
    page.select_option("#preset", "task-tilt")
    page.wait_for_function("location.hash === '#task-tilt'")
    for address in (dragged, "#paper"):
        page.go_back()
        page.wait_for_function("address => explorer.shown === address", arg=address)
    page.go_forward()
    page.wait_for_function("address => explorer.shown === address", arg=dragged)
    assert page.locator('[data-id="uncertainty.depth"]').input_value().startswith("699.99")


def press(page: Page, slider: str, key: str) -> None:
    """Move a slider by a key, and wait for the run."""
    page.evaluate("explorer.shown = null")
    page.locator(f'[data-id="{slider}"]').press(key)
    page.wait_for_function("explorer.shown !== null")


def told(page: Page, slider: str) -> tuple[str, str]:
    """Label and value of a slider."""
    row = page.locator(".slider", has=page.locator(f'[data-id="{slider}"]'))
    return row.locator("label").inner_text(), row.locator("output").inner_text()


@in_browser
def test_a_slider_of_different_errors_shifts_them_all(visit: Visit) -> None:
    page = visit.page
    depth = "uncertainty.depth"
    visit.go("#fails-unequal-depth")
    assert told(page, depth) == ("depth, mean", "15 % (-30 % to 30 %)")
    press(page, depth, "ArrowRight")
    assert page.evaluate("explorer.state.changes") == {depth: [0.305, 0.305, -0.295, 0.305]}
    press(page, depth, "ArrowLeft")
    assert page.evaluate("explorer.state.changes") == {}
    press(page, depth, "End")
    assert page.evaluate("explorer.state.changes") == {depth: [0.9, 0.9, 0.3, 0.9]}
    page.locator(".slider.changed .reset").click()
    page.wait_for_function("explorer.shown === '#fails-unequal-depth'")
    visit.go("#paper&uncertainty.depth=0.1,0.2,0.1,0.2")
    assert told(page, depth) == ("depth, mean", "15 % (10 % to 20 %)")
    page.locator(".slider.changed .reset").click()
    page.wait_for_function("explorer.shown === '#paper'")
    assert told(page, depth) == ("depth", "30 %")


@in_browser
def test_every_place_of_the_delay_is_a_delay_that_the_core_takes(visit: Visit) -> None:
    """It reaches eight servo periods in steps of one, of which places of a map between two steps are one."""
    page = visit.page
    for preset in ("composite-30hz", "pi-h824-positions"):
        step = hs.load_scenario(preset).simulation.step
        for place, ticks in {1000: 8, 500: 4, 70: 1, 40: 0}.items():
            visit.go(f"#{preset}&simulation.duration=0.2&metrics.rms_start=0.1&metrics.dwell=0.1")
            page.evaluate(
                """place => {
                  const input = document.querySelector('[data-id="actuators.delay"]');
                  explorer.shown = null;
                  input.step = 'any';
                  input.value = place;
                  input.dispatchEvent(new Event('change'));
                  if (!('actuators.delay' in explorer.state.changes)) explorer.shown = '';
                }""",
                place,
            )
            page.wait_for_function("explorer.shown !== null")
            assert visit.end()["refusal"] is None, place
            delay = page.evaluate("explorer.full()['actuators.delay']")
            assert delay == pytest.approx(ticks * step, rel=1e-9), (preset, place)


@in_browser
def test_the_duration_goes_back_to_that_of_a_short_preset(browser: Browser, tmp_path: Path) -> None:
    path = tmp_path / "short.html"
    short = {"name": "short", "simulation.duration": 0.2, "metrics.rms_start": 0.1, "metrics.dwell": 0.1}
    path.write_text(explorer_page(hs.load_scenario("paper").updated(short)), encoding="utf-8")
    visit = Visit(browser, path)
    visit.page.click("#controls summary:has-text('duration')")
    for key, words in {"ArrowRight": "0.7 s", "ArrowLeft": "0.2 s", "End": "20.2 s", "Home": "0.2 s"}.items():
        press(visit.page, "simulation.duration", key)
        assert visit.page.evaluate("explorer.refusal") is None
        assert told(visit.page, "simulation.duration")[1] == words, key
    assert visit.page.evaluate("explorer.state.changes") == {}
    assert visit.problems == []
    visit.context.close()


@in_browser
def test_a_slider_of_different_gains_multiplies_them_all(visit: Visit) -> None:
    page = visit.page
    kp = "controller.pbvs.kp/angular"
    visit.go("#fails-unequal-depth")
    assert told(page, kp) == ("kp, moment, factor", "× 1")
    press(page, kp, "End")
    assert page.evaluate("explorer.state.changes['controller.pbvs.kp']") == pytest.approx(
        [24, 24, 24, 0.06 * 10**1.5, 0.06 * 10**1.5, 0.12 * 10**1.5], rel=1e-4
    )
    page.locator(".slider.changed .reset").click()
    page.wait_for_function("explorer.shown === '#fails-unequal-depth'")
    for address, kinds in {
        "#paper&controller.law=pbvs": ("kp", "kd", "prior"),
        "#paper&controller.law=kelly": ("kp", "kd"),
        "#paper&controller.law=composite": ("kp", "kv", "kt", "kd", "drive", "prior"),
        "#moog-6dof2000e": ("kp", "kv", "kt", "kd", "drive", "prior"),
    }.items():
        visit.go(address)
        keys = set(page.locator("#controls input[type=range]").evaluate_all("found => found.map(e => e.dataset.id)"))
        law = page.evaluate("explorer.full()['controller.law']")
        for kind in kinds:
            halves = [""] if kind == "kp" and law != "pbvs" else ["/linear", "/angular"]
            assert {f"controller.{law}.{kind}{half}" for half in halves} <= keys, (address, kind)


@in_browser
def test_one_number_for_six_gains_is_that_of_both_sliders(visit: Visit) -> None:
    page = visit.page
    visit.go("#paper&controller.hybrid.kv=0.003")
    halves = [told(page, f"controller.hybrid.kv/{half}") for half in ("linear", "angular")]
    assert halves == [("kv, force", "0.003 N"), ("kv, moment", "0.003 N m")]
    press(page, "controller.hybrid.kv/angular", "ArrowLeft")
    moved = page.evaluate("explorer.state.changes['controller.hybrid.kv']")
    assert moved[:3] == [0.003] * 3
    assert moved[3] == moved[4] == moved[5] < 0.003
    assert visit.end()["refusal"] is None


@in_browser
def test_halves_of_a_gain_are_named_after_what_they_are(visit: Visit) -> None:
    """Forces and moments where that is their unit, else translation and rotation."""
    visit.go("#paper-composite")
    for kind, linear, angular in (
        ("kt", "kt, force", "kt, moment, factor"),
        ("drive", "drive, translation", "drive, rotation"),
        ("prior", "prior, translation", "prior, rotation"),
    ):
        names = [told(visit.page, f"controller.composite.{kind}/{half}")[0] for half in ("linear", "angular")]
        assert names == [linear, angular], kind
    visit.go("#reachy-mini-motors")
    assert told(visit.page, "controller.tracking.acceleration/linear")[0] == "acceleration, translation"
    assert told(visit.page, "controller.tracking.acceleration/angular")[0] == "acceleration, rotation"


@in_browser
def test_an_address_with_what_is_unknown_is_read_as_far_as_it_goes(visit: Visit) -> None:
    end = visit.go("#nosuch&nokey=3&uncertainty.depth=abc&uncertainty.gravity=0.01&constructor=1&alone")
    assert end["refusal"] is None
    assert visit.page.evaluate("explorer.state") == {"preset": "paper", "changes": {"uncertainty.gravity": 0.01}} or (
        visit.page.evaluate("Object.keys(explorer.state.changes)") == ["uncertainty.gravity"]
    )
    assert visit.page.locator("#message").inner_text().split(". ") == [
        'address: expected a scenario of the list, got "nosuch": this is paper',
        'address: expected a key of "All parameters", got "nokey": left out',
        'uncertainty.depth: expected finite numbers, got "abc": left out',
        'address: expected a key of "All parameters", got "constructor": left out',
        'address: expected key=value, got "alone": left out',
    ]
    for change, words in {
        "camera.timeout=Infinity": 'camera.timeout: expected finite numbers or none, got "Infinity"',
        "simulation.duration=-Infinity": 'simulation.duration: expected finite numbers, got "-Infinity"',
        "camera.gate=none,5": 'camera.gate: expected finite numbers or none, got "none 5"',
        "robot.payload.known=2": 'robot.payload.known: expected 1 or 0, got "2"',
    }.items():
        visit.go(f"#composite-30hz&{change}")
        assert visit.page.evaluate("explorer.state.changes") == {}, change
        assert visit.page.locator("#message").inner_text() == f"{words}: left out"
    for word, value in {"false": 0, "0": 0, "none": None}.items():
        key = "camera.gate" if value is None else "robot.payload.known"
        visit.go(f"#composite-30hz&camera.gate=5&{key}={word}")
        assert visit.page.evaluate("key => explorer.full()[key]", key) == value, word
        assert visit.page.locator("#message").is_hidden()
    visit.go("#paper&controller.switching.kind=implicit&nokey=1")
    words = visit.page.locator("#message").inner_text()
    assert words.startswith("controller.switching.kind: ")
    assert words.endswith('got "nokey": left out')
    press(visit.page, "uncertainty.gravity", "ArrowRight")
    assert "nokey" not in visit.page.locator("#message").inner_text()
    visit.go("#paper")
    assert visit.page.locator("#message").is_hidden()


@in_browser
@pytest.mark.parametrize("address", ["#%", "#%E0&uncertainty.gravity=0.01"])
def test_an_address_that_was_cut_is_one_of_the_default_preset(browser: Browser, file: Path, address: str) -> None:
    visit = Visit(browser, file, address)
    assert visit.page.evaluate("explorer.state.preset") == "paper"
    assert len(visit.page.evaluate("Object.keys(explorer.state.changes)")) == address.count("&")
    assert "expected a scenario of the list" in visit.page.locator("#message").inner_text()
    assert visit.problems == []
    visit.context.close()


@in_browser
def test_what_the_core_refuses_is_shown_in_its_words(visit: Visit) -> None:
    end = visit.go("#paper&controller.switching.kind=implicit")
    with pytest.raises(hs.ScenarioError) as error:
        hs.load_scenario("paper").updated({"controller.switching.kind": "implicit"})
    assert end["refusal"] in str(error.value)
    assert visit.page.locator("#message").inner_text() == end["refusal"]
    assert visit.go("#paper")["refusal"] is None
    assert visit.page.locator("#message").is_hidden()


@in_browser
@pytest.mark.parametrize("change", ["step=0", "step=1e-30", "duration=1e15"])
def test_a_refusal_names_the_key_that_was_changed(visit: Visit, change: str) -> None:
    """What the page adds for itself, how often a run is sampled, is right whatever the step and the duration are."""
    refusal = visit.go(f"#paper&simulation.{change}")["refusal"]
    assert refusal.startswith(
        "simulation.duration" if change == "step=1e-30" else f"simulation.{change.partition('=')[0]}: "
    )


@in_browser
def test_a_goal_and_the_platform_can_be_dragged(visit: Visit) -> None:
    page = visit.page
    page.locator("#image").focus()
    page.keyboard.press("2")
    page.evaluate("explorer.shown = null")
    page.keyboard.press("ArrowRight")
    page.wait_for_function("explorer.shown !== null")
    goals = np.asarray(hs.load_scenario("paper").target.desired_features, dtype=float)
    goals[2] += 1
    np.testing.assert_allclose(page.evaluate("explorer.state.changes['target.desired_features']"), goals, atol=0.051)
    box = page.locator("#scene").bounding_box()
    assert box is not None
    # where the platform is: the page's own hit test changes the pointer there
    found = None
    for y in range(20, int(box["height"]), 8):
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + y)
        if page.evaluate("document.getElementById('scene').style.cursor") == "move":
            found = y
            break
    assert found is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + found + 3)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 2 + 12, box["y"] + found + 3, steps=3)
    page.mouse.up()
    page.wait_for_function("explorer.state.changes['simulation.start.pose'] !== undefined")
    start = page.evaluate("explorer.state.changes['simulation.start.pose']")
    assert 0 < np.linalg.norm(start[:3]) < 0.1


@in_browser
def test_a_map_has_the_numbers_of_single_runs(visit: Visit) -> None:
    page = visit.page
    visit.go("#task-tilt&controller.law=pbvs&simulation.duration=0.2&metrics.rms_start=0.1&metrics.dwell=0.01")
    page.click("#map-section summary")
    page.select_option("#map [name=x]", "uncertainty.depth")
    page.select_option("#map [name=y]", "uncertainty.inertia")
    page.select_option("#map [name=metric]", "final_error")
    # Begun, stopped and begun while its workers load.
    page.evaluate("for (let i = 0; i < 3; ++i) document.querySelector('#map button').click()")
    page.wait_for_function("document.querySelector('#map canvas').dataset.done === 'yes'", timeout=5 * PATIENCE)
    box = page.locator("#map canvas").bounding_box()
    assert box is not None
    page.evaluate("explorer.shown = null")
    page.locator("#map canvas").click(position={"x": box["width"] / 2, "y": box["height"] / 3})
    page.wait_for_function("explorer.shown !== null")
    changes = page.evaluate("explorer.state.changes")
    assert {"uncertainty.depth", "uncertainty.inertia"} & set(changes)
    told = page.locator("#map [data-words]").inner_text()
    assert told.startswith("4096 runs in ")
    assert len(page.workers) == 2 + min(8, page.evaluate("navigator.hardwareConcurrency"))
    outcome, expected = native(hs.Scenario.from_yaml(page.evaluate("explorer.yaml()")))
    end = visit.end()
    assert (outcome, end["metrics"]["final_error"]) == ("completed", pytest.approx(expected["final_error"], rel=1e-9))


@in_browser
@pytest.mark.parametrize("change", ["controller.switching.kind=implicit", "controller.switching.kind=nosuch"])
def test_a_map_of_what_the_core_refuses_gives_its_words(browser: Browser, file: Path, change: str) -> None:
    """Of the first every run is refused, of the second a value that all of them have."""
    visit = Visit(browser, file, f"#paper&{change}")
    page = visit.page
    refusal = page.evaluate("explorer.refusal")
    assert refusal.startswith(change.partition("=")[0])
    page.click("#map-section summary")
    button = page.locator("#map button")
    button.click()
    page.wait_for_function("words => document.querySelector('#map [data-words]').textContent === words", arg=refusal)
    assert button.inner_text() == "Compute the map"
    assert visit.problems == []
    visit.context.close()


MAP_OF = "&simulation.duration=0.2&metrics.rms_start=0.1&metrics.dwell=0.01"


def begin_map(visit: Visit, address: str, x: str, y: str, metric: str) -> None:
    """Open the map of a scenario, begin it, and wait for some of its runs."""
    page = visit.page
    visit.go(address)
    if not page.locator("#map").is_visible():
        page.click("#map-section summary")
    for name, value in {"x": x, "y": y, "metric": metric}.items():
        page.select_option(f"#map [name={name}]", value)
    page.click("#map button")
    page.wait_for_selector("#map .legend > *")


def legend(page: Page) -> list[str]:
    """What the legend of the map names; the numbers first."""
    found: list[str] = page.locator("#map .legend > *").all_inner_texts()
    return found


@in_browser
def test_a_map_is_of_one_scenario(visit: Visit) -> None:
    """Its run ends with that, it gives nothing to another one, and comes back with it."""
    page = visit.page
    address = f"#task-tilt&controller.law=pbvs{MAP_OF}"
    stale = "document.getElementById('map').classList.contains('stale')"
    begin_map(visit, address, "controller.pbvs.kp/linear", "uncertainty.depth", "final_error")
    canvas = page.locator("#map canvas")
    box = canvas.bounding_box()
    assert box is not None
    place = {"x": box["width"] / 2, "y": box["height"] / 3}
    depth = page.evaluate("explorer.state.changes")
    unequal = f"{address}&uncertainty.depth=0.1,-0.1,0.1,-0.1"  # the map has equal ones
    for other in ("#paper", f"#task-tilt&controller.law=kelly{MAP_OF}", f"{address}&uncertainty.gravity=0.02", unequal):
        visit.go(other)
        assert page.locator("#map button").inner_text() == "Compute the map"
        assert page.evaluate(stale), other
        assert "runs of another scenario" in page.locator("#map [data-words]").inner_text()
        before = page.evaluate("explorer.state")
        canvas.click(position=place)  # type: ignore[arg-type]
        assert page.evaluate("explorer.state") == before
        visit.go(f"{address}&uncertainty.depth=0.1,0.1,0.1,0.1")
        assert not page.evaluate(stale)
    page.evaluate("explorer.shown = null")
    canvas.click(position=place)  # type: ignore[arg-type]
    page.wait_for_function("explorer.shown !== null")
    assert set(page.evaluate("explorer.state.changes")) - set(depth) == {"controller.pbvs.kp", "uncertainty.depth"}
    assert not page.evaluate(stale)


@in_browser
def test_the_legend_of_a_map_names_its_colours(visit: Visit) -> None:
    """Angles for cranks, and a run that the sentence warns of is not called settled alone."""
    page = visit.page
    begin_map(visit, f"#reachy-mini{MAP_OF}", "uncertainty.depth", "camera.noise", "peak_leg_excursion")
    bar = legend(page)[0].replace("\n", "")
    assert re.fullmatch(r"[\d.]+° ?(≥ [\d.]+°, up to )?[\d.]+°(, logarithmic)?", bar), bar
    page.select_option("#map [name=metric]", "settling_time")
    assert legend(page) == ["not settled"]
    for change, ending in ("", "settled"), ("&robot.force_limit=0.05", "settled, beyond a limit"):
        address = f"#paper&simulation.duration=1&metrics.rms_start=0.5{change}"
        begin_map(visit, address, "uncertainty.coriolis", "uncertainty.inertia", "outcome")
        assert ending in legend(page), change
        page.select_option("#map [name=metric]", "settling_time")
        assert ending not in legend(page)
        assert re.match(r"[\d.]+ s", legend(page)[0])
        page.click("#map button")


def runs_of_map(page: Page, count: int) -> None:
    """Wait for so many runs of the map, and stop it."""
    ready = "count => parseInt(document.querySelector('#map [data-words]').textContent) >= count"
    page.wait_for_function(ready, arg=count)
    page.click("#map button")


@in_browser
def test_a_map_of_a_metric_has_the_border_of_runs_that_settle(visit: Visit) -> None:
    """A line on the picture, and a sentence on how far runs settle on both sides of the sliders: single runs agree."""
    page = visit.page
    address = "#paper&simulation.duration=1&metrics.rms_start=0.5"
    begin_map(visit, address, "controller.hybrid.kp", "uncertainty.inertia", "peak_error")
    runs_of_map(page, 300)  # every fourth of each axis is computed
    assert "border of runs that settle, within and beyond limits" in legend(page)
    white = page.evaluate(
        """() => {
          const canvas = document.querySelector('#map canvas');
          const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
          let count = 0;
          for (let i = 0; i < data.length; i += 4) count += data[i] > 250 && data[i + 1] > 250 && data[i + 2] > 250;
          return count;
        }"""
    )
    assert white > 300  # the ring has a hundred
    words = page.locator("#map [data-here]").inner_text()
    found = re.fullmatch(
        r"Here runs settle from (\S+) N m/px² to (.+) of kp, and from (.+) to (.+) of inertia(, in part .*)?\.", words
    )
    assert found is not None, words
    lowest = float(found[1])
    spacing = 1000 ** (4 / 63)  # of cells that are computed
    for factor, settles in (1.0, True), (1 / spacing, False):
        end = visit.go(f"{address}&controller.hybrid.kp={','.join(8 * [str(lowest * factor)])}")
        assert math.isnan(end["metrics"]["settling_time"]) != settles, (words, factor)
    assert page.locator("#map [data-here]").inner_text() == "The run of the pixel at the ring does not settle."
    visit.go(f"{address}&uncertainty.gravity=0.01")
    assert page.locator("#map [data-here]").inner_text() == ""


@in_browser
def test_the_selectors_of_a_map_that_is_in_colour_again_name_its_axes(visit: Visit) -> None:
    page = visit.page
    chosen = "['x', 'y'].map(name => document.querySelector(`#map [name=${name}]`).value)"
    address = "#paper&simulation.mode=sampled&simulation.duration=0.2&metrics.rms_start=0.1&metrics.dwell=0.01"
    begin_map(visit, address, "camera.latency", "camera.noise", "peak_error")
    page.click("#map button")
    visit.go(address.replace("sampled", "continuous"))
    assert page.evaluate(chosen) != ["camera.latency", "camera.noise"]
    visit.go(address)
    assert not page.evaluate("document.getElementById('map').classList.contains('stale')")
    assert page.evaluate(chosen) == ["camera.latency", "camera.noise"]


@in_browser
def test_the_bar_of_a_map_names_the_largest_number_beyond_its_scale(visit: Visit) -> None:
    """Two of a hundred numbers have the colour of its upper end."""
    address = "#paper&simulation.duration=0.5&metrics.rms_start=0.2"
    begin_map(visit, address, "controller.hybrid.kp", "uncertainty.gravity", "peak_control_force")
    runs_of_map(visit.page, 64)
    found = re.search(r"≥ ([\d.]+) N, up to ([\d.]+) N", legend(visit.page)[0].replace("\n", ""))
    assert found is not None, legend(visit.page)
    assert float(found[1]) < float(found[2])


@in_browser
def test_a_second_tap_takes_what_the_first_one_tells(browser: Browser, file: Path) -> None:
    visit = Visit(browser, file, viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    page = visit.page
    begin_map(visit, f"#task-tilt&controller.law=pbvs{MAP_OF}", "uncertainty.inertia", "uncertainty.depth", "outcome")
    page.wait_for_function("/^[0-9]{3}/.test(document.querySelector('#map [data-words]').textContent)")
    page.click("#map button")
    before = page.evaluate("Object.keys(explorer.state.changes)")
    canvas = page.locator("#map canvas")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    assert box is not None
    canvas.tap(position={"x": 66, "y": box["height"] - 38})
    assert page.locator("#map [data-words]").inner_text().endswith("; tap again to take its values")
    assert page.evaluate("Object.keys(explorer.state.changes)") == before
    canvas.tap(position={"x": 70, "y": box["height"] - 42})
    page.wait_for_function("explorer.state.changes['uncertainty.depth'] !== undefined")
    assert visit.problems == []
    visit.context.close()


# --- failures


@in_browser
def test_a_text_that_no_key_has_is_refused(visit: Visit) -> None:
    """It would be written over what lies behind the place for it."""
    key = "controller.switching.kind"
    refusal = visit.go(f"#paper&{key}={'a' * 160_000}")["refusal"]
    assert refusal == f"{key}: expected text of at most 1024 letters, got 160000: shorten it"
    assert visit.go("#paper-gravity")["refusal"] is None


@in_browser
def test_after_a_failure_of_the_core_the_page_goes_on(visit: Visit) -> None:
    """With a core whose memory was written over every later call would fail."""
    before = visit.end()
    for worker in visit.page.workers:
        worker.evaluate(
            """() => {
              const set = Uint8Array.prototype.set;
              Uint8Array.prototype.set = function (...all) {
                Uint8Array.prototype.set = set;
                new Uint8Array(this.buffer).fill(255);
                return this.set(...all);
              };
            }"""
        )
    assert visit.go("#paper&uncertainty.gravity=0.01")["refusal"] is not None
    assert visit.page.locator("#message").inner_text().startswith("The core failed: ")
    again = visit.go("#paper")
    assert again["refusal"] is None
    assert again["metrics"] == pytest.approx(before["metrics"], rel=0, abs=0, nan_ok=True)


@in_browser
def test_without_webassembly_the_page_and_its_map_say_so(browser: Browser, file: Path) -> None:
    page = browser.new_page()
    page.add_init_script("delete globalThis.WebAssembly")
    page.goto(file.as_uri())
    page.wait_for_selector("#verdict.bad")
    assert page.locator("#verdict").inner_text() == "Does not run in this browser"
    assert page.locator("#message").inner_text().startswith("The explorer cannot run here: ")
    page.click("#map-section summary")
    page.click("#map button")
    page.wait_for_function("document.querySelector('#map [data-words]').textContent.startsWith('Maps cannot run here')")
    assert page.locator("#map button").inner_text() == "Compute the map"
    page.close()


# --- people and devices


@in_browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_scrolls_in_one_direction_and_names_all_its_controls(browser: Browser, file: Path, scheme: Any) -> None:
    visit = Visit(
        browser, file, viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True, color_scheme=scheme
    )
    page = visit.page
    for section in ("#map-section", "#all-keys"):
        page.locator(f"{section} > summary").tap()
    page.locator("#search").fill("latency")
    assert page.locator("#span").is_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    rows = page.locator(".key:visible").all_inner_texts()
    assert 2 <= len(rows) < 10
    assert all("latency" in row.lower() for row in rows)
    unnamed = page.evaluate(
        "[...document.querySelectorAll('input, select, textarea, canvas, button')].filter(e => !(e.labels?.length || "
        "e.parentElement.closest('[role=img]') || "
        "e.getAttribute('aria-label') || e.textContent.trim())).map(e => e.outerHTML.slice(0, 100))"
    )
    assert unnamed == []
    page.select_option("#preset", "composite-30hz")
    page.wait_for_function("explorer.shown === '#composite-30hz'")
    assert visit.problems == []
    visit.context.close()


@in_browser
@pytest.mark.parametrize("width", [801, 820])
def test_a_tablet_has_all_columns_of_the_metrics(browser: Browser, file: Path, width: int) -> None:
    visit = Visit(browser, file, "#paper&uncertainty.gravity=0.05", viewport={"width": width, "height": 1180})
    assert visit.page.evaluate("(box => box.scrollWidth <= box.clientWidth)(document.querySelector('.numbers'))")
    assert visit.problems == []
    visit.context.close()


@in_browser
@pytest.mark.parametrize(("width", "height"), [(1280, 720), (390, 844)])
def test_the_outcome_stays_in_view_and_covers_no_control(browser: Browser, file: Path, width: int, height: int) -> None:
    visit = Visit(browser, file, "#fails-gravity", viewport={"width": width, "height": height})
    page = visit.page
    top = "name => document.querySelector(name).getBoundingClientRect().top"
    below = "document.querySelector('.words').getBoundingClientRect().bottom"
    page.evaluate("scrollTo(0, document.body.scrollHeight)")
    assert page.evaluate(top, "#verdict") >= 0
    assert page.evaluate(below) <= 56
    assert page.evaluate(top, "#controls" if width > 800 else ".views") >= page.evaluate(below)
    slider = page.locator('[data-id="uncertainty.depth"]')
    slider.evaluate("slider => slider.scrollIntoView()")
    slider.press("ArrowRight")
    page.wait_for_function("explorer.shown.includes('depth')")
    box = slider.bounding_box()
    assert box is not None
    on_top = "([x, y]) => document.elementFromPoint(x, y).dataset.id"
    assert page.evaluate(on_top, [box["x"] + 5, box["y"] + 8]) == "uncertainty.depth"
    assert visit.problems == []
    visit.context.close()


@in_browser
@pytest.mark.parametrize(("width", "height", "is_cut"), [(1280, 720, False), (390, 844, True), (844, 390, True)])
def test_the_outcome_and_that_of_a_pinned_run_have_three_lines_and_all_where_one_asks(
    browser: Browser, file: Path, width: int, height: int, is_cut: bool
) -> None:
    pinned = "paper%26uncertainty.gravity%3D0.3%26simulation.duration%3D20"
    address = f"#paper&uncertainty.gravity=0.2&simulation.duration=20&pinned={pinned}"
    visit = Visit(browser, file, address, viewport={"width": width, "height": height})
    page = visit.page
    page.wait_for_function("explorer.result.ghost")
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    tall = "document.querySelector('.words').getBoundingClientRect().height"
    against, more = page.locator("#against"), page.locator("#more")
    assert against.is_visible()
    assert page.evaluate(tall) <= 82
    assert more.is_visible() == is_cut
    if is_cut:
        whole = "part => part.scrollHeight <= part.clientHeight + 1"
        assert not against.evaluate(whole)
        for is_open in (True, False):
            more.press("Enter")
            assert more.get_attribute("aria-expanded") == str(is_open).lower()
            assert against.evaluate(whole) == is_open
    assert visit.problems == []
    visit.context.close()


@in_browser
@pytest.mark.parametrize("width", [390, 801, 844])
def test_captions_of_the_views_fit_into_their_cards(browser: Browser, file: Path, width: int) -> None:
    """Of an image with a border, before another run."""
    visit = Visit(
        browser, file, "#fails-lost-features&uncertainty.gravity=0.05", viewport={"width": width, "height": 900}
    )
    page = visit.page
    page.wait_for_function("explorer.result.ghost")
    assert page.locator("figure:has(#image) .ghost").is_visible()
    sizes = "all => all.map(e => [e.scrollWidth - e.clientWidth, e.clientHeight])"
    for over, tall in page.locator(".views figcaption").evaluate_all(sizes):
        assert over <= 0
        assert tall <= 66
    assert visit.problems == []
    visit.context.close()


@in_browser
def test_a_page_without_room_for_the_machine_draws_none(browser: Browser, file: Path) -> None:
    visit = Visit(browser, file, viewport={"width": 40, "height": 400})
    assert visit.page.locator("#scene").evaluate("view => view.clientWidth") == 0
    assert visit.problems == []
    visit.context.close()


@in_browser
def test_lines_of_a_point_have_its_colour_in_the_image(visit: Visit) -> None:
    """Of each of five points x and y, and its depth; of nine the last one's have the first colour and other dashes."""
    page = visit.page
    visit.go("#reachy-mini")
    _, _, paths = features(page, "result")
    dots = [f"#{bytes(place[:3]).hex()}" for place in image_colours(page, paths[-1].reshape(-1, 2).tolist())]
    assert len(set(dots)) == 5
    assert dots == [f"#{bytes(rgb(page, f'c{i}')).hex()}" for i in range(5)]
    looks = looks_of(page, 0)
    assert looks[::2] == dots
    assert all(dot in look and look != dot for dot, look in zip(dots, looks[1::2], strict=True))
    page.select_option("#figure-1", "depth")
    assert looks_of(page, 1) == dots
    points, goals = page.evaluate("[explorer.full()['target.points'], explorer.result.scene.goal]")
    more = {
        "target.points": points + [0.9 * x for x in points[:12]],
        "target.desired_features": goals + [0.9 * x for x in goals[:8]],
    }
    words = [f"{key}={','.join(map(str, value))}" for key, value in more.items()]
    end = visit.go("&".join(["#reachy-mini", *words, "target.weights=1", "uncertainty.depth=0"]))
    assert end["refusal"] is None
    looks = looks_of(page, 0)
    assert len(set(looks)) == len(looks) == 18
    assert all(dots[0] in look for look in (*looks[:2], *looks[16:]))


@in_browser
def test_charts_tell_the_values_where_the_pointer_is_and_else_those_of_now(visit: Visit) -> None:
    page = visit.page
    samples = {
        name: np.array(page.evaluate(f"Array.from(explorer.result.samples.{name})"))
        for name in ("time", "feature_error", "wrench")
    }
    errors, wrench = (samples[name].reshape(len(samples["time"]), -1) for name in ("feature_error", "wrench"))
    weight = np.array(page.evaluate("explorer.result.weight"))

    def check() -> float:
        told = [page.locator(f"#chart-{chart} + .legend").locator("i, b").all_inner_texts() for chart in (0, 1)]
        assert told[0][0] == told[1][0], "all charts tell of one time"
        time = float(told[0][0].removesuffix(" s"))
        row = int(np.argmin(abs(samples["time"] - time)))
        np.testing.assert_allclose([float(text) for text in told[0][1:]], errors[row], rtol=5e-3)
        np.testing.assert_allclose([float(text) for text in told[1][1:]], wrench[row, :3] - weight, rtol=5e-2)
        return time

    assert check() == samples["time"][-1]
    page.locator("#chart-0").scroll_into_view_if_needed()
    box = page.locator("#chart-0 .u-over").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.5 * box["height"])
    end = page.evaluate("explorer.result.shown")
    assert check() == pytest.approx(0.3 * end, abs=1.5 * end / box["width"])
    page.mouse.move(1, 1)
    page.locator("#time").fill("0.02")
    assert check() == pytest.approx(0.1, abs=samples["time"][1])
    assert page.locator("#now").inner_text() == page.locator("#chart-0 + .legend i").inner_text()
    page.select_option("#figure-1", label="Displacement from the start")
    page.locator("#time").fill("0")
    assert page.locator("#chart-1 + .legend b").all_inner_texts() == ["0"] * 3


def looks_of(page: Page, chart: int) -> list[str]:
    """Return the colours of a chart's lines, or the pictures of those that are dashed, as its legend shows them."""
    lines = page.locator(f"#chart-{chart} + .legend span")
    shown = lines.evaluate_all("all => all.map(e => getComputedStyle(e, '::before').background)")
    found: list[str] = lines.evaluate_all("all => all.map(e => e.style.getPropertyValue('--colour'))")
    assert len(set(shown)) == len(set(found)), "what is set is seen"
    return found


@in_browser
def test_what_a_metric_means_is_found_without_a_pointer(visit: Visit) -> None:
    page = visit.page
    meaning = METRICS["settling_time"][1]
    name = page.locator("#metrics summary", has_text="settling time")
    assert name.count() == 1
    assert not page.get_by_text(meaning).is_visible()
    name.focus()
    page.keyboard.press("Enter")
    assert page.get_by_text(meaning).is_visible()


@in_browser
def test_on_paper_there_are_pictures_and_numbers_and_no_controls(visit: Visit) -> None:
    page = visit.page
    visit.go("#paper&uncertainty.gravity=0.01")
    assert page.locator("#origin").is_hidden()
    page.emulate_media(media="print")
    address = page.evaluate("location.href.split('#')[0]") + "#paper&uncertainty.gravity=0.01"
    assert page.locator("#origin").inner_text() == (
        f"Scenario paper; law hybrid; changed: uncertainty.gravity = 0.01; hexservo {hs.__version__}; {address}"
    )
    for name in ("#image", "#scene", "#chart-0", "#metrics", "#verdict"):
        assert page.locator(name).is_visible(), name
    for name in ("#controls", ".buttons", ".timeline", "#map-section"):
        assert page.locator(name).is_hidden(), name
    page.emulate_media(media="screen")
    assert page.locator("#controls").is_visible()


@in_browser
def test_what_is_printed_has_light_colours_and_charts_of_the_width_of_the_paper(visit: Visit) -> None:
    page = visit.page
    lines: dict[Literal["light", "dark"], str] = {"light": "#1f6feb", "dark": "#58a6ff"}
    for scheme, line in lines.items():
        page.emulate_media(color_scheme=scheme)
        page.wait_for_function("line => explorer.charts()[0].series[1].stroke() === line", arg=line)
        page.evaluate(
            """() => {
              const widths = box => [box, box.querySelector('canvas')].map(found => found.clientWidth);
              globalThis.looks = () => ({
                widths: [...document.querySelectorAll('.chart')].map(widths),
                paper: getComputedStyle(document.documentElement).backgroundColor,
                line: explorer.charts()[0].series[1].stroke(),
              });
              matchMedia('print').addEventListener('change', event => event.matches && (globalThis.printed = looks()));
            }"""
        )
        before = page.evaluate("looks()")
        page.pdf(format="Letter")
        printed = page.evaluate("printed")
        assert (printed["paper"], printed["line"]) == ("rgb(255, 255, 255)", "#1f6feb"), scheme
        assert len(printed["widths"]) == 3
        for box, canvas in printed["widths"]:
            assert (box > 650, canvas) == (True, pytest.approx(box, abs=1)), scheme  # Letter has 816 px of the screen's
        page.wait_for_function("before => JSON.stringify(looks()) === JSON.stringify(before)", arg=before)


@in_browser
def test_the_picture_follows_a_slider_within_a_frame_or_some(visit: Visit) -> None:
    """Measured from the change to the drawn picture, and printed; a busy machine takes longer, so 60 frames pass."""
    page = visit.page
    session = page.context.new_cdp_session(page)
    for rate in (1, 4):
        session.send("Emulation.setCPUThrottlingRate", {"rate": rate})
        times = page.evaluate(
            """async () => {
              const slider = document.querySelector('[data-id="uncertainty.depth"]');
              for (let i = 0; i < 80; ++i) {
                if (i === 20) explorer.latencies.length = 0;
                const count = explorer.latencies.length;
                slider.value = 500 + 3 * i;
                slider.dispatchEvent(new Event('input', {bubbles: true}));
                while (explorer.latencies.length === count) await new Promise(done => setTimeout(done, 1));
                await new Promise(requestAnimationFrame);
              }
              return explorer.latencies;
            }"""
        )
        quantiles = np.quantile(times, [0.0, 0.5, 0.95, 1.0])
        print(f"slow-down {rate}: least, median, 95 %, most of {len(times)}: {np.round(quantiles, 1)} ms")
        assert quantiles[1] <= 60 * 16.7 * rate


# --- what the page is built of


def test_the_page_has_every_law_and_the_gains_of_no_other() -> None:
    """A key of a law that the page does not know would be set for every law, and each run refused."""
    file = ROOT / "explorer" / "data.py"
    known = runpy.run_path(str(file))["data"]()
    assert known["laws"] == list(_core.LAW_TRAITS)
    for law in known["laws"]:
        others = tuple(f"controller.{other}." for other in known["laws"] if other != law)
        keys = {key["key"] for key in known["keys"] if not key["key"].startswith(others)}
        assert keys == {key.name for key in _core.scenario_keys(law)}, law


def test_a_scenario_of_a_file_has_the_gains_of_every_law() -> None:
    """Five points: the defaults of other laws are for four, and the core refuses them."""
    scenario = hs.load_scenario("reachy-mini").updated({"name": "mine"})
    values = preset_values(scenario)
    assert core_values(scenario).items() <= values.items()
    for law in set(_core.LAW_TRAITS) - {scenario.controller.law, "tracking"}:  # a law that this scenario cannot have
        expected = core_values(scenario.updated({"controller.law": law}))
        gains = {key: value for key, value in expected.items() if key.startswith(f"controller.{law}.")}
        assert gains.items() <= values.items(), law
    assert len(values["controller.kelly.kp"]) == 10
    assert not any(key.startswith("controller.tracking.") for key in values)


@pytest.fixture
def builder(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """`explorer/build.py`."""
    file = ROOT / "explorer" / "build.py"
    monkeypatch.syspath_prepend(str(file.parent))
    spec = importlib.util.spec_from_file_location("explorer_build", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_libraries_of_the_page_are_installed_until_that_succeeds(
    builder: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An npm that fails the first time, in the middle."""
    npm = tmp_path / "bin" / "npm"
    npm.parent.mkdir()
    npm.write_text("#!/bin/sh\necho >>calls\nmkdir -p node_modules\ntest $(wc -l <calls) -gt 1\n", encoding="utf-8")
    npm.chmod(0o755)
    monkeypatch.setenv("PATH", f"{npm.parent}:/usr/bin:/bin")
    monkeypatch.setattr(builder, "MODULES", tmp_path / "npm")
    monkeypatch.setattr(builder, "HERE", tmp_path)
    for name in ("package.json", "package-lock.json"):
        (tmp_path / name).write_text("1", encoding="utf-8")
    calls = tmp_path / "npm" / "calls"

    with pytest.raises(subprocess.CalledProcessError):
        builder.tools()
    for lock, count in (("1", 2), ("1", 2), ("2", 3), ("2", 3)):
        (tmp_path / "package-lock.json").write_text(lock, encoding="utf-8")
        assert builder.tools() == tmp_path / "npm" / "node_modules"
        assert len(calls.read_text().splitlines()) == count
        assert (tmp_path / "npm" / "package-lock.json").read_text(encoding="utf-8") == lock


def test_the_page_has_the_notices_of_what_is_in_it(builder: ModuleType) -> None:
    shown = html.unescape(builder.licences())
    assert set((ROOT / "licenses").iterdir()) - {ROOT / name for name in builder.LICENCES} == {
        ROOT / "licenses" / name for name in ("MPL-2.0.txt", "pybind11.txt")  # Eigen's notice names it; not in the page
    }  # fmt: skip
    for name in builder.LICENCES:
        assert (ROOT / name).read_text(encoding="utf-8").strip() in shown, name
    for library, holder in (("uplot", "2022 Leon Sorokin"), ("three", "three.js authors")):
        assert re.search(rf"Copyright .*{holder}\n\nPermission is hereby granted", shown), library
    page = (ROOT / "explorer" / "src" / "page.html").read_text(encoding="utf-8")
    parts = set(re.findall(r'^        "(\w+)": ', (ROOT / "explorer" / "build.py").read_text(encoding="utf-8"), re.M))
    assert set(re.findall(r"{{(\w+)}}", page)) == parts


# --- the command


def test_the_page_of_another_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    version, digest = built_for().split()
    assert version == hs.__version__

    def page(text: str) -> str:
        return f'<!doctype html>\n<meta name="hexservo" content="{text}">'

    assert checked_page(page(built_for())) == page(built_for())
    for other in (page(f"0.0.1 {digest}"), page(f"{version} {'0' * 16}"), "<!doctype html>"):
        with pytest.raises(ExplorerError, match="`make explorer`"):
            checked_page(other)

    package = tmp_path / "package"
    package.mkdir()
    for folder in ("campaigns", "scenarios"):  # whose names the help of the commands has
        (package / folder).symlink_to(str(resources.files("hexservo") / folder))
    (package / "explorer.html").write_text(page("0.0.1 0"), encoding="utf-8")
    monkeypatch.setattr(resources, "files", lambda _: package)
    result = CliRunner().invoke(app, ["explore", "paper", "--out", str(tmp_path / "page.html"), "--no-open"])
    assert result.exit_code == 2
    assert f"expected the page of hexservo {version} {digest}, got that of 0.0.1 0" in " ".join(result.stderr.split())
    assert list(tmp_path.iterdir()) == [package]


def test_a_page_is_for_keys_metrics_and_scenarios(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {built_for()}
    entries = schema()
    for name, value in (
        ("schema", lambda: entries[1:]),
        ("METRICS", METRICS | {"final_error": ("mm", "")}),
        ("scenario_names", lambda: hs.scenario_names()[1:]),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(explorer, name, value)
            found.add(built_for())
    assert len(found) == 4
    monkeypatch.setattr(explorer, "schema", lambda: [entry | {"default": None} for entry in entries])
    assert built_for() in found


@built
def test_the_command_writes_a_page_and_never_over_another_file(tmp_path: Path) -> None:
    runner = CliRunner()
    out = tmp_path / "page.html"
    assert runner.invoke(app, ["explore", "paper-gravity", "--out", str(out), "--no-open"]).exit_code == 0
    assert '"start": "paper-gravity"' in out.read_text(encoding="utf-8")
    assert len(out.read_bytes()) <= 1_000_000
    assert runner.invoke(app, ["explore", "--out", str(out), "--no-open"]).exit_code == 2
    assert runner.invoke(app, ["explore", "--out", str(out), "--no-open", "--force"]).exit_code == 0
    out.write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError):
        write_file(explorer_page("paper"), out, TITLE, "hexservo explore", force=True)
    assert out.read_text(encoding="utf-8") == "mine"


@in_browser
def test_a_scenario_of_a_file_is_one_more_preset(browser: Browser, tmp_path: Path) -> None:
    scenario = hs.load_scenario("task-tilt").updated({"description": "</script>", "uncertainty.gravity": 0.02})
    (tmp_path / "page.html").write_text(explorer_page(scenario), encoding="utf-8")
    visit = Visit(browser, tmp_path / "page.html")
    assert visit.page.evaluate("explorer.full()") == core_values(scenario)
    again = hs.Scenario.from_yaml(visit.page.evaluate("explorer.yaml()"))
    assert (again.name, again.uncertainty) == ("task-tilt-file", scenario.uncertainty)
    first = visit.page.locator("#preset optgroup").first
    assert first.get_attribute("label") == "From a file"
    assert first.locator("option").all_text_contents() == ["task-tilt-file"]
    assert visit.problems == []
    visit.context.close()


@pytest.mark.skipif(BUILT, reason="the explorer was built")
def test_without_the_page_the_command_explains_how_to_get_it(tmp_path: Path) -> None:
    with pytest.raises(ExplorerError, match="make explorer"):
        explorer_page()
    result = CliRunner().invoke(app, ["explore", "--out", str(tmp_path / "page.html"), "--no-open"])
    assert result.exit_code == 2
    assert not list(tmp_path.iterdir())
