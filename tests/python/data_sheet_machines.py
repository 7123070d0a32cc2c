"""Two machines of 5 kg as `hexservo new --machine` writes them, for tests: linear legs, and cranks of that size.

They have the servo period and the frames of a usual camera, and rates by differences of encoders.
"""

from __future__ import annotations

from typing import Any

import hexservo as hs
from hexservo.scenario.scenario import Scenario

_ROBOT: dict[str, Any] = {
    "platform_radius": 0.1,
    "platform_angles": [-0.872664626, 0.872664626, 1.22173048, 2.96705973, 3.31612558, 5.06145483],
    "base_radius": 0.15,
    "base_angles": [-0.174532925, 0.174532925, 1.91986218, 2.26892803, 4.01425728, 4.36332313],
    "home_position": [0.0, 0.0, -0.16],
    "gravity": 9.81,
    "mass": 5.0,
    "inertia": [0.0125, 0.0125, 0.025],
}
_LINEAR = {"stroke": [-0.015, 0.015], "force_limit": 49.0}
_CRANKS = {
    "stroke": [-0.698131701, 0.698131701],
    "force_limit": 2.5,
    "legs": "rotary",
    "cranks": {
        "length": 0.05,
        "rod": 0.1766,
        "axes": [
            [0.984807753, -0.173648177, 0.0],
            [0.984807753, 0.173648177, 0.0],
            [-0.342020146, 0.93969262, 0.0],
            [-0.642787612, 0.766044442, 0.0],
            [-0.642787609, -0.766044443, 0.0],
            [-0.342020143, -0.939692621, 0.0],
        ],
        "zero": [
            [-0.173648177, -0.984807753, 0.0],
            [-0.173648177, 0.984807753, 0.0],
            [0.93969262, 0.342020146, 0.0],
            [-0.766044442, -0.642787612, 0.0],
            [-0.766044443, 0.642787609, 0.0],
            [0.939692621, -0.342020143, 0.0],
        ],
        "branch": [-1, 1, -1, 1, -1, 1],
    },
}


def data_sheet_machine(*, cranks: bool = False) -> Scenario:
    """Return the scenario of one of the machines, with `composite` at 1 Hz."""
    return hs.Scenario.model_validate(
        {
            "name": "crank" if cranks else "linear",
            "robot": {**_ROBOT, **(_CRANKS if cranks else _LINEAR)},
            "camera": {
                "focal_pixels": 1500.0,
                "image_size": [1280.0, 1024.0],
                "mount": {"position": [0.0, 0.0, 0.0]},
                "noise": 0.2,
                "period": 1 / 30,
                "latency": 1 / 30,
                "prediction": "encoder",
            },
            "target": {
                "tag": {"size": 0.082, "pose": [0.0, 0.0, -0.66, 0.0, 0.0, 0.0]},
                "desired_pose": [0.003, -0.002, 0.002, -0.00872664626, -0.00872664626, 0.0174532925],
            },
            "sensors": {"pose": "encoders", "resolution": 0.000104719755 if cranks else 1e-6},
            "controller": {
                "law": "composite",
                "switching": {"kind": "implicit_coupled"},
                "composite": {"auto": {"bandwidth": 1.0}},
            },
            "simulation": {"mode": "sampled", "step": 1 / 150, "duration": 10.0},
        }
    )
