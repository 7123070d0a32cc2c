"""A client for hexapod controllers with the commands of the General Command Set (GCS) over TCP.

Positions are in mm and degrees, axes X, Y, Z, U, V, W; a command is a line, a query ends in a question mark, and in a
reply of several lines all but the last end with a blank. Commands have no reply: ``ERR?`` asks what became of them.
What is here is from publicly available manuals, and has not run on such a controller: try it with a small velocity
(``--velocity``) and the emergency stop at hand.

U, V and W are rotations about the axes of the moving platform, first U, then V, then W: R = Rx(U) Ry(V) Rz(W).
"""

from __future__ import annotations

import contextlib
import re
import threading
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from position_machines.clock import Clock
from position_machines.frames import Camera
from position_machines.kinematics import Kinematics, Pose
from position_machines.lines import Line, LinkError
from position_machines.servo import Reading, Stop

__all__ = ["AXES", "GcsHexapod", "GcsLink", "from_pose", "to_pose"]

Array: TypeAlias = NDArray[np.float64]
AXES = "XYZUVW"
STOPPED = 10  # error of a controller that was stopped by a command
_MOST_LINES = 32
_NUMBER = re.compile(r"[+-]?(\d{1,12}(\.\d{0,12})?|\.\d{1,12})([eE][+-]?\d{1,3})?")
_STOP = b"\x18"  # a single character, without the end of a line, which acts also while commands wait
# Axes of the controller's frame, z up, in B, where z is down: a rotation by 180 degrees about x.
_FRAME = np.diag([1.0, -1.0, -1.0])


def to_pose(values: Array, home: Pose) -> Pose:
    """Return the pose of the platform at X, Y, Z [mm], U, V, W [deg], which are all 0 at home."""
    turn = _FRAME @ Rotation.from_euler("XYZ", values[3:], degrees=True).as_matrix() @ _FRAME
    attitude = Rotation.from_matrix(turn) * Rotation.from_quat(np.roll(home[1], -1))
    return home[0] + _FRAME @ values[:3] * 1e-3, np.roll(attitude.as_quat(), 1)


def from_pose(pose: Pose, home: Pose) -> Array:
    """Return X, Y, Z [mm], U, V, W [deg] of a pose, (6,)."""
    turn = Rotation.from_quat(np.roll(pose[1], -1)) * Rotation.from_quat(np.roll(home[1], -1)).inv()
    angles = Rotation.from_matrix(_FRAME @ turn.as_matrix() @ _FRAME).as_euler("XYZ", degrees=True)
    return np.concatenate([_FRAME @ (pose[0] - home[0]) * 1e3, angles])


class GcsLink:
    """Commands and queries over a line; every method may raise `LinkError`."""

    def __init__(self, line: Line) -> None:
        self._line = line

    def command(self, text: str) -> None:
        """Send a command.

        Raises
        ------
        LinkError
            With the number of the error where the controller has one.
        """
        self._line.send(text.encode("ascii") + b"\n")
        if error := self.error():
            raise LinkError(f"{text.split()[0]}: the controller has error {error}")

    def error(self) -> int:
        """Return the number of the last error, 0 for none, and reset it."""
        (reply,) = self.query("ERR?", 1)
        if not re.fullmatch(r"\s*-?\d{1,6}\s*", reply):
            raise LinkError(f"ERR?: expected a number, got something else ({len(reply)} characters)")
        return int(reply)

    def query(self, text: str, count: int) -> list[str]:
        """Return the lines of a reply, as many as are expected, within one time limit."""
        deadline = self._line.deadline()
        self._line.send(text.encode("ascii") + b"\n")
        lines: list[str] = []
        while True:
            try:
                lines.append(self._line.receive(deadline).decode("ascii"))
            except UnicodeDecodeError:
                raise LinkError(f"{text}: expected text, got other bytes") from None
            if not lines[-1].endswith(" ") or len(lines) > _MOST_LINES:
                break
        if len(lines) != count:
            raise LinkError(f"{text}: expected {count} lines, got {len(lines)}")
        return lines

    def values(self, query: str) -> Array:
        """Return a number of each axis, (6,)."""
        found: dict[str, float] = {}
        for line in self.query(query, len(AXES)):
            axis, equals, number = (part.strip() for part in line.partition("="))
            if not equals or axis not in tuple(AXES) or axis in found or not _NUMBER.fullmatch(number):
                raise LinkError(
                    f"{query}: expected a line like X=1.5 for each of {', '.join(AXES)}, got something else"
                )
            found[axis] = float(number)
        values = np.array([found[axis] for axis in AXES])
        if not np.isfinite(values).all():
            raise LinkError(f"{query}: expected finite numbers, got others")
        return values

    def move(self, values: Array) -> None:
        """Send the platform there, (6,) [mm; deg]."""
        self.command("MOV " + " ".join(f"{axis} {value:.6f}" for axis, value in zip(AXES, values, strict=True)))

    def stop(self) -> None:
        """Stop all axes; that the controller then has the error of a stop is the confirmation."""
        self._line.send(_STOP)
        if (error := self.error()) != STOPPED:
            raise LinkError(f"stop: expected error {STOPPED}, stopped by command, got {error}")

    def close(self) -> None:
        """End the connection."""
        self._line.close()

    def again(self) -> GcsLink:
        """Return a new connection to the same controller."""
        self._line.close()
        return GcsLink(Line(self._line.host, self._line.port, self._line.timeout))


