"""Parameters of loops and plants as units: each changes an output, by itself or with other parameters changed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo import _core
from hexservo.bridges.fmi import _keys
from hexservo.run.controller import tick_keys
from hexservo.scenario.parameters import core_parameters

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")

from test_bridge_fmu import Made, Unit  # noqa: E402

STEPS = (1, 2, 5, 10, 30, 40, 40, 40, 60, 60)  # servo periods of communication steps
WRENCH = (0.02, 0.01, -0.5, 1e-4, 2e-4, 0.0)  # of a plant: the target grows in the image
TIMES = (-4, -1, 1, 3, 10)  # servo periods by which a time is changed
CHANGES: tuple[Callable[[float], float], ...] = (
    lambda x: 1.1 * x, lambda x: x + 1e-3, lambda x: 0.5 * x, lambda x: 0.1 * x, lambda x: 0.0, lambda x: x + 0.3,
    lambda x: x - 0.5, lambda x: -x, lambda x: 3.0 * x, lambda x: x + 20.0, lambda x: x + 300.0,
)  # fmt: skip

# Keys, and parameters with which they act.
WITH: tuple[tuple[str, dict[str, Any]], ...] = (
    ("", {}),
    ("camera.outlier", {"camera.outlier_probability": 0.5, "camera.outlier_size": 10.0}),
    ("camera.convention", {"camera.prediction": "none"}),
    ("camera. target.weights uncertainty.", {"camera.on_lost": "stop"}),
    ("camera.on_lost", {"camera.image_size[1]": 144.0, "camera.image_size[2]": 144.0}),
    ("target.weights", {"camera.image_size[1]": 144.0, "camera.image_size[2]": 144.0, "camera.on_lost": "stop"}),
    ("camera. uncertainty.", {"camera.prediction": "encoder"}),
    ("sensors.", {"sensors.pose": "encoders"}),
    ("robot.payload.", {"robot.payload.mass": 0.02, "robot.payload.position[2]": 0.01}),
    ("robot.force_limit", {"actuators.saturation": True}),
    ("actuators.saturation", {"robot.force_limit": 1e-3}),
    ("robot.on_limit", {"robot.stroke": 1e-4}),
    ("robot.stroke robot.limits_every", {"robot.stroke": 2e-3, "robot.on_limit": "stop"}),
    ("base_motion. target.frame", {"base_motion.kind": "sinusoid", "base_motion.amplitude[1]": 0.1}),
    ("base_motion.", {"base_motion.kind": "noise", "base_motion.level[1]": 1e-3}),
    ("base_motion.road.", {"base_motion.kind": "road"}),
    ("base_motion.", {"base_motion.rotation.kind": "sinusoid", "base_motion.rotation.amplitude[1]": 0.1}),
    ("base_motion.", {"base_motion.rotation.kind": "noise", "base_motion.rotation.level[1]": 1e-3}),
    ("target.motion.", {"target.motion.velocity[1]": 0.01}),
    ("target.motion.", {"target.motion.kind": "velocity"}),
    ("target.motion.", {"target.motion.kind": "sinusoid", "target.motion.amplitude[1]": 0.01}),
    ("controller.switching.", {"controller.switching.kind": "tanh"}),
    ("controller.composite.fuzzy.table", {"controller.composite.fuzzy.initial_scale[1]": 0.1}),
    ("actuators. controller.virtual_platform.", {"actuators.kind": "position"}),
    ("actuators.", {"actuators.kind": "position_torque"}),
)


def is_diagonal(name: str) -> bool:
    """Whether a variable is on the diagonal of a matrix."""
    row, _, column = name.partition("[")[2].rstrip("]").partition(",")
    return row == column


class Sweep:
    """A unit that is run with one parameter after the other changed."""

    def __init__(self, made: Made, scenario: hs.Scenario) -> None:
        self.scenario = scenario
        self.unit: Unit = made.instance()
        self.of_key: dict[str, list[Any]] = {}
        for variable in made.description.modelVariables:
            if variable.causality == "parameter":
                self.of_key.setdefault(variable.name.partition("[")[0], []).append(variable)
        outputs = [v for v in made.description.modelVariables if v.causality == "output" and v.type == "Real"]
        self.takes_wrench = any(v.causality == "input" for v in made.description.modelVariables)
        self.outputs = [v.valueReference for v in outputs]
        self.keys = {key.name: key for key in _core.scenario_keys(scenario.controller.law)}

    def outputs_with(self, parameters: dict[str, Any]) -> Any:
        """Outputs after each communication step; None where the unit refuses the parameters."""
        self.unit.fmu.reset()
        try:
            self.unit.start(**parameters)
        except fmpy.fmi1.FMICallException:
            return None
        if self.takes_wrench:
            self.unit.put("wrench", WRENCH)
        rows, goes_on = [], True
        for count in STEPS:
            goes_on = goes_on and self.unit.step(count * self.scenario.simulation.step)
            rows.append([*self.unit.fmu.getReal(self.outputs), float(goes_on)])
        return np.array(rows)

    def changes(self, key: str) -> Iterator[dict[str, Any]]:
        """Other values of a key: of its first entry, of all, and of the diagonal of a matrix."""
        entries = self.of_key[key]
        first = entries[0]
        if self.keys[key].type == "choice":
            yield from ({key: each} for each in self.keys[key].choices if each != first.start)
        elif first.type == "String":
            yield {key: str(int(first.start) + 1)}
        elif first.type == "Boolean":
            yield {key: first.start not in ("true", True)}
        elif first.type == "Integer":
            yield from ({key: int(first.start) + by} for by in (1, -1, 10))
        else:
            starts = {v.name: float(v.start) for v in entries}
            period = self.scenario.simulation.step
            parts = {first.name}, set(starts), {name for name in starts if is_diagonal(name)}
            for by in CHANGES:
                yield from ({name: by(starts[name]) for name in part} for part in parts)
            yield from ({name: 0.0} for name in starts if key == "target.weights")
            yield from ({name: start + n * period for name, start in starts.items()} for n in TIMES)

    def without_effect(self) -> set[str]:
        """Keys that change nothing, or of which every change is refused."""
        left = set(self.of_key)
        for prefixes, change in WITH:
            candidates = {key for key in left if key.startswith(tuple(prefixes.split()) or "")}
            if not candidates or not all(name.partition("[")[0] in self.of_key for name in change):
                continue
            expected = self.outputs_with(change)
            if expected is None:
                continue
            for key in candidates:
                answers = (self.outputs_with({**change, **other}) for other in self.changes(key))
                if any(each is not None and not np.array_equal(each, expected, equal_nan=True) for each in answers):
                    left.remove(key)
        return left


GATE = {"camera.gate": 1.0, "camera.timeout": 0.1}  # as far as the image noise of two frames, 0.28 px, leaves it
RIM = {
    "camera.distortion.brown_conrady": [-5.8, 0.0, 0.0, 0.0, 0.0]
}  # 93 px off the centre; the target begins at 92 px
OF_IMAGES = {
    "camera.prediction", "camera.on_lost", "target.weights", "uncertainty.focal_length", "uncertainty.principal_point",
    "uncertainty.mount.position", "uncertainty.mount.rotation",
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "what", "changes"),
    [
        ("composite-30hz", "plant", {}),
        ("real-machine", "plant", {}),
        ("composite-30hz", "plant", GATE),
        ("composite-30hz", "plant", RIM),
        ("composite-30hz", "loop", {"simulation.duration": 0.288}),
    ],
)
def test_every_parameter_of_a_unit_changes_an_output(
    tmp_path: Path, name: str, what: str, changes: dict[str, Any]
) -> None:
    scenario = hs.load_scenario(name).updated(changes)
    sweep = Sweep(Made(tmp_path, scenario, 2, what), scenario)
    assert {"robot.mass", "camera.noise", "uncertainty.gravity", "seed"} <= set(sweep.of_key)
    assert sweep.without_effect() == set()


def keys(scenario: hs.Scenario, what: Any) -> set[str]:
    return {key.name for key in _keys(core_parameters(scenario), what)}


@pytest.mark.parametrize(
    ("name", "changes", "acting"),
    [
        ("composite-30hz", {}, set()),
        ("real-machine", {}, {"camera.on_lost", "target.weights"}),  # with camera.image_size
        ("composite-30hz", GATE, OF_IMAGES),
        ("composite-30hz", RIM, OF_IMAGES - {"camera.prediction"} - {f"uncertainty.mount.{of}" for of in
                                                                     ("position", "rotation")}),
    ],
)  # fmt: skip
def test_images_act_on_a_plant_where_points_may_be_lost(name: str, changes: dict[str, Any], acting: set[str]) -> None:
    """A plant brakes without a usable image, and does nothing else with what it sees."""
    assert keys(hs.load_scenario(name).updated(changes), "plant") & OF_IMAGES == acting


def test_a_plant_has_no_key_that_its_scenario_leaves_one_value() -> None:
    scenario = hs.load_scenario("composite-30hz")
    assert not keys(scenario, "plant") & {"camera.convention", "camera.latency_known"}
    assert "camera.convention" in keys(scenario.updated({"camera.prediction": "none"}), "plant")
    assert "camera.latency_known" not in keys(scenario, "loop")


def test_a_loop_has_no_keys_of_what_its_law_does_not_do() -> None:
    switching = {"controller.switching.kind", "controller.switching.width"}
    tracking, composite = (hs.load_scenario(name) for name in ("reachy-mini-motors", "composite-30hz"))
    of_others = {"controller.jacobian", "controller.virtual_platform.damping", "controller.safe.hold",
                 "actuators.saturation", "camera.prediction", *switching}  # fmt: skip
    assert not keys(tracking, "loop") & of_others
    assert {"camera.latency_known", "actuators.kind"} <= keys(tracking, "loop")
    assert of_others <= keys(composite, "loop")
    assert not keys(composite.updated({"controller.law": "kelly"}), "loop") & switching


def test_the_jacobians_sign_has_no_effect_with_a_law_without_one() -> None:
    """Bit for bit in a run, and no key of the tick or of a loop; with a law that has one it acts."""
    for law, acts in (("pbvs", False), ("kelly", True)):
        scenario = hs.load_scenario("composite-30hz").updated({"controller.law": law, "simulation.duration": 0.1})
        signs = ("printed", "consistent")
        runs = [hs.simulate(scenario.updated({"controller.jacobian": sign})) for sign in signs]
        assert np.array_equal(runs[0].wrench, runs[1].wrench) != acts
        of_tick = {key.name for key in tick_keys(core_parameters(scenario))}
        assert ("controller.jacobian" in of_tick) == ("controller.jacobian" in keys(scenario, "loop")) == acts
