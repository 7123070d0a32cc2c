"""The block `controller`: one block of gains for each law. Defaults come from the C++ structs (docs/model.md)."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field, model_validator

from hexservo import _core
from hexservo.scenario.block import NOT_NEGATIVE, POSITIVE, SAMPLED, Block, PositiveNumber
from hexservo.scenario.core_defaults import core_default, from_core
from hexservo.scenario.rules import (
    ArrayRule,
    Choice,
    Flag,
    Matrix,
    Number,
    OptionalNumber,
    PointsRule,
    TableRule,
    Vector,
    map_lists,
)

SwitchingKind: TypeAlias = Literal["sign", "tanh", "saturation", "implicit", "implicit_coupled"]
JacobianPoint: TypeAlias = Literal["current", "desired", "mean"]
ALL_LAWS: tuple[str, ...] = tuple(_core.LAW_TRAITS)
SMOOTH_KINDS: tuple[SwitchingKind, ...] = ("tanh", "saturation")  # of the switching term, with a slope at rest
# of any machine; the others give where legs shall go, and so need a machine that takes positions
LAWS: tuple[str, ...] = tuple(law for law, traits in _core.LAW_TRAITS.items() if traits.output != "pose")
GENERAL_LAW = "composite"  # what a new machine begins with: it integrates, and its prior bounds the drift
POSE_LAW = next(law for law, traits in _core.LAW_TRAITS.items() if traits.output == "pose")  # for positions
THEOREM_LAW = next(law for law, traits in _core.LAW_TRAITS.items() if traits.theorem)  # the paper's
SixNotNegative: TypeAlias = Annotated[float | Vector, ArrayRule((6,), NOT_NEGATIVE, or_number=True)]
SixPositive: TypeAlias = Annotated[float | Vector, ArrayRule((6,), POSITIVE, or_number=True)]
TwoOfEachPoint: TypeAlias = Annotated[float | Vector, PointsRule((8,), NOT_NEGATIVE, or_number=True, each=2)]


def laws_with(*traits: str) -> tuple[str, ...]:
    """Return the laws that have all these traits of `_core.LawTraits`, such as ``memory``."""
    return tuple(law for law, has in _core.LAW_TRAITS.items() if all(getattr(has, trait) for trait in traits))


class Switching(Block):
    """The switching term of the law, sgn or a smooth stand-in; docs/model.md section 6."""

    kind: Annotated[SwitchingKind, Choice()] = from_core("controller.switching.kind")  # sign, or what stands for it
    # [m/s and rad/s], of tanh and saturation
    width: PositiveNumber = from_core("controller.switching.width")


class VirtualPlatform(Block):
    """The platform that a law's wrench moves inside the controller of a machine that takes positions.

    docs/model.md section 7; its pose is the command.
    """

    # D_v, diagonal, [N s/m] x3, [N m s/rad] x3
    damping: Annotated[float | Vector, ArrayRule((6,), NOT_NEGATIVE, or_number=True)] = 0.0


class Safe(Block):
    """The brake in sampled mode, where the law may not act: without an image, with an old one, with unusable numbers.

    docs/model.md section 7. A null gain is derived from the estimated inertia; zeros leave the platform to its weight's
    support alone.
    """

    # K_s, diagonal, [N s/m] x3, [N m s/rad] x3
    damping: Annotated[float | Vector | None, ArrayRule((6,), NOT_NEGATIVE, or_number=True, or_null=True)] = None
    # K_h, diagonal, [N/m] x3, [N m/rad] x3
    hold: Annotated[float | Vector | None, ArrayRule((6,), NOT_NEGATIVE, or_number=True, or_null=True)] = None


class Fuzzy(Block):
    """The six fuzzy systems and their adaptation, (13) and (22); docs/model.md section 5.

    Where six numbers are allowed they are for x, y, z (N) and about x, y, z (N m). In the block of `composite` the
    inputs are a pose error and its rate: a [1/m, 1/rad], b [s/m, s/rad], with different defaults.
    """

    enabled: Annotated[bool, Flag()] = from_core("controller.hybrid.fuzzy.enabled")  # false: no fuzzy systems
    # Psi of (22): the larger, the slower the weights
    adaptation: Annotated[float | Vector, ArrayRule((6,), POSITIVE, or_number=True)] = from_core(
        "controller.hybrid.fuzzy.adaptation"
    )
    # a, scales g to the first input [1/N, 1/(N m)]
    error_scale: SixNotNegative = from_core("controller.hybrid.fuzzy.error_scale")
    # b, scales dg/dt to the second input [s/N, s/(N m)]
    rate_scale: SixNotNegative = from_core("controller.hybrid.fuzzy.rate_scale")
    # s0 [N, N m]: the weights start at s0 times the table; above 0 they oppose g, below 0 they help it
    initial_scale: Annotated[float | Vector, ArrayRule((6,), or_number=True)] = from_core(
        "controller.hybrid.fuzzy.initial_scale"
    )
    # rows by the first input, columns by the second, NB to PB; terms stand for -1, -2/3, ..., 1
    table: Annotated[Literal["linear"] | Matrix, TableRule()] = "linear"
    # half width of a bell at half height; null: exactly 1/6
    bell_width: PositiveNumber = from_core("controller.hybrid.fuzzy.bell_width")
    # s, of a bell's slope: its exponent is 2 s
    bell_slope: Annotated[float, Number(above=0, at_most=16)] = from_core("controller.hybrid.fuzzy.bell_slope")
    # sigma, how fast the weights are forgotten [1/s]; at most one over the step
    leakage: SixNotNegative = from_core("controller.hybrid.fuzzy.leakage")
    # no weight, and so no output, is larger [N, N m]; null: no limit
    weight_limit: Annotated[float | Vector | None, ArrayRule((6,), POSITIVE, or_number=True, or_null=True)] = None
    # the driver of the adaptation has no effect within this [m/s, rad/s]
    dead_zone: SixNotNegative = from_core("controller.hybrid.fuzzy.dead_zone")

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("bell_width", 0) is None:
            return {key: value for key, value in data.items() if key != "bell_width"}
        return data


class Auto(Block):
    """Gains that fit: those that are not given follow from machine, camera and goal (docs/gains.md)."""

    # f [Hz] of the loop without friction and adaptation; null: gains that are not given have their defaults
    bandwidth: Annotated[float | None, OptionalNumber(at_least=1e-6, at_most=1e6)] = None
    damping: Annotated[float, Number(at_least=0.01, at_most=100)] = 1.0  # zeta of that loop [1]

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, data: Any) -> Any:
        return {} if data is None else data


class Hybrid(Block):
    """Gains of the paper's law (14), (15); docs/model.md section 5."""

    auto: Auto = Field(default_factory=Auto)
    # K_p, diagonal, one entry per feature coordinate [N m/px^2]
    kp: Annotated[float | Vector, PointsRule((8,), POSITIVE, or_number=True, each=2)] = from_core(
        "controller.hybrid.kp"
    )
    # K_v, diagonal, [N] x3, [N m] x3; 0 takes the switching term, the law's only damping, away
    kv: SixNotNegative = from_core("controller.hybrid.kv")
    fuzzy: Fuzzy = Field(default_factory=Fuzzy)


