"""Compiled core of hexservo; private. Units and frames: the core's own docstrings and docs/model.md, section 1."""

import enum
from collections.abc import Callable, Sequence
from typing import NoReturn, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Array = NDArray[np.float64]

class _PybindType(type): ...

ROBOT_PRESETS: tuple[str, ...]
TERM_CENTRES: tuple[float, ...]

class BatchLog(enum.Enum):
    __pybind11_native_enum__: object
    metrics = 0
    last_sample = 1
    trajectory = 2

class InputStatus(enum.Enum):
    __pybind11_native_enum__: object
    valid = 0
    unusable = 1
    missing_image = 2
    stale_image = 3
    lost_feature = 4

class StopCause(enum.Enum):
    __pybind11_native_enum__: object
    none = 0
    not_finite = 1
    feature_error = 2
    twist = 3
    behind_camera = 4
    feature_lost = 5
    leg_limit = 6
    singular = 7
    solver_failed = 8

class CameraConvention(enum.Enum):
    __pybind11_native_enum__: object
    eye_in_hand = 0
    as_printed = 1

class JacobianConvention(enum.Enum):
    __pybind11_native_enum__: object
    consistent = 0
    printed = 1

class KinematicsStatus(enum.Enum):
    __pybind11_native_enum__: object
    converged = 0
    not_converged = 1
    singular = 2

class LimitKind(enum.Enum):
    __pybind11_native_enum__: object
    stroke = 0
    force = 1

class Outcome(enum.Enum):
    __pybind11_native_enum__: object
    completed = 0
    diverged = 1
    behind_camera = 2
    feature_lost = 3
    leg_limit = 4
    singular = 5
    solver_failed = 6
    interrupted = 7

class JacobianPoint(enum.Enum):
    __pybind11_native_enum__: object
    current = 0
    desired = 1
    mean = 2

class SwitchingKind(enum.Enum):
    __pybind11_native_enum__: object
    sign = 0
    tanh = 1
    saturation = 2
    implicit = 3
    implicit_coupled = 4

class LoopMode(enum.Enum):
    __pybind11_native_enum__: object
    continuous = 0
    sampled = 1

class Prediction(enum.Enum):
    __pybind11_native_enum__: object
    none = 0
    encoder = 1

class LostFeature(enum.Enum):
    __pybind11_native_enum__: object
    hold = 0
    predict = 1
    stop = 2

class FrameSettings(metaclass=_PybindType):
    """Faults of the camera in sampled mode, and what stands in for missing images."""

    def __init__(self) -> None: ...
    prediction: Prediction
    on_lost: LostFeature
    noise: float
    quantisation: float
    dropout: float
    outlier_probability: float
    outlier_size: float
    image_size: _Array

class CameraSampling(metaclass=_PybindType):
    """The camera in sampled mode."""

    def __init__(self) -> None: ...
    period: float
    latency: float
    latency_jitter: float
    timeout: float
    faults: FrameSettings

class PoseSource(enum.Enum):
    __pybind11_native_enum__: object
    truth = 0
    encoders = 1

class RateSource(enum.Enum):
    __pybind11_native_enum__: object
    differences = 0
    true_rates = 1

class ActuatorHold(enum.Enum):
    __pybind11_native_enum__: object
    wrench = 0
    leg_forces = 1

class BaseMotionKind(enum.Enum):
    __pybind11_native_enum__: object
    none = 0
    sinusoid = 1
    recorded = 2
    noise = 3

class LimitPolicy(enum.Enum):
    __pybind11_native_enum__: object
    report = 0
    stop = 1

class EncoderParameters(metaclass=_PybindType):
    """Leg length encoders."""

    def __init__(self) -> None: ...
    resolution: float
    noise: float
    rates: RateSource

class SensorSettings(metaclass=_PybindType):
    """How the controller knows pose and twist in sampled mode."""

    def __init__(self) -> None: ...
    pose: PoseSource
    period: float
    encoders: EncoderParameters

