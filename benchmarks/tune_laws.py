"""Tunes every law on two scenarios, and compares the gains with those of the scenario on runs that no search used.

Run it as ``python benchmarks/tune_laws.py``; ``--help`` has the options. Each law is searched by `hexservo.tune` over
drawn machines and starts (`VARY`), with larger errors (`WIDER`) and a share of each bound left (`BOUNDS`, `RESERVE`),
in runs of `SEARCHED` s; campaigns of the scenario's own duration judge both gains by the bounds and without these
larger errors. All is kept in a folder, and the same command
goes on after an interruption. The tables are Markdown. For each scenario a file with the tuned gains of all laws is
written, for ``hexservo compare``.

``--own-errors RUNS`` searches nothing: it judges the gains of examples/ by the same bounds with the errors that these
scenarios have themselves, over so many seeds of their noise, and prints a table.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import hexservo as hs
from hexservo.campaigns.plan import CampaignPlan
from hexservo.run.machine import describe_machine
from hexservo.scenario.laws import LAWS

ERRORS: dict[str, Any] = {
    "uncertainty.inertia": {"uniform": [-0.075, 0.075], "each": True, "symmetric": True},
    "uncertainty.coriolis": {"uniform": [-0.125, 0.125], "each": True},
    "uncertainty.gravity": {"normal": [0.0, 0.03], "clip": [-0.1, 0.1]},
    "uncertainty.depth": {"uniform": [-0.3, 0.3], "each": True},
    "camera.noise": {"uniform": [0.1, 0.3]},  # [px]
    "target.translation": {"uniform": [-5.0e-3, 5.0e-3], "each": True},  # [m]
    "target.rotation": {"uniform": [-0.01, 0.01], "each": True},  # [rad]
    "seed": "each",
}
EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
VARY: dict[str, dict[str, Any]] = {
    "real-machine": ERRORS
    | {"camera.dropout": {"uniform": [0.0, 0.05]}, "base_motion.level": {"log": [1.0e-6, 1.0e-4]}},
    "slow-camera": ERRORS | {"camera.latency": {"choice": [0.05, 0.066, 0.08]}},  # [s]
}
BOUNDS = {
    "settling_time": 1.0,  # [s]
    "rms_error": 0.5,  # [px]
    "peak_leg_excursion": 0.017,  # [m]
    "peak_leg_force": 0.9,  # [N], a reserve to the limit of 1 N
}
# Of the laws whose searches found no gains that keep 0.5 px with the other bounds.
RELAXED = {
    ("real-machine", "hybrid"): {"rms_error": 0.75},  # [px]
    ("real-machine", "kelly"): {"rms_error": 0.75},
    ("real-machine", "resolved_rate"): {"rms_error": 0.75},
    ("slow-camera", "hybrid"): {"rms_error": 0.75},
    ("slow-camera", "kelly"): {"rms_error": 0.75},
}
# Of a search for `pbvs`: in one frame of some 10 000 its estimate follows the image alone (docs/model.md), too seldom
# for the runs of a search, and a platform jumps the less the weaker its gains are.
WEAKER = {"pbvs": {"peak_leg_force": 0.3}}  # [N]
RESERVE = 0.1  # share of each bound that a search leaves, since it ends at a bound
WIDER = 1.2  # by which errors and starts of a search are larger: few variations miss what fails in one of a thousand
SEARCHED = 2.0  # [s], duration of the runs of a search
HALVES = [3, 3]  # forces share a gain, and moments do
VARIABLES: dict[str, dict[str, Any]] = {
    "hybrid": {
        "kp": {"log": [1e-8, 1e-4]},
        "kv": {"log": [1e-6, 1.0], "groups": HALVES},
        "fuzzy.adaptation": {"log": [1e-2, 1e4], "groups": HALVES},
        "fuzzy.error_scale": {"log": [0.1, 1000], "groups": HALVES},
        "fuzzy.rate_scale": {"log": [0.01, 100], "groups": HALVES},
    },
    "composite": {
        "kt": {"log": [0.005, 300], "groups": HALVES},
        "kd": {"log": [5e-4, 30], "groups": HALVES},
        "drive": {"log": [1, 40]},
        "prior": {"log": [100, 1e6], "groups": HALVES},
        "kv": {"log": [1e-6, 1e-2], "groups": HALVES},
        "fuzzy.adaptation": {"log": [1e-3, 100], "groups": HALVES},
        "fuzzy.error_scale": {"log": [1, 200], "groups": HALVES},
        "fuzzy.rate_scale": {"log": [0.01, 50], "groups": HALVES},
    },
    "kelly": {"kp": {"log": [1e-8, 1e-3]}, "kd": {"log": [1e-4, 100], "groups": HALVES}},
    "resolved_rate": {
        "gain": {"log": [0.3, 60]},
        "ki": {"log": [5e-4, 100], "groups": HALVES},
        "damping": {"log": [1, 1e7], "groups": HALVES},
    },
    "pbvs": {
        "kp": {"log": [0.005, 500], "groups": HALVES},
        "kd": {"log": [5e-4, 30], "groups": HALVES},
        "prior": {"log": [100, 1e6], "groups": HALVES},
    },
    "computed_torque": {
        "kp": {"log": [10, 2e4], "groups": HALVES},
        "kd": {"log": [3, 500], "groups": HALVES},
        "prior": {"log": [100, 1e6], "groups": HALVES},
    },
}


def required(scenario: str, law: str) -> list[str]:
    """Return the requirements."""
    return bounded(BOUNDS | RELAXED.get((scenario, law), {}))


def searched(scenario: str, law: str) -> list[str]:
    """Return the requirements of a search, which leave a share of each bound."""
    bounds = BOUNDS | RELAXED.get((scenario, law), {})
    return bounded({name: (1 - RESERVE) * bound for name, bound in bounds.items()} | WEAKER.get(law, {}))


def bounded(bounds: dict[str, float]) -> list[str]:
    """Return requirements that a run completes, and keeps bounds."""
    return ["outcome == completed", *(f"{name} <= {bound:g}" for name, bound in bounds.items())]


def widened(distribution: Any) -> Any:
    """Return an error's distribution, wider by `WIDER`; others as they are."""
    match distribution:
        case {"uniform": [low, high]} if low == -high:
            return distribution | {"uniform": [WIDER * low, WIDER * high]}
        case {"normal": [0.0, deviation], "clip": [low, high]}:
            return distribution | {"normal": [0.0, WIDER * deviation], "clip": [WIDER * low, WIDER * high]}
    return distribution


