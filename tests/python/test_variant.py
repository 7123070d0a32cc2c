"""The compiled variants: which is chosen, what they export and contain, and that they agree."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from functools import cache
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo import _core
from hexservo.run.variant import ENVIRONMENT_VARIABLE, available_variants, chosen_kernel, load_kernel
from hexservo.scenario.parameters import core_parameters

X86 = bool(_core.processor_features())
LANES = {"baseline": 2, "avx2": 4, "avx512": 8}


def python(code: str, variant: str | None) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key != ENVIRONMENT_VARIABLE}
    if variant is not None:
        environment[ENVIRONMENT_VARIABLE] = variant
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)


def module_path(name: str) -> str:
    spec = importlib.util.find_spec(f"hexservo.{name}")
    assert spec is not None, f"{name} was not built"
    assert spec.origin is not None
    return spec.origin


def built_modules() -> list[str]:
    return ["_core", *(f"_core_{name}" for name in (LANES if X86 else ("baseline",)))]


def test_the_fastest_that_the_processor_has_is_chosen() -> None:
    assert available_variants()[-1] == "baseline"
    run = python("from hexservo.run.variant import chosen_kernel as k; print(k().name, k().lanes)", None)
    assert run.stdout.split() == [available_variants()[0], str(LANES[available_variants()[0]])], run.stderr


@pytest.mark.parametrize("variant", available_variants())
def test_a_home_pose_at_the_origin_of_the_base_has_no_meaning_of_its_own(variant: str) -> None:
    """Registers have places beyond six legs: joints at (0, 0, 0), whose leg has no length there."""
    circles = [np.deg2rad(angles) for angles in ([-50, 50, 70, 170, 190, 290], [-10, 10, 110, 130, 230, 250])]
    platform, base = (
        np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(6, z)])
        for radius, angles, z in zip((0.1, 0.2), circles, (0.0, 0.15), strict=True)
    )
    scenario = hs.load_scenario("composite-30hz").updated(
        {
            "robot.platform_joints": platform.tolist(),
            "robot.base_joints": base.tolist(),
            "robot.home_position": [0.0, 0.0, 0.0],
            "sensors.pose": "encoders",
            "simulation.duration": 0.05,
        }
    )
    run = _core.simulate(core_parameters(scenario), load_kernel(variant))
    assert (run.outcome.name, len(run.time)) == ("completed", 51), run.detail


@pytest.mark.parametrize("variant", available_variants())
def test_each_can_be_forced_and_says_so(variant: str) -> None:
    run = python("from hexservo.cli import main; import sys; sys.argv = ['hexservo', 'version']; main()", variant)
    assert run.returncode == 0, run.stderr
    facts = dict(re.split(r": +", line, maxsplit=1) for line in run.stdout.splitlines())
    listing = ", ".join(available_variants())
    assert facts["variant"] == f"{variant}, {LANES[variant]} scenarios per vector (available: {listing})"
    assert "-O" in facts["its flags"]
    assert ("-ffp-contract=fast" in facts["its flags"]) == (variant != "baseline")
    assert ("-mavx512f" in facts["its flags"]) == (variant == "avx512")


@pytest.mark.parametrize(
    ("wanted", "reason"),
    [
        ("sse9", '"sse9"'),
        pytest.param("avx512", "this processor cannot run it", marks=pytest.mark.skipif(not X86, reason="not built")),
    ],
)
def test_an_unknown_or_unsupported_one_is_refused_in_one_line(wanted: str, reason: str) -> None:
    program = """
import sys
from hexservo import _core
from hexservo.run import variant
from hexservo.cli import main
_core.processor_features = lambda: {}  # an old processor
variant.available_variants.cache_clear()
variant._CHOSEN = variant._chosen()
sys.argv = ["hexservo", "run", "paper"]
main()
"""
    run = python(program, wanted)
    assert run.returncode == 2, run.stderr
    (line,) = run.stderr.splitlines()
    assert line.startswith(f"Error: {ENVIRONMENT_VARIABLE}: expected one of baseline, got ")
    assert line.endswith(reason)


def test_a_wrong_choice_stops_runs_and_not_the_import() -> None:
    program = """