class ActuatorParameters(metaclass=_PybindType):
    """The actuators of the legs."""

    def __init__(self) -> None: ...
    hold: ActuatorHold
    saturation: bool
    bandwidth: float
    quantisation: float

class ActuatorSettings(metaclass=_PybindType):
    """The actuators in sampled mode."""

    def __init__(self) -> None: ...
    delay: float
    actuators: ActuatorParameters

class BaseMotionParameters(metaclass=_PybindType):
    """Acceleration of the base, but for what is recorded."""

    def __init__(self) -> None: ...
    kind: BaseMotionKind
    amplitude: _Array
    frequency: float
    phase: float
    level: _Array
    low_frequency: float
    high_frequency: float

class BaseMotionSettings(metaclass=_PybindType):
    """How the base moves in sampled mode."""

    def __init__(self) -> None: ...
    motion: BaseMotionParameters
    @property
    def samples(self) -> _Array | None: ...
    @samples.setter
    def samples(self, arg1: ArrayLike | None) -> None: ...
    sample_period: float

class RigidBody(metaclass=_PybindType):
    """Mass properties of the platform."""

    def __init__(self) -> None: ...
    mass: float
    inertia: _Array
    gravity: float
    @property
    def gravity_wrench(self) -> _Array: ...

class DynamicsError(metaclass=_PybindType):
    """Relative errors of the estimated dynamics, (3)."""

    def __init__(self) -> None: ...
    inertia: _Array
    coriolis: _Array
    gravity: _Array

class RobotParameters(metaclass=_PybindType):
    """A robot as a user describes it."""

    def __init__(self) -> None: ...
    platform_radius: float
    base_radius: float
    platform_angles: _Array
    base_angles: _Array
    home_position: _Array
    mass: float
    inertia: _Array
    stroke: float
    force_limit: float

class ForwardKinematics(metaclass=_PybindType):
    """Pose found from leg lengths."""

    def __init__(self, *args: NoReturn, **kwargs: NoReturn) -> None: ...
    @property
    def position(self) -> _Array: ...
    @property
    def quaternion(self) -> _Array: ...
    @property
    def residual(self) -> float: ...
    @property
    def status(self) -> KinematicsStatus: ...

class Hexapod(metaclass=_PybindType):
    """Legs of a robot; poses are (position in B, quaternion w x y z)."""

    def __init__(self, robot: RobotParameters) -> None: ...
    @property
    def home_position(self) -> _Array: ...
    @property
    def home_lengths(self) -> _Array: ...
    @property
    def platform_joints(self) -> _Array: ...
    @property
    def base_joints(self) -> _Array: ...
    def leg_lengths(self, position: ArrayLike, quaternion: ArrayLike) -> _Array: ...
    def wrench_map(self, position: ArrayLike, quaternion: ArrayLike) -> _Array: ...
    def leg_forces(self, position: ArrayLike, quaternion: ArrayLike, wrench: ArrayLike) -> _Array: ...
    def singular_values(self, position: ArrayLike, quaternion: ArrayLike) -> _Array: ...
    def forward_kinematics(
        self, lengths: ArrayLike, start_position: ArrayLike, start_quaternion: ArrayLike
    ) -> ForwardKinematics: ...

class Camera(metaclass=_PybindType):
    """Pinhole camera, (4)."""

    def __init__(self) -> None: ...
    focal_length: float
    pixel_scale: float
    @property
    def focal_pixels(self) -> float: ...

class FuzzyGains(metaclass=_PybindType):
    """Design of the six fuzzy systems, (13) and (22)."""

    def __init__(self) -> None: ...
    enabled: bool
    adaptation: _Array
    error_scale: _Array
    rate_scale: _Array
    initial_scale: _Array
    table: _Array
    bell_width: float
    bell_slope: float
    leakage: _Array
    weight_limit: _Array
    dead_zone: _Array

