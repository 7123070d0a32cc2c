"""What a measurement ran on."""

from __future__ import annotations

import importlib
import importlib.util
import os
import platform
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from hexservo import _core
from timing import core_count


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or "unknown"
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _run_loop() -> dict[str, str]:
    """Name and flags of the compiled run loop that this process uses, where there is a choice of several."""
    if importlib.util.find_spec("hexservo._variant") is None:
        return {}
    kernel = importlib.import_module("hexservo._variant").chosen_kernel()
    return {"variant": kernel.name, "flags": kernel.flags}


def describe_machine() -> dict[str, Any]:
    """Processor, system, interpreter, compiler and flags of the core, and how busy the machine is as we start."""
    return {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "cpu": _cpu_model(),
        "processors": core_count(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "python": platform.python_version(),
        "load_average": os.getloadavg()[0],
        "core": {"variant": "baseline", **_core.build_info(), **_run_loop()},
    }
