"""Colours, lines and sizes for print, and figures as files: the same figure gives the same bytes."""

from __future__ import annotations

import contextlib
import io
import threading
from collections.abc import Callable, Iterator
from functools import wraps
from typing import Any, NamedTuple, ParamSpec, TypeVar

import matplotlib
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

_P = ParamSpec("_P")
_T = TypeVar("_T")
COLUMN, PAGE = 3.5, 7.16  # widths of a figure in a two-column paper [in]
THIN = 0.6  # width of samples under their mean [pt]
FAINT = 0.45  # opacity of samples under their mean


class Ink(NamedTuple):
    """Style of one line."""

    colour: str
    dashes: Any = "-"


# Okabe and Ito's colours, the light ones darkened for text: distinguishable with every kind of colour vision.
# In grey, dashes and labels distinguish the lines.
BLACK, BLUE, VERMILION, GREEN, PURPLE, ORANGE = "#000000", "#0072B2", "#D55E00", "#009E73", "#B85F93", "#CC8400"
GREY = "0.45"
DASHED, DASH_DOT = (0, (4, 1.2)), (0, (5, 1, 1.2, 1))
AXES_INKS: tuple[Ink, ...] = (Ink(BLUE), Ink(VERMILION, DASHED), Ink(GREEN, DASH_DOT))  # x, y, z
LEG_INKS = (
    Ink(BLACK),
    Ink(ORANGE),
    Ink(BLUE, DASHED),
    Ink(VERMILION, DASHED),
    Ink(GREEN, DASH_DOT),
    Ink(PURPLE, DASH_DOT),
)

HALO = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.4}

_STYLE = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same everywhere
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-9, 9),
    "axes.titley": 1.0,  # fixed places for titles and labels: finding them takes a third of the drawing time
    "axes.titlepad": 5,
    "grid.color": "0.9",
    "grid.linewidth": 0.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.major.pad": 2.5,
    "ytick.major.pad": 2.5,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "lines.linewidth": 1.0,
    "lines.solid_joinstyle": "round",
    "lines.dash_joinstyle": "round",
    "figure.dpi": 200,
    "savefig.dpi": 200,
    "svg.fonttype": "path",  # needs no font in the viewer
    "svg.hashsalt": "hexservo",  # the same run gives the same bytes
}
# The settings that affect the look of a figure; the user's other settings (backend, keys, ...) are not touched.
_LOOK = (
    "agg.", "axes.", "figure.", "font.", "grid.", "hatch.", "image.", "legend.", "lines.", "markers.", "mathtext.",
    "patch.", "path.", "savefig.", "svg.", "text.", "xaxis.", "xtick.", "yaxis.", "ytick.",
)  # fmt: skip
# matplotlib's settings are one table of the whole process: of two threads in our style at once, the first to leave
# would take it from the other, and the other would then leave it behind. Drawing functions call one another.
_STYLE_IN_USE = threading.RLock()


@contextlib.contextmanager
def our_style() -> Iterator[None]:
    """Draw in our style, from matplotlib's defaults, and restore the user's settings; one thread at a time."""
    defaults = {name: value for name, value in matplotlib.rcParamsDefault.items() if name.startswith(_LOOK)}
    settings: Any = {**defaults, **_STYLE}
    with _STYLE_IN_USE, matplotlib.rc_context(settings):
        yield


def styled(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Draw in our style, except into the caller's axes, which have a style already."""

    @wraps(function)
    def styled(*args: _P.args, **kwargs: _P.kwargs) -> _T:
        if kwargs.get("ax") is not None or kwargs.get("axes") is not None:
            return function(*args, **kwargs)
        with our_style():
            return function(*args, **kwargs)

    return styled


def as_written(text: str) -> str:
    """Escape text that users chose: matplotlib takes what is between two dollar signs for a formula."""
    return text.replace("$", r"\$")


def text_width(text: str, size: float) -> float:
    """Return the width of a line of plain text in our style [in], of a font size [pt]."""
    width, _, _ = text_to_path.get_text_width_height_descent(text, FontProperties(size=size), ismath=False)
    return float(width) / 72


def wrapped(text: str, size: float, width: float) -> str:
    """Break a text at spaces into lines of at most a width [in], of a font size [pt]; a longer word is a line."""
    first, *words = text.split(" ")
    lines = [first]
    for word in words:
        longer = f"{lines[-1]} {word}"
        if text_width(longer, size) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return "\n".join(lines)


def short_number(value: float, _place: int | None = None) -> str:
    """Write a very large or very small number in few characters, as 2.25e6."""
    digits, _, power = f"{value:.4g}".partition("e")
    return (f"{digits}e{int(power)}" if power else digits).replace("-", "−")


@styled
def image_bytes(figure: Figure, extension: str) -> bytes:
    """Return a figure as the bytes of a file, without a date."""
    buffer = io.BytesIO()
    if extension == "svg":
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    else:
        figure.savefig(buffer, format="png", pil_kwargs={"compress_level": 1})  # little larger, much faster
    return buffer.getvalue()
