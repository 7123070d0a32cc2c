"""The blocks of a scenario: machine, camera, target, model errors, simulation and metrics.

SI units and radians throughout; image quantities in pixels. Frames, the symbols and the reasons for the defaults:
docs/model.md. The defaults of the maths have one source, the C++ structs.
"""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator
from pydantic.functional_validators import ModelWrapValidatorHandler

from hexservo import _core
from hexservo.scenario.block import (
    COORDINATE,
    HALF_TURN,
    LENGTH,
    MASS,
    NOT_NEGATIVE,
    POSITIVE,
    PROBABILITY,
    RELATIVE_ERROR,
    SAMPLED,
    Block,
    NumberNotNegative,
    PositiveNumber,
    together,
)
from hexservo.scenario.core_defaults import core_default, from_core
from hexservo.scenario.drives import Actuators
from hexservo.scenario.laws import Controller
from hexservo.scenario.leg_travel import travel
from hexservo.scenario.motion import BaseMotion, TargetMotion, moves
from hexservo.scenario.plain import plain
from hexservo.scenario.pose_rules import DisplacementRule, PoseRule
from hexservo.scenario.presets import MACHINES, ROBOT_PRESETS, machine
from hexservo.scenario.rules import (
    Angle,
    ArrayRule,
    Choice,
    Flag,
    GravityRule,
    Inertia,
    Integer,
    LineRule,
    Matrix,
    Name,
    Number,
    OptionalNumber,
    PointsRule,
    Problem,
    TrueOr,
    Vector,
    diagonal_if_diagonal,
    map_lists,
    refusal,
    shown_value,
    tupled,
)
from hexservo.scenario.tag import CORNERS, Grid, GridRule, Tag, TagRule, require_counts

_OPTIONAL_LENGTH = OptionalNumber(above=LENGTH.above, below=LENGTH.below)
DEFAULT_PRESET = "micro"
_FOCAL_KEYS = ("focal_length", "pixel_scale")
SIDES = ("platform", "base")
DEFAULT_DEPTH = float(core_default("target.depth"))  # [m], docs/model.md section 4


class Payload(Block):
    """A body fixed to the platform: the plant has it, and the controller where it is known; docs/model.md section 3."""

    mass: Annotated[float, Number(at_least=0, below=_core.MOST_MASS)] = 0.0  # [kg]; 0: no payload
    position: Annotated[Vector, ArrayRule((3,), COORDINATE)] = (0.0, 0.0, 0.0)  # (3,) [m], of its centre of mass in E
    # (3,) diagonal or (3, 3) [kg m^2], about its centre of mass, in E
    inertia: Annotated[Vector | Matrix, Inertia()] = (0.0, 0.0, 0.0)
    known: Annotated[bool, Flag()] = True  # to the controller


class Cranks(Block):
    """Cranks of rotary legs, whose centres are the base joints; docs/model.md section 2. All null: prismatic legs."""

    length: Annotated[float | None, _OPTIONAL_LENGTH] = None  # [m], from the centre to the rod
    rod: Annotated[float | None, _OPTIONAL_LENGTH] = None  # [m], length of the rods
    axes: Annotated[Matrix | None, ArrayRule((6, 3), or_null=True)] = None  # (6, 3), of rotation, unit vectors in B
    zero: Annotated[Matrix | None, ArrayRule((6, 3), or_null=True)] = None  # (6, 3), direction at angle 0, likewise
    # (6,), 1 or -1: which of the two angles that a pose has
    branch: Annotated[Vector | None, ArrayRule((6,), Number(at_least=-1, at_most=1), or_null=True)] = None


def circle_keys(side: str) -> tuple[str, str]:
    """Return the two keys of a robot that place the joints of a side on a circle, in place of `<side>_joints`."""
    return f"{side}_radius", f"{side}_angles"


