"""What a scene has room for: the gap that tools leave to the sheet, and mirror planes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
import shapely

from ..checks import InputError
from ..fabric import Fabric
from ..net.blank import rotation
from ..net.slits import TINY, mirror_slits
from ..tools.shapes import Tool
from ..tools.tool_file import ToolFile, why_tight
from .scene_file import SceneFile

NEARLY = 0.05  # of the thickness: what a tool may differ from its mirror image
EXACTLY = 0.001  # of the thickness: less is not reported
FACETS = 0.02  # of a tool's area: what may be bent more sharply because of facets
FACING = 0.2  # part of a normal towards the sheet, beyond which the surface faces it
COST = 2.4  # power of 1/size in the time of an iteration, between 2.5 and 10 mm
ACROSS = {"x": "across the warp", "y": "along the warp"}


def check_clearance(
    file: SceneFile,
    tools: Sequence[Tool],
    from_files: Mapping[str, ToolFile],
    outline: shapely.Polygon,
    thickness: float,
    travel: float,
) -> None:
    """Refuse driven and fixed tools that leave no room for the sheet where they are nearest."""
    low_x, low_y, high_x, high_y = outline.bounds
    z = np.linspace(*file.heights(outline, travel), 30)
    grid = np.meshgrid(np.linspace(low_x, high_x, 60), np.linspace(low_y, high_y, 60), z)
    points = np.stack([c.ravel() for c in grid], axis=1)
    near = max(3 * thickness, 0.01 * max(high_x - low_x, high_y - low_y))  # of the driven tool
    pairs = product(*([t for t in tools if (t.motion == "driven") == so] for so in (True, False)))
    for driven, fixed in pairs:
        for s in driven.turns(travel):
            d = driven.gap(points, driven.moved(s))
            gap = np.maximum(d + fixed.gap(points), 0.0)
            gap[np.abs(d) > near] = np.inf
            at = gap.argmin()
            if gap[at] < thickness * (1 - 1e-9):
                x, y, height = points[at]
                why = why_tight(driven, fixed, from_files, thickness)
                where = "the end of the travel" if s == travel else f"a travel of {s:g} mm"
                raise InputError(
                    f"{driven.name} and {fixed.name} leave {gap[at]:.2f} mm for a sheet of "
                    f"{thickness:g} mm between them at {where}, near "
                    f"({x:.0f}, {y:.0f}, {height:.0f}) mm{why}"
                )


def mirror_planes(
    file: SceneFile,
    tools: Sequence[Tool],
    outline: shapely.Polygon,
    slits: Sequence[np.ndarray],
    darts: Sequence[shapely.Polygon],
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
        (any(p.stitches for p in file.plies), "mirror planes are not sought with stitches"),
    ):
        if left_out:
            return (), [("the whole blank", why)]
    along = rotation(orientation)
    outline = shapely.affinity.rotate(outline, -orientation, origin=(0, 0))
    slits = [line @ along for line in slits]
    tips = [shapely.get_coordinates(dart) @ along for dart in darts]
    bounds = np.array(outline.bounds).reshape(2, 2)
    rng = np.random.default_rng(0)
    flat = rng.uniform(*bounds, (20000, 2))
    low, high = file.heights(outline, travel)
    z = rng.uniform(low, high + fabric.thickness, len(flat))
    planes: list[str] = []
    within, allowed = 0.0, NEARLY * fabric.thickness
    broken: list[str] = []
    for axis, name in enumerate("xy"):
        flip = np.ones(2)
        flip[axis] = -1.0
        mirrored = shapely.affinity.scale(outline, *flip, origin=(0, 0))
        if outline.symmetric_difference(mirrored).area > 1e-6 * outline.area:
            broken.append(f"{ACROSS[name]} the outline differs")
            continue
        if why := _broken_by_cuts(slits, tips, axis, TINY * np.ptp(bounds)):
            broken.append(f"{ACROSS[name]} {why}")
            continue
        sides = [np.column_stack([points @ along.T, z]) for points in (flat, flat * flip)]
        off = {tool.name: _off_mirror(tool, sides, travel, fabric.thickness) for tool in tools}
        off = {t.name: max(off[t.name], 2 * abs(along[:, axis] @ t.place)) for t in tools}
        worst = max(off, key=off.get)
        if off[worst] > allowed:
            broken.append(f"{ACROSS[name]} the {worst} differs by {off[worst]:.2g} mm")
        elif not (planes and symmetry == "half"):
            planes.append(name)
            within = max(within, off[worst])
    more = f"; {' and '.join(broken)} ({allowed:.2g} allowed)" if broken else ""
    if not planes:
        return (), [("the whole blank", f"no plane along the fibres mirrors it{more}")]
    nearly = f" within {within:.1g} mm" if within > EXACTLY * fabric.thickness else ""
    why = (
        f"blank, fibres and tools are mirrored{nearly} at the plane{'s' * (len(planes) > 1)} "
        f"{' and '.join(ACROSS[plane] for plane in planes)}; wrinkles or bands that break this "
        f"symmetry are not seen (--symmetry none){more}"
    )
    return tuple(planes), [("a quarter" if len(planes) == 2 else "a half", why)]


def _broken_by_cuts(
    slits: Sequence[np.ndarray], tips: Sequence[np.ndarray], axis: int, near: float
) -> str:
    """Why cuts do not have a mirror plane; empty if they have it."""
    if not mirror_slits(slits, axis, near):
        return "the slits differ, or one lies on it"
    through = any(tip[:, axis].min() < 0 < tip[:, axis].max() for tip in tips)
    return "it runs through a dart, whose tip would be closed" * through


def _off_mirror(tool: Tool, sides: Sequence[np.ndarray], travel: float, thickness: float) -> float:
    """By how much a tool's surface differs from its mirror image near the sheet, mm.

    `sides` are points (n, 3) and their images.
    """
    off = 0.0
    for s in tool.turns(travel):
        d = [tool.gap(points, tool.moved(s)) for points in sides]
        near = np.minimum(*np.abs(d)) < 2 * thickness
        off = max(off, float(np.abs(d[0] - d[1])[near].max(initial=0.0)))
    return off


def smallest_radius(tool: Tool, from_files: Mapping[str, ToolFile]) -> float:
    """Smallest radius that a sheet bends over on a tool, mm; 0 if it is not known.

    On a surface from a file that of all but a fiftieth of the area that faces the sheet: facets are
    no fillets, and no sheet meets the far rim of a solid.
    """
    if tool.name not in from_files:
        return float(getattr(tool.shape, "sharpest", 0.0))
    read = from_files[tool.name]
    middles, sides = read.corners.mean(1), np.diff(read.corners, axis=1)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    near = ((middles > read.grid.low) & (middles < read.grid.high)).all(1)
    _, normals, bends = read.grid.distance(middles[near])
    faces = (-normals[:, 2] if read.down else normals[:, 2]) > FACING
    if not faces.any():
        return 0.0
    bend, area = np.linalg.eigvalsh(bends[faces])[:, -1], area[near][faces]
    order = np.argsort(bend)
    share = np.cumsum(area[order]) / area.sum()
    sharp = bend[order][np.searchsorted(share, 1 - FACETS)]
    return float(1 / sharp) if sharp > 1e-6 else np.inf


def what_resolves(radii: Mapping[Tool, float], size: float) -> str:
    """The smallest radius of tools, the size that resolves it, and what that costs."""
    tool = min(radii, key=radii.get)
    radius = radii[tool]
    if not 0 < radius < 2 * size:
        return ""
    times = f"{float(f'{(2 * size / radius) ** COST:.2g}'):g}"
    return (
        f"; smallest radius {radius:.2g} mm, of the {tool.name}: a size of at most "
        f"{radius / 2:.2g} resolves it, at about {times} times the time of an iteration"
    )