class HybridGains(metaclass=_PybindType):
    """Gains of the law hybrid, (14) and (15)."""

    def __init__(self) -> None: ...
    kp: _Array
    kv: _Array
    fuzzy: FuzzyGains

class CompositeGains(metaclass=_PybindType):
    """Gains of the law composite."""

    def __init__(self) -> None: ...
    kp: _Array
    kv: _Array
    kt: _Array
    kd: _Array
    drive: _Array
    prior: _Array
    fuzzy: FuzzyGains

class KellyGains(metaclass=_PybindType):
    """Gains of the law kelly."""

    def __init__(self) -> None: ...
    kp: _Array
    kd: _Array

class ResolvedRateGains(metaclass=_PybindType):
    """Gains of the law resolved_rate."""

    def __init__(self) -> None: ...
    gain: float
    adaptive: bool
    gain_far: float
    gain_slope: float
    jacobian_at: JacobianPoint
    ki: _Array
    damping: _Array

class PbvsGains(metaclass=_PybindType):
    """Gains of the law pbvs."""

    def __init__(self) -> None: ...
    kp: _Array
    kd: _Array
    prior: _Array

class ComputedTorqueGains(metaclass=_PybindType):
    """Gains of the law computed_torque."""

    def __init__(self) -> None: ...
    kp: _Array
    kd: _Array
    prior: _Array

class Switching(metaclass=_PybindType):
    """Stand-in for sgn in (15)."""

    def __init__(self) -> None: ...
    kind: SwitchingKind
    width: float

class SafeSettings(metaclass=_PybindType):
    """The brake that acts where the law may not."""

    def __init__(self) -> None: ...
    damping: _Array | None
    hold: _Array | None

class Target(metaclass=_PybindType):
    """Four points to look at, and where they shall appear."""

    def __init__(self) -> None: ...
    initial_features: _Array
    depth: _Array
    points: _Array | None
    desired_features: _Array

class Uncertainty(metaclass=_PybindType):
    """Relative errors between estimates and plant."""

    def __init__(self) -> None: ...
    dynamics: DynamicsError
    depth: _Array

class SimulationSettings(metaclass=_PybindType):
    """Time grid and logging."""

    def __init__(self) -> None: ...
    mode: LoopMode
    step: float
    substeps: int
    duration: float
    log_every: int

class MetricsSettings(metaclass=_PybindType):
    """What is measured, when and against what."""

    def __init__(self) -> None: ...
    band: float
    dwell: float
    rms_start: float

class _LawSettings(metaclass=_PybindType):  # what the settings of all laws have, which one C++ template binds
    def __init__(self) -> None: ...
    robot: RobotParameters
    camera: Camera
    convention: CameraConvention
    sampling: CameraSampling
    sensors: SensorSettings
    actuators: ActuatorSettings
    base_motion: BaseMotionSettings
    on_limit: LimitPolicy
    jacobian: JacobianConvention
    target: Target
    uncertainty: Uncertainty
    switching: Switching
    safe: SafeSettings
    simulation: SimulationSettings
    metrics: MetricsSettings
    seed: int
    def validate(self) -> None: ...

class HybridSettings(_LawSettings):
    """A scenario for the law hybrid, as numbers."""

    gains: HybridGains

class CompositeSettings(_LawSettings):
    """A scenario for the law composite, as numbers."""

    gains: CompositeGains

class KellySettings(_LawSettings):
    """A scenario for the law kelly, as numbers."""

    gains: KellyGains

class ResolvedRateSettings(_LawSettings):
    """A scenario for the law resolved_rate, as numbers."""

    gains: ResolvedRateGains

class PbvsSettings(_LawSettings):
    """A scenario for the law pbvs, as numbers."""

    gains: PbvsGains

class ComputedTorqueSettings(_LawSettings):
    """A scenario for the law computed_torque, as numbers."""

    gains: ComputedTorqueGains

_Settings: TypeAlias = (
    HybridSettings | CompositeSettings | KellySettings | ResolvedRateSettings | PbvsSettings | ComputedTorqueSettings
)

