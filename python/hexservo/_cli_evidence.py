from __future__ import annotations


def report() -> None:
    pass


def certify() -> None:
    pass


def analyse() -> None:
    pass


def diagnose() -> None:
    pass
