"""The version of hexservo, as the core was built with it."""

from __future__ import annotations

from hexservo import _core

VERSION: str = _core.build_info()["hexservo"]
