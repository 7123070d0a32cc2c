"""What differs between the campaign of a folder and the one that is to be run there."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from typing import Any

from hexservo.campaigns.plan import CampaignPlan
from hexservo.scenario.plain import dotted
from hexservo.scenario.rules import shown_value
from hexservo.scenario.wording import first_of

_NAMED = 3  # keys within one of a campaign
_NONE = object()


def differences(plan: CampaignPlan, there: CampaignPlan, may_change: Collection[str] = ()) -> list[str]:
    """Return the keys of a campaign, but those that may change, in which it differs from that of a folder.

    Each has both values. Name and description of a scenario do not count, the order of `vary` does.
    """
    now, before = (one.to_mapping() | one.drawn_from() for one in (plan, there))
    return [
        _difference(key, before[key], now[key])
        for key in now
        if key not in may_change and _text(before[key]) != _text(now[key])
    ]


def of_both(key: str, there: Any, now: Any) -> str:
    """Return a key with its value in a folder, and the one that it has now."""
    texts = ["none" if value is _NONE else shown_value(value) for value in (there, now)]
    return f"{key} ({texts[0]} there, {texts[1]} now)" if texts[0] != texts[1] else key


def _difference(key: str, there: Any, now: Any) -> str:
    if key == "vary":
        if sorted(map(_text, there)) == sorted(map(_text, now)):
            return "the order of the keys of vary"
        there, now = dict(there), dict(now)
    if there == now:
        return f"the sign of a zero in {key}"
    if not (isinstance(there, Mapping) and isinstance(now, Mapping)):
        return of_both(key, there, now)
    inner = [dotted(value) for value in (there, now)]
    values = {name: [each.get(name, _NONE) for each in inner] for name in inner[0] | inner[1]}
    found = [of_both(name, *both) for name, both in values.items() if both[0] != both[1]]
    return f"{key}: {first_of(found, _NAMED)}"


def _text(value: Any) -> str:
    return json.dumps(value, sort_keys=True)