def plan_of(scenario: str, law: str, over: int) -> CampaignPlan:
    """Return the file of a search: one law on one scenario."""
    return CampaignPlan(
        scenario=hs.load_scenario(scenario).updated({"controller.law": law, "simulation.duration": SEARCHED}),
        vary={key: widened(distribution) for key, distribution in VARY[scenario].items()},
        require=searched(scenario, law),
        runs=200,
        tune={
            "variables": {f"controller.{law}.{key}": each for key, each in VARIABLES[law].items()},
            "minimise": "settling_time",
            "over": over,
        },
    )


def cells(result: hs.CampaignResult) -> list[str]:
    """Return failures with their interval, and the largest settling time, RMS error and leg force, of a campaign."""
    low, high = result.interval
    shown = [f"{result.failures} of {len(result)}, {low:.2g} ... {high:.2g}"]
    for name in ("settling_time", "rms_error", "peak_leg_force"):
        values = result.to_arrow([name]).column(0).to_numpy()
        missing = int((~(values < math.inf)).sum())
        shown.append(f"none in {missing}" if missing else f"{values.max():.3g}")
    return shown


def own_errors(scenario: str, law: str, runs: int) -> CampaignPlan:
    """Return a campaign of the published gains with the scenario's own errors, where nothing but the noise varies."""
    return CampaignPlan(
        scenario=hs.load_scenario(EXAMPLES / f"{scenario}-tuned.yaml").updated({"controller.law": law}),
        vary={"seed": "each"},
        require=required(scenario, law),
        runs=runs,
    )


def missed(result: hs.CampaignResult) -> str:
    """Return how many runs miss each bound, as "66 peak_leg_excursion, 2 peak_leg_force"."""
    bounds = [each for each in result.plan.require if each.name in BOUNDS]
    table = result.to_arrow([each.name for each in bounds])
    counts = {each.name: int((~(each.distance(table.column(each.name).to_numpy()) >= 0)).sum()) for each in bounds}
    return ", ".join(f"{count} {name}" for name, count in counts.items() if count) or "none"