@cache
def _composite_fuzzy() -> dict[str, Any]:
    """Return the defaults of the fuzzy systems that are not those of `Fuzzy`, as plain data (not to be changed)."""
    keys = ("adaptation", "error_scale", "rate_scale")
    return {key: map_lists(core_default(f"controller.composite.fuzzy.{key}"), list) for key in keys}


class Composite(Block):
    """Gains of the law that regulates the most probable pose error; docs/model.md section 5.

    Its fuzzy systems see that error and its rate, so their scales have other units and other defaults.
    """

    auto: Auto = Field(default_factory=Auto)
    # K_p, diagonal, one entry per feature coordinate [N m/px^2]
    kp: TwoOfEachPoint = from_core("controller.composite.kp")
    # K_v, diagonal, [N] x3, [N m] x3
    kv: SixNotNegative = from_core("controller.composite.kv")
    # K_t, diagonal, stiffness against the pose error [N/m] x3, [N m/rad] x3
    kt: SixNotNegative = from_core("controller.composite.kt")
    # K_d, diagonal, viscous damping [N s/m] x3, [N m s/rad] x3
    kd: SixNotNegative = from_core("controller.composite.kd")
    # Lambda, diagonal: how fast the pose error drives the adaptation [1/s]
    drive: SixNotNegative = from_core("controller.composite.drive")
    # M, diagonal: weight of the start pose against the image [px^2/m^2] x3, [px^2/rad^2] x3
    prior: SixNotNegative = from_core("controller.composite.prior")
    fuzzy: Fuzzy = Field(default_factory=lambda: Fuzzy(**_composite_fuzzy()))

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("fuzzy"), dict):
            return {**data, "fuzzy": {**_composite_fuzzy(), **data["fuzzy"]}}
        return data


