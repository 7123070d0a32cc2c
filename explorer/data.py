"""Writes what the page knows of scenarios: ``python explorer/data.py OUT.json``, with hexservo installed.

Keys come from the core's schema, their meaning from docs/model.md, what they need of other keys from `hexservo check`,
and presets from the packaged scenarios: of each, the values by key that differ from the defaults, for each law.
"""

from __future__ import annotations

import json
import math
import re
import sys
from pathlib import Path
from typing import Any

import hexservo as hs
from hexservo import _core
from hexservo.findings.check_keys import settings_needed
from hexservo.report.explorer import LAWS, preset_values
from hexservo.run.metrics import METRICS, OF_CRANKS
from hexservo.scenario.flat import plain_value
from hexservo.scenario.schema import schema

ROOT = Path(__file__).resolve().parent.parent
PLAIN = re.compile(r"\[([^\]]+)\]\([^)]*\)|[`*]")  # links and marks of Markdown
ROW = re.compile(r"^\| (`[^|]+`) \|[^|]*\| (?P<meaning>[^|]+) \|")


def meanings() -> dict[str, str]:
    """Return the meaning of each key, from the tables of docs/model.md; a gain's stands for all laws without a row."""
    found: dict[str, str] = {}
    for line in (ROOT / "docs" / "model.md").read_text(encoding="utf-8").splitlines():
        row = ROW.match(line)
        if row is None:
            continue
        block = ""
        for name in re.findall(r"`([^`]+)`", row[1]):
            key = name if "." in name else block + name
            block = key.rpartition(".")[0] + "." if "." in name else block
            found.setdefault(key, PLAIN.sub(r"\1", row["meaning"]).strip())
    return found


def preset(name: str, defaults: dict[str, Any]) -> dict[str, Any]:
    """Return a packaged scenario as what differs from the defaults."""
    scenario = hs.load_scenario(name)
    changed = {key: value for key, value in preset_values(scenario).items() if value != defaults.get(key)}
    return {"name": name, "description": scenario.description, "values": changed}


def needs(settings: dict[str, tuple[Any, ...]]) -> dict[str, list[Any]]:
    """Return what a key needs of others, as the page has their values: a flag is a number."""
    return {
        key: [int(value) if isinstance(value, bool) else value for value in values] for key, values in settings.items()
    }


def data() -> dict[str, Any]:
    """Return everything."""
    meaning, needed = meanings(), settings_needed()
    keys, none = [], {}
    defaults: dict[str, Any] = {"controller.law": LAWS[0]}
    for law in LAWS:
        settings = _core.Settings(law)
        for key in _core.scenario_keys(law):
            defaults.setdefault(key.name, plain_value(key, settings[key.name]))
            if key.none is not None and math.isfinite(key.none):
                none[key.name] = key.none
    for entry in schema():
        name = entry["key"]
        shared = re.sub(rf"^controller\.(?:{'|'.join(LAWS)})\.", "controller.<law>.", name)
        leaf = name.rpartition(".")[2]
        text = meaning.get(name) or meaning.get(shared) or meaning.get(shared.replace("controller.<law>.", "")) or ""
        keys.append(
            {key: value for key, value in entry.items() if key not in ("concern", "reach")}
            | {"default": defaults[name], "meaning": text or leaf.replace("_", " ")}
            | ({"none": none[name]} if name in none else {})  # a number that the core has for null
            | ({"needs": needs(needed[name])} if name in needed else {})
        )
    names = sorted(hs.scenario_names(), key=lambda name: (name != "paper", name))
    return {
        "version": hs.__version__,
        "laws": list(LAWS),
        "twist_laws": [law for law in LAWS if _core.LAW_TRAITS[law].output == "twist"],
        "keys": keys,
        "most_delay": _core.MAX_ACTUATOR_DELAY,
        "metrics": [
            {"name": name, "unit": unit, "meaning": text, "of_cranks": OF_CRANKS.get(name)}
            for name, (unit, text) in METRICS.items()
        ],
        "presets": [preset(name, defaults) for name in names],
    }


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps(data(), separators=(",", ":"), allow_nan=False), encoding="utf-8")
