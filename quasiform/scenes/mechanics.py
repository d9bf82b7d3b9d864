"""Whether a scene is mechanical: the driven tool meets the sheet, and something holds the sheet.

Both are asked of the flat sheet, moved as a whole: a sheet without a load stays flat until the
driven tool touches it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import shapely

from ..checks import InputError
from ..tools.mending import position
from ..tools.shapes import Tool
from ..tools.tool_file import ToolFile, box_of, middle
from .scene_file import SceneFile

FloatArray = np.ndarray
HEIGHTS = 9  # along the travel at which the sheet is looked for
SAMPLES = 150  # points a side on which it is looked for
LARGE = 4.0  # times the blank: a tool as large may be in another unit
TOUCH = 1e-3  # of the thickness


def check_mechanics(
    file: SceneFile,
    tools: Sequence[Tool],
    from_files: Mapping[str, ToolFile],
    outline: shapely.Polygon,
    thickness: float,
    travel: float,
) -> None:
    """Refuse a scene whose driven tools never meet the sheet, or in which nothing holds it."""
    if file.gravity or file.grippers or file.diaphragm:  # the sheet moves by itself, or is held
        return
    x0, y0, x1, y1 = outline.bounds
    sheet = f"the sheet lies at x {x0:.4g} to {x1:.4g}, y {y0:.4g} to {y1:.4g} mm"
    sheet += " and has a hole" * bool(outline.interiors)
    gaps = {}
    for tool in (tool for tool in tools if tool.motion != "free"):
        points = _points(box_of(tool, from_files), outline)
        gap = _least_gap(tool, points, thickness, travel if file.driven else thickness)
        gaps.setdefault(tool.motion, []).append((gap, tool.name, tool))
    gap, name, tool = min(gaps.get("driven", [(0.0, "pressure", None)]), key=lambda found: found[0])
    if gap > TOUCH * thickness:
        at = position(middle(tool, from_files))
        across = np.ptp(box_of(tool, from_files), axis=0).max() if name in from_files else 0.0
        if across > LARGE * max(x1 - x0, y1 - y0):
            sheet += f"; the tool is {across:.4g} mm across: is its file in another unit (scale)?"
        words = f"within {travel:g} mm of travel it comes no nearer than {gap:.3g} mm"
        raise InputError(
            f"the {name} never meets the sheet: {words}; its middle is at {at}, {sheet}"
        )
    fixed = [found[0] for found in gaps.get("fixed", ())]
    if not file.supports and min(fixed, default=np.inf) > TOUCH * thickness:
        why = "it does not reach the die" if fixed else "there is no die and no support"
        raise InputError(f"nothing holds the sheet under the {name}: {why}; {sheet}")


def _points(box: FloatArray | None, outline: shapely.Polygon) -> FloatArray:
    """Points (n, 2) of the sheet: on its edge, and on a grid in the box where the tool may be."""
    low, high = np.reshape(outline.bounds, (2, 2))
    if box is not None:
        low, high = np.maximum(low, box[0]), np.minimum(high, box[1])
    grid = np.stack(np.meshgrid(*np.linspace(low, high, SAMPLES).T), axis=-1).reshape(-1, 2)
    edge = shapely.segmentize(outline.boundary, outline.length / SAMPLES)
    return np.vstack([shapely.get_coordinates(edge), grid[shapely.contains_xy(outline, grid)]])


def _least_gap(tool: Tool, points: FloatArray, thickness: float, travel: float) -> float:
    """Least gap (mm) between a tool and the flat sheet while one of them moves down."""
    least = np.inf
    for s in (*np.linspace(0.0, travel, HEIGHTS), *tool.turns(travel)):
        z = 0.5 * thickness - s * (tool.motion != "driven")
        at = np.column_stack([points, np.full(len(points), z)])
        least = min(least, float(tool.gap(at, tool.moved(s)).min()) - 0.5 * thickness)
        if least <= 0:
            break
    return least
