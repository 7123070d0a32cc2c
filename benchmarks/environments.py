"""Environment steps a second of `hs.bridges.gymnasium`: ``python benchmarks/environments.py [SCENARIO] [PROCESSES]``.

Each process has 256 environments on one thread, as a learner's collectors have them; the default is two processes.
"""

from __future__ import annotations

import sys
import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np

import hexservo as hs

ENVIRONMENTS, STEPS = 256, 200


def steps_per_second(name: str) -> tuple[float, float]:
    """Return the rates of one process by the clock and by its processor time [1/s]."""
    env = hs.bridges.gymnasium(hs.load_scenario(name), ENVIRONMENTS, start_spread=[1e-3] * 3 + [1e-2] * 3)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1e-3, 1e-3, (16, ENVIRONMENTS, 6)).astype(np.float32)
    started, worked = time.perf_counter(), time.process_time()
    for step in range(STEPS):
        env.step(actions[step % 16])
    total = ENVIRONMENTS * STEPS
    return total / (time.perf_counter() - started), total / (time.process_time() - worked)


def main() -> None:
    """Print the rates of all processes, and their sum."""
    name = sys.argv[1] if len(sys.argv) > 1 else "paper-nominal"
    processes = int(sys.argv[2]) if len(sys.argv) > 2 else 2
    with ProcessPoolExecutor(processes) as pool:
        rates = list(pool.map(steps_per_second, [name] * processes))
    by_clock, by_work = (sum(each[kind] for each in rates) for kind in (0, 1))
    print(f"{name}: {by_clock:,.0f} environment steps a second on {processes} processes")
    print(f"{by_work:,.0f} on as many processors that do nothing else (by processor time)")


if __name__ == "__main__":
    main()
