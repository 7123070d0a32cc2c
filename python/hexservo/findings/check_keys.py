"""Keys of a scenario that are written and have no effect: for ``hexservo check`` and campaigns."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexservo.findings.gate_width import predicts
from hexservo.scenario.blocks import Robot, preset_values
from hexservo.scenario.fitted import auto_of, chosen_keys, fitted_keys, gains_written, idle_gains
from hexservo.scenario.keys import default_of, keys_below, value_at
from hexservo.scenario.laws import ALL_LAWS, LAWS, POSE_LAW, SMOOTH_KINDS, Controller, laws_with
from hexservo.scenario.motion import Road, moves
from hexservo.scenario.plain import plain
from hexservo.scenario.presets import ROBOT_PRESETS
from hexservo.scenario.scenario import Scenario

_Need = tuple[str, tuple[Any, ...]]  # a key, and the values of it with which others act


@dataclass(frozen=True)
class _Condition:
    """Keys that act only under a condition."""

    keys: tuple[str, ...]  # blocks or keys
    acts: Callable[[Scenario], bool]
    when: str  # the condition, as it follows "they act"
    can_be_met: bool = True  # by other settings of the scenario
    last: int = 0  # so many numbers at the end of arrays; 0: all
    needs: tuple[_Need, ...] = ()  # all of the condition, where it is one on values of other keys

    def has(self, key: str) -> bool:
        """Return whether all of a dotted key is subject to the condition."""
        return not self.last and any(f"{key}.".startswith(f"{name}.") for name in self.keys)

    def differing(self, scenario: Scenario) -> Iterator[str]:
        """Yield the keys that differ from their defaults in what is subject to the condition, and not part of it."""
        own = {setting for setting, _ in self.needs}
        for key in (key for name in self.keys for key in keys_below(name) if key not in own):
            value, default = value_at(scenario, key), default_of(key)
            if self.last and not isinstance(value, tuple):  # one number, which is there for the others too
                continue
            if (value[-self.last :] != default[-self.last :]) if self.last else (value != default):
                yield key


_SWITCHES: _Need = ("controller.law", laws_with("switching"))
_HAS_SLOPE = (_SWITCHES, ("controller.switching.kind", SMOOTH_KINDS))


def _has(scenario: Scenario, needs: Iterable[_Need]) -> bool:
    return all(value_at(scenario, key) in values for key, values in needs)


def has_slope(scenario: Scenario) -> bool:
    """Return whether the law has a switching term with a slope at rest."""
    return _has(scenario, _HAS_SLOPE)


def _uses_exposures(scenario: Scenario) -> bool:
    return predicts(scenario) or scenario.camera.timeout is not None or scenario.controller.law not in LAWS


def _where(keys: Iterable[str], needs: tuple[_Need, ...], when: str, law: str | None = None) -> _Condition:
    """Return a condition on values of other keys; for gains of a law met where another law acts."""

    def acts(scenario: Scenario) -> bool:
        return scenario.controller.law != (law or scenario.controller.law) or _has(scenario, needs)

    return _Condition(tuple(keys), acts, when, needs=needs)


def _with(keys: Iterable[str], setting: str, value: str) -> _Condition:
    return _where(keys, ((setting, (value,)),), f"only with {setting}: {value}")


def _above_zero(key: str, setting: str) -> _Condition:
    return _Condition((key,), lambda scenario: value_at(scenario, setting) > 0, f"only with {setting} above 0")


def _in_block(law: str, keys: Iterable[str], acts: Callable[[Any], bool], when: str) -> _Condition:
    """Return a condition on gains of a law, which looks at its block; met where another law acts."""
    return _Condition(
        tuple(f"controller.{law}.{key}" for key in keys),
        lambda scenario: scenario.controller.law != law or acts(scenario.controller.gains),
        f"only with {when.format(block=f'controller.{law}')}",
    )


def _of_fuzzy(law: str) -> Iterator[_Condition]:
    names = ("fuzzy", "drive") if hasattr(getattr(Controller(), law), "drive") else ("fuzzy",)
    enabled = f"controller.{law}.fuzzy.enabled"
    keys = (f"controller.{law}.{name}" for name in names)
    yield _where(keys, ((enabled, (True,)),), f"only with {enabled}: true", law)
    yield _in_block(
        law,
        ("fuzzy.table",),
        lambda gains: not gains.fuzzy.enabled or bool(np.any(gains.fuzzy.initial_scale)),
        "a {block}.fuzzy.initial_scale other than 0",
    )


def _of_auto(law: str) -> tuple[_Condition, ...]:
    block = f"controller.{law}.auto"

    def fits(scenario: Scenario) -> bool:
        if scenario.controller.law != law or auto_of(scenario).bandwidth is None:
            return True
        follow = set(fitted_keys(law)).difference(chosen_keys(scenario), idle_gains(scenario))
        return not all(_idles(f"controller.{law}.{key}", scenario) for key in follow)

    def has_bandwidth(scenario: Scenario) -> bool:
        return scenario.controller.law != law or auto_of(scenario).bandwidth is not None

    bandwidth = _Condition((block,), fits, f"only where one of {', '.join(fitted_keys(law))} acts and is not given")
    if law not in LAWS:  # whose fitted gains have no damping
        when = f"only in the blocks of other laws, since the motion of {law} is critically damped"
        return bandwidth, _Condition(
            (f"{block}.damping",), lambda scenario: scenario.controller.law != law, when, False
        )
    return bandwidth, _Condition((f"{block}.damping",), has_bandwidth, f"only with {block}.bandwidth")


def _of_adaptive_gain(law: str) -> Iterator[_Condition]:
    yield _in_block(law, ("gain_far", "gain_slope"), lambda gains: gains.adaptive, "{block}.adaptive: true")
    yield _in_block(
        law, ("gain_far",), lambda gains: not gains.adaptive or gains.gain_slope > 0, "{block}.gain_slope above 0"
    )
    yield _in_block(
        law,
        ("gain_slope",),
        lambda gains: not gains.adaptive or gains.gain_far < gains.gain,
        "{block}.gain_far below {block}.gain",
    )


def _of_motion(block: str, keys: str, kind: str) -> _Condition:
    return _with((f"{block}.{key}" for key in keys.split()), f"{block}.kind", kind)


_CONDITIONS = (
    *(_with((f"controller.{law}",), "controller.law", law) for law in ALL_LAWS),
    *(condition for law in laws_with("memory") for condition in _of_fuzzy(law)),
    *(condition for law in ALL_LAWS for condition in _of_auto(law)),
    *(each for law in ALL_LAWS if hasattr(getattr(Controller(), law), "adaptive") for each in _of_adaptive_gain(law)),
    _in_block(POSE_LAW, ("band",), lambda gains: gains.integral > 0, "{block}.integral above 0"),
    _Condition(
        (f"controller.{POSE_LAW}.acceleration", f"controller.{POSE_LAW}.speed"),
        lambda scenario: scenario.controller.law != POSE_LAW or scenario.controller.gains.follow != "direction",
        f"only with controller.{POSE_LAW}.follow: pose",
        last=3,  # a direction is followed by the target's place alone
    ),
    _where(
        ("controller.jacobian",),
        (("controller.law", laws_with("depth")),),
        f"only with the laws that use the image Jacobian: {', '.join(laws_with('depth'))}",
    ),
    _where(("controller.switching.kind",), (_SWITCHES,), f"only with the laws {' and '.join(laws_with('switching'))}"),
    _where(("controller.switching.width",), _HAS_SLOPE, "only where the switching term is tanh or saturation"),
    _above_zero("robot.payload.known", "robot.payload.mass"),
    _above_zero("camera.outlier_size", "camera.outlier_probability"),
    _above_zero("camera.outlier_probability", "camera.outlier_size"),
    _Condition(
        ("uncertainty.latency",),
        _uses_exposures,
        "only where an exposure counts: with camera.prediction: encoder, camera.on_lost: predict, camera.timeout, or "
        f"the law {' or '.join(law for law in ALL_LAWS if law not in LAWS)}",
    ),
    _Condition(
        ("camera.on_lost",),
        lambda scenario: (
            scenario.camera.image_size is not None or (scenario.camera.gate is not None and predicts(scenario))
        ),
        "only with camera.image_size or an acting camera.gate",
    ),
    _Condition(("camera.gate",), predicts, "only with camera.prediction: encoder or camera.on_lost: predict"),
    _Condition(
        ("actuators.position.bandwidth", "actuators.position.damping"),
        lambda scenario: scenario.actuators.kind != "position_torque" or scenario.controller.law == POSE_LAW,
        f"only with actuators.kind: position, or with the law {POSE_LAW}, which leads by them: the motors' response is "
        "that of actuators.motor",
    ),
    _with((f"sensors.{key}" for key in ("rate", "resolution", "noise", "period")), "sensors.pose", "encoders"),
    _of_motion("base_motion", "amplitude frequency phase", "sinusoid"),
    _of_motion("base_motion", "level low_frequency high_frequency", "noise"),
    _of_motion("base_motion", "samples attitudes sample_period", "recorded"),
    _of_motion("base_motion", " ".join(f"road.{key}" for key in Road.model_fields), "road"),
    _of_motion("base_motion.rotation", "amplitude frequency phase", "sinusoid"),
    _of_motion("base_motion.rotation", "level low_frequency high_frequency", "noise"),
    _of_motion("target.motion", "velocity", "velocity"),
    _of_motion("target.motion", "amplitude frequency phase", "sinusoid"),
    _of_motion("target.motion", "samples sample_period", "recorded"),
    _Condition(
        ("target.frame",), lambda scenario: moves(scenario.base_motion), "only where the base moves (base_motion.kind)"
    ),
)


_OF_PRESETS = (  # in which machines differ
    *(f"{side}_{what}" for side in ("platform", "base") for what in ("radius", "angles", "joints")),
    *("home_position", "mass", "inertia", "stroke", "force_limit"),
)


def _of_preset(robot: Robot) -> Iterator[str]:
    """Find a preset that gives a machine next to nothing, as where only its name was changed in a resolved file."""
    if robot.preset is None:
        return
    given = plain(robot)
    equal = {
        name: [given[key] == value for key in _OF_PRESETS if (value := preset_values(name)[key]) is not None]
        for name in ROBOT_PRESETS
    }
    other = next((name for name in ROBOT_PRESETS if name != robot.preset and all(equal[name])), None)
    if other is not None or sum(equal[robot.preset]) <= 1:
        whose = "" if other is None else f', those of "{other}"'
        yield (
            f'robot.preset: "{robot.preset}" has no effect here, since other values of the machine are given{whose}; '
            "drop those keys, and the preset gives them"
        )


def keys_without_effect(scenario: Scenario) -> list[str]:
    """Return a sentence for each group of keys that differ from their defaults and have no effect.

    So does a preset of the robot whose keys have, nearly all, other values. Gains that `auto` fits are not written, and
    not among them.

    They are legal: a scenario keeps them when its law is replaced in a comparison or its outliers are switched off.
    """
    sentences = list(_of_preset(scenario.robot))
    law = scenario.controller.law
    fitted = {f"controller.{law}.{key}" for key in set(fitted_keys(law)).difference(chosen_keys(scenario))}
    for condition in _CONDITIONS:
        if condition.acts(scenario):
            continue
        keys = [key for key in condition.differing(scenario) if key not in fitted]
        if keys:
            has, acts = ("has", "it acts") if len(keys) == 1 and not condition.last else ("have", "they act")
            which = f"the last {condition.last} numbers " if condition.last else ""
            sentences.append(f"{', '.join(keys)}: {which}{has} no effect here; {acts} {condition.when}")
    return sentences


def settings_needed() -> dict[str, dict[str, tuple[Any, ...]]]:
    """Return what keys need that act only with certain values of others: by key, those values by the other key.

    Conditions of another kind, such as a number above zero, are left out.
    """
    found: dict[str, dict[str, tuple[Any, ...]]] = {}
    for condition in _CONDITIONS:
        needs = dict(condition.needs)
        for key in (key for name in condition.keys for key in keys_below(name) if needs and key not in needs):
            found[key] = found.get(key, {}) | needs
    return found


def _idles(key: str, scenario: Scenario) -> bool:
    return any(condition.has(key) and not condition.acts(scenario) for condition in _CONDITIONS)


def needed_by(key: str, scenarios: Iterable[Scenario], given: Container[str] = ()) -> str:
    """Return what a key needs to act, and what to do, as it follows "it acts"; "" where it acts in one of scenarios.

    A bandwidth of `auto` is looked at as if the scenarios had one: in a campaign they do. Gains of the keys `given`
    follow neither it nor a damping.
    """
    tried = next((values for end, values in _TRIED.items() if key.endswith(end)), ())
    pairs = [[scenario.updated({key: each}) for each in tried] or [scenario] for scenario in scenarios]
    for condition in _CONDITIONS:
        if condition.has(key) and not any(condition.acts(scenario) for scenario, *_ in pairs):
            return f"{condition.when}; {_MEET_OR_DROP if condition.can_be_met else 'drop the key'}"
    if tried and all(_following(one, given) == _following(other, given) for one, other in pairs):
        return f"only where a gain that follows from it acts and is not given; {_MEET_OR_DROP}"
    return ""


def _following(scenario: Scenario, given: Container[str]) -> dict[str, Any]:
    """Return the gains that `auto` fits and that act, without those of the keys `given`."""
    written = gains_written(scenario).items()
    return {key: value for key, value in written if key not in given and not _idles(key, scenario)}


_MEET_OR_DROP = "set that in the scenario, or drop the key"
_TRIED = {".auto.bandwidth": (1.0, 2.0), ".auto.damping": (0.5, 1.0)}  # [Hz], [1]; a gain that depends on it differs
