"""Image-based visual servoing of parallel robots: scenarios, simulation, metrics and figures.

>>> import hexservo as hs
>>> result = hs.simulate(hs.load_scenario("paper"))
>>> result.outcome
'completed'
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

try:
    from hexservo import _core  # noqa: F401
except ImportError as error:  # a source tree, or a wheel of another Python
    interruption = error.__cause__ or error.__context__
    if isinstance(interruption, KeyboardInterrupt):  # Ctrl-C while the core imported
        raise interruption from None
    raise ImportError(
        "hexservo: the compiled module hexservo._core is missing or was built for another Python; install the package "
        "(`pip install .` in the source tree) and import it from outside of python/"
    ) from error

from hexservo.run.drawn import drawn_by
from hexservo.scenario.version import VERSION

if TYPE_CHECKING:
    from hexservo import bridges, plots
    from hexservo.campaigns.engine import campaign
    from hexservo.campaigns.names import campaign_names
    from hexservo.campaigns.plan import CampaignPlan
    from hexservo.campaigns.rare import RareFailures, estimate_rare_failures
    from hexservo.campaigns.result import CampaignResult, WorstRun, load_campaign
    from hexservo.campaigns.sensitivity import Sensitivity, sensitivity
    from hexservo.campaigns.tune_result import TuneResult
    from hexservo.campaigns.tuning import tune
    from hexservo.campaigns.worst_case import WorstCase, worst_case
    from hexservo.findings.analysis import Analysis, analyse
    from hexservo.findings.certificate import BatchCertificate, Certificate, certify, certify_batch
    from hexservo.findings.diagnosis import Diagnosis, diagnose
    from hexservo.findings.identification import Identification, identify
    from hexservo.findings.identification.log import Log, read_log
    from hexservo.findings.leg_feedback import feedback_margin, integral_margin
    from hexservo.findings.reach import Reachability, project, reachable
    from hexservo.findings.scenario_check import Check, check
    from hexservo.report import write_report
    from hexservo.report.campaign_page import write_campaign_report
    from hexservo.run.batch import BatchResult, simulate_batch
    from hexservo.run.c_library import c_library
    from hexservo.run.compare import compare
    from hexservo.run.comparison import Comparison, ComparisonRow
    from hexservo.run.controller import Controller, ControllerOutput
    from hexservo.run.custom_controller import LegForces, LegPositions, Observation
    from hexservo.run.metrics import METRICS, metrics
    from hexservo.run.publish import OutputError
    from hexservo.run.result import LimitEvent, Result
    from hexservo.run.saved import load_result
    from hexservo.run.sealed import ResultError
    from hexservo.run.simulation import simulate
    from hexservo.run.variant import VariantError
    from hexservo.scenario.calibration import camera_from_opencv
    from hexservo.scenario.scenario import Scenario, load_scenario, scenario_names
    from hexservo.scenario.yaml import ScenarioError

__all__ = [
    "METRICS",
    "Analysis",
    "BatchCertificate",
    "BatchResult",
    "CampaignPlan",
    "CampaignResult",
    "Certificate",
    "Check",
    "Comparison",
    "ComparisonRow",
    "Controller",
    "ControllerOutput",
    "Diagnosis",
    "Identification",
    "LegForces",
    "LegPositions",
    "LimitEvent",
    "Log",
    "Observation",
    "OutputError",
    "RareFailures",
    "Reachability",
    "Result",
    "ResultError",
    "Scenario",
    "ScenarioError",
    "Sensitivity",
    "TuneResult",
    "VariantError",
    "WorstCase",
    "WorstRun",
    "__version__",
    "analyse",
    "bridges",
    "c_library",
    "camera_from_opencv",
    "campaign",
    "campaign_names",
    "certify",
    "certify_batch",
    "check",
    "compare",
    "diagnose",
    "estimate_rare_failures",
    "feedback_margin",
    "identify",
    "integral_margin",
    "load_campaign",
    "load_result",
    "load_scenario",
    "metrics",
    "plots",
    "project",
    "reachable",
    "read_log",
    "scenario_names",
    "sensitivity",
    "simulate",
    "simulate_batch",
    "tune",
    "worst_case",
    "write_campaign_report",
    "write_report",
]

__version__ = VERSION

# module -> its public names: imported when one of them is first used, since pydantic, SciPy and the rest take a while
_MODULES = {
    "campaigns.engine": ("campaign",),
    "campaigns.names": ("campaign_names",),
    "campaigns.plan": ("CampaignPlan",),
    "campaigns.rare": ("RareFailures", "estimate_rare_failures"),
    "campaigns.result": ("CampaignResult", "WorstRun", "load_campaign"),
    "campaigns.sensitivity": ("Sensitivity", "sensitivity"),
    "campaigns.tune_result": ("TuneResult",),
    "campaigns.tuning": ("tune",),
    "campaigns.worst_case": ("WorstCase", "worst_case"),
    "findings.analysis": ("Analysis", "analyse"),
    "findings.certificate": ("BatchCertificate", "Certificate", "certify", "certify_batch"),
    "findings.diagnosis": ("Diagnosis", "diagnose"),
    "findings.identification": ("Identification", "identify"),
    "findings.identification.log": ("Log", "read_log"),
    "findings.leg_feedback": ("feedback_margin", "integral_margin"),
    "findings.reach": ("Reachability", "project", "reachable"),
    "findings.scenario_check": ("Check", "check"),
    "report": ("write_report",),
    "report.campaign_page": ("write_campaign_report",),
    "run.batch": ("BatchResult", "simulate_batch"),
    "run.c_library": ("c_library",),
    "run.compare": ("compare",),
    "run.comparison": ("Comparison", "ComparisonRow"),
    "run.controller": ("Controller", "ControllerOutput"),
    "run.custom_controller": ("LegForces", "LegPositions", "Observation"),
    "run.metrics": ("METRICS", "metrics"),
    "run.publish": ("OutputError",),
    "run.result": ("LimitEvent", "Result"),
    "run.saved": ("load_result",),
    "run.sealed": ("ResultError",),
    "run.simulation": ("simulate",),
    "run.variant": ("VariantError",),
    "scenario.calibration": ("camera_from_opencv",),
    "scenario.scenario": ("Scenario", "load_scenario", "scenario_names"),
    "scenario.yaml": ("ScenarioError",),
}
_PLACES = {name: f"hexservo.{module}" for module, names in _MODULES.items() for name in names}

drawn_by(lambda: import_module("hexservo.report.notebook"))


if not TYPE_CHECKING:  # a type checker takes a module with this function to have every name

    def __getattr__(name: str) -> Any:
        """Import what a public name stands for when it is first used."""
        if name in ("bridges", "plots"):
            return import_module(f"hexservo.{name}")
        if name not in _PLACES:
            raise AttributeError(f"module 'hexservo' has no attribute {name!r}")
        value = globals()[name] = getattr(import_module(_PLACES[name]), name)
        return value


def __dir__() -> list[str]:
    """Offer the public names."""
    return sorted(__all__)
