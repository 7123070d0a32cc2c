"""Figures of results and findings. The packages that draw are above this one; `hexservo` sets where they are.

A result shows itself in a notebook and a comparison writes its figures. Neither may import what draws: its module is
found when the first picture is wanted.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_finders: list[Callable[[], Any]] = []


def drawn_by(find: Callable[[], Any]) -> None:
    """Set the function that imports the module that has ``html_of``, ``figure_of`` and ``image_of``."""
    _finders[:] = [find]


def html_of(shown: object) -> str:
    """Return a result, batch, comparison or findings as HTML for a notebook."""
    return str(_finders[0]().html_of(shown))


def figure_of(comparison: object) -> Figure:
    """Draw a comparison."""
    figure: Figure = _finders[0]().figure_of(comparison)
    return figure


def image_of(figure: Figure, extension: str) -> bytes:
    """Return a figure as the content of a file, the same bytes for the same figure."""
    content: bytes = _finders[0]().image_of(figure, extension)
    return content
