"""A flat pattern as DXF, SVG and CSV, in mm and at its real size."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from ..tools.surface_file import optional
from .pattern import FlatPattern

FloatArray = np.ndarray
ARROW = 0.15  # of the blank's size
SIDE = "upper side (punch side) towards you; mm, 1:1"
LAYERS = {"BLANK": 8, "TRIM": 1, "MARKS": 5}  # with their colours: grey, red, blue


def write_dxf(pattern: FlatPattern, path: Path) -> None:
    """Write layers BLANK, TRIM and MARKS, $INSUNITS millimetres.

    Raises
    ------
    InputError
        If ezdxf is missing.
    """
    ezdxf = optional("ezdxf", "cad", "a .dxf file needs ezdxf")
    drawing = ezdxf.new("R2010")
    drawing.header["$INSUNITS"] = 4
    drawing.header["$MEASUREMENT"] = 1
    space = drawing.modelspace()
    for name, colour in LAYERS.items():
        drawing.layers.add(name, color=colour)
    for layer, lines in (("BLANK", pattern.blank), ("TRIM", pattern.trim)):
        for line in lines:
            closed = bool(np.array_equal(line[0], line[-1]))
            points = line[:-1] if closed else line
            space.add_lwpolyline(points.tolist(), close=closed, dxfattribs={"layer": layer})
    for line, text, at, height in _marks(pattern):
        if line is not None:
            space.add_lwpolyline(line.tolist(), dxfattribs={"layer": "MARKS"})
        space.add_text(
            text, height=height, dxfattribs={"layer": "MARKS", "insert": tuple(at.tolist())}
        )
    drawing.saveas(path)


def write_svg(pattern: FlatPattern, path: Path) -> None:
    """Write the same as SVG; a unit of its view is a millimetre."""
    points = np.vstack([*pattern.blank, *pattern.trim])
    margin = 0.05 * float(np.ptp(points, axis=0).max())
    low, high = points.min(0) - margin, points.max(0) + margin
    low[1] -= margin  # for the words below
    width, height = high - low

    def drawn(line: FloatArray) -> str:
        shown = np.column_stack([line[:, 0] - low[0], high[1] - line[:, 1]])
        return " ".join(f"{x:.4f},{y:.4f}" for x, y in shown)

    out = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.4f}mm" height="{height:.4f}mm" '
        f'viewBox="0 0 {width:.4f} {height:.4f}">',
        f"<title>{escape(pattern.name)}: flat pattern</title>",
    ]
    colours = {"BLANK": "#777777", "TRIM": "#d00000", "MARKS": "#0050b0"}
    for layer, lines in (("BLANK", pattern.blank), ("TRIM", pattern.trim)):
        out.append(f'<g id="{layer}" fill="none" stroke="{colours[layer]}" stroke-width="0.25">')
        out += [f'<polyline points="{drawn(line)}"/>' for line in lines]
        out.append("</g>")
    out.append(f'<g id="MARKS" fill="none" stroke="{colours["MARKS"]}" stroke-width="0.25">')
    for line, text, at, size in _marks(pattern):
        if line is not None:
            out.append(f'<polyline points="{drawn(line)}"/>')
        x, y = at[0] - low[0], high[1] - at[1]
        out.append(
            f'<text x="{x:.4f}" y="{y:.4f}" font-family="sans-serif" font-size="{size:.4f}" '
            f'fill="{colours["MARKS"]}" stroke="none">{escape(text)}</text>'
        )
    path.write_text("\n".join([*out, "</g>", "</svg>", ""]), encoding="utf-8")


def write_csv(pattern: FlatPattern, path: Path) -> None:
    """Write the points of the lines: layer, number of the line in it, x, y."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["layer", "loop", "x_mm", "y_mm"])
        for layer, lines in (("TRIM", pattern.trim), ("BLANK", pattern.blank)):
            for number, line in enumerate(lines):
                writer.writerows([layer, number, f"{x:.6g}", f"{y:.6g}"] for x, y in line)


def _marks(pattern: FlatPattern) -> Iterator[tuple[FloatArray | None, str, FloatArray, float]]:
    """Arrow (k, 2) or None, its words, where they begin, and how high they are, mm."""
    points = np.vstack(pattern.blank)
    low, high = points.min(0), points.max(0)
    size = float((high - low).max())
    height = 0.02 * size
    centre = 0.5 * (low + high)
    for along, text, length in zip(
        pattern.along, ("0° (warp)", "90° (weft)"), (ARROW, 0.6 * ARROW), strict=True
    ):
        across = np.array([-along[1], along[0]])
        tip = centre + length * size * along
        barbs = [tip - height * along + side * 0.4 * height * across for side in (1, -1)]
        yield np.array([centre, tip, barbs[0], tip, barbs[1]]), text, tip + height * along, height
    yield None, f"{pattern.name}: {SIDE}", low - [0.0, 2.0 * height], height