class LimitEvent(metaclass=_PybindType):
    """A leg beyond one of its limits."""

    def __init__(self, *args: NoReturn, **kwargs: NoReturn) -> None: ...
    @property
    def kind(self) -> LimitKind: ...
    @property
    def leg(self) -> int: ...
    @property
    def first_time(self) -> float: ...
    @property
    def peak(self) -> float: ...
    @property
    def limit(self) -> float: ...

class Metrics(metaclass=_PybindType):
    """Metrics of a run, streamed at every step."""

    def __init__(self, *args: NoReturn, **kwargs: NoReturn) -> None: ...
    @property
    def settling_time(self) -> float: ...
    @property
    def final_error(self) -> float: ...
    @property
    def rms_error(self) -> float: ...
    @property
    def peak_error(self) -> float: ...
    @property
    def peak_displacement(self) -> float: ...
    @property
    def peak_rotation(self) -> float: ...
    @property
    def final_linear_speed(self) -> float: ...
    @property
    def final_angular_speed(self) -> float: ...
    @property
    def peak_control_force(self) -> float: ...
    @property
    def peak_control_moment(self) -> float: ...
    @property
    def peak_leg_force(self) -> float: ...
    @property
    def peak_leg_excursion(self) -> float: ...
    @property
    def overshoot(self) -> float: ...
    @property
    def relative_overshoot(self) -> float: ...
    @property
    def peak_feature_distance(self) -> float: ...
    @property
    def peak_line_deviation(self) -> float: ...
    @property
    def effort(self) -> float: ...
    @property
    def chatter(self) -> float: ...

class SampledObservation(metaclass=_PybindType):
    """What a controller sees at a tick."""

    def __init__(self, *args: NoReturn, **kwargs: NoReturn) -> None: ...
    @property
    def tick(self) -> int: ...
    @property
    def time(self) -> float: ...
    @property
    def exposure(self) -> float: ...
    @property
    def features(self) -> _Array: ...
    @property
    def depth(self) -> _Array: ...
    @property
    def position(self) -> _Array: ...
    @property
    def quaternion(self) -> _Array: ...
    @property
    def twist(self) -> _Array: ...

class SampledRun(metaclass=_PybindType):
    """A run in sampled mode, commanded tick by tick."""

    def __init__(self, settings: _Settings) -> None: ...
    @property
    def running(self) -> bool: ...
    def observe(self) -> SampledObservation: ...
    def command(self, wrench: ArrayLike) -> None: ...
    def command_legs(self, leg_forces: ArrayLike) -> None: ...
    def finish(self) -> Trajectory: ...

class LawProbe(metaclass=_PybindType):
    """What a law gives at n states."""

    def __init__(self, *args: NoReturn, **kwargs: NoReturn) -> None: ...
    @property
    def wrench(self) -> _Array: ...
    @property
    def fuzzy_output(self) -> _Array: ...
    @property
    def error_memberships(self) -> _Array | None: ...
    @property
    def rate_memberships(self) -> _Array | None: ...
    @property
    def adaptation(self) -> _Array | None: ...

class StageProbe(metaclass=_PybindType):
    """The four Runge-Kutta stages of n steps, and the states after them."""

    def __init__(self, *args: NoReturn, **kwargs: NoReturn) -> None: ...
    @property
    def features(self) -> _Array: ...
    @property
    def depth(self) -> _Array: ...
    @property
    def position(self) -> _Array: ...
    @property
    def quaternion(self) -> _Array: ...
    @property
    def twist(self) -> _Array: ...
    @property
    def wrench(self) -> _Array: ...
    @property
    def fuzzy_output(self) -> _Array: ...
    @property
    def acceleration(self) -> _Array: ...
    @property
    def next_features(self) -> _Array: ...
    @property
    def next_depth(self) -> _Array: ...
    @property
    def next_position(self) -> _Array: ...
    @property
    def next_quaternion(self) -> _Array: ...
    @property
    def next_twist(self) -> _Array: ...
    @property
    def next_weights(self) -> _Array | None: ...

