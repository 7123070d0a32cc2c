"""Questions of ``hexservo new`` about the loop: how late an image is, what the drives take, how fast it shall be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import hexservo as hs
from hexservo import _core
from hexservo.cli.dialogue import Dialogue
from hexservo.scenario.blocks import Metrics
from hexservo.scenario.laws import GENERAL_LAW, POSE_LAW

_TICKS = 150  # servo periods in one of the bandwidth, at least
_PERIODS = 10  # of the bandwidth in a run, at least
_ROOM = 2  # times the longest of the metrics' times, the frame period and the latency that a run lasts, at least
_ROUNDING = 1e-9  # relative, by which a number may be above the whole number that it stands for
_ANSWERED = 0.01  # servo periods by which a time is longer than whole ones since it was answered in three digits
_BANDWIDTHS = (0.05, 500.0)  # [Hz]: with any rate, a run's times and its log are ones that a scenario may have
_LATEST = 1e4  # [ms], latency of an image, at most
_SHORT_LATENCY = 1e-3  # [s], below which the answer may be in seconds
_COMMANDS = (1.0, 1e4)  # [1/s], to a drive
_USUAL_COMMANDS = 50.0  # [1/s], to a drive that takes positions, at least by default: RC servos and network protocols
_SHORTEST = 1.0 / _COMMANDS[1]  # servo period [s] that is chosen for drives that take forces, at least
_SPEEDS = "drives that take speeds follow positions by a loop around them: docs/your-machine.md, section 2"
_RESPONSES = (0.01, 1e4)  # [Hz], of a drive
_SPEED = 1e-6  # [deg/s] or [mm/s], of a drive, at least
_LEAST_NOISE = 0.1  # [px], assumed by the law: encoders and lens leave as much where the image has none


@dataclass(frozen=True)
class Loop:
    """The answers about the loop of a machine whose drives take forces."""

    frame: float  # [s], between two exposures
    latency: float  # [s], from an exposure until the image is used
    bandwidth: float  # [Hz]

    def scenario(self, dialogue: Dialogue, machine: dict[str, Any]) -> tuple[dict[str, Any], hs.Scenario]:
        """Return the whole document, and its scenario, for robot, camera and target.

        The servo period divides that of the frames. It is one of which `hexservo check` does not warn, unless that
        would be below the period of the fastest commands.

        Raises
        ------
        ScenarioError
            For what one answer alone does not tell.
        """
        parts = self._parts(1.0 / (_TICKS * self.bandwidth))
        document = self._document(machine, parts)
        scenario = hs.Scenario.from_mapping(document)
        finer = self._parts(_coarsest_period(scenario))
        if finer > parts:
            parts = finer
            document = self._document(machine, parts)
            scenario = hs.Scenario.from_mapping(document)
        step = 1e3 * scenario.simulation.step
        share = f"1/{parts} of " if parts > 1 else ""
        dialogue.say(f"The servo period is {step:.4g} ms, {share}the frame period.")
        return document, scenario

    def _parts(self, longest: float) -> int:
        """Return the servo periods of a frame: none longer than `longest` [s], but none below `_SHORTEST` either."""
        most = math.floor(self.frame / _SHORTEST * (1.0 + _ROUNDING))
        return max(1, min(_whole_above(self.frame / longest), most))

    def _document(self, machine: dict[str, Any], parts: int) -> dict[str, Any]:
        ticks = _no_shorter(self.latency / self.frame * parts)
        return _document(
            machine,
            {"period": self.frame, "latency": self.frame * ticks / parts, "prediction": "encoder"},
            {
                "law": GENERAL_LAW,
                "switching": {"kind": "implicit_coupled"},  # whatever the inertia couples
                GENERAL_LAW: {"auto": {"bandwidth": self.bandwidth}},
            },
            self.frame / parts,  # not rounded: times are whole numbers of it
            self.bandwidth,
        )


@dataclass(frozen=True)
class PositionLoop:
    """The answers about the loop of a machine whose drives take positions at even times."""

    frame: float  # [s], between two exposures
    latency: float  # [s], from an exposure until the image is used
    bandwidth: float  # [Hz], of the motion to the target
    period: float  # [s], between two commands
    delay: float  # [s], from a command until the drive acts on it
    response: dict[str, float]  # the keys of `actuators.position`

    def scenario(self, dialogue: Dialogue, machine: dict[str, Any]) -> tuple[dict[str, Any], hs.Scenario]:
        """Return the whole document, and its scenario, for robot, camera and target.

        The servo period is that of the commands, and the other times are whole numbers of it, no shorter than they
        are, as a loop with less of them looks better than it is.

        Raises
        ------
        ScenarioError
            For what one answer alone does not tell.
        """
        frame, latency, delay = (
            self.period * _no_shorter(time / self.period) for time in (self.frame, self.latency, self.delay)
        )
        frame = max(frame, self.period)
        times = {"period": frame, "latency": latency, "prediction": "none"}
        law = {
            "auto": {"bandwidth": self.bandwidth},
            "noise": max(machine["camera"]["noise"], _LEAST_NOISE),
        }
        document = {
            **_document(machine, times, {"law": POSE_LAW, POSE_LAW: law}, self.period, self.bandwidth),
            "actuators": {"kind": "position", "delay": delay, "position": self.response},
        }
        scenario = hs.Scenario.from_mapping(document)
        rate = f"{_usual_commands(self.frame):.6g} commands a second"
        slower = f" A multiple of the frame rate, such as {rate}, would keep it."
        dialogue.say(
            f"Times are whole numbers of the {1e3 * self.period:.4g} ms between two commands: a frame every "
            f"{_became(self.frame, frame)}, used {_became(self.latency, latency)} after its exposure, and a delay of "
            f"{_became(self.delay, delay)}. `hexservo identify` measures them from a log, of drives that report where "
            "they are, and rounds to commands too." + (slower if frame > self.frame * (1.0 + _ANSWERED) else "")
        )
        return document, scenario


def _whole_above(ratio: float) -> int:
    """Return the least whole number that is not below a ratio of two times, but for its rounding."""
    return math.ceil(ratio * (1.0 - _ROUNDING))


def _no_shorter(ticks: float) -> int:
    """Return the whole servo periods that last no less than an answer, given in them."""
    return math.ceil(ticks - _ANSWERED)


def _became(answer: float, time: float) -> str:
    """Return a time [s] with its unit, and the answer that it was rounded from where they differ."""
    given, taken = f"{1e3 * answer:.4g}", f"{1e3 * time:.4g}"
    return f"{taken} ms" if given == taken else f"{taken} ms ({given} ms before rounding)"


def _usual_commands(frame: float) -> float:
    """Return the least multiple of a camera's frame rate that is at least `_USUAL_COMMANDS` [1/s]; `frame` in s."""
    return min(_whole_above(_USUAL_COMMANDS * frame) / frame, _COMMANDS[1])


