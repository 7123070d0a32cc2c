"""The keys of a scenario without a cause of a diagnosis, and why they need none."""

from __future__ import annotations

IN_COMMON: dict[str, str] = {
    "robot.stroke_centre": "leg_limits: part of the travel",
    "robot.preset": "stands for the robot's other keys",
    "robot.platform_radius": "leg_limits and gains: acts through the reach of the legs and the stiffness of the loop",
    "robot.base_radius": "as platform_radius",
    "robot.platform_angles": "as platform_radius",
    "robot.base_angles": "as platform_radius",
    "robot.platform_joints": "as platform_radius",
    "robot.base_joints": "as platform_radius",
    "robot.home_position": "as platform_radius: the middle of the leg travel is counted from home",
    "robot.home_attitude": "as home_position",
    "robot.legs": "as platform_radius",
    **dict.fromkeys(
        (f"robot.cranks.{name}" for name in ("length", "rod", "axes", "zero", "branch")), "as platform_radius"
    ),
    "robot.gravity": "gravity: the law feeds the weight forward, and only its error counts",
    "robot.centre_of_mass": "gravity: known to the controller, as the mass is",
    "robot.mass": "gains: they are high or low for a mass",
    "robot.inertia": "gains: they are high or low for an inertia",
    "simulation.mode": "decides whether devices act; each of them has its removal",
    "camera.prediction": "late_camera, depth and encoders: a prediction repeats their errors and adds none",
    "simulation.start.pose": "leg_limits and lost_features: acts through the reach of the legs and the image",
    "simulation.start.twist": "as start.pose",
    "actuators.kind": "what the drives take is how a machine is built; causes of positions and motors have removals",
    "controller.virtual_platform.damping": "gains: it adds to the damping of the law",
    "target.tag": "read into points",
    "target.grid": "read into points",
    "target.weights": "pixel_noise and lost_features: what the points count in the image, whose errors have removals",
    "target.desired_pose": "read into desired_features",
    "camera.latency_known": "late_camera: without latency there is nothing to know",
    "camera.convention": "another plant, for the paper's signs; the goal's pose is open there",
}
"""Keys that act only through the cause of another key, each with that cause."""

HARMLESS: dict[str, str] = {
    "name": "names output",
    "description": "is shown in lists",
    "seed": "chooses among equal draws; whether it decides is tried with other seeds",
    "simulation.log_every": "no effect on the run or its metrics",
    "robot.limits_every": "can only delay when a limit is seen",
    "metrics.rms_start": "affects only the metric rms_error, which is no criterion",
    "controller.tracking.band": (
        "acts on legs that come to rest elsewhere than commanded, as motors with friction do: `motors`, `stick_slip`"
    ),
}
"""Keys that cannot make a run fail, each with the reason."""
