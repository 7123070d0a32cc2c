"""Description of the machine of a measurement."""

from __future__ import annotations

import os
import platform
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from hexservo import _core
from hexservo.run.batch import thread_count
from hexservo.run.variant import available_variants, chosen_kernel


def describe_machine() -> dict[str, Any]:
    """Processor, system, interpreter, compiler and flags of the core, and how busy the machine is as we start."""
    kernel = chosen_kernel()
    return {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "host": platform.node(),
        "cpu": _cpu_model(),
        "processors": thread_count(None),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "python": platform.python_version(),
        "load_average": os.getloadavg()[0],
        "core": {**_core.build_info(), "variant": kernel.name, "flags": kernel.flags},
    }


def versions() -> dict[str, str]:
    """Return version, compiler and compiled variants."""
    import numpy as np

    build = _core.build_info()
    kernel = chosen_kernel()
    return {
        "hexservo": build["hexservo"],
        "compiler": build["compiler"],
        "flags": build["flags"],
        "variant": f"{kernel.name}, {kernel.lanes} scenarios per vector (available: {', '.join(available_variants())})",
        "its flags": kernel.flags,
        "Eigen": build["eigen"],
        "Python": f"{platform.python_version()} ({platform.python_implementation()})",
        "numpy": np.__version__,
        "platform": platform.platform(),
    }


def _cpu_model() -> str:
    """Name the processor; where a hypervisor hides its number, by family and model, which tell generations apart."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or "unknown"
    first: dict[str, str] = {}
    for line in lines:
        name, _, value = line.partition(":")
        first.setdefault(name.strip(), value.strip())
    model = first.get("model name", "")
    if model and not any(letter.isdigit() for letter in model) and {"cpu family", "model"} <= first.keys():
        return f"{model} (family {first['cpu family']}, model {first['model']})"
    return model or platform.machine()
