"""What a scene has room for: the gap that tools leave to the sheet, and mirror planes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import shapely

from ..checks import InputError
from ..fabric import Fabric
from ..net.blank import rotation
from ..tools.shapes import Tool
from ..tools.tool_file import ToolFile, why_tight
from .scene_file import SceneFile


def check_clearance(
    tools: Sequence[Tool],
    from_files: Mapping[str, ToolFile],
    outline: shapely.Polygon,
    thickness: float,
    travel: float,
) -> None:
    """Refuse driven and fixed tools that leave no room for the sheet between them at the end."""
    low_x, low_y, high_x, high_y = outline.bounds
    z = np.linspace(-travel, 0.0, 30)
    grid = np.meshgrid(np.linspace(low_x, high_x, 60), np.linspace(low_y, high_y, 60), z)
    points = np.stack([c.ravel() for c in grid], axis=1)
    near = max(3 * thickness, 0.01 * max(high_x - low_x, high_y - low_y))  # of the driven tool
    for driven in (tool for tool in tools if tool.motion == "driven"):
        for fixed in (tool for tool in tools if tool.motion != "driven"):
            d = driven.gap(points, -travel)
            gap = np.maximum(d + fixed.gap(points), 0.0)
            gap[np.abs(d) > near] = np.inf
            at = gap.argmin()
            if gap[at] < thickness * (1 - 1e-9):
                x, y, height = points[at]
                why = why_tight(driven, fixed, from_files, thickness)
                raise InputError(
                    f"{driven.name} and {fixed.name} leave {gap[at]:.2f} mm for a sheet of "
                    f"{thickness:g} mm between them at the end of the travel, near "
                    f"({x:.0f}, {y:.0f}, {height:.0f}) mm{why}"
                )


def mirror_planes(
    file: SceneFile,
    tools: Sequence[Tool],
    outline: shapely.Polygon,
    orientation: float,
    travel: float,
    symmetry: str,
    fabric: Fabric,
) -> tuple[tuple[str, ...], list[tuple[str, str]]]:
    """Planes "x" and "y" along the fibres that map blank and tools onto themselves, and why.

    In the fibres' axes; the second is for the description of the model.
    """
    for left_out, why in (
        (symmetry == "none", "symmetry is switched off"),
        (file.mesh != "fibre", "the mesh does not follow the fibres"),
        (file.supports or file.grippers, "mirror planes are not sought with supports"),
    ):
        if left_out:
            return (), [("the whole blank", why)]
    along = rotation(orientation)
    outline = shapely.affinity.rotate(outline, -orientation, origin=(0, 0))
    bounds = np.array(outline.bounds).reshape(2, 2)
    rng = np.random.default_rng(0)
    flat = rng.uniform(*bounds, (20000, 2))
    z = rng.uniform(-travel, fabric.thickness, len(flat))
    planes: list[str] = []
    for axis, name in enumerate("xy"):
        flip = np.ones(2)
        flip[axis] = -1.0
        mirrored = shapely.affinity.scale(outline, *flip, origin=(0, 0))
        same = outline.symmetric_difference(mirrored).area < 1e-6 * outline.area
        for tool in tools if same else ():
            same = same and abs(along[:, axis] @ tool.place) < 1e-9
            sunk = -travel if tool.motion == "driven" else 0.0
            sides = [np.column_stack([points @ along.T, z]) for points in (flat, flat * flip)]
            d = [tool.gap(points, sunk) for points in sides]
            near = np.minimum(*np.abs(d)) < 2 * fabric.thickness
            off = np.abs(d[0] - d[1])[near]
            same = same and not (off > 0.01 * fabric.thickness).any()
        if same and not (planes and symmetry == "half"):
            planes.append(name)
    if not planes:
        return (), [("the whole blank", "no plane along the fibres mirrors it")]
    where = {"x": "across the warp", "y": "along the warp"}
    why = (
        f"blank, fibres and tools are mirrored at the plane{'s' * (len(planes) > 1)} "
        f"{' and '.join(where[plane] for plane in planes)}; wrinkles or bands that break this "
        "symmetry are not seen (--symmetry none)"
    )
    return tuple(planes), [("a quarter" if len(planes) == 2 else "a half", why)]
