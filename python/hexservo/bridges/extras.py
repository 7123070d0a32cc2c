"""Optional packages that bridges lead to."""

from __future__ import annotations

from importlib import import_module
from typing import Any


def extra(package: str, name: str) -> Any:
    """Import an optional package.

    Parameters
    ----------
    package
        Name of its module.
    name
        Of the extra that installs it.

    Raises
    ------
    ImportError
        Where it is missing, with the command that installs it.
    """
    try:
        return import_module(package)
    except ImportError as error:
        raise ImportError(
            f"{package}: expected the package, which the extra {name!r} installs: pip install 'hexservo[{name}]'"
        ) from error