class Robot(Block):
    """The hexapod: its geometry, mass and limits.

    In a file, a preset fills in every key that is not given or null; without one (null, the default of a robot block)
    every key is required. A scenario without a robot block has the preset "micro". Frames B and E: docs/model.md
    section 1; legs: section 2.
    """

    preset: Annotated[str | None, Choice(ROBOT_PRESETS, or_null=True)] = None  # a machine, for keys that are not given
    platform_radius: Annotated[float | None, _OPTIONAL_LENGTH]  # [m], circle of the platform joints about E
    base_radius: Annotated[float | None, _OPTIONAL_LENGTH]  # [m], circle of the base joints about B
    platform_angles: Annotated[Vector | None, ArrayRule((6,), Angle(), or_null=True)]  # (6,) [rad], on the circle, in E
    base_angles: Annotated[Vector | None, ArrayRule((6,), Angle(), or_null=True)]  # (6,) [rad], on the circle, in B
    # (6, 3) [m], in E; no circle
    platform_joints: Annotated[Matrix | None, ArrayRule((6, 3), COORDINATE, or_null=True)] = None
    # (6, 3) [m], in B; no circle
    base_joints: Annotated[Matrix | None, ArrayRule((6, 3), COORDINATE, or_null=True)] = None
    home_position: Annotated[Vector, ArrayRule((3,), COORDINATE)]  # (3,) [m], of E's origin in B; z points down
    home_attitude: Annotated[Vector, ArrayRule((3,), Angle())] = (0.0, 0.0, 0.0)  # (3,) [rad], rotation vector, in B
    # prismatic: leg lengths are driven; rotary: cranks with rods; then coordinates of the legs are angles [rad] and
    # efforts torques [N m], here, in sensors and in actuators
    legs: Annotated[Literal["prismatic", "rotary"], Choice()] = "prismatic"
    cranks: Cranks = Field(default_factory=Cranks)
    gravity: Annotated[Vector, GravityRule()] = from_core("robot.gravity")  # (3,) [m/s^2], in B; a number: along +z
    mass: Annotated[float, MASS]  # [kg], of the platform
    inertia: Annotated[Vector | Matrix, Inertia()]  # (3,) diagonal or (3, 3) [kg m^2], in E about its origin
    centre_of_mass: Annotated[Vector, ArrayRule((3,), COORDINATE)] = (0.0, 0.0, 0.0)  # (3,) [m], of the platform, in E
    payload: Payload = Field(default_factory=Payload)
    # [m] or [rad], each leg's travel either way from its middle; [shortest, longest], from home, is read as both
    stroke: Annotated[float, LENGTH]
    stroke_centre: Annotated[float, COORDINATE] = 0.0  # [m] or [rad], middle of the travel, from the home length
    force_limit: PositiveNumber  # [N] or [N m], magnitude of each leg's effort
    # [m/s] or [rad/s], magnitude of each leg's rate
    speed_limit: Annotated[float | None, OptionalNumber(above=0)] = None
    # (2,) [rad], largest angle between a leg and its direction at home, seen from the base and from the platform
    joint_limit: Annotated[Vector | None, ArrayRule((2,), HALF_TURN, or_null=True)] = None
    # in sampled mode: what a leg beyond its stroke, speed limit or joint limit means, an event or the end of the run
    on_limit: Annotated[Literal["report", "stop"], Choice(), SAMPLED] = "report"
    # steps, or ticks, from one at which limits and metrics of the legs are looked at to the next
    limits_every: Annotated[int, Integer(1, 10**9)] = from_core("robot.limits_every")

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        given = {key: value for key, value in data.items() if value is not None}
        whole = {**data, "stroke": 1.0, "stroke_centre": None}
        given |= travel(given.get("stroke"), given.get("stroke_centre"), lambda: cls.model_validate(whole))
        # Joints given one by one leave no circle.
        other = {key: None for side in SIDES if f"{side}_joints" in given for key in circle_keys(side)}
        preset = given.get("preset")
        if preset is None:
            return {**other, **given}
        # A circle leaves no joints of a preset.
        other |= {f"{side}_joints": None for side in SIDES if not given.keys().isdisjoint(circle_keys(side))}
        # An unknown preset is reported at its own key; any values do to check the others.
        known = isinstance(preset, str) and preset in ROBOT_PRESETS
        values = preset_values(preset if known else DEFAULT_PRESET)
        if isinstance(cranks := given.get("cranks"), dict):
            given["cranks"] = {**values["cranks"], **cranks}
        return {**values, **other, **given}

    @model_validator(mode="after")
    def _has_one_form(self) -> Robot:
        both = [
            ((key,), f"expected null beside {side}_joints, got {shown_value(map_lists(value, list))}")
            for side in SIDES
            if getattr(self, f"{side}_joints") is not None
            for key in circle_keys(side)
            if (value := getattr(self, key)) is not None
        ]
        if both:
            raise refusal(*both)
        lacking = [
            ((key,), f"expected a value, since {side}_joints is null, got null")
            for side in SIDES
            if getattr(self, f"{side}_joints") is None
            for key in circle_keys(side)
            if getattr(self, key) is None
        ]
        if lacking:
            raise refusal(*lacking)
        return self