class Kelly(Block):
    """Gains of the transpose Jacobian law with viscous damping; docs/model.md section 5."""

    auto: Auto = Field(default_factory=Auto)
    # K_p, diagonal, one entry per feature coordinate [N m/px^2]
    kp: TwoOfEachPoint = from_core("controller.kelly.kp")
    # K_d, diagonal, viscous damping [N s/m] x3, [N m s/rad] x3
    kd: SixNotNegative = from_core("controller.kelly.kd")


class ResolvedRate(Block):
    """Gains of the classical pseudo-inverse law over a velocity loop; docs/model.md section 5."""

    auto: Auto = Field(default_factory=Auto)
    # lambda [1/s]; where it adapts, its value at the goal
    gain: Annotated[float, NOT_NEGATIVE] = from_core("controller.resolved_rate.gain")
    # the gain falls from the goal to far from it, by gain_slope and gain_far
    adaptive: Annotated[bool, Flag()] = from_core("controller.resolved_rate.adaptive")
    # of the adaptive gain: its value far from the goal [1/s], at most `gain`
    gain_far: Annotated[float, NOT_NEGATIVE] = from_core("controller.resolved_rate.gain_far")
    # of the adaptive gain: its slope at the goal [1/(s px)]
    gain_slope: Annotated[float, NOT_NEGATIVE] = from_core("controller.resolved_rate.gain_slope")
    # current: measured features and depths; desired: those of the goal; mean: half the sum of the two Jacobians
    jacobian_at: Annotated[JacobianPoint, Choice()] = from_core("controller.resolved_rate.jacobian_at")
    # K_i, diagonal, of the velocity loop [N s/m] x3, [N m s/rad] x3
    ki: SixNotNegative = from_core("controller.resolved_rate.ki")
    # M, diagonal, damps the pseudo-inverse [px^2/m^2] x3, [px^2/rad^2] x3
    damping: SixNotNegative = from_core("controller.resolved_rate.damping")


class Pbvs(Block):
    """Gains of the position-based law, which estimates its pose from the features; docs/model.md section 5."""

    auto: Auto = Field(default_factory=Auto)
    # K_p, diagonal, stiffness against the pose error [N/m] x3, [N m/rad] x3
    kp: SixNotNegative = from_core("controller.pbvs.kp")
    # K_d, diagonal, viscous damping [N s/m] x3, [N m s/rad] x3
    kd: SixNotNegative = from_core("controller.pbvs.kd")
    # M, diagonal: weight of the joint sensors against the image [px^2/m^2] x3, [px^2/rad^2] x3; 0: the image alone
    prior: SixNotNegative = from_core("controller.pbvs.prior")


