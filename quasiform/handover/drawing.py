"""A flat pattern as DXF, SVG and CSV, in mm and at its real size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..checks import optional
from .keywords import render

FloatArray = np.ndarray
ARROW = 0.15  # of the blank's size
SIDE = "upper side (punch side) towards you; mm, 1:{:g}"
SCALES = (1.0, 2.0, 2.5, 5.0, 10.0, 20.0, 25.0, 50.0, 100.0)
LAYERS = {"BLANK": (8, "#777777"), "SLITS": (3, "#008000"), "TRIM": (1, "#d00000")}
LAYERS |= {"MARKS": (5, "#0050b0")}
"""Layers with their colours: numbers in DXF, names in SVG."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """Lines of a cut in the flat blank; `FlatPattern` describes them."""

    name: str
    trim: list[FloatArray]
    blank: list[FloatArray]
    along: FloatArray
    slits: Sequence[FloatArray] = ()


def write_dxf(pattern: Drawing, path: Path) -> None:
    """Write layers BLANK, SLITS, TRIM and MARKS, $INSUNITS millimetres; needs ezdxf."""
    ezdxf = optional("ezdxf", "cad", "a .dxf file needs ezdxf")
    drawing = ezdxf.new("R2010")
    drawing.header["$INSUNITS"] = 4
    drawing.header["$MEASUREMENT"] = 1
    space = drawing.modelspace()
    lines, words = _content(pattern)
    for layer, (colour, _) in ((name, LAYERS[name]) for name in lines):
        drawing.layers.add(layer, color=colour)
        for line in lines[layer]:
            closed = bool(np.array_equal(line[0], line[-1]))
            points = line[:-1] if closed else line
            space.add_lwpolyline(points.tolist(), close=closed, dxfattribs={"layer": layer})
    for text, at, height in words:
        attributes = {"layer": "MARKS", "insert": tuple(at.tolist())}
        space.add_text(text, height=height, dxfattribs=attributes)
    drawing.saveas(path)


def write_svg(pattern: Drawing, path: Path) -> None:
    """Write the same as SVG; a unit of its view is a millimetre."""
    head = '<?xml version="1.0" encoding="UTF-8"?>\n'
    path.write_text(f"{head}{svg(pattern)}\n", encoding="utf-8")


def svg(pattern: Drawing, room: tuple[float, float] | None = None) -> str:
    """Element `svg` of a pattern at 1:1, or at the first of `SCALES` that fits a room on paper, mm.

    A drawing that is not 1:1 has a bar of known length.
    """
    points = np.vstack([*pattern.blank, *pattern.trim])
    margin = 0.05 * float(np.ptp(points, axis=0).max())
    low, high = points.min(0) - [margin, 2 * margin], points.max(0) + margin  # words below
    size = high - low
    fits = [scale for scale in SCALES if room is None or (size / scale <= room).all()]
    scale = fits[0] if fits else SCALES[-1]
    lines, words = _content(pattern, scale)

    def seen(p: FloatArray) -> list[str]:
        """Places in the view, where y points down."""
        return [f"{x:.4f},{y:.4f}" for x, y in np.atleast_2d(p - [low[0], high[1]]) * [1.0, -1.0]]

    layers = [
        (layer, colour, [" ".join(seen(line)) for line in lines[layer]])
        for layer, (_, colour) in ((name, LAYERS[name]) for name in lines)
    ]
    words = [(*seen(at)[0].split(","), f"{size:.4f}", text) for text, at, size in words]
    given = {"name": pattern.name, "layers": layers, "words": words, "width": 0.25 * scale}
    given |= {"view": [f"{length:.4f}" for length in size]}
    return render("pattern.svg", size=[f"{v:.4f}" for v in size / scale], **given)


def write_csv(pattern: Drawing, path: Path) -> None:
    """Write the points of the lines: layer, number of the line in it, x, y."""
    layers = {"TRIM": pattern.trim, "BLANK": pattern.blank, "SLITS": pattern.slits}
    text = render("pattern.csv", layers=layers).replace("\n", "\r\n")
    path.write_text(text, encoding="utf-8", newline="")


def _content(
    pattern: Drawing, scale: float = 1.0
) -> tuple[dict[str, list[FloatArray]], list[tuple[str, FloatArray, float]]]:
    """Lines (k, 2) by layer; words, where they begin, and how high they are, mm."""
    points = np.vstack(pattern.blank)
    low, high = points.min(0), points.max(0)
    size = float((high - low).max())
    height, centre, arrows = 0.02 * size, 0.5 * (low + high), []
    words = []
    for along, text, length in zip(
        pattern.along, ("0° (warp)", "90° (weft)"), (ARROW, 0.6 * ARROW), strict=True
    ):
        across = 0.4 * height * np.array([-along[1], along[0]])
        tip = centre + length * size * along
        back = tip - height * along
        arrows.append(np.array([centre, tip, back + across, tip, back - across]))
        words.append((text, tip + height * along, height))
    words.append((f"{pattern.name}: {SIDE.format(scale)}", low - [0.0, 2.0 * height], height))
    if scale != 1:  # a bar of round length above
        left, bar = np.array([low[0], high[1] + height]), 10.0 ** np.floor(np.log10(0.5 * size))
        arrows.append(np.array([left, left + np.array([bar, 0.0])]))
        words.append((f"{bar:g} mm", left + np.array([0.0, 0.3 * height]), height))
    slits = {"SLITS": list(pattern.slits)} if pattern.slits else {}
    return {"BLANK": pattern.blank, **slits, "TRIM": pattern.trim, "MARKS": arrows}, words