class Mount(Block):
    """Where the camera's frame C is in the frame that it is mounted on; as an error, what the controller's is off.

    The rotation vector of an error turns the true C into the controller's, about the axes of C.
    """

    position: Annotated[Vector, ArrayRule((3,), COORDINATE)] = (0.0, 0.0, 0.0)  # (3,) [m], of C's origin in E or B
    rotation: Annotated[Vector, ArrayRule((3,))] = (0.0, 0.0, 0.0)  # (3,) [rad], rotation vector of C in E or B


class CameraMount(Mount):
    """Where the camera is, and on what: the target's points are fixed to the other of platform and base."""

    # platform: eye in hand, C in E and the points in B; base: eye to hand, C in B and the points in E
    on: Annotated[Literal["platform", "base"], Choice()] = "platform"


class Distortion(Block):
    """Distortion of the lens with the coefficients of OpenCV: none, or one of the two."""

    # (5,), k1, k2, p1, p2, k3
    brown_conrady: Annotated[Vector | None, ArrayRule((5,), or_null=True)] = None
    # (4,), k1 ... k4, of a fisheye
    kannala_brandt: Annotated[Vector | None, ArrayRule((4,), or_null=True)] = None

    @model_validator(mode="after")
    def _is_one(self) -> Distortion:
        if self.brown_conrady is not None and self.kannala_brandt is not None:
            raise refusal(((), "expected one of brown_conrady and kannala_brandt, got both; set one to null"))
        return self


