"""The command line."""

from hexservo.cli.commands import main

__all__ = ["main"]
