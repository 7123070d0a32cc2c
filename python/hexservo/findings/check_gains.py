"""Gains that are legal and probably unintended: too fast or too slow for the run, and what `auto` cannot fit."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.motor_rest import BEGINS
from hexservo.findings.analysis.reach import nearest_limit
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.analysis.words import AXES
from hexservo.findings.check_forces import of_fitted_forces, of_weight, of_written_forces, start_forces
from hexservo.findings.coupling import SHARE, causes_of_products, has_products, noise_at_rest, settling
from hexservo.findings.leg_feedback import OF_MARGIN, feedback_margin, integral_margin
from hexservo.findings.prior import balance_of_prior, largest_share, left_by_inverse, share_of_prior
from hexservo.findings.target_path import follows_direction
from hexservo.scenario.default_gains import is_far, misfit, platform_of_defaults
from hexservo.scenario.fitted import Machine, auto_of, chosen_keys, fitted_keys, idle_gains
from hexservo.scenario.keys import value_at
from hexservo.scenario.laws import LAWS
from hexservo.scenario.parameters import actuators_lag, frame_period, image_age
from hexservo.scenario.pixels import feature_noise
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import apart, below, number, quantity

OF_SERVO_RATE = 0.25  # share of it that a bandwidth may have
_OF_RUN = 0.1  # periods of the bandwidth that a run must have at least
_SLOW = 0.5  # of the bandwidth: motions below it are slow
_LATE_BY_FRICTION = 0.01  # periods: half of the delay with which laws without viscous damping settle (docs/gains.md)
_LEFT = 0.02  # share of the image error that may be slow, or stay
_OF_BAND = 0.4  # of metrics.band, least of a slow part of the image error that keeps a run out of it for long
_TURNED = 0.9  # share of rotations in the common motion of the features
_COUPLED = 0.85, 1.2  # least and most of the time to settle, over that without products of the inertia
_DEVIATIONS = 3.0  # of the features about rest that metrics.band should hold
_HALF_DECADES = 12  # by which a prior is reduced in search of one that leaves less, at most
_OF_MOTION = frozenset(  # what sets how fast a platform moves: spring, damping, adaptation, or the bandwidth itself
    ("kp", "kd", "kt", "drive", "fuzzy.adaptation", "gain", "gain_far", "gain_slope", "ki", "bandwidth")
)
_WIDE = 0.1  # of the stroke: a motion of the platform's joints that an integral should not leave
_NARROW = 0.02  # of the stroke: what it leaves with the band that is suggested
_ROUNDING = 1.0 + 1e-9

SELDOM = 2600.0
"""Frames of which noise may restart the estimate of a target in one."""


def of_gains(scene: Scene) -> Iterator[str]:
    """Yield a sentence for each problem of a scenario's gains."""
    scenario = scene.scenario
    auto = auto_of(scenario)
    law = scenario.controller.law
    if auto.bandwidth is not None and _follows_bandwidth(scenario):
        of_bandwidth = f"controller.{law}.auto.bandwidth: {{}} Hz"
        key = of_bandwidth.format(number(auto.bandwidth))
        yield from _of_times(scenario, of_bandwidth, auto.bandwidth)
        if law in LAWS:  # the others have no loop through the image: the target is estimated where it is
            yield from _of_delay(scenario, of_bandwidth, auto.bandwidth, auto.damping)
        if scenario.actuators.kind == "force":  # other drives get there in their own time, or whatever effort it takes
            yield from _of_forces(scene, key)
            yield from _of_coupling(scene, key)
            yield from _of_coupled_noise(scene, key)
        yield from _of_image(scene, key)
    elif scenario.controller.traits.output == "pose":
        bandwidth = scenario.controller.gains.bandwidth
        yield from _of_times(scenario, f"controller.{law}.bandwidth: {{}} Hz", bandwidth)
    else:
        yield from _of_defaults(scenario)
        if scenario.actuators.kind == "force":
            yield from of_written_forces(scene)
    yield from _of_way(scene)
    yield from _of_pull(scene)
    yield from _of_switching(scene)
    if scenario.controller.traits.output == "pose":
        yield from _of_feedback(scenario, law)
        yield from _of_band(scene, f"controller.{law}")
        yield from _of_noise(scenario, f"controller.{law}")


