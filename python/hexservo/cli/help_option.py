"""The option --help of all commands, with the errors of standard output as every other text has them."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from hexservo.cli.terminal import write

__all__ = ["HelpCommand", "HelpGroup"]


def _show(ctx: typer.Context, parameter: object, asked: bool) -> None:
    if asked and not ctx.resilient_parsing:
        write(f"{ctx.get_help()}\n")  # typer's own writing ends in a traceback where a disk is full
        raise typer.Exit


class _Help:
    """Has the text of --help written by `write`; before a class of typer."""

    def get_help_option(self, ctx: Any) -> Any:
        """Return the option, None where it is left out."""
        option = super().get_help_option(ctx)  # type: ignore[misc]  # of that class
        if option is not None:
            option.callback = _show
        return option


class HelpCommand(_Help, TyperCommand):
    """A command."""


class HelpGroup(_Help, TyperGroup):
    """All commands together."""
