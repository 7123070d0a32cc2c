"""Random failures whose cause is known: a passing scenario is drawn, and one fault is put into it.

`variation(cause, seed)` draws a baseline (law, camera, devices, target, goal, gains and small model errors) and one
fault of the cause, both from the ranges below, which were fixed before any rule of the diagnosis was tuned. What counts
is used: the baseline passes and the same scenario with the fault fails, both by the criterion of
`hexservo.findings.diagnosis`. The fault is then the truth, whatever else would cure the run as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

import hexservo as hs
from hexservo.scenario.parameters import frame_period

KEPT_APART = 10000
"""Seeds below 1000 are for tuning, from this one on for the test alone."""


@dataclass(frozen=True)
class Uniform:
    low: float
    high: float

    def draw(self, random: np.random.Generator) -> float:
        return float(random.uniform(self.low, self.high))


@dataclass(frozen=True)
class LogUniform:
    low: float
    high: float

    def draw(self, random: np.random.Generator) -> float:
        return math.exp(random.uniform(math.log(self.low), math.log(self.high)))


@dataclass(frozen=True)
class EitherSign:
    """As large as `low` to `high`, with a random sign."""

    low: float
    high: float

    def draw(self, random: np.random.Generator) -> float:
        return float(random.uniform(self.low, self.high) * random.choice([-1.0, 1.0]))


@dataclass(frozen=True)
class Choice:
    values: tuple[Any, ...]

    def draw(self, random: np.random.Generator) -> Any:
        return self.values[int(random.integers(len(self.values)))]


@dataclass(frozen=True)
class Several:
    """Numbers drawn one by one."""

    count: int
    each: Uniform | EitherSign

    def draw(self, random: np.random.Generator) -> list[float]:
        return [self.each.draw(random) for _ in range(self.count)]


Range = Uniform | LogUniform | EitherSign | Choice | Several

# ---- Baselines: what passes ------------------------------------------------------------------------------------------

TASK: dict[str, Range] = {
    "turn": Uniform(-math.pi, math.pi),  # of the target about the image centre [rad]
    "size": Uniform(0.85, 1.2),  # of the target, about the image centre
    "jitter": Uniform(0.0, 3.0),  # of each feature coordinate, standard deviation [px]
    "shift": Uniform(14.0, 28.0),  # of the goal against the start [px]
    "direction": Uniform(-math.pi, math.pi),  # of the shift [rad]
    "roll": Uniform(-0.03, 0.03),  # of the goal about the optical axis [rad]
    "zoom": Uniform(0.99, 1.01),  # of the goal
}
MODEL: dict[str, Range] = {
    "target.depth": Uniform(0.4, 0.6),
    "uncertainty.inertia": Uniform(-0.075, 0.075),
    "uncertainty.coriolis": Uniform(-0.125, 0.125),
    "uncertainty.depth": Uniform(-0.3, 0.3),  # the same for all points
}
GAINS: dict[str, Range] = {"stiffness": Uniform(0.8, 1.25), "damping": Uniform(0.8, 1.25)}  # times the default
COMMON = {**TASK, **MODEL, **GAINS}

STEADY: dict[str, Range] = {"uncertainty.gravity": Uniform(-0.001, 0.001)}  # what laws without an integrator hold
LIGHT: dict[str, Range] = {"uncertainty.gravity": Uniform(-0.02, 0.02)}
WEIGHT = {"hybrid": STEADY, "kelly": STEADY}  # other laws: LIGHT

STIFFNESS = {
    "hybrid": "hybrid.kp",
    "composite": "composite.kt",
    "kelly": "kelly.kp",
    "resolved_rate": "resolved_rate.gain",
    "pbvs": "pbvs.kp",
    "computed_torque": "computed_torque.kp",
}
DAMPING = {
    "hybrid": "hybrid.kv",
    "composite": "composite.kd",
    "kelly": "kelly.kd",
    "resolved_rate": "resolved_rate.ki",
    "pbvs": "pbvs.kd",
    "computed_torque": "computed_torque.kd",
}

IMAGE: dict[str, Range] = {"camera.noise": Uniform(0.0, 0.2), "camera.quantisation": Uniform(0.0, 0.25)}
CAMERAS: dict[str, tuple[Mapping[str, Any], Mapping[str, Range]]] = {
    "every_tick": ({"camera.period": 0.001, "camera.latency": 0.0}, IMAGE),
    "frames": (
        {"camera.period": 0.010, "camera.latency": 0.010},
        {**IMAGE, "camera.dropout": Uniform(0.0, 0.1), "camera.latency_jitter": Choice((0.0, 0.001, 0.002))},
    ),
    "predicted": (
        {"camera.period": 0.033, "camera.latency": 0.033, "camera.prediction": "encoder"},
        {**IMAGE, "camera.dropout": Uniform(0.0, 0.1), "camera.latency_jitter": Choice((0.0, 0.002, 0.004))},
    ),
    "slow": (
        {"camera.period": 0.033, "camera.latency": 0.010},
        {**IMAGE, "camera.latency_jitter": Choice((0.0, 0.002, 0.004))},
    ),
}
CAMERAS_OF: dict[str, Sequence[str]] = {
    "hybrid": ("every_tick", "predicted"),
    "kelly": ("every_tick", "predicted"),
}  # other laws: the next line
QUICK = ("every_tick", "frames", "predicted")

ENCODERS: dict[str, Range] = {"sensors.noise": Uniform(0.0, 2e-7), "sensors.resolution": Uniform(0.0, 2e-7)}
LEGS: dict[str, Range] = {
    "actuators.quantisation": Uniform(0.0, 5e-4),
    "actuators.bandwidth": Uniform(150.0, 400.0),
    "actuators.delay": Choice((0.0, 0.001)),
}
DEVICES: dict[str, tuple[Mapping[str, Any], Mapping[str, Range]]] = {
    "ideal": ({}, {}),
    "encoders": ({"sensors.pose": "encoders"}, ENCODERS),
    "real": ({"sensors.pose": "encoders", "actuators.hold": "leg_forces"}, {**ENCODERS, **LEGS}),
    "road": (
        {"actuators.hold": "leg_forces", "base_motion.kind": "sinusoid"},
        {**LEGS, "base_motion.amplitude": Several(3, Uniform(-0.03, 0.03)), "base_motion.frequency": Uniform(0.5, 3.0)},
    ),
    "positions": (  # whose legs follow as those of good drives do; of causes that name them alone
        {"actuators.kind": "position"},
        {"actuators.position.bandwidth": Uniform(15.0, 40.0), "actuators.position.damping": Uniform(0.7, 1.2)},
    ),
    "motors": (  # likewise, by motors that are stiff compared with the weight
        {"actuators.kind": "position_torque", "actuators.position.bandwidth": 60.0, "simulation.substeps": 2},
        {
            "actuators.motor.kp": LogUniform(4e3, 1e4),
            "actuators.motor.kv": Uniform(12.0, 25.0),
            "actuators.motor.friction": Uniform(0.0, 2e-3),
            "actuators.motor.armature": Uniform(0.0, 5e-3),
        },
    ),
}
ALL_LAWS = tuple(STIFFNESS)
IMPLICIT: dict[str, Any] = {"simulation.mode": "sampled", "controller.switching.kind": "implicit"}
CONTINUOUS: dict[str, Any] = {"simulation.mode": "continuous", "controller.switching.kind": "tanh"}

PAPER = (30.0, 18.0, 65.0, -65.0, -44.0, 37.0, -10.0, -15.0)  # four features [px]
WIDE = (105.0, 90.0, -95.0, 110.0, -115.0, -95.0, 90.0, -105.0)  # well spread
CLUSTER = (-4.0, -4.0, 4.0, -5.0, -3.0, 3.0, 5.0, 4.0)  # on a small spot
LINE = (60.0, 3.0, 20.0, -2.0, -20.0, 2.0, -60.0, -3.0)  # almost on one line


# ---- Faults ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Fault:
    """One form that a cause takes.

    Ranges name keys of a scenario, or changes of `_apply`. "slower", "stiffer", "friction", "adaptation", "drive" and
    "prior" are factors of gains, "tick" a servo period, "border", "timeout", "brake" and "noise_of_goal" as commented
    there.
    """

    ranges: Mapping[str, Range]
    changes: Mapping[str, Any] = field(default_factory=dict)  # that the fault makes beside what is drawn
    laws: Sequence[str] = ALL_LAWS
    cameras: Sequence[str] | None = None  # None: those of the law
    devices: Sequence[str] = ("ideal", "encoders", "real", "road")
    base: Mapping[str, Any] = field(default_factory=dict)  # of the baseline too
    base_ranges: Mapping[str, Range] = field(default_factory=dict)  # likewise
    features: Sequence[float] | None = None  # of the fault's target
    base_features: Sequence[float] = PAPER
    continuous: bool = False  # the baseline in continuous mode


FRICTION = ("hybrid", "composite")
IMAGE_LAWS = ("kelly", "composite", "resolved_rate", "computed_torque")
ORDINARY_NOISE: dict[str, Range] = {"camera.noise": Uniform(0.25, 0.5), "uncertainty.depth": Uniform(-0.15, 0.15)}
SIGNED: dict[str, Range] = {"uncertainty.depth": Several(4, EitherSign(0.12, 0.35))}
DRIFTING: dict[str, Any] = {"simulation.duration": 5.0}

ON_POSITIONS: dict[str, Any] = {"laws": ("tracking",), "cameras": ("every_tick", "frames"), "devices": ("positions",)}
FOLLOWING: dict[str, Any] = {  # the law that is made for a target that moves
    **ON_POSITIONS,
    "base": {
        "controller.tracking.follow": "direction",
        "controller.tracking.noise": 0.05,
        "controller.tracking.bandwidth": 8.0,
        "target.motion.kind": "sinusoid",
    },
    "base_ranges": {
        "camera.noise": Uniform(0.02, 0.1),
        "camera.quantisation": Uniform(0.0, 0.1),
        "actuators.position.bandwidth": Uniform(2.5, 5.0),
        "target.motion.amplitude": Several(3, EitherSign(0.004, 0.012)),
        "target.motion.frequency": Uniform(0.3, 0.7),
        "target.motion.phase": Uniform(-math.pi, math.pi),
        "roll": Uniform(0.0, 0.0),  # a ray has none
        "zoom": Uniform(1.0, 1.0),
    },
}

FAULTS: dict[str, tuple[Fault, ...]] = {
    "wrong_sign": (
        Fault({}, {"controller.jacobian": "printed"}, ("hybrid", "kelly", "composite", *IMAGE_LAWS[2:])),
        Fault({}, {"controller.jacobian": "printed"}, ("hybrid", "kelly"), continuous=True),
    ),
    "pixel_noise": (Fault({"camera.noise": LogUniform(1.5, 15.0)}),),
    "pixel_quantisation": (Fault({"camera.quantisation": LogUniform(4.0, 40.0)}),),
    "outliers": (
        Fault({"camera.outlier_probability": Uniform(0.03, 0.4), "camera.outlier_size": LogUniform(10.0, 100.0)}),
    ),
    "lost_features": (
        *(
            Fault({"border": Uniform(2.0, 8.0)}, {"camera.on_lost": lost}, IMAGE_LAWS, ("frames",))
            for lost in ("hold", "stop")
        ),
        Fault(
            {"camera.dropout": Uniform(0.85, 0.97)}, {}, ("composite", "computed_torque", "resolved_rate"), ("slow",)
        ),
    ),
    "image_timeout": (
        Fault(
            {"timeout": Uniform(1.0, 1.3)},
            cameras=("frames", "predicted"),
            base_ranges={"camera.dropout": Uniform(0.75, 0.92)},
        ),
    ),
    "late_camera": (
        Fault(
            {
                "camera.period": Choice((0.005, 0.010, 0.020, 0.033)),
                "camera.latency": Choice((0.005, 0.010, 0.020, 0.033)),
            },
            laws=("hybrid", "kelly"),
            cameras=("every_tick",),
        ),
        Fault(
            {"camera.period": Choice((0.033, 0.050, 0.066)), "camera.latency": Choice((0.050, 0.066, 0.100, 0.150))},
            laws=("composite", "computed_torque", "resolved_rate", "pbvs"),
            cameras=("every_tick", "frames"),
        ),
        Fault(
            {"camera.latency_jitter": Choice((0.060, 0.100, 0.200))}, laws=("composite", "pbvs"), cameras=("frames",)
        ),
    ),
    "encoder_noise": (Fault({"sensors.noise": LogUniform(2e-6, 5e-4)}, devices=("encoders", "real")),),
    "encoder_resolution": (Fault({"sensors.resolution": LogUniform(5e-6, 2e-3)}, devices=("encoders", "real")),),
    "encoder_period": (
        Fault({"sensors.period": Choice((0.005, 0.010, 0.020, 0.040, 0.080))}, devices=("encoders", "real")),
    ),
    "actuator_delay": (
        Fault({"actuators.delay": Choice((0.003, 0.004, 0.005, 0.006, 0.007, 0.008))}, laws=("hybrid", "kelly")),
        Fault(
            {"actuators.delay": Choice((0.005, 0.006, 0.007, 0.008))},
            laws=("composite", "pbvs", "computed_torque"),
            base_ranges={"stiffer": Uniform(2.0, 4.0)},
        ),
    ),
    "actuator_lag": (Fault({"actuators.bandwidth": LogUniform(0.3, 12.0)}),),
    "actuator_quantisation": (Fault({"actuators.quantisation": LogUniform(0.01, 0.5)}),),
    "saturation": (
        Fault({"robot.force_limit": Uniform(0.105, 0.131)}, {"actuators.saturation": True}, devices=("ideal", "real")),
    ),
    "base_motion": (
        Fault(
            {"base_motion.amplitude": Several(3, EitherSign(0.5, 6.0)), "base_motion.frequency": LogUniform(0.3, 5.0)},
            {"base_motion.kind": "sinusoid"},
        ),
        Fault({"base_motion.level": LogUniform(0.1, 20.0)}, {"base_motion.kind": "noise"}, devices=("ideal", "real")),
        Fault(
            {
                "base_motion.rotation.amplitude": Several(3, EitherSign(0.05, 0.3)),
                "base_motion.rotation.frequency": LogUniform(0.3, 3.0),
            },
            {"base_motion.rotation.kind": "sinusoid"},
            devices=("ideal", "real"),
        ),
    ),
    "target_motion": (
        Fault(
            {
                "target.motion.amplitude": Several(3, EitherSign(0.01, 0.05)),
                "target.motion.frequency": LogUniform(0.3, 3.0),
            },
            {"target.motion.kind": "sinusoid"},
            devices=("ideal", "real"),
        ),
    ),
    "gravity": (
        Fault({"uncertainty.gravity": EitherSign(0.025, 0.075)}, laws=("hybrid", "kelly")),
        Fault({"uncertainty.gravity": EitherSign(0.3, 0.9)}, laws=("pbvs", "computed_torque", "resolved_rate")),
        Fault({"uncertainty.gravity": EitherSign(0.025, 0.075)}, laws=("hybrid", "kelly"), continuous=True),
    ),
    "inertia": (Fault({"uncertainty.inertia": EitherSign(0.5, 0.99)}),),
    "coriolis": (Fault({"uncertainty.coriolis": EitherSign(0.5, 0.99)}),),
    "calibration": (Fault({"uncertainty.mount.rotation": Several(3, EitherSign(0.6, 1.5))}),),
    "unequal_depth": (
        Fault(SIGNED, laws=("pbvs", "resolved_rate"), base={**DRIFTING, "controller.pbvs.prior": 0.0}),
        Fault(SIGNED, laws=("pbvs", "resolved_rate"), base={**DRIFTING, "controller.pbvs.prior": 0.0}, continuous=True),
        Fault(SIGNED, laws=("computed_torque",), base={**DRIFTING, "controller.computed_torque.prior": 0.0}),
    ),
    "common_depth": (
        Fault({"uncertainty.depth": Uniform(-0.98, -0.7)}),
        Fault({"uncertainty.depth": Uniform(0.8, 0.99)}),
    ),
    "spring": (
        Fault({"adaptation": LogUniform(0.0003, 0.006)}, laws=("hybrid",)),
        Fault({"adaptation": LogUniform(0.0003, 0.006)}, laws=("hybrid",), continuous=True),
    ),
    "stiction": (
        Fault({"friction": LogUniform(60.0, 250.0)}, laws=("hybrid",)),
        Fault({"friction": LogUniform(60.0, 250.0)}, laws=("hybrid",), base={"controller.hybrid.fuzzy.enabled": False}),
        Fault({"friction": LogUniform(60.0, 250.0)}, laws=("composite",)),
    ),
    "switching": (
        Fault(
            {"controller.switching.width": LogUniform(0.1, 30.0)}, {"controller.switching.kind": "tanh"}, ("hybrid",)
        ),
        Fault(
            {"controller.switching.width": LogUniform(0.1, 30.0)},
            {"controller.switching.kind": "saturation"},
            ("hybrid",),
            continuous=True,
        ),
        Fault({}, {"controller.switching.kind": "sign"}, ("hybrid",)),
    ),
    "weights": (
        Fault({"initial_scale": EitherSign(0.1, 1.0)}, laws=FRICTION),
        Fault(
            {"leakage": LogUniform(5.0, 500.0)},
            laws=("composite",),
            base_ranges={"uncertainty.gravity": EitherSign(0.1, 0.3)},
        ),
        Fault(
            {"weight_limit": LogUniform(1e-5, 3e-2)},
            laws=("composite",),
            base_ranges={"uncertainty.gravity": EitherSign(0.1, 0.3)},
        ),
        Fault(
            {"dead_zone": LogUniform(0.01, 1.0)},
            laws=("composite",),
            base_ranges={"uncertainty.gravity": EitherSign(0.1, 0.3)},
        ),
    ),
    "prior": (
        Fault({"prior": LogUniform(100.0, 1e5)}, laws=("composite", "computed_torque")),
        Fault({"controller.resolved_rate.damping": LogUniform(1e7, 1e9)}, laws=("resolved_rate",)),
    ),
    "gains_high": (Fault({"slower": LogUniform(1.0 / 80.0, 1.0 / 10.0)}, cameras=("every_tick",)),),
    "gains_low": (Fault({"slower": LogUniform(10.0, 80.0)}),),
    "coarse_step": (
        Fault(
            {"tick": Choice((0.005, 0.008, 0.010, 0.020))},
            laws=("hybrid",),
            cameras=("every_tick",),
            devices=("ideal",),
        ),
        Fault({"tick": Choice((0.020, 0.025, 0.040))}, laws=("kelly",), cameras=("every_tick",), devices=("ideal",)),
        Fault({"tick": Choice((0.020, 0.025, 0.040, 0.050))}, laws=("kelly", "hybrid"), continuous=True),
    ),
    "duration": (
        Fault({"simulation.duration": Choice((0.01, 0.02, 0.03, 0.05))}),
        Fault({"metrics.dwell": Uniform(1.7, 1.98)}),
    ),
    "poor_image": tuple(
        Fault(
            {"size": size, "jitter": jitter},
            laws=("resolved_rate", "pbvs"),
            cameras=("frames",),
            devices=("ideal", "real"),
            base_ranges=ORDINARY_NOISE,
            features=features,
            base_features=WIDE,
        )
        for features, size, jitter in (
            (CLUSTER, Uniform(0.8, 1.2), Uniform(0.0, 0.8)),
            (LINE, Uniform(0.5, 0.9), Uniform(0.0, 0.5)),
        )
    ),
    "leg_limits": tuple(
        Fault(
            {"roll": EitherSign(0.28, 0.42), "shift": Uniform(0.0, 6.0), "zoom": Uniform(0.97, 1.03)},
            {"robot.on_limit": limit},
            ("composite", "computed_torque", "resolved_rate", "pbvs"),
        )
        for limit in ("stop", "report")
    ),
    "impossible_goal": (
        Fault({"noise_of_goal": Uniform(5.0, 12.0)}, laws=tuple(law for law in ALL_LAWS if law != "pbvs")),
    ),
    "false_equilibrium": (
        Fault(
            {
                "half_side": Uniform(0.011, 0.013),  # of a square [m]
                "tilt": Uniform(0.1, 0.2),  # of it [rad]
                "way": Uniform(0.6, 0.7),  # of the goal about the square [rad]
                "kp": Uniform(1.0, 2.0),
                "kd": Uniform(0.8, 1.25),
            },
            laws=("kelly",),
        ),
    ),
    "band": (Fault({"metrics.band": LogUniform(0.005, 0.2)}),),
    "brake": (
        Fault(
            {"brake": LogUniform(10.0, 200.0)},
            cameras=("frames", "predicted"),
            base={"camera.timeout": 0.070},
            base_ranges={"camera.dropout": Uniform(0.2, 0.6)},
        ),
    ),
    "position_lag": (
        Fault({"actuators.position.bandwidth": LogUniform(0.05, 3.0)}, devices=("positions",)),
        Fault({"actuators.position.damping": LogUniform(3.0, 100.0)}, devices=("positions",)),
        Fault({"actuators.position.damping": LogUniform(0.001, 0.03)}, devices=("positions",)),
    ),
    "leg_rates": (
        Fault({"actuators.position.speed_limit": LogUniform(2e-4, 1e-2)}, devices=("positions",)),
        Fault({"actuators.position.acceleration_limit": LogUniform(2e-4, 3e-2)}, devices=("positions",)),
    ),
    "motors": (
        Fault({"actuators.motor.kp": LogUniform(5.0, 40.0)}, devices=("motors",)),
        Fault({"robot.force_limit": Uniform(0.105, 0.131)}, devices=("motors",)),
    ),
    "stick_slip": (Fault({"actuators.motor.friction": LogUniform(15.0, 80.0)}, devices=("motors",)),),
    "lag_not_led": tuple(
        Fault({"controller.tracking.lead": share}, **FOLLOWING) for share in (Uniform(0.0, 0.4), Uniform(2.0, 6.0))
    ),
    "target_filter": tuple(
        Fault({f"controller.tracking.{name}": values}, **FOLLOWING)
        for name, values in {
            "noise": LogUniform(1.0, 50.0),
            "acceleration": LogUniform(50.0, 5e3),
            "jump": LogUniform(0.005, 0.3),
            "certainty": LogUniform(8.0, 100.0),
        }.items()
    ),
    "image_smoothing": (
        Fault({"camera.smoothing": LogUniform(0.03, 1.0)}),
        Fault({"camera.smoothing": LogUniform(0.03, 1.0)}, cameras=("predicted",)),
    ),
    "latency_error": tuple(
        Fault({"uncertainty.latency": Choice(tuple(tick / 1000 for tick in ticks))}, cameras=("predicted",))
        for ticks in (range(15, 121), range(-33, -14))
    ),
    "direction_alone": (
        Fault(
            {},
            {"controller.tracking.follow": "direction"},
            base_ranges={"roll": EitherSign(0.06, 0.15)},
            **ON_POSITIONS,
        ),
    ),
    "leg_feedback": (Fault({"controller.tracking.feedback": LogUniform(60.0, 300.0)}, **ON_POSITIONS),),
    "gate": (
        Fault(
            {"camera.gate": LogUniform(0.1, 1.0)},
            cameras=("predicted",),
            base={"camera.timeout": 0.3},
            base_ranges={"camera.noise": Uniform(0.3, 1.2)},
        ),
    ),
    "fast_adaptation": (Fault({"drive": LogUniform(15.0, 100.0)}, laws=("composite",)),),
}
"""What `variation` draws from, beside the baselines; a fault of a cause is drawn first."""

CAUSES = tuple(FAULTS)


# ---- Drawing --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Variation:
    """A scenario with one fault, and the same one without it."""

    cause: str
    seed: int
    scenario: hs.Scenario
    baseline: hs.Scenario


def shipped(cause: str) -> str:
    """Give the name of the packaged scenario of a cause."""
    return f"fails-{cause.replace('_', '-')}"


def variation(cause: str, seed: int) -> Variation:
    """Draw a baseline and a fault."""
    random = np.random.default_rng([CAUSES.index(cause), seed])
    fault = FAULTS[cause][int(random.integers(len(FAULTS[cause])))]
    if cause == "false_equilibrium":
        scenario = _trap(fault, random)
        return Variation(cause, seed, scenario, scenario.updated({"controller.law": "pbvs"}))
    law = str(random.choice(list(fault.laws)))
    if fault.continuous:
        camera, devices = "", ""
    else:
        cameras: Sequence[str] = fault.cameras or CAMERAS_OF.get(law, QUICK)
        camera = str(random.choice(list(cameras)))
        devices = str(random.choice(list(fault.devices)))
    mode = CONTINUOUS if fault.continuous else IMPLICIT
    fixed: dict[str, Any] = {**mode, **fault.base}
    ranges: dict[str, Range] = {**COMMON, **WEIGHT.get(law, LIGHT)}
    for part, name in ((CAMERAS, camera), (DEVICES, devices)):
        if name:
            fixed |= part[name][0]
            ranges |= part[name][1]
    drawn = {name: rule.draw(random) for name, rule in {**ranges, **fault.base_ranges}.items()}
    drawn_fault = {name: rule.draw(random) for name, rule in fault.ranges.items()}
    jitter = random.normal(0.0, 1.0, (4, 2))
    start, goal = _task(drawn, fault.base_features, jitter)
    plain = {"controller.law": law, "simulation.duration": 2.0, **fixed}
    baseline = _bare(law, tuple(sorted((key, _frozen(value)) for key, value in plain.items())))
    changes: dict[str, Any] = {} if fault.continuous else {"seed": seed}
    changes |= {"target.initial_features": start.tolist(), "target.desired_features": goal.tolist()}
    changes |= {key: value for key, value in drawn.items() if "." in key}
    changes |= _gains(baseline, law, drawn)
    baseline = baseline.updated(changes)
    task = {name: drawn_fault.get(name, drawn[name]) for name in TASK}
    features = fault.features or fault.base_features
    with_fault = {**fault.changes, **{key: value for key, value in drawn_fault.items() if "." in key}}
    with_fault |= _gains(baseline, law, drawn_fault)
    if fault.features is not None or any(name in drawn_fault for name in TASK):
        start, goal = _task(task, features, jitter)
        with_fault |= {"target.initial_features": start.tolist(), "target.desired_features": goal.tolist()}
    with_fault |= _others(baseline, drawn_fault, start, goal, random)
    return Variation(cause, seed, baseline.updated(with_fault), baseline)


@cache
def _bare(law: str, changes: tuple[tuple[str, Any], ...]) -> hs.Scenario:
    target = {"initial_features": list(PAPER), "desired_features": list(PAPER)}
    return hs.Scenario(name="variation", target=target).updated(dict(changes))


def _frozen(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _gains(scenario: hs.Scenario, law: str, drawn: Mapping[str, Any]) -> dict[str, Any]:
    """Give the gains of a law, multiplied as drawn."""
    controller = scenario.controller
    block = getattr(controller, law)
    changes: dict[str, Any] = {}

    def multiply(key: str, factor: float) -> None:
        value = changes.get(f"controller.{key}")
        if value is None:
            value = controller
            for part in key.split("."):
                value = getattr(value, part)
        changes[f"controller.{key}"] = (np.asarray(value, dtype=float) * factor).tolist()

    if "stiffness" in drawn and law in STIFFNESS:
        multiply(STIFFNESS[law], drawn["stiffness"])
    damps = law in DAMPING and (law != "resolved_rate" or scenario.actuators.kind == "force")  # ki acts on forces
    if "damping" in drawn and damps:
        multiply(DAMPING[law], drawn["damping"])
    if "stiffer" in drawn:  # with the damping that belongs to it
        square = law != "resolved_rate"
        multiply(STIFFNESS[law], drawn["stiffer"] ** 2 if square else drawn["stiffer"])
        multiply(DAMPING[law], drawn["stiffer"])
    if "friction" in drawn:
        multiply(f"{law}.kv", drawn["friction"])
    if "adaptation" in drawn:  # [m/N], [rad/(N m)] of the paper's 10
        multiply(f"{law}.fuzzy.adaptation", drawn["adaptation"])
    if "drive" in drawn:
        multiply(f"{law}.drive", drawn["drive"])
    if "prior" in drawn:
        multiply(f"{law}.prior", drawn["prior"])
    if "slower" in drawn:  # the same loop in another time: forces by the square, dampings by the first power
        rate = 1.0 / drawn["slower"]
        for name in ("kp", "kt", "kd", "ki", "gain", "gain_far", "gain_slope", "kv", "drive"):
            if hasattr(block, name):
                first = name in ("kd", "ki", "gain", "gain_far", "gain_slope", "drive")
                multiply(f"{law}.{name}", rate if first else rate**2)
        if hasattr(block, "fuzzy"):
            multiply(f"{law}.fuzzy.adaptation", rate**-2)
            multiply(f"{law}.fuzzy.rate_scale", rate**-3 if law == "hybrid" else rate**-1)
            if law == "hybrid":
                multiply(f"{law}.fuzzy.error_scale", rate**-2)
    for name in ("initial_scale", "leakage", "weight_limit", "dead_zone"):
        if name in drawn:  # moments and turns in the proportion of K_v
            value = drawn[name]
            arms = 1.0 if name in ("leakage", "dead_zone") else 0.05
            changes[f"controller.{law}.fuzzy.{name}"] = [value] * 3 + [value * arms] * 3
    return changes


def _others(
    baseline: hs.Scenario,
    drawn: Mapping[str, Any],
    start: np.ndarray,
    goal: np.ndarray,
    random: np.random.Generator,
) -> dict[str, Any]:
    """Give the changes of what is neither a key nor a gain nor of the task."""
    changes: dict[str, Any] = {}
    if "tick" in drawn:  # a camera that gives a frame at every tick
        changes["simulation.step"] = drawn["tick"]
        if baseline.simulation.mode == "sampled":
            changes["camera.period"] = drawn["tick"]
    if "timeout" in drawn:  # of the age that every frame has when the next one comes, were none lost
        camera = baseline.camera
        age = drawn["timeout"] * (frame_period(baseline) + camera.latency + camera.latency_jitter)
        changes["camera.timeout"] = round(math.ceil(age / 0.001 - 1e-9) * 0.001, 9)
    if "brake" in drawn:  # damping, of the critical one at 100 rad/s
        inertia = [baseline.robot.mass] * 3 + list(baseline.robot.inertia)
        changes["controller.safe.damping"] = [drawn["brake"] * 200.0 * part for part in inertia]
    if "border" in drawn:
        reach = np.abs(goal.reshape(4, 2)).max(axis=0)
        outer = int(np.argmax(reach))
        half = np.abs(start.reshape(4, 2)).max(axis=0) + 20.0
        half[outer] = reach[outer] - drawn["border"]
        changes["camera.image_size"] = (2.0 * half).tolist()
    if "noise_of_goal" in drawn:  # [px]: features that no pose shows
        wrong = goal + random.normal(0.0, drawn["noise_of_goal"], 8)
        changes["target.desired_features"] = wrong.round(6).tolist()
    return changes


def _task(drawn: Mapping[str, Any], features: Any, jitter: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Give start and goal features, (8,) each [px]: points in one plane, so that the goal is a pose that there is."""
    points = np.asarray(features, dtype=float).reshape(4, 2)
    start = drawn["size"] * points @ _turn(drawn["turn"]).T + drawn["jitter"] * jitter
    shift = drawn["shift"] * np.array([math.cos(drawn["direction"]), math.sin(drawn["direction"])])
    goal = drawn["zoom"] * start @ _turn(drawn["roll"]).T + shift
    return start.round(6).ravel(), goal.round(6).ravel()


