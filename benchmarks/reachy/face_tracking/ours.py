"""hexservo's controller on the head: `hs.Controller`, or the program of its exported header."""

from __future__ import annotations

import shutil
import struct
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import hexservo as hs
from face_tracking.machine import TICK, kinematics
from face_tracking.published import Frame
from face_tracking.scene import EYE, FRONT, LANDMARKS, Array, Camera
from hexservo.run.export import gains_header
from hexservo.scenario import blocks

__all__ = ["LAWS", "ExportedController", "OurController", "compiled", "settings"]

ROOT = Path(__file__).resolve().parents[3]
_LONGEST = 0.24  # [s], latency for which the controller keeps poses
_DISTANCE = 1.0  # [m], assumed of every face

LAWS = ("resolved_rate", "tracking")
"""Of hexservo; one set of settings each, for all motors, cases and latencies. What the motors do is identified."""

_GAINS: dict[str, dict[str, Any]] = {
    # Frames without stamps count as exposed when they arrive, up to 0.2 s late: a larger gain overshoots.
    "resolved_rate": {"camera.prediction": "encoder", "controller.resolved_rate.gain": 2.5},
    "tracking": {  # chosen with seeds 0 to 39, of soft motors 0 to 19
        "camera.prediction": "none",
        "controller.tracking.follow": "direction",
        "controller.tracking.bandwidth": 4.5,  # at most that of the motors
        "controller.tracking.noise": 0.6,
        "controller.tracking.acceleration": 0.6,
        "controller.tracking.certainty": 1.8,  # without the times of exposure
        "controller.tracking.feedback": 1.5,  # at most half of what makes the motors oscillate
        "controller.tracking.integral": 8.0,
        "controller.tracking.band": [1e-4, 1e-4, 1e-4, 7e-4, 7e-4, 7e-4],
    },
}

_STAMPED_CERTAINTY = 2.1  # a velocity is found sooner with them, and then overshoots more where the face stops

_PROGRAM = """
#include "gains.hpp"
#include <hexservo/controller.hpp>
#include <cstdio>

int main() {
  const auto gains = HEXSERVO_GAINS::controller_gains();
  auto state = hexservo::initial_state(gains);
  double row[8 + 3 * POINTS];
  while (std::fread(row, sizeof row, 1, stdin) == 1) {
    hexservo::ControllerInputOf<PLACES> input;
    input.now = row[0];
    input.frame.exposure = row[1];
    for (int i = 0; i < 2 * POINTS; ++i) input.frame.image.features(i) = row[2 + i];
    for (int i = 0; i < POINTS; ++i) input.frame.image.depth(i) = row[2 + 2 * POINTS + i];
    for (int i = 0; i < 6; ++i) input.joints.lengths(i) = row[2 + 3 * POINTS + i];
    const hexservo::ControllerOutput out = hexservo::step(gains, state, input);
    std::fwrite(out.leg_positions.data(), sizeof(double), 6, stdout);
    std::fflush(stdout);
  }
}
"""


def settings(law: str, rate: float, camera: Camera, known: bool, motors: Mapping[str, Any]) -> hs.Scenario:
    """Return the controller's scenario.

    Parameters
    ----------
    law
        One of `LAWS`.
    rate
        Of the frames [Hz]; the camera's period is the next whole tick.
    camera
        Which the controller assumes.
    known
        Whether frames have the time of their exposure.
    motors
        Keys of `actuators`, as identified; with none the scenario's own.
    """
    scenario = hs.load_scenario("reachy-mini")
    points = (EYE + [_DISTANCE, 0.0, 0.0] + LANDMARKS @ FRONT.T) * [1.0, -1.0, -1.0] + scenario.robot.home_position
    changes: dict[str, Any] = {
        "camera.focal_pixels": list(camera.focal),
        "camera.principal_point": list(camera.centre),
        "camera.period": TICK * np.ceil(1.0 / rate / TICK - 1e-9),
        "camera.latency": _LONGEST,
        "target.points": points.tolist(),
        "target.desired_features": None,
        "target.desired_pose": [0.0] * 6,
        "controller.law": law,
        **_GAINS[law],
        **motors,
    }
    if law == "tracking":
        changes["camera.latency_known"] = known
        if known:
            changes["controller.tracking.certainty"] = _STAMPED_CERTAINTY
        motors_bandwidth = motors.get("actuators.position.bandwidth", scenario.actuators.position.bandwidth)
        changes["controller.tracking.bandwidth"] = min(_GAINS[law]["controller.tracking.bandwidth"], motors_bandwidth)
        margin = hs.feedback_margin(scenario.updated(changes))
        changes["controller.tracking.feedback"] = min(_GAINS[law]["controller.tracking.feedback"], 0.5 * margin)
    return scenario.updated(changes)