class Probe(metaclass=_PybindType):
    """The parts of a scenario's loop at given states, one per row."""

    def __init__(self, settings: _Settings) -> None: ...
    @property
    def has_fuzzy_systems(self) -> bool: ...
    @property
    def initial_weights(self) -> _Array | None: ...
    def image(self, position: ArrayLike, quaternion: ArrayLike) -> tuple[_Array, _Array]: ...
    def image_jacobian(
        self, features: ArrayLike, depth: ArrayLike, quaternion: ArrayLike, controller: bool = False
    ) -> _Array: ...
    def measured_depth(self, depth: ArrayLike) -> _Array: ...
    def law(
        self,
        features: ArrayLike,
        depth: ArrayLike,
        position: ArrayLike,
        quaternion: ArrayLike,
        twist: ArrayLike,
        weights: ArrayLike | None = None,
    ) -> LawProbe: ...
    def acceleration(
        self, position: ArrayLike, quaternion: ArrayLike, twist: ArrayLike, wrench: ArrayLike
    ) -> _Array: ...
    def estimated_wrenches(
        self, quaternion: ArrayLike, twist: ArrayLike, acceleration: ArrayLike
    ) -> tuple[_Array, _Array, _Array]: ...
    def inertia(self, quaternion: ArrayLike) -> _Array: ...
    def stages(
        self,
        features: ArrayLike,
        depth: ArrayLike,
        position: ArrayLike,
        quaternion: ArrayLike,
        twist: ArrayLike,
        weights: ArrayLike | None = None,
    ) -> StageProbe: ...
    @staticmethod
    def moved(
        position: ArrayLike,
        quaternion: ArrayLike,
        twist: ArrayLike,
        stage_quaternion: ArrayLike,
        stage_twist: ArrayLike,
        stage_acceleration: ArrayLike,
        scale: float,
    ) -> tuple[_Array, _Array, _Array]: ...
    @staticmethod
    def after(
        position: ArrayLike,
        quaternion: ArrayLike,
        twist: ArrayLike,
        stage_quaternion: ArrayLike,
        stage_twist: ArrayLike,
        stage_acceleration: ArrayLike,
        step: float,
    ) -> tuple[_Array, _Array, _Array]: ...

class Trajectory(metaclass=_PybindType):
    """Logged samples of a run; arrays share its memory."""

    def __init__(self, *args: NoReturn, **kwargs: NoReturn) -> None: ...
    @property
    def time(self) -> _Array: ...
    @property
    def feature_error(self) -> _Array: ...
    @property
    def depth(self) -> _Array: ...
    @property
    def position(self) -> _Array: ...
    @property
    def quaternion(self) -> _Array: ...
    @property
    def twist(self) -> _Array: ...
    @property
    def wrench(self) -> _Array: ...
    @property
    def fuzzy_output(self) -> _Array: ...
    @property
    def leg_lengths(self) -> _Array: ...
    @property
    def leg_forces(self) -> _Array: ...
    @property
    def fuzzy_weights(self) -> _Array: ...
    @property
    def weight_history(self) -> _Array | None: ...
    @property
    def outcome(self) -> Outcome: ...
    @property
    def detail(self) -> str: ...
    @property
    def end_time(self) -> float: ...
    @property
    def steps(self) -> int: ...
    @property
    def events(self) -> list[LimitEvent]: ...
    @property
    def metrics(self) -> Metrics: ...

