"""The command line.

It contains only the entry point, so that Ctrl-C gives a short message while the rest is imported.
"""

from __future__ import annotations

import os
import signal
from types import FrameType

__all__ = ["main"]


def main() -> None:
    """Run the command line with the arguments of the process, and exit."""
    # No exception: what is being imported might catch it. Where the caller ignores Ctrl-C it stays ignored.
    early = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if early:
        signal.signal(signal.SIGINT, _leave)
    from hexservo.cli.commands import main as run

    if early:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(2, b"Interrupted\n")
    os._exit(130)  # 128 + SIGINT, as shells count; nothing is buffered or open yet
