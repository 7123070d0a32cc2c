"""Campaign files: which runs are drawn, what they must keep, and how many there are (docs/campaigns.md)."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib import resources
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, model_validator

from hexservo.campaigns.acting import keys_that_never_act, scenarios_at_the_ends
from hexservo.campaigns.distributions import SEED, Variation
from hexservo.campaigns.drawing import PLACED, Drawing
from hexservo.campaigns.file_keys import (
    PROBABILITY,
    MetricsRule,
    OptionalInteger,
    RecordRule,
    RequireRule,
    ScenarioRule,
    Until,
    UntilRule,
    VariantRule,
    VaryRule,
)
from hexservo.campaigns.intervals import JEFFREYS, RARE, Mixture, anytime_interval
from hexservo.campaigns.loop_numbers import without_loop
from hexservo.campaigns.names import campaign_names
from hexservo.campaigns.refused import FEW_DRAWS, MOST_REFUSED, refused_draw, refused_scenario, valid_rows
from hexservo.campaigns.requirements import Requirement
from hexservo.campaigns.tune_keys import TunePlan, TuneRule
from hexservo.campaigns.unfit import unfit, unfit_variable
from hexservo.run.metrics import OF_LIMITS, asked_metrics
from hexservo.run.variant import ENVIRONMENT_VARIABLE, VariantError, available_variants, chosen_kernel
from hexservo.run.variations import checked_variations
from hexservo.scenario.block import Block
from hexservo.scenario.blocks import Blocks
from hexservo.scenario.keys import value_at
from hexservo.scenario.noise import is_random
from hexservo.scenario.plain import dotted, plain
from hexservo.scenario.problems import in_words
from hexservo.scenario.rules import Flag, Integer, Problem, refusal, shown_value
from hexservo.scenario.scenario import Document, Scenario, load_scenario, scenario_names
from hexservo.scenario.wording import wrong_type
from hexservo.scenario.yaml import ScenarioError, dump_yaml, read_yaml

MAX_RUNS = 10**12
_REQUIRED = frozenset({"scenario", "vary", "require"})  # keys of a file
CHUNK_SIZE = 5000
MOST_LOG_EVERY = 10**9  # that a scenario may have
_DURATION, _DWELL = "simulation.duration", "metrics.dwell"
_OF_TIMES = {"rms_error": "metrics.rms_start", "settling_time": _DWELL}  # metrics of runs that are long enough
_ROUNDING = 1e-9  # of a bound that is the last time at which a run can settle
_MOST_CORNERS = 10  # numbers that vary; each doubles the corners


class CampaignPlan(Block):
    """A campaign file, checked. Immutable."""

    scenario: Annotated[Scenario, ScenarioRule()]  # what `vary` varies
    vary: Annotated[dict[str, Variation], VaryRule()]  # by dotted key
    require: Annotated[tuple[Requirement, ...], RequireRule()]
    runs: Annotated[int | None, OptionalInteger(1, MAX_RUNS)] = None  # with `until`: the most of them
    until: Annotated[Until | None, UntilRule()] = None
    chunk_size: Annotated[int, Integer(1, 10**6)] = CHUNK_SIZE  # runs that are computed and kept together
    confidence: Annotated[float, PROBABILITY] = 0.95  # of each interval
    rare: Annotated[bool, Flag()] = False  # the mixture of the interval is Beta(0.1, 1e4), for rare failures
    stream: Annotated[int, Integer(0, 2**63 - 1)] = 0  # another number, other variations
    variant: Annotated[str | None, VariantRule()] = None  # compiled variant; null: that of the process which begins
    metrics: Annotated[str | tuple[str, ...], MetricsRule()] = "all"  # kept of each run; those required are in any case
    tune: Annotated[TunePlan | None, TuneRule()] = None  # gains to search (docs/tune.md); a campaign ignores it
    record: Annotated[None, RecordRule()] = Field(default=None, exclude=True)

    def __init__(self, /, **keys: Any) -> None:
        """Check the keys of a campaign file.

        Raises
        ------
        ScenarioError
            With one line for each problem.
        """
        given = keys.get("scenario")
        keys = plain({key: value for key, value in keys.items() if key != "scenario"})
        if given is not None:
            # a path may have bytes that are no text
            keys["scenario"] = given if isinstance(given, Scenario | str) else plain(given, "scenario")
        try:
            super().__init__(**keys)
        except ValidationError as error:
            raise ScenarioError(list(in_words(error, CampaignPlan))) from None

    @model_validator(mode="after")
    def _fits_together(self) -> CampaignPlan:
        if self.runs is None and self.until is None:
            raise refusal((("runs",), "expected a number of runs, or until, got neither"))
        problems: list[Problem] = [
            (("vary", key), sentence)
            for key, variation in self.vary.items()
            if (sentence := unfit(self.scenario, key, variation))
        ]
        both = [key for key in ("target.initial_features", "target.depth", "target.points") if key in self.vary]
        if both and any(key in self.vary for key in PLACED):
            problems += [
                (("vary", key), f"expected nothing that places the points beside {PLACED[0]} and {PLACED[1]}")
                for key in both
            ]
        asked: list[tuple[tuple[str | int, ...], str]] = [
            (("require", index), one.name) for index, one in enumerate(self.require)
        ]
        problems += [
            (("require", index), sentence)
            for index, one in enumerate(self.require)
            if (sentence := one.undecided or _beyond_settling(self, one) or _excluded(self, one))
        ]
        if self.tune is not None:
            asked += [(("tune", "minimise"), name) for name in self.tune.minimise]
            problems += [
                (("tune", "variables", key), sentence)
                for key, variable in self.tune.variables.items()
                if (sentence := unfit_variable(self.scenario, key, variable, self.vary))
            ]
        problems += [(place, sentence) for place, name in asked if (sentence := _without_value(self, name))]
        problems = problems or list(keys_that_never_act(self)) or list(_unfit_for_search(self))
        if problems:
            raise refusal(*problems)
        drawing = self.drawing()
        if self.tune is not None and self.tune.corners and not 1 <= drawing.dimension <= _MOST_CORNERS:
            got = f"{drawing.dimension} numbers that vary, which have 2^{drawing.dimension} corners"
            raise refusal((("tune", "over"), f"corners: expected 1 to {_MOST_CORNERS} numbers that vary, got {got}"))
        numbers = drawing.numbers(0, FEW_DRAWS)
        try:
            # of a run too, whose samples would not fit a log: a campaign keeps none
            base = self.scenario.updated({**drawing.base, "simulation.log_every": MOST_LOG_EVERY})
            checked_variations(base, drawing.variations(drawing.numbers(0, 1)))
        except ValueError as error:
            if refused_scenario(error) is None:
                raise refusal(*((("vary",), line) for line in str(error).splitlines())) from None
            if len(valid_rows(base, drawing.variations(numbers), FEW_DRAWS)) < (1.0 - MOST_REFUSED) * FEW_DRAWS:
                drawn = refused_draw(error, self.scenario, numbers, lambda place: f"run {place}")
                raise refusal(*((("vary",), line) for line in str(drawn).splitlines())) from None
        return self

    def required_metrics(self) -> tuple[str, ...]:
        """Return the metrics that its requirements need."""
        return tuple(one.name for one in self.require if one.name != "outcome")

    def kept_metrics(self) -> tuple[str, ...]:
        """Return the metrics that it keeps of each run."""
        if self.metrics == "all":
            return asked_metrics("all")
        kept = {*self.metrics, *self.required_metrics()}
        # a settling time of 0 has two meanings without it
        return asked_metrics(tuple(kept | {"peak_error"} if "settling_time" in kept else kept))

    def drawing(self) -> Drawing:
        """Return what draws the variations of its runs."""
        return Drawing(self.scenario, self.vary, int(self.digest()[:32], 16))

    def drawn_from(self) -> dict[str, Any]:
        """Return all that determines the variations of its runs, by the keys of the file.

        That is the scenario without its name and description, `vary` as a list, whose order counts, and `stream`: runs,
        chunks and requirements may differ.
        """
        keys = self.scenario.to_mapping()
        return {
            "scenario": {key: value for key, value in keys.items() if key not in ("name", "description")},
            "vary": [[key, variation.to_plain()] for key, variation in self.vary.items()],
            "stream": self.stream,
        }

    def digest(self) -> str:
        """Return the SHA-256, in hexadecimal digits, of all that determines the variations of its runs."""
        text = json.dumps(list(self.drawn_from().values()), allow_nan=False, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def to_mapping(self) -> dict[str, Any]:
        """Return the whole file, every default filled in, as dicts, lists, text and numbers."""
        return {
            "scenario": self.scenario.to_mapping(),
            "vary": {key: variation.to_plain() for key, variation in self.vary.items()},
            "require": [requirement.to_plain() for requirement in self.require],
            "runs": self.runs,
            "until": None if self.until is None else self.until.to_plain(),
            "chunk_size": self.chunk_size,
            "confidence": self.confidence,
            "rare": self.rare,
            "stream": self.stream,
            "variant": self.variant,
            "metrics": self.metrics if isinstance(self.metrics, str) else list(self.metrics),
            "tune": None if self.tune is None else self.tune.to_plain(),
        }

    def to_yaml(self) -> str:
        """Return the whole file as YAML that `load_plan` reads back equal."""
        return dump_yaml(self.to_mapping())

    def changed(self, **keys: Any) -> CampaignPlan:
        """Return a copy with some keys changed, checked again.

        Raises
        ------
        ScenarioError
            With one line for each problem.
        """
        return CampaignPlan(**{**self.to_mapping(), "scenario": self.scenario, **keys})

    @cached_property
    def common_noise(self) -> int | None:
        """The seed of the noise that all runs share; None where each has its own, or none is random."""
        if "seed" in self.vary:
            return None
        return self.scenario.seed if any(map(is_random, chain([self.scenario], scenarios_at_the_ends(self)))) else None

    @cached_property
    def needs_motion(self) -> bool:
        """Whether settling is required or minimised, and staying at the start is no result in any run."""
        from hexservo.findings.analysis.scene import has_to_hold

        minimised = () if self.tune is None else self.tune.minimise
        if "settling_time" not in (*self.required_metrics(), *minimised):
            return False
        return not any(map(has_to_hold, chain([self.scenario], scenarios_at_the_ends(self))))

    def with_own_noise(self) -> CampaignPlan:
        """Return a copy in which each run has its own noise, where all share one; else this plan."""
        if self.common_noise is None:
            return self
        return self.changed(vary={**self.to_mapping()["vary"], "seed": SEED})

    @property
    def chunk_count(self) -> int | None:
        """Number of chunks; None if only the interval ends the campaign."""
        return None if self.runs is None else -(-self.runs // self.chunk_size)

    def runs_of_chunk(self, index: int) -> tuple[int, int]:
        """Return the first run of a chunk, and the one after its last.

        Raises
        ------
        IndexError
            For a chunk that the campaign does not have.
        """
        if index < 0 or (self.chunk_count is not None and index >= self.chunk_count):
            raise IndexError(f"index: expected a chunk of the campaign, counted from 0, got {index}")
        first = index * self.chunk_size
        last = first + self.chunk_size
        return first, last if self.runs is None else min(last, self.runs)

    @property
    def mixture(self) -> Mixture:
        """The mixture of the intervals that hold at any stop."""
        return RARE if self.rare else JEFFREYS

    def interval(self, failures: int, runs: int) -> tuple[float, float]:
        """Return the interval of a failure probability, which holds at any stop (docs/campaigns.md, section 5).

        Raises
        ------
        TypeError
            For counts that are no integers.
        ValueError
            Unless 0 <= failures <= runs.
        """
        return anytime_interval(failures, runs, self.confidence, self.mixture)

    def required_variant(self) -> str:
        """Return the compiled variant that its runs need, which is the one that this process uses.

        Raises
        ------
        VariantError
            The campaign needs a different one.
        """
        chosen = chosen_kernel().name
        if self.variant not in (None, chosen):
            if self.variant in available_variants():
                remedy = f"set {ENVIRONMENT_VARIABLE}={self.variant}"
            else:
                remedy = f"this machine has {', '.join(available_variants())}: run it elsewhere, or in a new folder"
            raise VariantError(f"variant: expected {self.variant}, that of the campaign, got {chosen}; {remedy}")
        return chosen


def _unfit_for_search(plan: CampaignPlan) -> Iterator[Problem]:
    """Find gains to search that have no value where a search begins, and requirements on a loop that no gains have."""
    if plan.tune is None:
        return
    for key in plan.tune.variables:
        if value_at(plan.scenario, key) is None:
            yield (
                ("tune", "variables", key),
                "expected a scenario with a number, where the search begins, got null; set the key in the scenario",
            )
    if plan.tune.subject_to and (reason := without_loop(plan.scenario)):
        yield ("tune", "subject_to"), f"expected a scenario with a linear loop, got one without: {reason}"


def _without_value(plan: CampaignPlan, metric: str) -> str:
    """Return why no run of a campaign has a value of a metric; "" where some may."""
    limit = OF_LIMITS.get(metric)
    if limit is not None and limit not in plan.vary and value_at(plan.scenario, limit) is None:
        return f"{metric}: expected {limit} in the scenario, without which no run has a value, got null"
    needed = _OF_TIMES.get(metric)
    if needed is not None and (time := _reach(plan, needed)[0]) > (span := _reach(plan, _DURATION)[1]):
        return f"{metric}: expected {needed} within the {span:g} s of a run, got {time:g} s"
    return ""


def _beyond_settling(plan: CampaignPlan, requirement: Requirement) -> str:
    """Return why no run shows whether it settles by the bound of a requirement; "" where some may.

    A settled run is within the band for the dwell time at its end, so that an earlier bound would hold in its place.
    """
    if requirement.name != "settling_time":
        return ""
    span, dwell = _reach(plan, _DURATION)[1], _reach(plan, _DWELL)[0]
    if dwell > span or requirement.bound <= (span - dwell) * (1.0 + _ROUNDING):  # the former: `_without_value`
        return ""
    return (
        f"settling_time: expected a bound of at most {span - dwell:.6g} s, as a run of {span:g} s can settle no later "
        f"(simulation.duration - metrics.dwell), got {requirement.bound:g} s; lower the bound or lengthen the run"
    )


def _excluded(plan: CampaignPlan, requirement: Requirement) -> str:
    """Return with which lower bound no run can keep an upper one on the same metric; "" where there is none."""
    other = next((one for one in plan.require if requirement.excludes(one)), None)
    return (
        "" if other is None else f"{requirement.name}: expected bounds with a value between, got {requirement}, {other}"
    )


def _reach(plan: CampaignPlan, key: str) -> tuple[float, float]:
    """Return the least and the largest value that a key which holds a number has in the runs."""
    present = float(value_at(plan.scenario, key))
    if key not in plan.vary:
        return present, present
    variation = plan.vary[key]
    low, high = variation.reach
    return (low + present, high + present) if variation.add else (low, high)


# ---- Campaigns by name or path --------------------------------------------------------------------------------------


def load_plan(
    source: str | os.PathLike[str] | Mapping[str, Any] | CampaignPlan,
    changes: Mapping[str, Any] | None = None,
    **keys: Any,
) -> CampaignPlan:
    """Load a campaign file.

    Parameters
    ----------
    source
        One of `campaign_names`, the path of a file, or what a file holds. A packaged name wins over a file of the same
        name in the current folder. A path of a scenario in a file is relative to that file.
    changes
        Of its scenario, as for `load_scenario`; of a `Scenario`, as for `Scenario.updated`. A key that `vary` has is
        refused where no run has anything of its value.
    keys
        In place of keys of the file; None leaves a key as it is.

    Raises
    ------
    TypeError
        For anything else.
    ScenarioError
        No such campaign, a file that cannot be read, or a campaign that is not valid: then with one line for each
        problem, headed by the file's name unless the changes are the cause.
    """
    if changes is not None and not isinstance(changes, Mapping):
        raise wrong_type("changes", "a mapping of dotted keys, or None", changes)
    name, document = None, source
    if isinstance(source, CampaignPlan):
        document = {**source.to_mapping(), "scenario": source.scenario}
    elif isinstance(source, str | os.PathLike):
        name, document = os.fsdecode(source), _read(source)
    elif not isinstance(source, Mapping):
        raise wrong_type("source", "the name or path of a campaign, or a mapping", source)
    if not isinstance(document, Mapping):
        raise ScenarioError(
            f"expected a campaign: a block with scenario, vary and require; got {shown_value(document)}", name
        )
    if _REQUIRED.isdisjoint(document) and (Blocks.model_fields.keys() - CampaignPlan.model_fields) & document.keys():
        raise ScenarioError(
            "expected a campaign, with the keys scenario, vary and require, got a scenario: `hexservo run` runs it, "
            "and a campaign names its file under scenario, beside what varies (docs/campaigns.md)",
            name,
        )
    document = {**document, **{key: value for key, value in keys.items() if value is not None}}
    before = document.get("scenario")
    if changes and before is not None:
        document["scenario"] = _changed(before, changes, name)
    try:
        plan = CampaignPlan(**document)
    except ScenarioError as error:
        raise ScenarioError(error.problems, error.source or name) from None
    _refuse_idle(plan, before, changes or {})
    return plan


def _refuse_idle(plan: CampaignPlan, before: Any, changes: Mapping[str, Any]) -> None:
    """Refuse changes of keys that vary, without which a plan with the scenario `before` would have the same runs.

    A number that is added to the value has it in every run, and where the file has a goal pose or a tag, the camera's
    keys are in the goal image, which does not vary.
    """
    given = dotted(changes)
    idle = []
    for key in given:
        if key in plan.vary and not plan.vary[key].add:
            others = {name: value for name, value in given.items() if name != key}
            with contextlib.suppress(ValueError):  # of a scenario that is not valid without the change
                if _first_run(plan, _changed(before, others)) == _first_run(plan, plan.scenario):
                    idle.append(key)
    if idle:
        reason = "has no effect, since vary has the key too, and every run draws its own value"
        raise ScenarioError([f"{key}: {reason}; drop the setting, or the key from vary" for key in idle])


def _first_run(plan: CampaignPlan, scenario: Scenario) -> Scenario:
    """Return the scenario of a run in a plan with this scenario, which draws the same numbers for any."""
    return scenario.updated(Drawing(scenario, plan.vary, 0).changes(0))


def _changed(scenario: Any, changes: Mapping[str, Any], source: str | None = None) -> Scenario:
    """Return a campaign's scenario with changes; errors are headed by the source where these are not the cause."""
    written = plain(scenario) if isinstance(scenario, Mapping) else scenario
    try:
        accepted = ScenarioRule().accept(written)
    except ValidationError as error:
        problems = [f"scenario: {each['msg']}" for each in error.errors(include_url=False)]
        raise ScenarioError(problems, source) from None
    if isinstance(written, str):
        return load_scenario(written, changes)
    return Document(written, source).scenario(changes) if isinstance(written, dict) else accepted.updated(changes)


def _read(source: str | os.PathLike[str]) -> Any:
    if isinstance(source, str):
        if source in campaign_names():
            packaged = resources.files("hexservo") / "campaigns" / "packaged" / f"{source}.yaml"
            with resources.as_file(packaged) as path:
                return read_yaml(path)
        if not os.path.lexists(source):
            names = ", ".join(campaign_names())
            other = ", which is that of a scenario (`hexservo run`)" if source in scenario_names() else ""
            problem = f"no such file, and no packaged campaign has that name{other}; packaged: {names}"
            raise ScenarioError(problem, f'"{source}"')
    document = read_yaml(source)
    if isinstance(document, dict) and isinstance(document.get("scenario"), str):
        named = str(document["scenario"])
        beside = Path(os.fsdecode(source)).parent / named
        if named not in scenario_names() and not Path(named).is_absolute():
            document["scenario"] = str(beside)
    return document
