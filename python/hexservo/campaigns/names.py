"""Names of the packaged campaigns, for what does not read them."""

from __future__ import annotations

from importlib import resources


def campaign_names() -> tuple[str, ...]:
    """Return the names of the packaged campaigns, in alphabetical order."""
    folder = resources.files("hexservo") / "campaigns" / "packaged"
    return tuple(sorted(item.name[:-5] for item in folder.iterdir() if item.name.endswith(".yaml")))
