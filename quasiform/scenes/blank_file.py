"""What the model says about a blank from a file: its size, its place, and what looks wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import shapely

from ..net.blank import Blank
from ..tools.grid import likely_unit
from ..tools.mending import position
from ..tools.shapes import FAR, Tool
from ..tools.tool_file import ToolFile, box_of
from .scene_file import SceneFile

WIDE, NARROW = 15.0, 0.5  # of the driven tool: the model warns of a blank outside of these


def blank_from_file(
    file: SceneFile,
    own: Blank | None,
    outline: shapely.Polygon,
    tools: Sequence[Tool],
    from_files: Mapping[str, ToolFile],
) -> list[tuple[str, str]]:
    """Lines of the model for a blank that comes from a file; none for another one."""
    if own is not None:
        path, scale, notes, unit = Path(file.mesh), file.mesh_scale, own.notes, ("", 1.0)
    elif file.blank.shape == "file":
        drawing = file.blank.drawing
        path, scale, notes, unit = *file.blank.parameters[:2], drawing.notes, drawing.unit
    else:
        return []
    bounds = np.reshape(outline.bounds, (2, 2))
    size = "{:.4g} x {:.4g} mm".format(*np.ptp(bounds, axis=0))
    where = f"its middle at {position(bounds.mean(0))}"
    lines = [(f"blank from {path.name}", f"{size}, {outline.area:.4g} mm², {where}")]
    lines += [(path.name, note) for note in notes]
    across = float(np.ptp(bounds, axis=0).max())
    for tool in tools:
        box = box_of(tool, from_files)
        wide = np.inf if box is None else float(np.ptp(box, axis=0).max())
        if tool.motion != "driven" or wide >= FAR or NARROW * wide < across < WIDE * wide:
            continue
        words = f"it is {across:.4g} mm wide beside a {tool.name} of {wide:.4g} mm"
        if unit[0] and unit[1] != 1.0:
            remedy = (
                f"the header says {unit[0]}; if it is drawn in mm, set scale = {1 / unit[1]:.7g}"
            )
        else:
            remedy = likely_unit(across / scale, 3 * wide)
        lines.append((f"warning, {path.name}", f"{words}: {remedy}"))
    return lines