def judge_own_errors(scenarios: list[str], laws: list[str], runs: int, out: Path, threads: int | None) -> None:
    """Print a table for each scenario: the published gains with its own errors."""
    heads = ["law", "failures", "settles [s]", "RMS [px]", "leg force [N]", "missed"]
    for scenario in scenarios:
        print("\n".join(f"| {' | '.join(row)} |" for row in [[f"{scenario}: law", *heads[1:]], ["---"] * len(heads)]))
        for law in laws:
            plan = own_errors(scenario, law, runs)
            result = hs.campaign(plan, out / f"own-{scenario}-{law}-{plan.digest()[:12]}", threads=threads)
            print(f"| {' | '.join([law, *cells(result), missed(result)])} |", flush=True)


def main() -> None:
    """Tune, judge both gains, and print a table for each scenario."""
    parser = argparse.ArgumentParser(description="Tuned gains for every law")
    parser.add_argument("--out", type=Path, default=Path("out/tuned"), help="folder (%(default)s)")
    parser.add_argument("--scenarios", default=",".join(VARY), help="(%(default)s)")
    parser.add_argument("--laws", default=",".join(LAWS), help="(%(default)s)")
    parser.add_argument("--generations", type=int, default=60, help="of each round (%(default)s)")
    parser.add_argument("--rounds", type=int, default=6, help="at most (%(default)s)")
    parser.add_argument("--over", type=int, default=100, help="drawn variations of a search (%(default)s)")
    parser.add_argument("--first", type=int, default=12, help="those of a first search; 0: none (%(default)s)")
    parser.add_argument("--runs", type=int, default=2000, help="of each campaign (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the searches (%(default)s)")
    parser.add_argument("--own-errors", type=int, metavar="RUNS", help="judge the gains of examples/, without a search")
    parser.add_argument("--threads", type=int, help="(one for each core)")
    given = parser.parse_args()
    machine = describe_machine()
    print(f"{machine['date']}, {machine['cpu']}, {machine['core']['variant']}, seed {given.seed}")
    if given.own_errors:
        judge_own_errors(given.scenarios.split(","), given.laws.split(","), given.own_errors, given.out, given.threads)
        return
    for scenario in given.scenarios.split(","):
        tuned = hs.load_scenario(scenario)
        rows = []
        for law in given.laws.split(","):
            plan, folder = plan_of(scenario, law, given.over), given.out / f"{scenario}-{law}"
            start = plan.scenario
            if given.first:  # over many variations, a search that begins at gains which diverge finds no way out
                first = hs.tune(
                    plan_of(scenario, law, given.first),
                    folder / "first",
                    generations=25,
                    rounds=6,
                    seed=given.seed,
                    threads=given.threads,
                )
                start = plan.scenario.updated(dict(first.gains))
            found = hs.tune(
                plan.changed(scenario=start),
                folder / "search",
                generations=given.generations,
                rounds=given.rounds,
                seed=given.seed,
                threads=given.threads,
            )
            whole = {"simulation.duration": hs.load_scenario(scenario).simulation.duration}
            plans = [
                plan.changed(
                    scenario=each.updated(whole),
                    vary=VARY[scenario],
                    require=required(scenario, law),
                    runs=given.runs,
                    stream=plan.stream + 2,
                )
                for each in (plan.scenario, found.scenario)
            ]
            hand, judged = (
                hs.campaign(each, folder / f"runs-{each.digest()[:12]}", threads=given.threads) for each in plans
            )
            tuned = tuned.updated(dict(found.gains))
            rows.append([law, *cells(hand), *cells(judged)])
            print(f"{scenario}, {law}: {' '.join(found.section().sentences)}", flush=True)
        path = given.out / f"{scenario}-tuned.yaml"
        path.write_text(tuned.updated({"name": f"{scenario}-tuned"}).to_yaml(), encoding="utf-8")
        names = ["failures", "settles [s]", "RMS [px]", "leg force [N]"]
        heads = ["law", *(f"{gains}: {name}" for gains in ("hand", "tuned") for name in names)]
        print("\n".join(f"| {' | '.join(row)} |" for row in [heads, ["---"] * len(heads), *rows]))
        print(f"hexservo compare --scenarios {path}", flush=True)


if __name__ == "__main__":
    main()