def stamp_of(frame: Frame, now: float, finds_latency: bool) -> float:
    """Return the time that a frame counts by: its exposure where it has it.

    A law that finds the latency has the arrival, which a program has between two ticks; others the tick.
    """
    if frame.stamped:
        return frame.exposure
    return frame.arrival if finds_latency else now


def depths_of(frame: Frame, camera: blocks.Camera) -> Array:
    """Return the depths (5,) [m] of the landmarks of a face at the assumed distance, along the ray to its middle.

    A distance along the axis in its place would have a face that rests come nearer while the camera turns to it.
    """
    ray = (frame.pixels.mean(axis=0) - np.asarray(camera.principal_point)) / np.asarray(camera.focal_pixels)
    return np.asarray(-(_DISTANCE / np.sqrt(1.0 + ray @ ray) + LANDMARKS[:, 2]))


class OurController:
    """Crank angles at each tick, from `hs.Controller`."""

    def __init__(self, scenario: hs.Scenario) -> None:
        """`scenario` is one of `settings`."""
        self._controller = hs.Controller(scenario)
        self._camera = scenario.camera
        self._command = np.asarray(kinematics().home_lengths)
        self._finds_latency = not scenario.camera.latency_known

    def tick(self, now: float, reading: Array, frame: Frame | None) -> Array:
        """Return the commanded angles (6,) [rad]."""
        out = self._controller.step(
            None if frame is None else frame.pixels.ravel(),
            None if frame is None else depths_of(frame, self._camera),
            leg_lengths=reading,
            exposure=None if frame is None else stamp_of(frame, now, self._finds_latency),
            now=now,
        )
        if np.all(np.isfinite(out.leg_positions)):
            self._command = out.leg_positions
        return self._command


class ExportedController:
    """The same from the exported header: a C++ program that answers every tick over a pipe."""

    def __init__(self, program: Path, scenario: hs.Scenario) -> None:
        """`program` is that of `compiled` for the scenario."""
        self._camera = scenario.camera
        self._finds_latency = not scenario.camera.latency_known
        self._process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._command = np.asarray(kinematics().home_lengths)

    def close(self) -> None:
        """End the program."""
        self._process.communicate()

    def tick(self, now: float, reading: Array, frame: Frame | None) -> Array:
        """Return the commanded angles (6,) [rad]."""
        if self._process.stdin is None or self._process.stdout is None:
            raise RuntimeError("expected a program with pipes")
        row = np.full(8 + 3 * len(LANDMARKS), np.nan)
        row[0], row[-6:] = now, reading
        if frame is not None:
            row[1] = stamp_of(frame, now, self._finds_latency)
            row[2:-6] = [*frame.pixels.ravel(), *depths_of(frame, self._camera)]
        self._process.stdin.write(row.tobytes())
        self._process.stdin.flush()
        answer = np.array(struct.unpack("6d", self._process.stdout.read(48)))
        if np.all(np.isfinite(answer)):
            self._command = answer
        return self._command


def compiled(scenario: hs.Scenario, folder: Path, library: Path | None = None) -> Path:
    """Return a program with the controller of a scenario, compiled with g++.

    Parameters
    ----------
    scenario
        One of `settings`.
    folder
        For sources and program, made where it is missing.
    library
        `libhexservo_core.a` of the headers' version; None: CMake builds it, which takes minutes the first time.

    Raises
    ------
    OSError
        Without g++, or CMake where it is needed.
    subprocess.CalledProcessError
        Where the compiler refuses.
    """
    if shutil.which("g++") is None:
        raise OSError("g++ was not found")
    folder.mkdir(parents=True, exist_ok=True)
    if library is None:
        core = folder / "core"
        library = core / "libhexservo_core.a"
        for command in (
            ["cmake", "-S", str(ROOT), "-B", str(core), "-DCMAKE_BUILD_TYPE=Release"],
            ["cmake", "--build", str(core), "--target", "hexservo_core"],  # compiles what has changed
        ):
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    header, program = gains_header(scenario), folder / "controller"
    places = 4 if len(LANDMARKS) == 4 else 16
    (folder / "gains.hpp").write_text(header, encoding="utf-8")
    source = _PROGRAM.replace("POINTS", str(len(LANDMARKS))).replace("PLACES", str(places))
    (folder / "controller.cpp").write_text(source, encoding="utf-8")
    eigen = [
        argument for path in ("/usr/include/eigen3", "/usr/local/include/eigen3") for argument in ("-isystem", path)
    ]
    command = ["g++", "-std=c++20", "-O1", "-Wno-psabi", "-I", str(ROOT / "cpp" / "include"), *eigen, "-I", str(folder)]
    subprocess.run(
        [*command, str(folder / "controller.cpp"), str(library), "-lpthread", "-o", str(program)], check=True
    )
    return program
