"""How often the tuned gains of docs/robustness.md fail with the errors of their own scenario, over seeds of the noise.

The campaigns of that page draw the errors of the four depths independently; the scenarios have one common error, which
a shift of the platform explains exactly.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import hexservo as hs

_EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
_STROKE, _FORCE, _LATEST = 0.017, 0.9, 1.0  # [m], [N], [s]


def main() -> None:
    """Print a line per scenario and law."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1000)
    parser.add_argument("--laws", nargs="+", default=["hybrid", "composite", "kelly", "resolved_rate", "pbvs"])
    options = parser.parse_args()
    for name in ("slow-camera-tuned", "real-machine-tuned"):
        for law in options.laws:
            scenario = hs.load_scenario(_EXAMPLES / f"{name}.yaml").updated({"controller.law": law})
            found = hs.simulate_batch(scenario, {"seed": np.arange(options.seeds)}, log="metrics").metrics
            late = ~(found["settling_time"] <= _LATEST)
            beyond = found["peak_leg_excursion"] > _STROKE
            strong = found["peak_leg_force"] > _FORCE
            print(
                f"{name}, {law}: {np.sum(late | beyond | strong)} of {options.seeds} fail: {np.sum(beyond)} beyond the "
                f"stroke, {np.sum(late)} not settled within {_LATEST:g} s, {np.sum(strong)} above {_FORCE:g} N"
            )


if __name__ == "__main__":
    main()
