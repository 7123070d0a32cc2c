"""The head behind a socket: the program's side, and a simulated head that answers it.

A line of JSON for each request, and one for its reply:

======================================  ===============================================================
``{"read": true}``                      ``{"legs": [6 angles, rad], "frame": null}``, or a frame
                                        ``{"features": [...], "depth": [...], "age": s}``, null for both
                                        coordinates of a point that is lost (`frames`)
``{"command": [6 angles, rad]}``        ``{"ok": true}``
``{"hold": true}``                      ``{"ok": true}``: the cranks stop where they are
======================================  ===============================================================

A refused request is answered by ``{"error": "..."}``. Cranks stop also where no command comes for 0.25 s.

This is not the protocol of a robot. For Reachy Mini, `Head` calls its package instead: `get_current_joint_positions`
has the angles of the cranks in this order behind that of the body, and `set_target_head_pose` takes the pose that
belongs to commanded angles (`Kinematics.pose`), in axes with z up.
"""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np

import hexservo as hs
from position_machines.clock import Clock
from position_machines.frames import frame_of, numbers, object_of, report_of
from position_machines.kinematics import Array, Kinematics
from position_machines.lines import Line, LinkError, Server, answering
from position_machines.servo import Reading
from position_machines.simulated import Drives, SimulatedMachine

__all__ = ["DRIVES", "WATCHDOG", "Head", "head_handler", "head_server", "simulated_scenario"]

DRIVES = Drives(bandwidth=4.0, damping=0.9, delay=0.02, speed=1.5)
"""What the simulated cranks do, for `hexservo identify` to find; not measured on a robot."""
WATCHDOG = 0.25  # [s]


class Head:
    """The head, for the loop of `servo`.

    Parameters
    ----------
    line
        To the head.
    points
        Number of points of the target.
    clock
        Of the program.
    """

    def __init__(self, line: Line, points: int, clock: Clock) -> None:
        self._line, self._points, self._clock = line, points, clock

    def read(self) -> Reading:
        """Return angles and the newest image.

        Raises
        ------
        LinkError
            For a lost link, a refusal, and anything that is not as above.
        """
        content = self._request({"read": True})
        legs = numbers(content.get("legs"), 6, "legs")
        return Reading(legs, frame_of(content.get("frame"), self._points, self._clock.now()))

    def command(self, legs: Array) -> None:
        """Send the cranks there, (6,) [rad]."""
        self._acknowledged({"command": legs.tolist()})

    def stop(self) -> None:
        """Stop the cranks where they are; over a new connection if this one is lost."""
        try:
            self._acknowledged({"hold": True})
        except LinkError:
            self._line = Line(self._line.host, self._line.port, self._line.timeout)
            self._acknowledged({"hold": True})
        finally:
            self._line.close()

    def _request(self, content: dict[str, object]) -> dict[str, object]:
        self._line.send(json.dumps(content).encode() + b"\n")
        reply = object_of(self._line.receive())
        if "error" in reply:
            raise LinkError(f"the head refuses: {str(reply['error'])[:200]}")
        return reply

    def _acknowledged(self, content: dict[str, object]) -> None:
        if self._request(content).get("ok") is not True:
            raise LinkError("the head did not confirm a request")


def simulated_scenario() -> hs.Scenario:
    """Return the machine that is simulated: the head, with 25 images a second that radio makes 200 ms late."""
    camera = {"camera.period": 0.04, "camera.latency": 0.2, "camera.noise": 0.5}
    return hs.load_scenario("reachy-mini-head").updated(camera)


def head_server(machine: SimulatedMachine, port: int = 0) -> Server:
    """Return a server on the loopback interface with a simulated head behind it."""
    return Server(lambda: head_handler(machine), port)


def head_handler(machine: SimulatedMachine) -> Callable[[bytes], bytes | None]:
    """Return what answers a connection to a simulated head, for `Server`."""
    kinematics = Kinematics(machine.scenario)

    def answer(line: bytes) -> bytes:
        return json.dumps(_answer(machine, kinematics, line)).encode() + b"\n"

    return answering(answer)


def _answer(machine: SimulatedMachine, kinematics: Kinematics, line: bytes) -> dict[str, object]:
    try:
        request = object_of(line)
        if request.get("read") is True:
            return {"legs": machine.legs().tolist(), "frame": report_of(machine.frame())}
        if request.get("hold") is True:
            machine.hold()
            return {"ok": True}
        legs = numbers(request.get("command"), 6, "command")
    except LinkError as error:
        return {"error": str(error)}
    if not np.all((kinematics.lowest <= legs) & (legs <= kinematics.highest)):
        return {"error": "a crank would be beyond its range"}
    machine.command(legs)
    return {"ok": True}