def ask_loop(dialogue: Dialogue, frame: float, *, rotary: bool) -> Loop | PositionLoop:
    """Return what was answered about the loop of a camera with a `frame` period [s]."""
    latency = 1e-3 * dialogue.number(
        "Latency, from the exposure of an image until it is used [ms]", 1e3 * frame, 0.0, _LATEST
    )
    if 0.0 < latency < _SHORT_LATENCY:
        dialogue.say(
            f"{1e3 * latency:.4g} ms is shorter than exposure and transfer of most images. If these are seconds, the "
            f"answer is {1e6 * latency:.4g}."
        )
    if dialogue.choice("Commands that the drives take", ("forces", "positions"), _SPEEDS) == "forces":
        return Loop(frame, latency, _bandwidth(dialogue))
    period = 1.0 / dialogue.number("Commands a second [1/s]", _usual_commands(frame), *_COMMANDS)
    delay = 1e-3 * dialogue.number(
        "Delay, from a command until a drive acts on it [ms]",
        1e3 * period,
        0.0,
        1e3 * _core.MAX_ACTUATOR_DELAY * period,
    )
    response = {"bandwidth": dialogue.number("Bandwidth of a drive, 0.53 over its rise time [Hz]", 10.0, *_RESPONSES)}
    unit, most, scale = ("deg/s", 300.0, math.pi / 180.0) if rotary else ("mm/s", 20.0, 1e-3)
    speed = dialogue.number(f"Largest speed of a drive, 0: no limit [{unit}]", most, _SPEED, zero=True)
    if speed > 0.0:
        response["speed_limit"] = float(f"{scale * speed:.9g}")
    return PositionLoop(frame, latency, _bandwidth(dialogue), period, delay, response)


def _bandwidth(dialogue: Dialogue) -> float:
    return dialogue.number("Bandwidth of the loop [Hz]", 1.0, *_BANDWIDTHS)


def _document(
    machine: dict[str, Any], times: dict[str, Any], controller: dict[str, Any], step: float, bandwidth: float
) -> dict[str, Any]:
    """Return the document of a machine with its camera's times, for a run that is long enough to show its end."""
    metrics, frame = Metrics(), times["period"]
    duration = max(_PERIODS / bandwidth, _ROOM * max(metrics.dwell, metrics.rms_start, frame, times["latency"]))
    return {
        **machine,
        "camera": {**machine["camera"], **times},
        "controller": controller,
        "simulation": {
            "mode": "sampled",
            "step": step,
            "duration": frame * _whole_above(duration / frame),
        },
    }


def _coarsest_period(scenario: hs.Scenario) -> float:
    """Return the longest servo period [s] of which `hexservo check` warns with no law; infinite where none is known."""
    from hexservo.findings.check import known_rate
    from hexservo.findings.check_period import coarsest_period

    rate = known_rate(scenario)
    return math.inf if rate is None else coarsest_period(rate)
