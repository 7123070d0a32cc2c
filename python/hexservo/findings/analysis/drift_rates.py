"""Rates of a drift whose law has the image from where the platform was (docs/analysis/drift.md)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hexservo.scenario.arrays import Array, Complex
from hexservo.scenario.parameters import actuators_lag, frame_period, image_age, lost_frames_wait
from hexservo.scenario.scenario import Scenario

_UNDER_WAY = 3  # images that are exposed and not yet used, at most: more are taken together
_UNSTOPPED = 30.0  # e-foldings from one image to the next, after which no image matters
_TAYLOR_ORDER, _TAYLOR_SIZE = 12, 0.5  # 0.5^13/13! is 2e-14


@dataclass(frozen=True)
class Lateness:
    """How late the law has the image, behind the pose that it moves: images are held, one after the other."""

    mean: float  # [s]
    hold: float  # [s], of one image: with lost frames on average
    of: str  # what is late


def lateness(scenario: Scenario) -> Lateness | None:
    """Return how late the pose in the image is, behind that to which the law carries the image on; None: not at all.

    With ``camera.prediction: encoder`` the law carries it from the exposure to now, and where the legs take positions
    from where they are to where they are sent. There the virtual platform is at the command that is yet to be sent, a
    servo period ahead of the legs' last one, which they hold: half a period less.
    """
    predicts, leads = scenario.camera.prediction == "encoder", scenario.actuators.takes_positions
    step = scenario.simulation.step
    age = image_age(scenario) if predicts else 0.0
    mean = age + (max(actuators_lag(scenario) - 0.5 * step, 0.0) if leads else 0.0)
    if not scenario.sampled or mean <= 0.0:
        return None
    kinds = ["its mean age"] * (age > 0.0) + ["the lag of the legs"] * (mean > age)
    return Lateness(
        mean, frame_period(scenario) + lost_frames_wait(scenario) if predicts else step, " and ".join(kinds)
    )


def late_rates(moved: Array, held: Array, late: Lateness) -> Complex:
    """Return the rates of y' = -(F y + H u), where u is the first six numbers of y when the image in use was exposed.

    Parameters
    ----------
    moved, held
        F (n, k, k) and H (n, k, 6) [1/s].
    late
        Images are exposed every `hold`, and used in turn for as long, at a mean of `mean` after their exposure. That
        time is exact; a hold of which many would be under way is made longer, and one above twice the mean shorter.

    Returns
    -------
    Complex
        (n, m) [1/s]: y is a sum of exp(-rate t) from exposure to exposure.
    """
    hold = float(np.clip(late.hold, late.mean / (_UNDER_WAY + 0.5), 2.0 * late.mean))
    passed = max(late.mean - 0.5 * hold, 0.0)  # from the exposure to the first use
    whole = int(passed / hold + 1e-9)  # images on their way at an exposure
    first = max(passed - whole * hold, 0.0)  # for which the image before is still in use
    n, size = moved.shape[:2]
    alone = np.linalg.eigvals(moved)
    unstopped = alone.real.min(axis=-1) * hold < -_UNSTOPPED
    kept = np.where(unstopped[:, None, None], 0.0, moved)

    def over(time: float) -> tuple[Array, Array]:
        system = np.zeros((n, size + 6, size + 6))
        system[:, :size, :size], system[:, :size, size:] = -time * kept, -time * held
        grown = exponential(system)
        return grown[:, :size, :size], grown[:, :size, size:]

    # The state at an exposure: y, then u of the images exposed before, the newest first.
    total = size + 6 * (whole + 1)
    change = np.zeros((n, total, total))
    (before, by_older), (after, by_newer) = over(first), over(hold - first)
    change[:, :size, :size] = after @ before
    change[:, :size, total - 6 :] = after @ by_older
    newer = size + 6 * (whole - 1) if whole else 0  # the image exposed now is that of y
    change[:, :size, newer : newer + 6] += by_newer
    change[:, size : size + 6, :6] = np.eye(6)
    change[:, range(size + 6, total), range(size, total - 6)] = 1.0
    multipliers = np.linalg.eigvals(change).astype(complex)
    multipliers[np.abs(multipliers) < 1e-300] = 1e-300
    rates = -np.log(multipliers) / hold
    rates[unstopped, :size], rates[unstopped, size:] = alone[unstopped], np.inf
    return np.asarray(rates)


def exponential(matrices: Array) -> Array:
    """Return the exponentials of matrices (..., k, k), all at once: `scipy.linalg.expm` takes them one by one.

    By a Taylor series and squaring, of sizes at which neither leaves more than rounding.
    """
    size = float(np.abs(matrices).sum(axis=-1).max(initial=0.0))
    halvings = max(math.ceil(math.log2(size / _TAYLOR_SIZE)), 0) if size > 0.0 else 0
    part = matrices / 2.0**halvings
    result = unit = np.broadcast_to(np.eye(matrices.shape[-1]), matrices.shape)
    for order in range(_TAYLOR_ORDER, 0, -1):
        result = unit + part @ result / order
    for _ in range(halvings):
        result = result @ result
    return np.asarray(result)
