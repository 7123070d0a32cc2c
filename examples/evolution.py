"""The CMA evolution strategy: minimises a function of which only comparisons are trusted."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]


def evolve(
    cost: Callable[[Array], Array],
    start: Array,
    step: float,
    generations: int,
    random: np.random.Generator,
    after: Callable[[int, float, Array], bool],
) -> Array:
    """Minimise over the unit cube by CMA-ES; names and constants are those of Hansen's tutorial.

    Parameters
    ----------
    cost
        (k, n) points to (k,) costs; only their order matters.
    after
        Called after each generation with its number, the lowest cost so far and its point; true where it changed what
        the costs are.
    """
    n = len(start)
    offspring = 20  # more than the tutorial's 4 + 3 log n: the costs are noisy
    mu = offspring // 2
    weights = math.log(mu + 0.5) - np.log(np.arange(1, mu + 1))
    weights /= weights.sum()
    mu_eff = 1 / float((weights**2).sum())
    c_sigma = (mu_eff + 2) / (n + mu_eff + 5)
    d_sigma = 1 + c_sigma + 2 * max(0.0, math.sqrt((mu_eff - 1) / (n + 1)) - 1)
    c_c = (4 + mu_eff / n) / (n + 4 + 2 * mu_eff / n)
    c_1 = 2 / ((n + 1.3) ** 2 + mu_eff)
    c_mu = min(1 - c_1, 2 * (mu_eff - 2 + 1 / mu_eff) / ((n + 2) ** 2 + mu_eff))
    length = math.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))  # of a random vector, on average

    mean, C = start.copy(), np.eye(n)
    p_sigma, p_c = np.zeros(n), np.zeros(n)
    lowest, best = math.inf, start
    for generation in range(generations):
        squares, B = np.linalg.eigh(C)
        D = np.sqrt(np.maximum(squares, 1e-20))
        y = (random.standard_normal((offspring, n)) * D) @ B.T
        points = mean + step * y
        inside = np.clip(points, 0, 1)
        costs = cost(inside) + 10 * ((points - inside) ** 2).sum(axis=1)  # back towards the cube
        order = np.argsort(costs, kind="stable")
        if costs[order[0]] < lowest:
            lowest, best = float(costs[order[0]]), inside[order[0]]
        chosen = y[order[:mu]]
        y_w = weights @ chosen
        mean = mean + step * y_w
        p_sigma = (1 - c_sigma) * p_sigma + math.sqrt(c_sigma * (2 - c_sigma) * mu_eff) * (B @ ((B.T @ y_w) / D))
        grown = float(np.linalg.norm(p_sigma))
        h = float(grown / math.sqrt(1 - (1 - c_sigma) ** (2 * (generation + 1))) < (1.4 + 2 / (n + 1)) * length)
        p_c = (1 - c_c) * p_c + h * math.sqrt(c_c * (2 - c_c) * mu_eff) * y_w
        C = (
            (1 - c_1 - c_mu + (1 - h) * c_1 * c_c * (2 - c_c)) * C
            + c_1 * np.outer(p_c, p_c)
            + c_mu * (chosen.T * weights) @ chosen
        )
        step = min(0.4, step * math.exp(c_sigma / d_sigma * (grown / length - 1)))
        if after(generation, lowest, best):
            lowest = float(cost(best[None])[0])
    return best
