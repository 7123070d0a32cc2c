"""Selection of the compiled run loop, once, when hexservo is imported."""

from __future__ import annotations

import os
from functools import cache
from importlib import import_module
from importlib.util import find_spec

from hexservo import _core

__all__ = ["ENVIRONMENT_VARIABLE", "VariantError", "available_variants", "chosen_kernel"]

ENVIRONMENT_VARIABLE = "HEXSERVO_VARIANT"
_VARIANTS = ("avx512", "avx2", "baseline")  # the fastest first


class VariantError(RuntimeError):
    """The environment asks for a compiled variant that is not known, not built or not supported by the processor."""


@cache
def available_variants() -> tuple[str, ...]:
    """Return the variants that were built and that processor and operating system support, the fastest first."""
    return tuple(name for name in _VARIANTS if _is_built(name) and _is_supported(name))


def chosen_kernel() -> _core.Kernel:
    """Return the run loop for this process.

    Raises
    ------
    VariantError
        Where the environment variable HEXSERVO_VARIANT asks for what is not there.
    """
    if isinstance(_CHOSEN, VariantError):
        raise _CHOSEN
    return _CHOSEN


def _is_built(name: str) -> bool:
    return find_spec(f"hexservo._core_{name}") is not None


def _is_supported(name: str) -> bool:
    return name == "baseline" or _core.processor_features().get(name, False)


def _choose(wanted: str) -> _core.Kernel:
    available = available_variants()
    if not wanted:
        return load_kernel(available[0])
    listing = ", ".join(available)
    if wanted not in _VARIANTS:
        raise VariantError(f'{ENVIRONMENT_VARIABLE}: expected one of {listing}, got "{wanted}"')
    if wanted not in available:
        reason = "this processor cannot run it" if _is_built(wanted) else "it was not built"
        raise VariantError(f'{ENVIRONMENT_VARIABLE}: expected one of {listing}, got "{wanted}": {reason}')
    return load_kernel(wanted)


def load_kernel(name: str) -> _core.Kernel:
    return _core.Kernel(import_module(f"hexservo._core_{name}").kernel)


def _chosen() -> _core.Kernel | VariantError:
    # A wrong choice raises only where a run needs it: commands that do not simulate (`hexservo check`) still work.
    try:
        return _choose(os.environ.get(ENVIRONMENT_VARIABLE, ""))
    except VariantError as error:
        return error


_CHOSEN = _chosen()
