"""The theorem's assumption of runs with few samples, to which weights can be fitted whatever the uncertainty is."""

from __future__ import annotations

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.certificate.uncertainty import Assumption
from hexservo.findings.certificate.weights import best_weights
from hexservo.findings.evidence import Table

SEED = 65


def assumption(scenario: hs.Scenario, samples: int, **changes: object) -> Assumption:
    step = scenario.simulation.step
    found = hs.certify(hs.simulate(scenario.updated({"simulation.duration": (samples - 1) * step, **changes})))
    assert found.assumption is not None
    return found.assumption


@pytest.mark.parametrize("samples", [2, 5, 21])
@pytest.mark.parametrize("kv", [None, 1e-9])
def test_few_samples_leave_the_assumption_open(paper: hs.Scenario, samples: int, kv: float | None) -> None:
    """Whatever k_v is: without the rule such runs are "good"."""
    found = assumption(paper, samples, **({} if kv is None else {"controller.hybrid.kv": kv}))
    section = found.section()
    if (found.margin < -found.rounding).any():  # no weights do, even for few samples
        assert section.verdict == "warning"
    else:
        assert section.verdict == "open"
        assert f"The run has {samples} samples" in " ".join(section.sentences)
    few = found.few_samples
    assert few.any()
    assert not (found.decided | found.held)[few].any()
    assert (samples < 2 * found.rank[few]).all()
    assert (found.largest[few] > found.kv[few]).all()  # where Delta-tau itself is within k_v nothing is fitted
    table = section.items[0]
    assert isinstance(table, Table)
    column = [of.title for of in table.columns].index("held")
    assert [row[column] == "undecided" for row in table.rows] == few.tolist()


def test_many_samples_decide_it(paper: hs.Scenario) -> None:
    """From 98 samples on, twice the weights, every run is decided, and without fuzzy systems any run."""
    found = assumption(paper, 98)
    assert found.decided.all()
    assert found.rank.max() == 49
    assert found.section().verdict == "warning"
    assert assumption(paper, 11, **{"controller.hybrid.fuzzy.enabled": False}).decided.all()


def test_weights_fit_most_signs_of_few_samples() -> None:
    """Cover's theorem: of n samples in general position and r weights the share is P(Binomial(n - 1, 1/2) < r)."""
    random = np.random.default_rng(SEED)
    weights, draws = 6, 200
    for samples, share in ((12, 0.5), (6, 1.0), (24, 0.0053)):
        fitted = 0
        for _ in range(draws):
            basis, signs = random.normal(size=(samples, weights)), random.choice([-1.0, 1.0], samples)
            fitted += best_weights(basis, signs, smallest=False).error < 1.0 - 1e-6
        assert abs(fitted / draws - share) <= 4.0 * np.sqrt(max(share * (1 - share), 0.005) / draws)
