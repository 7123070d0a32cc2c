"""Draws the camera's frames and the axes of its image, by both conventions: docs/figures/camera_frames.svg.

Run it as ``python docs/tools/camera_frames.py`` in the source tree.
"""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PICTURE = ROOT / "docs" / "figures" / "camera_frames.svg"

_INK, _PAPER, _OPENCV, _PIXEL = "#24292f", "#0072b2", "#d55e00", "#009e73"


def picture() -> str:
    """Return the SVG: machine from the side, then the image with features and pixels."""
    shapes = [
        _text(190, 24, "from the side", anchor="middle", weight="bold"),
        # base, legs, platform
        _line(70, 300, 310, 300, width=6),
        *(_line(x, 300, x + shift, 190) for x, shift in ((90, 40), (170, -20), (210, 20), (290, -40))),
        _line(110, 190, 270, 190, width=6),
        _arrow(190, 300, 190, 340, _INK, "z of B"),
        _arrow(190, 190, 190, 232, _INK, ""),
        _text(190, 249, "z of E", anchor="middle"),  # between the inner legs
        _text(90, 194, "E"),
        _text(44, 322, "B"),
        # the camera on its bracket
        _line(190, 188, 262, 150, dashed=True),
        _text(226, 146, "mount.position", anchor="end"),
        '<g transform="rotate(14 262 150)">',
        f'<rect x="246" y="138" width="32" height="24" rx="4" fill="#fff" stroke="{_INK}" stroke-width="2"/>',
        _arrow(262, 150, 262, 206, _PAPER, ""),
        _arrow(262, 150, 262, 96, _OPENCV, ""),
        _arrow(262, 150, 306, 150, _PAPER, ""),
        _line(262, 138, 238, 50, dashed=True),
        _line(262, 138, 286, 50, dashed=True),
        "</g>",
        _text(276, 218, "z, paper", _PAPER),
        _text(298, 104, "z, opencv", _OPENCV),
        *(f'<circle cx="{x}" cy="{y}" r="4" fill="{_INK}"/>' for x, y in ((262, 52), (284, 44), (300, 56), (276, 64))),
        _text(312, 48, "target"),
        # the other camera, on a post of the base, and its target
        _line(70, 300, 26, 300, width=3),
        _line(26, 300, 26, 100, width=3),
        '<g transform="rotate(-52 26 100)">',
        f'<rect x="10" y="88" width="32" height="24" rx="4" fill="#fff" stroke="{_INK}" stroke-width="2"/>',
        _line(26, 112, 12, 232, dashed=True),
        _line(26, 112, 40, 224, dashed=True),
        "</g>",
        _text(8, 72, "mount.on: base"),
        *(f'<circle cx="{x}" cy="185" r="3" fill="{_INK}"/>' for x in (122, 134, 146)),
        # the image
        _text(560, 24, "image, seen from behind the camera", anchor="middle", weight="bold"),
        f'<rect x="420" y="60" width="280" height="210" fill="#fff" stroke="{_INK}" stroke-width="2"/>',
        f'<circle cx="572" cy="158" r="4" fill="{_INK}"/>',
        _text(580, 180, "principal_point"),
        _arrow(572, 158, 650, 158, _PAPER, "x"),
        _arrow(572, 158, 572, 92, _PAPER, "y"),
        _text(470, 214, "features: from the principal point", _PAPER, size=12),
        _arrow(420, 60, 498, 60, _PIXEL, ""),
        _text(504, 78, "u", _PIXEL),
        _arrow(420, 60, 420, 126, _PIXEL, "v"),
        _text(432, 240, "pixels: (0, 0) is the centre", _PIXEL, size=12),
        _text(432, 256, "of the first pixel", _PIXEL, size=12),
        _text(560, 300, "image_size", anchor="middle"),
        _line(420, 284, 700, 284),
        _text(420, 326, "pixels: u = c_x + f_x x_d,   v = c_y + f_y y_d", size=13),
        _text(420, 346, "features: (f X/|Z|, f Y/|Z|)", size=13),
    ]
    body = "\n".join(f"  {shape}" for shape in shapes)
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" width="800" height="360" viewBox="0 0 800 360" '
        'font-family="sans-serif" font-size="14">\n'
        '  <defs><marker id="head" viewBox="0 0 10 10" refX="8" refY="5" markerWidth="7" markerHeight="7" '
        'orient="auto-start-reverse"><path d="M0 0L10 5L0 10z" fill="context-stroke"/></marker></defs>\n'
        "  <title>Frames of the machine, the camera on its mount, and the axes of its image</title>\n"
        f'  <rect width="800" height="360" fill="#fff"/>\n{body}\n</svg>\n'
    )


def _text(
    x: float, y: float, words: str, color: str = _INK, *, anchor: str = "start", weight: str = "normal", size: int = 14
) -> str:
    return (
        f'<text x="{x}" y="{y}" fill="{color}" text-anchor="{anchor}" font-weight="{weight}" font-size="{size}">'
        f"{words}</text>"
    )


def _line(x1: float, y1: float, x2: float, y2: float, *, width: float = 2, dashed: bool = False) -> str:
    dash = ' stroke-dasharray="4 4"' if dashed else ""
    return f'<path d="M{x1} {y1}L{x2} {y2}" stroke="{_INK}" stroke-width="{width}" fill="none"{dash}/>'


def _arrow(x1: float, y1: float, x2: float, y2: float, color: str, name: str) -> str:
    line = f'<path d="M{x1} {y1}L{x2} {y2}" stroke="{color}" stroke-width="2.5" fill="none" marker-end="url(#head)"/>'
    return line + (_text(x2 + 6, y2 + 4, name, color) if name else "")


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
    print(f"{PICTURE.relative_to(ROOT)} is written")
