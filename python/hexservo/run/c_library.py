"""Where the shared library of the C interface is."""

from __future__ import annotations

from importlib import resources
from pathlib import Path


def c_library() -> Path:
    """Return the path of the shared library with the functions of hexservo.h, for ctypes and linkers.

    The header is in the folder ``include`` beside it (docs/c-interface.md).

    Raises
    ------
    FileNotFoundError
        Where the package was built without it.
    """
    path = Path(str(resources.files("hexservo") / "libhexservo.so"))
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: expected the shared library of the C interface, found none; `pip install .` builds it"
        )
    return path
