"""Writes the results of a run into a folder: scenario, metrics, samples and figures."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexservo.findings.evidence import as_data
from hexservo.run.files import write_folder
from hexservo.scenario.reading import RESULT_OF_RUN, SCENARIO_OF_RUN

if TYPE_CHECKING:
    from hexservo.run.result import Result


def write_results(result: Result, folder: str | os.PathLike[str], *, force: bool = False) -> Path:
    """Write a run into a folder: scenario.yaml, metrics.json, result.nc, the paper's figures and a marker.

    Parameters
    ----------
    result
        The run; its outcome does not matter.
    folder, force
        As for `write_folder`; so are the return value and the exceptions.
    """
    contents = f'one run of the scenario "{result.scenario.name}"'
    return write_folder(folder, lambda temporary: _write_files(result, temporary), contents, force=force)


def _write_files(result: Result, folder: Path) -> None:
    from hexservo.draw.plots import paper_images
    from hexservo.run.saving import result_bytes

    (folder / SCENARIO_OF_RUN).write_text(result.scenario.to_yaml(), encoding="utf-8")
    (folder / "metrics.json").write_text(_metrics_json(result), encoding="utf-8")
    (folder / RESULT_OF_RUN).write_bytes(result_bytes(result))
    for name, content in paper_images(result).items():
        (folder / name).write_bytes(content)


def _metrics_json(result: Result) -> str:
    """Return outcome, events, points that leave the image and metrics as strict JSON: what is not finite is null."""
    from hexservo.run.metrics import metric_meaning, metric_unit, metrics
    from hexservo.run.unseen_points import unseen_points
    from hexservo.scenario.version import VERSION

    robot = result.scenario.robot
    content: dict[str, Any] = {
        "hexservo": VERSION,
        "scenario": result.scenario.name,
        "outcome": result.outcome,
        "end_time": {"value": result.end_time, "unit": "s"},
        "stop_time": {"value": result.stop_time, "unit": "s"},
        "detail": result.detail,
        "events": [
            {
                "kind": event.kind,
                "leg": event.leg,
                "time": {"value": event.time, "unit": "s"},
                "peak": {"value": event.peak, "unit": event.unit},
                "limit": {"value": event.limit, "unit": event.unit},
            }
            for event in result.events
        ],
        "points_outside_image": [
            {
                "point": one.point,
                "first": {"value": one.first, "unit": "s"},
                "total": {"value": one.total, "unit": "s"},
            }
            for one in unseen_points(result)
        ],
        "metrics": {
            name: {"value": value, "unit": metric_unit(name, robot), "meaning": metric_meaning(name, robot)}
            for name, value in metrics(result).items()
        },
    }
    return json.dumps(as_data(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
