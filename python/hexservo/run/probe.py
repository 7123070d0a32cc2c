"""The parts of a scenario's loop at given states, from the core: no analysis copies an equation."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexservo import _core
from hexservo.scenario.parameters import core_parameters

if TYPE_CHECKING:
    from hexservo.scenario.scenario import Scenario


def probe(scenario: Scenario) -> _core.Probe:
    """Return the parts of a scenario's loop, to be evaluated at n states at once (docs/model.md, sections 3 to 7).

    Arrays hold one state per row: features (n, 2p) [px] of p points, depth (n, p) [m] and negative in front of the
    camera, position (n, 3) in B [m], quaternion (n, 4) w x y z of any length but zero (1e-150 to 1e150), twist, wrench
    and acceleration (n, 6) in B [m/s; rad/s], [N; N m], [m/s^2; rad/s^2], weights (n, 6, 7, 7) [N; N m] with row: term
    of u, column: term of u-dot. Quaternions are used as they stand: inside a Runge-Kutta step they are not normalised.

    ``image(position, quaternion)``
        True features and Z, (4). Features are NaN for a point that is not in front of the camera.
    ``goal_minima()``
        Poses from which the true points look nearest to the desired features, position (m, 3) and quaternion (m, 4):
        local minima of the image error found from home, the first that shows the goal last.
    ``image_jacobian(features, depth, quaternion, controller=False, position=None)``
        (n, 2p, 6), (12): twist to feature rates, with the depths as given and the plant's sign or the controller's. A
        camera on the base needs the positions too.
    ``measured_depth(depth)``
        The controller's depths (n, p) for the true ones.
    ``law(features, depth, position, quaternion, twist, weights=None)``
        Wrench, its parts by name (those of ``_core.LAW_TRAITS[law].parts``, which sum to it with G-bar), the pose error
        that the law regulates, fuzzy output, normalised memberships and adaptation; `depth` is the controller's. The
        weights follow omega_j-dot = adaptation_j phi-bar_j - sigma_j omega_j, phi-bar_j being the outer product of the
        two memberships and sigma_j the leakage; a limit acts at the end of a step. Adaptation holds the dead zone. A
        sampled scenario's law is that of a servo tick, with the tick's period.
    ``acceleration(position, quaternion, twist, wrench)``
        Of the actual plant, (3); the same at every position.
    ``base_acceleration(time)``
        Of the frame B, (n, 3) in W [m/s^2], at times (n,) >= 0 [s]; zero in continuous mode, whose base stands.
    ``base_motion(time)``
        Position of B in W (n, 3) [m], attitude R_WB (n, 3, 3), rate (n, 3) [rad/s] and its change (n, 3) [rad/s^2] in
        B. A sinusoid or noise with a frequency of 0 has no position: NaN.
    ``base_wrench(time, position, quaternion, twist)``
        What the motion of the base adds to the wrench on the actual platform, (n, 6) in B [N; N m].
    ``estimated_wrenches(quaternion, twist, acceleration)``
        D-bar chi-ddot (n, 6), C-bar chi-dot (n, 6) and G-bar (6,), (1).
    ``inertia(quaternion)``
        D-bar, (n, 6, 6).
    ``stages(features, depth, position, quaternion, twist, weights=None)``
        One step of the loop in continuous mode from each state, `depth` being the true one: features, depth, position,
        quaternion, twist, wrench, fuzzy output and acceleration of its four stages, (n, 4, k), and the state after it
        (``next_...``). From the first stage on that has a point behind the camera, features, wrench, fuzzy output and
        acceleration are NaN; so are depth and body of the stages after it, and all of ``next_...``. Whether the loop
        would stop there for another reason is not asked.
        A quadrature over the step with weights 1/6, 1/3, 1/3, 1/6 is what the method itself does. The
        weights inside a stage are those of the step plus the stage's way along one rate; ``law`` gives memberships and
        adaptation of a stage without them, since neither depends on weights.
    ``moved(position, quaternion, twist, stage_quaternion, stage_twist, stage_acceleration, scale)``
        The body a `scale` [s] along the rate of a stage, as the next stage starts: position, quaternion, twist.
    ``after(position, quaternion, twist, stage_quaternion, stage_twist, stage_acceleration, step)``
        The body after a step from its four stages (n, 4, k), normalised.

    All of them raise ``ValueError("name: expected ..., got ...")`` for arrays of another shape, numbers that are not
    finite or not real, a quaternion that is zero, depths that are not negative.

    Raises
    ------
    ValueError
        For a scenario that the core refuses.
    """
    return _core.Probe(core_parameters(scenario))