import hexservo as hs
scenario = hs.load_scenario("paper")
for run in (lambda: hs.simulate(scenario), lambda: hs.simulate_batch(scenario, {"robot.mass": [0.1]})):
    try:
        run()
    except hs.VariantError as error:
        print(error)
"""
    run = python(program, "turbo")
    assert run.returncode == 0, run.stderr
    assert len(set(run.stdout.splitlines())) == 1
    assert run.stdout.startswith(f"{ENVIRONMENT_VARIABLE}: expected one of ")
    assert len(run.stdout.splitlines()) == 2


PROGRAM = """
import json, numpy as np, hexservo as hs
scenario = hs.load_scenario("paper").updated({"controller.switching": {"kind": "tanh", "width": 0.01},
                                             "simulation.duration": 1.2, "simulation.log_every": 50})
result = hs.simulate(scenario)
depths = np.linspace(-0.5, 0.5, 11)
batch = hs.simulate_batch(scenario, {"uncertainty.depth": depths, "controller.hybrid.kp": np.full((1, 8), 2e-6)})
print(json.dumps({
    "single": {name: getattr(result, name).tolist()
               for name in ("feature_error", "position", "twist", "wrench", "leg_forces", "fuzzy_weights")},
    "metrics": hs.metrics(result),
    "batch": {name: values.tolist() for name, values in (batch.samples | dict(batch.metrics)).items()}}))
"""


@cache
def answers(variant: str) -> dict[str, Any]:
    run = python(PROGRAM, variant)
    assert run.returncode == 0, run.stderr
    return dict(json.loads(run.stdout))


@pytest.mark.parametrize("variant", [name for name in available_variants() if name != "baseline"])
@pytest.mark.parametrize("part", ["single", "metrics", "batch"])
def test_variants_agree_on_the_smooth_loop(variant: str, part: str) -> None:
    expected, got = answers("baseline")[part], answers(variant)[part]
    assert expected.keys() == got.keys()
    different = False
    for name in expected:
        a, b = np.asarray(expected[name]), np.asarray(got[name])
        size = np.max(np.abs(a), initial=0.0, where=np.isfinite(a))
        np.testing.assert_allclose(b, a, rtol=0, atol=1e-9 * size, err_msg=name)
        different |= not np.array_equal(a, b, equal_nan=True)
    assert different, "bit for bit the same: was the other variant run at all?"


@pytest.mark.parametrize("module", built_modules())
@pytest.mark.skipif(shutil.which("nm") is None, reason="needs nm")
def test_a_module_exports_its_entry_point_only(module: str) -> None:
    listing = subprocess.run(
        ["nm", "-D", "--defined-only", module_path(module)], capture_output=True, text=True, check=True
    )
    assert [line.split()[-1] for line in listing.stdout.splitlines()] == [f"PyInit_{module}"]


@pytest.mark.parametrize("module", built_modules())
@pytest.mark.skipif(shutil.which("objdump") is None or not X86, reason="needs objdump, and an x86-64 processor")
def test_only_the_vector_variants_contain_wide_instructions(module: str) -> None:
    code = subprocess.run(["objdump", "-d", module_path(module)], capture_output=True, text=True, check=True).stdout
    wide = {register: f"%{register}" in code for register in ("ymm", "zmm")}
    expected = {"_core_avx2": {"ymm": True, "zmm": False}, "_core_avx512": {"ymm": True, "zmm": True}}
    assert wide == expected.get(module, {"ymm": False, "zmm": False})
    fused = re.search(r"\tvfmadd\w+pd ", code) is not None
    assert fused == (module in expected)


def test_a_kernel_comes_from_its_own_capsule_only() -> None:
    import datetime

    with pytest.raises(ValueError, match="capsule: expected a hexservo kernel, got another one"):
        _core.Kernel(datetime.datetime_CAPI)
    assert chosen_kernel().fma_peak(0.01) > 0.1
    assert hs.VariantError.__mro__[1] is RuntimeError
