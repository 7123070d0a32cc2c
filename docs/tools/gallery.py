"""Draws every packaged scenario for the site: one run, its features and errors, and its verdict.

Run it as ``python docs/tools/gallery.py --out build/gallery``. A picture that was drawn from the same scenario with the
same package is kept, so that a second run takes a moment.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import warnings
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import hexservo as hs

PACKAGE = Path(hs.__file__).parent


@dataclass(frozen=True)
class Shown:
    """One scenario of the gallery."""

    name: str
    description: str
    law: str
    mode: str  # continuous or sampled
    verdict: str  # as in a comparison: settled, not settled, diverged, ...
    why: str  # one sentence


@cache
def code_of(package: Path) -> bytes:
    """Return the digest of this file, and of every Python file and compiled module of a package."""
    digest = hashlib.sha256()
    for file in (Path(__file__), *sorted(package.rglob("*.py")), *sorted(package.glob("*.so"))):
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.digest()


def key_of(scenario: hs.Scenario) -> str:
    """Return what a picture and its verdict depend on, as a digest: the scenario and all code of the package."""
    return hashlib.sha256(code_of(PACKAGE) + scenario.to_yaml().encode()).hexdigest()


def draw(scenario: hs.Scenario, picture: Path) -> Shown:
    """Run a scenario and draw the ways of its features and their errors into an SVG file."""
    from matplotlib.figure import Figure

    row = hs.compare([scenario], [scenario.controller.law]).rows[0]
    result = hs.simulate(scenario)
    figure = Figure(figsize=(7.2, 3.0), layout="constrained")
    ways, errors = figure.subplots(1, 2)
    hs.plots.feature_paths(result, ax=ways)
    hs.plots.feature_errors(result, ax=errors)
    for axes in (ways, errors):
        axes.set_title("")
        for text in [axes.xaxis.label, axes.yaxis.label, *axes.get_xticklabels(), *axes.get_yticklabels()]:
            text.set_fontsize(8)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Creating legend")  # its place takes a while to find in a run of a minute
        figure.savefig(picture, metadata={"Date": None})
    return Shown(
        scenario.name, scenario.description, scenario.controller.law, scenario.simulation.mode, row.verdict, row.why
    )


def gallery(folder: Path) -> list[Shown]:
    """Draw all packaged scenarios into a folder; what has not changed since the last time is kept."""
    folder.mkdir(parents=True, exist_ok=True)
    shown = []
    for name in hs.scenario_names():
        scenario = hs.load_scenario(name)
        picture, note = folder / f"{name}.svg", folder / f"{name}.json"
        key = key_of(scenario)
        kept = json.loads(note.read_text(encoding="utf-8")) if picture.exists() and note.exists() else {}
        if kept.get("key") != key:
            kept = {"key": key, **asdict(draw(scenario, picture))}
            note.write_text(json.dumps(kept, indent=1), encoding="utf-8")
        shown.append(Shown(**{field: value for field, value in kept.items() if field != "key"}))
    return shown


def main() -> None:
    """Draw the gallery and print a line for each scenario."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the pictures")
    for each in gallery(parser.parse_args().out):
        print(f"{each.name}: {each.verdict}, {each.why}")


if __name__ == "__main__":
    main()