class BatchResult(metaclass=_PybindType):
    """What a batch gives back; arrays share its memory. The scenario is axis 0."""

    def __init__(self, *args: NoReturn, **kwargs: NoReturn) -> None: ...
    @property
    def outcome(self) -> NDArray[np.uint8]: ...
    @property
    def cause(self) -> NDArray[np.uint8]: ...
    @property
    def limit_leg(self) -> NDArray[np.int8]: ...
    @property
    def end_time(self) -> _Array: ...
    @property
    def stop_time(self) -> _Array: ...
    @property
    def metrics(self) -> _Array: ...
    @property
    def time(self) -> _Array | None: ...
    @property
    def samples(self) -> dict[str, _Array]: ...
    @property
    def fuzzy_weights(self) -> _Array | None: ...

class Kernel(metaclass=_PybindType):
    """The run loop compiled for one instruction set."""

    def __init__(self, capsule: object) -> None: ...
    @property
    def name(self) -> str: ...
    @property
    def lanes(self) -> int: ...
    @property
    def flags(self) -> str: ...
    def fma_peak(self, seconds: float = 0.1) -> float: ...

def recorded_ticks(settings: _Settings) -> dict[str, _Array]: ...

class Controller(metaclass=_PybindType):
    """The servo tick of a law, with its state."""

    def __init__(self, settings: _Settings, period: float) -> None: ...
    def step(
        self,
        features: object,
        depth: object,
        position: object,
        quaternion: object,
        twist: object,
        leg_lengths: object = None,
        leg_rates: object = None,
        exposure: float = 0.0,
        now: float = 0.0,
    ) -> tuple[_Array, _Array, _Array, InputStatus, bool]: ...
    def reset(self) -> None: ...
    def state(self) -> _Array: ...
    def restore(self, state: object) -> None: ...
    @property
    def period(self) -> float: ...
    @property
    def fuzzy_weights(self) -> _Array: ...

class TickTimes(metaclass=_PybindType):
    """Times of servo ticks; arrays share its memory."""

    def __init__(self, *args: NoReturn, **kwargs: NoReturn) -> None: ...
    @property
    def latency(self) -> NDArray[np.uint32]: ...
    @property
    def lateness(self) -> NDArray[np.uint32]: ...
    @property
    def periods(self) -> int: ...
    @property
    def missed(self) -> int: ...
    @property
    def clock_cost(self) -> float: ...
    @property
    def invalid(self) -> int: ...
    @property
    def reproduced(self) -> bool: ...
    @property
    def wrench_difference(self) -> float: ...
    @property
    def scheduling(self) -> str: ...
    @property
    def memory(self) -> str: ...
    @property
    def interrupted(self) -> bool: ...

def build_info() -> dict[str, str]: ...
def step_count(simulation: SimulationSettings) -> int: ...
def robot_preset(name: str) -> RobotParameters: ...
def take_image(
    camera: Camera, position: ArrayLike, quaternion: ArrayLike, points: ArrayLike
) -> tuple[_Array, _Array]: ...
def image_jacobian(
    camera: Camera,
    features: ArrayLike,
    depth: ArrayLike,
    quaternion: ArrayLike,
    convention: CameraConvention = CameraConvention.eye_in_hand,
) -> _Array: ...
def simulate(settings: _Settings, kernel: Kernel, log_weights: bool = False) -> Trajectory: ...
def processor_features() -> dict[str, bool]: ...
def numeric_keys(settings: _Settings) -> dict[str, list[int]]: ...
def simulate_batch(
    settings: _Settings,
    variations: Sequence[tuple[str, _Array]],
    count: int,
    log: BatchLog,
    threads: int,
    kernel: Kernel,
    progress: Callable[[int, int, int, int], object] | None = None,
) -> BatchResult: ...
def time_ticks(settings: _Settings, periods: int, rate: float = 0.0, realtime: bool = False) -> TickTimes: ...
def describe(cause: StopCause, time: float, leg: int = -1) -> str: ...
def drive_legs(
    hexapod: Hexapod,
    body: RigidBody,
    error: DynamicsError,
    position: ArrayLike,
    quaternion: ArrayLike,
    twist: ArrayLike,
    leg_forces: ArrayLike,
    step: float,
    steps: int,
) -> tuple[_Array, _Array, _Array]: ...
