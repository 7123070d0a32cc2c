"""From the log of a machine to its model: drives, camera, and the keys of a scenario (docs/identification.md)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from hexservo.findings.analysis.scene import Scene
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Section, as_data
from hexservo.findings.identification.changes import (
    Changes,
    changes_of,
    faults_of,
    in_milliseconds,
    in_whole_ticks,
    of_law,
    open_keys,
    raised_timeout,
    ticks_of,
    times_of_camera,
    times_of_drives,
)
from hexservo.findings.identification.drives import DriveFit, Drives, fit_drives
from hexservo.findings.identification.frames import CameraFit, fit_camera
from hexservo.findings.identification.joints_repeated import require_readings
from hexservo.findings.identification.log import Log, read_log
from hexservo.findings.identification.log_end import LogEnd, end_of
from hexservo.findings.identification.motors import MotorFit, fit_motors
from hexservo.findings.identification.reach import require_reach
from hexservo.run.progress import ProgressCallback, reporting
from hexservo.scenario.fields import described
from hexservo.scenario.keys import value_at
from hexservo.scenario.leg_units import leg_units
from hexservo.scenario.pixels import feature_noise
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import wrong_type

__all__ = ["CameraFit", "DriveFit", "Drives", "Identification", "Log", "LogEnd", "MotorFit", "identify", "read_log"]


@described
@dataclass(frozen=True, eq=False, repr=False)
class Identification(Findings):
    """What the log of a machine gives, and the scenario with it."""

    machine: Scenario = field(repr=False)  # that was given
    scenario: Scenario  # the machine with `changes` and `rounded`
    changes: dict[str, Any]  # keys of the scenario that the log gives, by dotted name
    drives: Drives  # of the legs
    camera: CameraFit | None  # None where the log has no image
    motors: MotorFit | None = None  # None where they were not asked for, or not all legs moved
    rounded: dict[str, Any] = field(default_factory=dict)  # times of the machine in whole ticks of the log, likewise
    faults: dict[str, Any] = field(default_factory=dict)  # keys of wrong times of exposure, likewise
    end: LogEnd | str = ""  # how far from the goal the log ends, or why the log does not tell

    @property
    def as_logged(self) -> Scenario:
        """The scenario with `faults`: what the logged machine does, and is not to be run with."""
        return self.scenario.updated(self.faults)

    @property
    def doubtful(self) -> list[Section]:
        """The parts whose model is not of the machine, with the likely reasons: none of their keys is taken over."""
        return [section for section in self._parts() if section.verdict == "bad"]

    def _parts(self) -> list[Section]:
        return [part.section() for part in (self.drives, self.motors, self.camera) if part is not None]

    def sections(self) -> Sequence[Section]:
        """Return the findings as sentences, tables and curves."""
        parts = self._parts()
        left = open_keys(self.drives, self.changes)
        given = {key: value_at(self.machine, key) for key in (*self.changes, *self.rounded, *left)}
        verdicts = {part.title: part.verdict for part in parts}
        times = times_of_drives(self.drives, self.changes)
        if self.camera is not None:
            times |= times_of_camera(self.camera, self.machine)
        seconds = in_milliseconds(self.machine, self.drives)
        changes = Changes(self.changes, self.rounded, given, verdicts, self.faults, times, seconds, left)
        return [*parts, changes.section()]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain data, for JSON: keys, and each section's verdict, sentences and numbers."""
        of_parts = {section.name: section.to_dict() for section in self.sections()}
        return as_data({"changes": self.changes, "faults": self.faults, **of_parts})  # type: ignore[no-any-return]


def identify(
    log: Log | str | os.PathLike[str],
    machine: Scenario,
    *,
    motors: bool = False,
    progress: bool | ProgressCallback = False,
) -> Identification:
    """Find the model of a machine that takes positions from a log of it.

    Parameters
    ----------
    log
        Record, or the CSV or MCAP file that `read_log` reads.
    machine
        Its legs, and camera and target where the log has images. What the log gives replaces its keys.
    motors
        Also fit motors that hold positions, six alike with the platform that they move: `actuators.kind` is then
        `position_torque`, with the drives' response as what the controller takes the legs for. Mass, inertia and
        `robot.force_limit` are the machine's. It takes some 15 s for half a minute of a log.
    progress
        Draw a bar on standard error, or call a function with the legs that are done, and 6, then with the delays.

    Returns
    -------
    Identification
        Bandwidth, damping, delay and limits of each leg, clock and noise of the camera, with 95 % intervals and the
        share of the part of the record kept apart that they predict; `scenario` runs as the machine does.

    Raises
    ------
    ScenarioError
        A file that cannot be read, or what is wrong with it; legs that are out of the machine's reach, as in another
        unit; joints that were read fewer than 50 times.
    TypeError
        For other types.
    """
    if not isinstance(machine, Scenario):
        raise wrong_type("machine", "a Scenario", machine)
    record = log if isinstance(log, Log) else read_log(log)
    source = None if isinstance(log, Log) else os.fsdecode(log)
    require_reach(record, machine, source)
    ticks = ticks_of(record, machine)
    machine.updated(ticks | in_whole_ticks(machine, ticks))  # refuses a scenario that has no run at these ticks
    with reporting(progress, "legs identified") as report:
        drives = fit_drives(record, leg_units(machine.robot), report)
    if drives.if_exchanged is None:  # commands that were held repeat as well
        require_readings(record, source)
    scene = Scene(machine)
    camera = None if record.frames is None else fit_camera(record, scene, drives)
    found = None
    if motors and drives.if_exchanged is None:
        with reporting(progress, "delays of motors tried") as report:
            found = fit_motors(record, machine, drives, report)
        if found is not None and found.explains:  # one delay for the motors and for what the controller takes them for
            drives = fit_drives(record, leg_units(machine.robot), delays=(found.delay,))
    changes = changes_of(record, machine, drives, camera, found)
    changes |= of_law(machine, changes)
    changes |= raised_timeout(machine, changes, lambda scenario: faults_of(scenario, drives, camera))
    rounded = in_whole_ticks(machine, changes)
    scenario = machine.updated(changes | rounded)
    return Identification(
        machine,
        scenario,
        changes,
        drives,
        camera,
        found,
        rounded,
        faults_of(scenario, drives, camera),
        end_of(record, scene, feature_noise(scenario.camera)),
    )