class Camera(Block):
    """The camera, on the platform or on the base; docs/model.md section 4, (4)-(8).

    Times, faults and predictions act in `sampled` mode alone, where every time is a whole number of servo periods
    (``simulation.step``); docs/model.md section 7.
    """

    # [m]; null where focal_pixels takes its place
    focal_length: Annotated[float, OptionalNumber(above=0)] = from_core("camera.focal_length")
    pixel_scale: Annotated[float, OptionalNumber(above=0)] = from_core("camera.pixel_scale")  # [px/m], likewise
    # [px], one number or (f_x, f_y), in place of focal_length and pixel_scale
    focal_pixels: Annotated[float | Vector | None, ArrayRule((2,), POSITIVE, or_number=True, or_null=True)] = None
    # (2,) [px], counted from the centre of the first pixel; null: pixels count from the image centre
    principal_point: Annotated[Vector | None, ArrayRule((2,), or_null=True)] = None
    # paper: looks along -z, y up in the image; opencv: looks along +z, y down
    axes: Annotated[Literal["paper", "opencv"], Choice()] = "paper"
    distortion: Distortion = Field(default_factory=Distortion)
    mount: CameraMount = Field(default_factory=CameraMount)
    # eye_in_hand: the image of the points by (4), s = -1; as_printed: the features integrate (8) as it stands, s = 1
    convention: Annotated[Literal["eye_in_hand", "as_printed"], Choice()] = "eye_in_hand"
    # [s], between exposures; null: the servo period, also where that changes
    period: Annotated[float | None, OptionalNumber(above=0), SAMPLED] = None
    latency: Annotated[NumberNotNegative, SAMPLED] = 0.0  # [s], from an exposure to its first use
    latency_jitter: Annotated[NumberNotNegative, SAMPLED] = 0.0  # [s], most that the latency of a frame is longer
    # frames carry their exposure; false: their arrival, and the law finds how late that is
    latency_known: Annotated[bool, Flag(), SAMPLED] = True
    # [s], since its exposure: an older image is not used, and the wrench holds the platform; null: any is used
    timeout: Annotated[float | None, OptionalNumber(above=0), SAMPLED] = None
    noise: Annotated[NumberNotNegative, SAMPLED] = 0.0  # [px], standard deviation of each coordinate
    quantisation: Annotated[NumberNotNegative, SAMPLED] = 0.0  # [px], coordinates are multiples of it; 0: not rounded
    dropout: Annotated[float, PROBABILITY, SAMPLED] = 0.0  # probability that a frame never arrives
    outlier_probability: Annotated[float, PROBABILITY, SAMPLED] = 0.0  # that a point of a frame is an outlier
    # [px], standard deviation of what is added to an outlier's coordinates, beside the noise
    outlier_size: Annotated[NumberNotNegative, SAMPLED] = 0.0
    # [s], time constant of a filter of the coordinates, from exposure to exposure; 0: none
    smoothing: Annotated[NumberNotNegative, SAMPLED] = 0.0
    # (2,) [px], width and height; a feature outside is lost; null: no border
    image_size: Annotated[Vector | None, ArrayRule((2,), POSITIVE, or_null=True), SAMPLED] = None
    # what a law does with a lost feature: its last image, that image carried along by the joint sensors, or no more
    on_lost: Annotated[Literal["hold", "predict", "stop"], Choice(), SAMPLED] = "hold"
    # between two frames: the newest one as it is, or carried along by the joint sensors
    prediction: Annotated[Literal["none", "encoder"], Choice(), SAMPLED] = "none"
    # [px], that a point may be from where its last image and the joint sensors expect it; beyond it counts as lost
    gate: Annotated[float | None, OptionalNumber(above=0), SAMPLED] = None

    @model_validator(mode="before")
    @classmethod
    def _has_one_focal_length(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        lengths = [key for key in _FOCAL_KEYS if data.get(key) is not None]
        if data.get("focal_pixels") is None:
            return {key: value for key, value in data.items() if key in lengths or key not in _FOCAL_KEYS}
        if lengths:
            raise refusal(
                (("focal_pixels",), f"expected null beside {' and '.join(lengths)}, got both; set one side to null")
            )
        return {**data, "focal_length": None, "pixel_scale": None}


class Sensors(Block):
    """Source of the controller's pose and twist, in `sampled` mode; docs/model.md section 7.

    The period is a whole number of servo periods (``simulation.step``).
    """

    # true: exactly; encoders: from the lengths of the legs, which alone have what follows
    pose: Annotated[Literal[True, "encoders"], TrueOr("encoders")] = True
    # what the twist is made of: differences of readings over their period, or the true rates of the legs
    rate: Annotated[Literal[True, "differences"], TrueOr("differences")] = "differences"
    resolution: NumberNotNegative = 0.0  # [m], a length is a multiple of it; 0: not rounded
    noise: NumberNotNegative = 0.0  # [m], standard deviation of each length
    period: Annotated[float | None, OptionalNumber(above=0)] = None  # [s], between readings; null: every servo period


class Target(Block):
    """The 3 to 16 points in view of the camera, and their desired image.

    The points are given by their image from the home pose and their depth, by their place in B, as the corners of a
    square tag, or as those of a grid; the desired image by its features, or as the image of the points from a pose.
    Features are ordered (x1, y1, ..., xn, yn), in pixels. Tag, grid and pose are read at once: a scenario holds the
    points and the features that follow from them, and its own ``tag``, ``grid`` and ``desired_pose`` are null.
    """

    initial_features: Annotated[Vector | None, PointsRule((8,), or_null=True, each=2)] = None  # (2n,) [px], from home
    # (2n,) [px], at the goal; null only until a desired pose has been read
    desired_features: Annotated[Vector, PointsRule((8,), or_null=True, each=2)]
    # (6,) [m; rad], displacement from home, in B: difference of the positions, rotation vector
    desired_pose: Annotated[Vector | None, DisplacementRule()] = None
    # [m], distance |Z| along the optical axis from home: one for all points or (n,); 0.5 if not given
    depth: Annotated[float | Vector | None, PointsRule((4,), POSITIVE, or_number=True, or_null=True)] = None
    # (n, 3) [m], in the target's frame
    points: Annotated[Matrix | None, PointsRule((4, 3), or_null=True, each=3, rows=True)] = None
    tag: Annotated[Tag | None, TagRule()] = None  # size and pose [m; rad] of a square tag, in place of points
    grid: Annotated[Grid | None, GridRule()] = None  # rows, columns, spacing, pose [m; rad] of a grid, likewise
    # w, what each point counts in the controller's sums over the image [1]: one for all points or (n,)
    weights: Annotated[float | Vector, PointsRule((4,), NOT_NEGATIVE, or_number=True)] = 1.0
    # base: the points ride on B; world: they do not, and W is where B rests without motion
    frame: Annotated[Literal["base", "world"], Choice(), SAMPLED] = "base"
    motion: Annotated[TargetMotion, SAMPLED] = Field(default_factory=TargetMotion)

    @property
    def count(self) -> int:
        """How many points there are."""
        for numbers, each in ((self.points, 1), (self.initial_features, 2), (self.desired_features, 2)):
            if numbers is not None:
                return len(numbers) // each
        return self.grid[0] * self.grid[1] if self.grid is not None else len(CORNERS)

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        require_counts(data)
        if data.get("initial_features") is not None and data.get("points") is None:
            data = {**data, "depth": DEFAULT_DEPTH if data.get("depth") is None else data["depth"]}
        return {"desired_features": None, **data}

    @model_validator(mode="wrap")
    @classmethod
    def _has_one_form(cls, data: Any, read: ModelWrapValidatorHandler[Target]) -> Target:
        problems = _problems_of_form(data) if isinstance(data, dict) else []
        of_form = [refusal(*problems)] if problems else []
        try:
            target = read(data)
        except ValidationError as error:
            raise together(error, *of_form) from None
        if of_form:
            raise of_form[0]
        return target


def _problems_of_form(target: dict[str, Any]) -> list[Problem]:
    """Return what is missing in a target, as it is written, or given twice: its points, and its goal."""
    forms = (
        "expected either initial_features (2 numbers per point, px) with depth (m), points (3 numbers per point, "
        "m, in B), tag (size, pose), or grid (rows, columns, spacing, pose)"
    )
    problems: list[Problem] = []
    given = [key for key in ("initial_features", "points", "tag", "grid") if target.get(key) is not None]
    if not given:
        problems.append(((), f"{forms}, got none of them"))
    elif len(given) > 1:
        problems.append(((), f"{forms}, got {' and '.join(given)}; leave one out or set it to null"))
    elif given != ["initial_features"] and target.get("depth") is not None:
        depth = shown_value(map_lists(target["depth"], list))
        problems.append((("depth",), f"expected no depth beside {given[0]}, got {depth}"))
    goals = [key for key in ("desired_features", "desired_pose") if target.get(key) is not None]
    if not goals:
        problems.append(
            (
                (),
                "expected either desired_features (2 numbers per point, px) or desired_pose (6 numbers, displacement "
                "from home, m and rad), got neither",
            )
        )
    elif len(goals) > 1:
        problems.append((("desired_pose",), "expected null beside desired_features, got both; leave one out"))
    return problems


class Uncertainty(Block):
    """Errors of the controller's model, relative ones above -1 and below 1; docs/model.md sections 3 and 4.

    The plant has (1 - delta) times the controller's inertia, Coriolis and gravity terms (3); the controller takes
    (1 + delta) times the true depth of a point. Arrays act element by element.
    """

    inertia: Annotated[float | Matrix, ArrayRule((6, 6), RELATIVE_ERROR, or_number=True)] = 0.0  # the plant has less
    coriolis: Annotated[float | Matrix, ArrayRule((6, 6), RELATIVE_ERROR, or_number=True)] = 0.0  # likewise
    gravity: Annotated[float | Vector, ArrayRule((6,), RELATIVE_ERROR, or_number=True)] = 0.0  # > 0: it is lighter
    # relative, > 0: assumed too deep; one for all points or (n,)
    depth: Annotated[float | Vector, PointsRule((4,), RELATIVE_ERROR, or_number=True)] = 0.0
    focal_length: Annotated[float, RELATIVE_ERROR, SAMPLED] = 0.0  # relative, of the controller's camera
    principal_point: Annotated[Vector, ArrayRule((2,)), SAMPLED] = (0.0, 0.0)  # (2,) [px], what the controller's is off
    latency: Annotated[float, Number(), SAMPLED] = 0.0  # [s], what the one that the controller assumes is off
    mount: Mount = Field(default_factory=Mount)


class Start(Block):
    """How a run starts; docs/model.md section 7. The defaults are home, at rest."""

    # (6,) [m; rad], displacement from home, in B: difference of the positions, rotation vector
    pose: Annotated[Vector, PoseRule()] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    twist: Annotated[Vector, ArrayRule((6,))] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # (6,) [m/s; rad/s], in B


class Simulation(Block):
    """How long and how finely; the step divides the duration."""

    # continuous: the law acts in every stage of the integration; sampled: at the servo's ticks, on the camera's frames
    mode: Annotated[Literal["continuous", "sampled"], Choice()] = "continuous"
    # [s], of the Runge-Kutta integration; in sampled mode the servo period
    step: PositiveNumber = from_core("simulation.step")
    # in sampled mode: Runge-Kutta steps in a servo period
    substeps: Annotated[int, Integer(1, 10**6), SAMPLED] = from_core("simulation.substeps")
    duration: PositiveNumber = from_core("simulation.duration")  # [s], of the run
    # steps per logged sample
    log_every: Annotated[int, Integer(1, 10**9)] = from_core("simulation.log_every")
    start: Start = Field(default_factory=Start)

    @model_validator(mode="after")
    def _step_divides_duration(self) -> Simulation:
        try:
            _core.step_count(self.step, self.duration, self.log_every)
        except ValueError as error:  # "simulation.step: expected ..., got ..."
            path, _, sentence = str(error).partition(": ")
            raise refusal(((path.removeprefix("simulation."),), sentence)) from None
        return self


class Metrics(Block):
    """What the metrics of a run are measured against; docs/model.md section 8."""

    # [px], of settling, overshoot and straight ways: every feature error is within it
    band: PositiveNumber = from_core("metrics.band")
    # [s]: a run is settled where it has been within the band for so long at its end
    dwell: PositiveNumber = from_core("metrics.dwell")
    # [s]: from here to the end the RMS error is taken; a run that is not longer has none
    rms_start: NumberNotNegative = from_core("metrics.rms_start")


class Blocks(Block):
    """All keys of a scenario, block by block, before it is known whether they fit one another."""

    name: Annotated[str, Name()]  # of the scenario; its files are named after it
    description: Annotated[str, LineRule()] = ""  # what it shows, for lists
    seed: Annotated[int, Integer(0, 2**64 - 1), SAMPLED] = 0  # of everything random
    robot: Robot = Field(default_factory=lambda: Robot.model_validate({"preset": DEFAULT_PRESET}))
    camera: Camera = Field(default_factory=Camera)
    sensors: Annotated[Sensors, SAMPLED] = Field(default_factory=Sensors)
    actuators: Annotated[Actuators, SAMPLED] = Field(default_factory=Actuators)
    base_motion: Annotated[BaseMotion, SAMPLED] = Field(default_factory=BaseMotion)
    target: Target
    uncertainty: Uncertainty = Field(default_factory=Uncertainty)
    controller: Controller = Field(default_factory=Controller)
    simulation: Simulation = Field(default_factory=Simulation)
    metrics: Metrics = Field(default_factory=Metrics)

    @property
    def legs_follow_twists(self) -> bool:
        """Whether legs follow the law's twist by themselves: what would make a wrench of it has no effect."""
        return self.moves_without_mass and self.controller.traits.output == "twist"

    @property
    def moves_without_mass(self) -> bool:
        """Whether drives take the positions of a platform without mass, whose damping is a gain of the law."""
        return self.actuators.takes_positions and bool(self.controller.traits.viscosity)

    @property
    def has_unknown_payload(self) -> bool:
        """Whether the platform has a payload that the controller does not know."""
        return self.robot.payload.mass > 0.0 and not self.robot.payload.known

    @property
    def target_moves(self) -> bool:
        """Whether the target moves in B: by itself, or at rest in W as the base does."""
        return self.target.motion.kind != "none" or (self.target.frame == "world" and moves(self.base_motion))


@cache
def preset_values(preset: str) -> dict[str, Any]:
    """Return what a preset puts in for the machine's own keys of the robot block, as plain data (not to be changed)."""
    if preset in MACHINES:
        keys = machine(preset)
    else:
        robot = _core.robot_preset(preset)
        own = ("platform_radius", "base_radius", "platform_angles", "base_angles", "home_position", "gravity", "mass")
        keys = {key: plain(tupled(getattr(robot, key))) for key in (*own, "stroke", "force_limit")}
        keys["inertia"] = plain(diagonal_if_diagonal(tupled(robot.inertia)))
    values: dict[str, Any] = plain(Robot.model_validate(keys))
    return {key: value for key, value in values.items() if key not in ("preset", "payload", "on_limit", "limits_every")}