def _turn(angle: float) -> np.ndarray:
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def _trap(fault: Fault, random: np.random.Generator) -> hs.Scenario:
    """Vary the packaged false equilibrium: tilt and size of the square, the goal's way about it, and the gains."""
    from hexservo import _core

    drawn: dict[str, Any] = {name: rule.draw(random) for name, rule in fault.ranges.items()}
    scenario = hs.load_scenario("false-equilibrium")
    half, centre = drawn["half_side"], np.array([0.0, 0.0, -0.3])
    corners = half * np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])
    points = centre + corners @ _about_y(drawn["tilt"]).T
    turned = _about_y(drawn["way"])
    position = centre + turned @ (np.array([0.0, 0.0, -0.2]) - centre)
    quaternion = [math.cos(drawn["way"] / 2.0), 0.0, math.sin(drawn["way"] / 2.0), 0.0]
    camera = _core.Camera()
    goal, _ = _core.take_image(camera, position, quaternion, points)
    law = scenario.controller.kelly
    return scenario.updated(
        {
            "target.points": points.tolist(),
            "target.desired_features": goal.tolist(),
            "controller.kelly.kp": (np.asarray(law.kp) * drawn["kp"]).tolist(),
            "controller.kelly.kd": (np.asarray(law.kd) * drawn["kd"]).tolist(),
            "simulation.duration": 10.0,
        }
    )


def _about_y(angle: float) -> np.ndarray:
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
