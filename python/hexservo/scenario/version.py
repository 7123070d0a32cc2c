"""The version of hexservo, as the core was built with it."""

from __future__ import annotations

from hexservo import _core

__all__ = ["VERSION"]

VERSION: str = _core.build_info()["hexservo"]