def _of_defaults(scenario: Scenario) -> Iterator[str]:
    """Find default gains on a machine that they do not fit, as after a change of the law alone."""
    if is_far(scenario):
        key = f"controller.{scenario.controller.law}"
        yield (
            f"{key}: its gains are the defaults, of {platform_of_defaults()}: those of any "
            f"bandwidth differ from them by a factor of {number(misfit(scenario), 2)} or more on this machine; "
            f"{key}.auto.bandwidth fits them"
        )


def _of_switching(scene: Scene) -> Iterator[str]:
    """Axis by axis, `implicit` stops D_jj v_j/T_c; the other entries of D leave v - D^-1 diag(D) v after a period."""
    controller = scene.scenario.controller
    axis_by_axis = controller.switching.kind == "implicit" and controller.traits.switching
    if not axis_by_axis or not np.any(scene.settings[f"controller.{controller.law}.kv"]):
        return
    inertia = scene.probe.inertia(scene.home.rows.quaternion)[0]
    factor = float(np.abs(np.linalg.eigvals(np.eye(6) - np.linalg.solve(inertia, np.diag(np.diag(inertia))))).max())
    if factor >= 1.0:
        yield (
            "controller.switching.kind: implicit stops axis by axis, but the inertia couples the axes so much that a "
            f"twist changes by {number(factor)} times itself from one servo period to the next: the platform chatters "
            "by kv; use implicit_coupled"
        )


def _of_feedback(scenario: Scenario, law: str) -> Iterator[str]:
    for name, margin in (("feedback", feedback_margin), ("integral", integral_margin)):
        key = f"controller.{law}.{name}"
        own = value_at(scenario, key)
        most = margin(scenario) if own > 0.0 else math.inf
        if own > OF_MARGIN * most * _ROUNDING and most > 0.0:  # 0: the feedback alone is too much
            value, written = apart(own, OF_MARGIN * most * _ROUNDING, 3, keeps=True)
            yield f"{key}: {value} is more than {written}, half of that with which legs of this response oscillate"


def _of_band(scene: Scene, law: str) -> Iterator[str]:
    """Find a band of another machine: up to twice the band no error makes the integral begin."""
    if value_at(scene.scenario, f"{law}.integral") == 0.0:
        return
    left = BEGINS * scene.settings[f"{law}.band"]  # (6,) [m; rad]
    levers = scene.levers
    share = left * levers / scene.stroke_length
    axis = int(share.argmax())
    if share[axis] > _WIDE * _ROUNDING:
        shift, turn = 0.5 * _NARROW * scene.stroke_length / levers[[0, 3]]
        least = quantity(left[axis], "m" if axis < 3 else "rad")
        yield (
            f"{law}.band: the integral begins beyond twice the band, at {least} {AXES[axis]}, which moves the "
            f"platform's joints by {share[axis]:.0%} of the stroke: legs may rest that far from where they are sent; "
            f"a band of {quantity(shift, 'm', 1)} and {quantity(turn, 'rad', 1)} leaves {_NARROW:.0%}"
        )