class ComputedTorque(Block):
    """Gains of the law that turns the estimated dynamics around; docs/model.md section 5."""

    auto: Auto = Field(default_factory=Auto)
    # K_p, diagonal [1/s^2]
    kp: SixNotNegative = from_core("controller.computed_torque.kp")
    # K_d, diagonal [1/s]
    kd: SixNotNegative = from_core("controller.computed_torque.kd")
    # M, diagonal: weight of the start pose against the image [px^2/m^2] x3, [px^2/rad^2] x3; 0: the image alone
    prior: SixNotNegative = from_core("controller.computed_torque.prior")


class Tracking(Block):
    """Gains of the law that sends the legs where the target is seen as desired; docs/model.md section 5."""

    auto: Auto = Field(default_factory=Auto)
    # pose: the whole pose of the camera relative to the target; direction: the ray alone, from the place of home
    follow: Annotated[Literal["pose", "direction"], Choice()] = from_core("controller.tracking.follow")
    # of the motion towards the target [Hz]
    bandwidth: PositiveNumber = from_core("controller.tracking.bandwidth")
    # standard deviation of a measured coordinate, as the law assumes it [px]
    noise: PositiveNumber = from_core("controller.tracking.noise")
    # sigma_a of the target between two frames [m/s^2] x3, [rad/s^2] x3
    acceleration: SixPositive = from_core("controller.tracking.acceleration")
    # sigma_v of a target just seen [m/s] x3, [rad/s] x3
    speed: SixPositive = from_core("controller.tracking.speed")
    # standard deviations of what is expected, beyond which the target is somewhere else [1]
    jump: PositiveNumber = from_core("controller.tracking.jump")
    # standard deviations that a velocity has to be of, to count [1]
    certainty: Annotated[float, NOT_NEGATIVE] = from_core("controller.tracking.certainty")
    # share of the legs' lag that the command leads by [1]
    lead: Annotated[float, NOT_NEGATIVE] = from_core("controller.tracking.lead")
    # gain on how far the measured legs are behind the reference [1]
    feedback: Annotated[float, NOT_NEGATIVE] = from_core("controller.tracking.feedback")
    # rate at which the command makes up for where the legs come to rest [1/s]
    integral: Annotated[float, NOT_NEGATIVE] = from_core("controller.tracking.integral")
    # of such a pose error that is left [m] x3, [rad] x3
    band: SixPositive = from_core("controller.tracking.band")


class Controller(Block):
    """The control law. Each law has a separate block, and only the selected one has an effect."""

    law: Annotated[str, Choice(ALL_LAWS)] = LAWS[0]  # that acts, with the gains of its block
    # consistent: the sign of the plant; printed: (8) as it stands
    jacobian: Annotated[Literal["consistent", "printed"], Choice()] = "consistent"
    switching: Switching = Field(default_factory=Switching)
    safe: Annotated[Safe, SAMPLED] = Field(default_factory=Safe)
    virtual_platform: Annotated[VirtualPlatform, SAMPLED] = Field(default_factory=VirtualPlatform)
    hybrid: Hybrid = Field(default_factory=Hybrid)
    composite: Composite = Field(default_factory=Composite)
    kelly: Kelly = Field(default_factory=Kelly)
    resolved_rate: ResolvedRate = Field(default_factory=ResolvedRate)
    pbvs: Pbvs = Field(default_factory=Pbvs)
    computed_torque: ComputedTorque = Field(default_factory=ComputedTorque)
    tracking: Tracking = Field(default_factory=Tracking)

    @property
    def gains(self) -> Any:
        """The block of the selected law."""
        return getattr(self, self.law)

    @property
    def traits(self) -> _core.LawTraits:
        """What there is to know of the selected law without its equation."""
        return _core.LAW_TRAITS[self.law]