class GcsHexapod:
    """A hexapod behind such a controller, for the loop of `servo`, in coordinates of its legs.

    Parameters
    ----------
    link
        To the controller.
    camera
        Gives the newest image.
    kinematics
        Of the scenario's legs; X to W are 0 at its home.
    """

    def __init__(self, link: GcsLink, camera: Camera, kinematics: Kinematics) -> None:
        self._link, self._camera, self._kinematics = link, camera, kinematics
        self._lowest, self._highest = np.full(6, -np.inf), np.full(6, np.inf)

    def start(self, velocity: float, clock: Clock, interrupted: threading.Event, timeout: float = 10.0) -> None:
        """Prepare the controller: referenced, servo on, limits, velocity, and the platform at home.

        Parameters
        ----------
        velocity
            Of the platform [mm/s].
        clock, interrupted
            For the way home.
        timeout
            Of the way home, beyond what it takes from the farthest limit at this velocity [s].

        Raises
        ------
        Stop
            Where the hexapod is not referenced, or does not arrive. After this and any other failure on the way home
            it is stopped.
        LinkError
            For a lost link, an error of the controller, or a reply that is not as expected.
        """
        self._link.error()  # an old one is no concern of this program
        if not self._link.values("FRF?").all():
            raise Stop("the hexapod is not referenced; reference it first (FRF), with free space around it")
        self._link.command("SVO " + " ".join(f"{axis} 1" for axis in AXES))
        self._lowest, self._highest = self._link.values("TMN?"), self._link.values("TMX?")
        if not (self._lowest < self._highest).all():
            raise LinkError("TMN?, TMX?: expected lowest positions below the highest ones")
        self._link.command(f"VLS {velocity:.6f}")
        try:
            self._link.move(np.zeros(6))
            limit = timeout + float(np.maximum(-self._lowest, self._highest).max()) / velocity
            due = clock.now() + limit
            while not self._link.values("ONT?").all():
                if interrupted.is_set() or clock.now() >= due:
                    raise Stop("interrupted" if interrupted.is_set() else f"home was not reached within {limit:.1f} s")
                clock.wait_until(clock.now() + 0.05, interrupted)
        except BaseException:
            with contextlib.suppress(LinkError):  # the first reason is the one to report
                self.stop()
            raise

    def read(self) -> Reading:
        """Return the legs at the measured pose, and the newest image.

        Raises
        ------
        LinkError
            For a lost link, and anything that is not as expected.
        Stop
            For a pose beyond the controller's limits.
        """
        values = self._link.values("POS?")
        self._check(values, "is")
        return Reading(self._kinematics.legs(to_pose(values, self._kinematics.home)), self._camera.read())

    def command(self, legs: Array) -> None:
        """Send the platform to the pose that belongs to these legs, (6,) [m; rad].

        Raises
        ------
        LinkError
            For a lost link, and for an error of the controller.
        Stop
            For a pose beyond the controller's limits, or legs without a pose; nothing is sent then.
        """
        try:
            pose = self._kinematics.pose(legs)
        except ValueError as error:
            raise Stop(str(error)) from None
        values = from_pose(pose, self._kinematics.home)
        self._check(values, "was to be sent")
        self._link.move(values)

    def stop(self) -> None:
        """Stop all axes; over a new connection if this one is lost."""
        try:
            self._link.stop()
        except LinkError:
            self._link = self._link.again()
            self._link.stop()
        finally:
            self._link.close()

    def _check(self, values: Array, what: str) -> None:
        margin = 1e-3 * (self._highest - self._lowest) if what == "is" else 0.0  # of the measurement at a limit
        outside = ~((self._lowest - margin <= values) & (values <= self._highest + margin))
        if outside.any():
            axis = int(np.argmax(outside))
            span = f"{self._lowest[axis]:.4g} to {self._highest[axis]:.4g}"
            raise Stop(f"{AXES[axis]} {what} at {values[axis]:.4g}, expected {span}")