def _of_noise(scenario: Scenario, law: str) -> Iterator[str]:
    """Find noise and rounding of the camera that the filter of the target takes for a target that is somewhere else."""
    true = feature_noise(scenario.camera)
    assumed, jump = value_at(scenario, f"{law}.noise"), value_at(scenario, f"{law}.jump")
    share = share_of_restarts(scenario, law)
    if share * SELDOM < 1.0:
        return
    root = _root_of_weights(scenario, law)
    as_assumed = share_of_restarts(scenario, law, true * root)
    if as_assumed * SELDOM < 1.0:
        value, written = apart(assumed / root, true)
        by_weights, or_weights = "", ""
        if root != 1.0:
            by_weights = ", over the root of the largest of target.weights,"
            or_weights = f", or the largest weight to {number((assumed / true) ** 2)}"
        yield (
            f"{law}.noise: {value} px{by_weights} is less than the {written} px of camera.noise and "
            f"camera.quantisation, so that these alone are beyond {law}.jump and restart the estimate of the target "
            f"{_how_often(share)}, and the machine may not stay on its goal; set it to {number(true * root)}"
            f"{or_weights}"
        )
    else:
        yield (
            f"{law}.jump: noise as it is assumed is beyond {number(jump)} deviations {_how_often(as_assumed)}, and "
            "restarts the estimate of the target; a jump of 4 or more is seldom noise"
        )


def _how_often(share: float) -> str:
    return f"up to once in {below(1.0 / share, 2)} frames" if share < 0.5 else "at nearly every frame"


def share_of_restarts(scenario: Scenario, law: str, assumed: float | None = None) -> float:
    """Return in which share of the frames, at most, the camera's noise restarts the estimate of the target.

    As if what the filter expects were certain: its own variance makes restarts more seldom.

    Parameters
    ----------
    scenario
        Whose law estimates the target's pose.
    law
        Block of its gains.
    assumed
        Noise that the law would assume [px]; None: that of the block.
    """
    from scipy.stats import chi2  # here, since a check of most scenarios does without the import

    true = feature_noise(scenario.camera)
    if assumed is None:
        assumed = value_at(scenario, f"{law}.noise")
    if not scenario.sampled or true == 0.0:
        return 0.0
    numbers = 3 if follows_direction(scenario) else 6
    within = _core.all_within(value_at(scenario, f"{law}.jump"), numbers)
    return float(chi2.sf(within * (assumed / _root_of_weights(scenario, law) / true) ** 2, numbers))


def _root_of_weights(scenario: Scenario, law: str) -> float:
    """Return by what, at most, the filter's noise is divided: it takes a point of weight w for one of noise/sqrt(w)."""
    if follows_direction(scenario):  # of shares, in which a common factor has no part
        return 1.0
    return math.sqrt(float(np.max(scenario.target.weights)))


def _of_times(scenario: Scenario, key: str, bandwidth: float) -> Iterator[str]:
    step = scenario.simulation.step
    most = OF_SERVO_RATE / step
    if bandwidth > most * _ROUNDING:
        what = "servo period" if scenario.sampled else "step"
        above = _out_of_bound(key, "above", bandwidth, most)
        yield f"{above}, a quarter of the rate of a {what} of {quantity(step, 's')}"
    least = _OF_RUN / scenario.simulation.duration
    if bandwidth < least / _ROUNDING:
        run = quantity(scenario.simulation.duration, "s")
        yield f"{_out_of_bound(key, 'below', bandwidth, least)}, a tenth of a period in the run of {run}"


def _out_of_bound(key: str, side: str, bandwidth: float, bound: float) -> str:
    """Return that a bandwidth is above or below a bound: what is written for the bound has no such warning."""
    rounding = _ROUNDING if side == "above" else 1.0 / _ROUNDING
    value, written = apart(bandwidth, bound * rounding, 3, keeps=True)
    return f"{key.format(value)} is {side} {written} Hz"


