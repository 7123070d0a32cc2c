"""Image-based visual servoing of parallel robots: scenarios, simulation, metrics and figures.

>>> import hexservo as hs
>>> result = hs.simulate(hs.load_scenario("paper"))
>>> result.outcome
'completed'
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

try:
    from hexservo import _core
except ImportError as error:  # a source tree, or a wheel of another Python
    raise ImportError(
        "hexservo: the compiled module hexservo._core is missing or was built for another Python; install the package "
        "(`pip install .` in the source tree) and import it from outside of python/"
    ) from error

from hexservo.findings.analysis import Analysis, analyse
from hexservo.findings.certificate import BatchCertificate, Certificate, certify, certify_batch
from hexservo.findings.diagnosis import Diagnosis, diagnose
from hexservo.report import write_report
from hexservo.run.batch import BatchResult, simulate_batch
from hexservo.run.compare import Comparison, ComparisonRow, compare
from hexservo.run.controller import Controller, ControllerOutput
from hexservo.run.custom_controller import LegForces, Observation
from hexservo.run.metrics import METRICS, metrics
from hexservo.run.result import LimitEvent, Result
from hexservo.run.saved import ResultError, load_result
from hexservo.run.simulation import simulate
from hexservo.run.variant import VariantError
from hexservo.scenario.scenario import Scenario, ScenarioError, load_scenario, scenario_names

__all__ = [
    "METRICS",
    "Analysis",
    "BatchCertificate",
    "BatchResult",
    "Certificate",
    "Comparison",
    "ComparisonRow",
    "Controller",
    "ControllerOutput",
    "Diagnosis",
    "LegForces",
    "LimitEvent",
    "Observation",
    "Result",
    "ResultError",
    "Scenario",
    "ScenarioError",
    "VariantError",
    "__version__",
    "analyse",
    "certify",
    "certify_batch",
    "compare",
    "diagnose",
    "load_result",
    "load_scenario",
    "metrics",
    "plots",
    "scenario_names",
    "simulate",
    "simulate_batch",
    "write_report",
]

__version__: str = _core.build_info()["hexservo"]


def __getattr__(name: str) -> ModuleType:
    """Import the plotting module when it is first used: matplotlib takes most of a second."""
    if name == "plots":
        return import_module("hexservo.draw.plots")
    raise AttributeError(f"module 'hexservo' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Offer the public names, the plotting module among them."""
    return sorted(__all__)
