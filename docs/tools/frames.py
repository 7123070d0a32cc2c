"""Draws frames, angles and image axes of a machine: docs/figures/frames.svg.

Run it as ``python docs/tools/frames.py`` in the source tree. Joints and angles are those of the preset pi_h824.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
PICTURE = ROOT / "docs" / "figures" / "frames.svg"
MACHINE = ROOT / "python" / "hexservo" / "machines" / "pi_h824.yaml"

_BASE, _PLATFORM, _CAMERA, _INK, _TARGET = "#6b7280", "#0072b2", "#d55e00", "#111827", "#009e73"
_WIDTH, _HEIGHT = 940, 400


def picture() -> str:
    """Return the figure: the machine from the side, its joints from below, and the axes of the image."""
    robot = yaml.safe_load(MACHINE.read_text(encoding="utf-8"))
    shapes = [*_from_the_side(), *_joints(robot), *_image()]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" font-family="sans-serif" '
            'font-size="13">',
            "<title>Frames B and E, angles of the joints, and axes of the image</title>",
            f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="#ffffff"/>',
            *shapes,
            "</svg>\n",
        ]
    )


def _from_the_side() -> list[str]:
    """Draw base, platform, legs, frames, camera and tag, seen along -y of B."""
    base, plate, middle = 340.0, 220.0, 160.0
    shapes = [_text(20, 24, "From the side (y of both frames points at you)", weight="bold")]
    shapes += [_line(60, base, 260, base, _BASE, 6), _line(95, plate, 225, plate, _PLATFORM, 6)]
    legs = ((70, 115), (110, 95), (140, 190), (180, 130), (210, 225), (250, 205))
    shapes += [_line(foot, base - 3, head, plate + 3, _BASE, 2) for foot, head in legs]
    shapes += _axes(middle, base, "B", 150) + _axes(middle, plate, "E", 110)
    shapes += [_line(middle, plate, middle - 40, 90, _CAMERA, 1, dash=True)]
    shapes += [_line(middle, plate, middle + 40, 90, _CAMERA, 1, dash=True)]
    shapes += [
        _line(middle - 26, 70, middle + 26, 70, _TARGET, 6),
        _text(middle + 36, 74, "tag, z to the viewer", _TARGET),
    ]
    shapes += [_arrow(middle - 18, 72, middle - 18, 98, _TARGET), _text(middle - 34, 94, "z", _TARGET)]
    shapes += [
        _arrow(middle, plate - 8, middle, 130, _CAMERA),
        _text(middle + 52, 148, "camera at E's origin", _CAMERA),
    ]
    shapes += [_text(middle + 52, 164, "looks along -z of E", _CAMERA)]
    shapes += [_arrow(30, 110, 30, 162, _INK), _text(38, 140, "g")]
    shapes += [_arrow(42, base, 42, plate, _PLATFORM), _text(14, 372, "home: z = -0.159 m", _PLATFORM)]
    return shapes


def _axes(x: float, y: float, name: str, length: float) -> list[str]:
    return [
        _arrow(x, y, x + length, y, _INK),
        _text(x + length - 4, y - 8, "x"),
        _arrow(x, y, x, y + 44, _INK),
        _text(x + 7, y + 44, "z"),
        _text(x - 16, y - 8, name, weight="bold"),
    ]


def _joints(robot: dict[str, Any]) -> list[str]:
    """Draw both circles of joints as seen along z: x to the right and y down, so that angles run clockwise."""
    x0, y0, scale = 540.0, 205.0, 1000.0
    shapes = [_text(400, 24, "Along z, from above: angles from x to y", weight="bold")]
    places = {}
    for side, colour in (("base", _BASE), ("platform", _PLATFORM)):
        radius = scale * float(robot[f"{side}_radius"])
        shapes.append(
            f'<circle cx="{x0:g}" cy="{y0:g}" r="{radius:g}" fill="none" stroke="{colour}" stroke-dasharray="3 4"/>'
        )
        places[side] = [
            (x0 + radius * math.cos(angle), y0 + radius * math.sin(angle)) for angle in robot[f"{side}_angles"]
        ]
    for foot, head in zip(places["base"], places["platform"], strict=True):
        shapes.append(_line(*foot, *head, "#9ca3af", 2))
    for side, colour in (("base", _BASE), ("platform", _PLATFORM)):
        for number, (x, y) in enumerate(places[side], start=1):
            away = 1.11 if side == "base" else 0.86
            shapes.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{colour}"/>')
            shapes.append(_text(x0 + away * (x - x0) - 4, y0 + away * (y - y0) + 4, str(number), colour))
    shapes += [_arrow(x0, y0, x0 + 60, y0, _INK), _text(x0 + 64, y0 + 4, "x")]
    shapes += [_arrow(x0, y0, x0, y0 + 60, _INK), _text(x0 + 7, y0 + 62, "y")]
    x, y = places["platform"][1]
    shapes += [_line(x0, y0, x, y, _PLATFORM, 1)]
    angle = float(robot["platform_angles"][1])
    end = x0 + 34 * math.cos(angle), y0 + 34 * math.sin(angle)
    shapes.append(
        f'<path d="M{x0 + 34:g} {y0:g}A34 34 0 0 1 {end[0]:.1f} {end[1]:.1f}" fill="none" stroke="{_PLATFORM}"/>'
    )
    shapes += [
        _text(x0 + 38, y0 + 22, "φ₂ = 45°", _PLATFORM),
        _text(400, 372, "grey: base_angles, blue: platform_angles"),
    ]
    return shapes


def _image() -> list[str]:
    """Draw the axes of OpenCV's image and those of features."""
    left, top, width, height = 720.0, 60.0, 190.0, 150.0
    x, y = left + width / 2, top + height / 2
    return [
        _text(720, 24, "In the image", weight="bold"),
        f'<rect x="{left:g}" y="{top:g}" width="{width:g}" height="{height:g}" fill="#f3f4f6" stroke="{_BASE}"/>',
        _arrow(left, top, left + 56, top, _BASE),
        _text(left + 60, top - 6, "u (OpenCV)", _BASE),
        _arrow(left, top, left, top + 56, _BASE),
        _text(left + 6, top + 60, "v", _BASE),
        _arrow(x, y, x + 56, y, _CAMERA),
        _text(x + 60, y + 4, "x", _CAMERA),
        _arrow(x, y, x, y - 46, _CAMERA),
        _text(x + 7, y - 38, "y", _CAMERA),
        _text(x - 52, y + 18, "(cx, cy)", _INK),
        _text(left, top + height + 32, "x = u - cx", _CAMERA),
        _text(left, top + height + 52, "y = cy - v", _CAMERA),
        _text(left, top + height + 82, "E has the x axis of OpenCV's"),
        _text(left, top + height + 100, "camera; y and z are reversed:"),
        _text(left, top + height + 122, "R_E = R_cv diag(1, -1, -1)"),
    ]


def _line(x: float, y: float, to_x: float, to_y: float, colour: str, width: float, *, dash: bool = False) -> str:
    dashed = ' stroke-dasharray="5 4"' if dash else ""
    ends = f'x1="{x:.1f}" y1="{y:.1f}" x2="{to_x:.1f}" y2="{to_y:.1f}"'
    return f'<line {ends} stroke="{colour}" stroke-width="{width:g}"{dashed}/>'


def _arrow(x: float, y: float, to_x: float, to_y: float, colour: str) -> str:
    length = math.hypot(to_x - x, to_y - y)
    ux, uy = (to_x - x) / length, (to_y - y) / length
    corners = [(to_x, to_y)] + [(to_x - 9 * ux + side * uy, to_y - 9 * uy - side * ux) for side in (4.0, -4.0)]
    head = " ".join(f"{a:.1f},{b:.1f}" for a, b in corners)
    return f'{_line(x, y, to_x - 6 * ux, to_y - 6 * uy, colour, 2)}<polygon points="{head}" fill="{colour}"/>'


def _text(x: float, y: float, text: str, colour: str = _INK, weight: str = "normal") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" font-weight="{weight}">{text}</text>'


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