def image_delay(scenario: Scenario) -> float:
    """Return how late the image acts, on average [s]: its mean age (`image_age`), half a tick, filter, actuators.

    Joints carry a predicted image along, and where drives take positions the image is seen from where the legs are sent
    (docs/model.md, section 7): then age and lag act in the share delta/(1 + delta) of the motion, over all points, that
    depths which are too large by delta carry wrongly. Depths that are too small take nothing away. A frame with
    a wrong stamp is carried too far or too short by that time. Too short is a delay; too far takes less damping, and in
    the end stability, and counts as much. No stamp shows the lag of a filter.
    """
    if not scenario.sampled:
        return 0.0
    age, late = image_age(scenario), actuators_lag(scenario)
    too_far = np.atleast_1d(scenario.uncertainty.depth)
    carried = max(float(np.mean(too_far / (1.0 + too_far))), 0.0)
    if scenario.camera.prediction == "encoder":
        age = carried * age + abs(scenario.uncertainty.latency)
    if scenario.actuators.takes_positions:
        late *= carried
    return 0.5 * scenario.simulation.step + smoothing_lag(scenario) + age + late


def smoothing_lag(scenario: Scenario) -> float:
    """Return how late features that change evenly are behind their filter, ``camera.smoothing`` [s].

    The filter moves on from exposure to exposure: an exponential one in steps, which is late by less than its time
    constant tau, P/(exp(P/tau) - 1) with P between exposures.
    """
    constant, between = scenario.camera.smoothing, frame_period(scenario)
    if constant == 0.0:
        return 0.0
    left = math.exp(-between / constant)  # of the old value, in a step
    return between * left / -math.expm1(-between / constant)


def _of_delay(scenario: Scenario, key: str, bandwidth: float, damping: float) -> Iterator[str]:
    delay, viscous = image_delay(scenario), scenario.controller.traits.viscous
    most = (damping / (2.0 * math.pi) if viscous else _LATE_BY_FRICTION) / delay if delay > 0.0 else math.inf
    if bandwidth > most * _ROUNDING:
        above = _out_of_bound(key, "above", bandwidth, most)
        late = quantity(delay, "s")
        damped = "the damping" if viscous else "what friction and adaptation damp"
        yield f"{above}, where an image that takes effect {late} late, drives included, takes half of {damped} away"


def _of_forces(scene: Scene, key: str) -> Iterator[str]:
    forces, limit = start_forces(scene), scene.scenario.robot.force_limit
    if np.abs(forces.weight).max() > limit:
        legs = quantity(limit, scene.units.effort)
        yield (
            f"{key} fits no better than any other: the legs' {legs} do not carry the weight; {of_weight(scene, forces)}"
        )
    elif _has_fitted_motion(scene.scenario):
        yield from of_fitted_forces(scene, key)
    else:  # then the wrench does not follow the bandwidth
        yield from of_written_forces(scene)


def _couples(scene: Scene) -> str:
    return f"the inertia couples the axes ({causes_of_products(scene.scenario)})"


def _of_coupling(scene: Scene, key: str) -> Iterator[str]:
    """Find an inertia that couples the axes, as that of a centre of mass off the origin: gains are for one axis."""
    if not _has_fitted_motion(scene.scenario):
        return
    ratio, band, is_share = settling(scene)
    least, most = _COUPLED
    if ratio < least or ratio > most:  # not where it is not a number
        of = f"{100 * SHARE:g} % of that at the start" if is_share else "metrics.band"
        time = f"in {number(ratio, 2)} times the time" if math.isfinite(ratio) else "beyond the time"
        yield (
            f"{key} is fitted axis by axis, but {_couples(scene)}: the image error settles to {number(band, 2)} px, "
            f"{of}, {time} of uncoupled axes; {_decoupling_laws(scene.scenario)} takes the coupling out"
        )


def _of_coupled_noise(scene: Scene, key: str) -> Iterator[str]:
    """Find an inertia that makes motions which the image hardly constrains, and which noise drives, visible."""
    if not has_products(scene.machine) or not _has_fitted_motion(scene.scenario):
        return
    coupled, alone = noise_at_rest(scene)
    if _DEVIATIONS * coupled > scene.band and coupled > _COUPLED[1] * alone:
        law, traits = scene.scenario.controller.law, scene.scenario.controller.traits
        inverse = f"controller.{law}.{traits.inverse or 'prior'}"
        yield (
            f"{key} is fitted axis by axis, but {_couples(scene)}: "
            f"{number(feature_noise(scene.scenario.camera))} px of noise in the image move the features by "
            f"{number(coupled, 2)} px about rest (standard deviation; {number(alone, 2)} px with uncoupled axes), "
            f"so that they do not stay within metrics.band, {number(scene.band)} px; "
            f"{_decoupling_laws(scene.scenario)} takes the coupling out, and a larger {inverse} lets less noise through"
        )


def _follows_bandwidth(scenario: Scenario) -> bool:
    """Return whether a gain that sets the motion is fitted; with all of them written the bandwidth does not act."""
    fitted = _OF_MOTION.intersection(fitted_keys(scenario.controller.law))
    return not fitted.issubset({*chosen_keys(scenario), *idle_gains(scenario)})


def _has_fitted_motion(scenario: Scenario) -> bool:
    """Return whether spring, damping and adaptation are those of the bandwidth: fitted, and none of them written."""
    return auto_of(scenario).bandwidth is not None and _OF_MOTION.isdisjoint(chosen_keys(scenario))


def _decoupling_laws(scenario: Scenario) -> str:
    """Return the laws that take the coupling out, with the same bandwidth: their defaults are of another machine."""
    bandwidth = auto_of(scenario).bandwidth
    laws = (law for law, traits in _core.LAW_TRAITS.items() if "coriolis_feedforward" in traits.parts)
    return " or ".join(f"{law} with controller.{law}.auto.bandwidth: {bandwidth:g}" for law in laws)


def _of_image(scene: Scene, key: str) -> Iterator[str]:
    """Yield where the law's own structure keeps it from settling as others do."""
    law, machine = scene.scenario.controller.law, scene.machine
    traits = _core.LAW_TRAITS[law]
    if traits.points:  # it follows a pose, or inverts the image Jacobian
        return
    if not traits.prior:  # its stiffness is J^T K_p J
        share = slow_share(scene, machine)
        start = float(np.abs(scene.desired - scene.view(scene.start).features)[machine.weights > 0.0].max())
        if share > _LEFT and share * start > _OF_BAND * scene.band:
            yield (
                f"{key} is that of the features' common motion; {number(100 * share, 2)} % of the image error at the "
                "start is more than twice as slow with this law"
            )
        turned = turning_share(machine)
        if not traits.viscous and turned < _TURNED:
            yield (
                f"{key} is meant for targets that are seen to move with rotations; this one is so near that rotations "
                f"have {number(100 * turned, 2)} % of the features' common motion"
            )
    else:
        share = share_of_prior(scene, machine)
        if _LEFT < share <= 1.0:  # else `_of_pull`
            yield (
                f"controller.{law}.prior: with {number(100 * share, 2)} % of the image error at the start, the image "
                f"and the pull towards home balance{_less_left(scene, key)}"
            )


def _of_way(scene: Scene) -> Iterator[str]:
    """Find a pose out of reach on the way to a goal within reach: the law takes a part of a turn for a shift."""
    law = scene.scenario.controller.law
    traits = _core.LAW_TRAITS[law]
    if not traits.inverse or not scene.has_points:
        return
    machine = scene.machine
    first = machine.displacement - left_by_inverse(scene, machine)
    if not np.isfinite(first).all() or not nearest_limit(scene, scene.home.moved(machine.displacement)).within:
        return
    limit = nearest_limit(scene, scene.home.moved(first))
    if limit.within:
        return
    shift, turn = (number(float(np.linalg.norm(part))) for part in np.split(first, 2))
    remedy = f"{traits.inverse} that is larger for shifts" if traits.prior else f"smaller {traits.inverse}"
    bandwidth = auto_of(scene.scenario).bandwidth
    fitted = "" if bandwidth is None else f": {number(bandwidth)}"
    # the laws that find the pose of the image, with a spring to that of the goal
    of_pose = " or ".join(
        f"{each} with controller.{each}.auto.bandwidth{fitted}"
        for each, has in _core.LAW_TRAITS.items()
        if has.pose_error and not has.inverse
    )
    yield (
        f"controller.{law}.{traits.inverse}: the law first goes to a pose {shift} m and {turn} rad from home, where "
        f"{limit.beyond}, although the legs reach the goal; a {remedy}, or a law of the pose, {of_pose}, does not"
    )


def _of_pull(scene: Scene) -> Iterator[str]:
    """Find a start nearer to the goal image than the balance of image and prior, whose reference is home anyway."""
    law = scene.scenario.controller.law
    traits = _core.LAW_TRAITS[law]
    if not (traits.prior and traits.inverse and scene.has_points and any(scene.scenario.simulation.start.pose)):
        return
    machine = scene.machine
    if share_of_prior(scene, machine) <= 1.0:
        return
    left, pixels = balance_of_prior(scene, machine)
    shift, turn = (float(np.linalg.norm(part)) for part in np.split(left, 2))
    yield (
        f"controller.{law}.prior: the start is nearer to the goal image than where the image and the pull towards home "
        f"balance, with {number(pixels)} px and {quantity(shift, 'm')} and {quantity(turn, 'rad')} from the "
        f"goal; the run goes there{_less_left(scene, f'controller.{law}')}"
    )


def _less_left(scene: Scene, key: str) -> str:
    """Return as a clause how the law leaves at most `_LEFT` of the image error; empty where no smaller prior does.

    A smaller prior is proposed where neither coupled axes nor noise nor a way out of reach come in with it.
    """
    prior = f"controller.{scene.scenario.controller.law}.prior"
    for half_decades in range(1, _HALF_DECADES + 1):
        factor = 10.0 ** (-0.5 * half_decades)
        smaller = (factor * np.asarray(value_at(scene.scenario, prior))).tolist()
        less = Scene(scene.scenario.updated({prior: smaller}))
        share = share_of_prior(less, less.machine)
        if share <= _LEFT:
            break
    else:
        return ""
    if any(_of_way(less)):
        return ""
    if any(_of_coupling(less, key)) or any(_of_coupled_noise(less, key)):
        return (
            f"; {_decoupling_laws(scene.scenario)} and {number(factor, 1)} times this prior leaves "
            f"{number(100 * share, 1)} %, with which this law amplifies noise or oscillates, since the inertia couples "
            "the axes"
        )
    return f"; {number(factor, 1)} times this prior leaves {number(100 * share, 1)} %"


def slow_share(scene: Scene, machine: Machine) -> float:
    """Return the share of the largest feature error at the start that motions below half the bandwidth have.

    Of the points that count. Motions of `kelly` without damping, at the goal: the eigenvectors of J D^-1 J^T W K_p.
    Image errors that no motion has (its null space) count.
    """
    counted = machine.weights > 0.0
    stiffness = np.tile(1.0 / machine.pointing, len(counted) // 2)  # K_p/omega^2
    root = np.sqrt(machine.weights * stiffness)[counted]
    jacobian = machine.jacobian[counted]
    moved = jacobian @ np.linalg.solve(machine.mass, jacobian.T)
    squares, ways = np.linalg.eigh(root[:, None] * moved * root)
    error = (scene.desired - scene.view(scene.start).features)[counted]
    parts = ways.T @ (root * error)
    slow = ways @ np.where(squares < _SLOW**2, parts, 0.0) / root
    return largest_share(slow, error)


def turning_share(machine: Machine) -> float:
    """Return the share of rotations in how a common force on all features moves them together, the least of x and y."""
    pull = machine.common_pull[:, 3:]
    turned = np.einsum("ij,ji->i", pull, np.linalg.solve(machine.mass[3:, 3:], pull.T))
    return float((turned / machine.pointing).min())
