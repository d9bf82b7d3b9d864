"""The flat pattern: a line on the formed part, mapped back to the flat blank.

A point of the line goes to the closest point of the formed triangles, and with its barycentric
coordinates there to the flat ones. Of a line that is known only as it is seen along z (the opening
of a die, a CSV without z) the points are those where the edges of the triangles cross it.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..checks import InputError, check_number, optional
from ..comparison.mapping import beyond_edge, on_surface, spacing
from ..net.slits import joined
from ..result.files import replaced
from ..result.sheet import FormedSheet
from ..tables import read_table
from ..tools.mending import together
from .drawing import Drawing, write_csv, write_dxf, write_svg
from .fibres import ASIDE, limits_of, read_formed
from .keywords import NOTICES, write_notices

if TYPE_CHECKING:
    import shapely

    from ..result.record import Record
    from ..result.run import Result

FloatArray = np.ndarray
Line = str | Path | FloatArray | Sequence[Sequence[float]]
STEP = 0.25  # of the spacing: distance of the points that are mapped
HALVINGS = 30  # of an edge, to find where a line crosses it
TOUCH = 1e-7  # of the sheet: places that near are one
JUMP = 3.0  # flat step over formed step: the line has passed from one fold to another
FILES = ("pattern.dxf", "pattern.svg", "pattern.csv", "pattern.txt")
NOT_MODELLED = NOTICES["pattern"]


@dataclass(frozen=True, eq=False)
class FlatPattern(Drawing):
    """A cut in the flat blank, seen from the upper side, where the punch is.

    Parameters
    ----------
    name : str
        Of the part.
    trim, blank : list of (k, 2) arrays
        Lines to cut along; outline of the blank and of its holes; mm, a closed one repeats its
        first point.
    along : (2, 2) array
        Flat unit vectors of warp (0°) and weft (90°).
    slits : list of (k, 2) arrays
        Lines along which the blank is cut before forming, mm.
    notices : tuple of str
        What the pattern does not hold: that of this one, then that of them all (`NOT_MODELLED`).
    ply : int
        Its number in a stack.
    """

    notices: tuple[str, ...] = ()
    ply: int = 0

    @property
    def area(self) -> float:
        """Area inside the closed lines, those inside others as holes, mm²."""
        import shapely

        rings = [shapely.make_valid(shapely.Polygon(p)) for p in self.trim if _closed(p)]
        return float(reduce(shapely.symmetric_difference, rings, shapely.Polygon()).area)

    def save(self, out: str | Path, *, force: bool = False) -> Path:
        """Write `files` (the .dxf with ezdxf only) into `out`; `force` replaces an earlier one."""
        dxf, drawing, points, words = self.files
        with replaced(out, force=force, names=self.files) as folder:
            if not _without_dxf():
                write_dxf(self, folder / dxf)
            write_csv(self, folder / points)
            write_svg(self, folder / drawing)
            title = f"Flat pattern of {self.name}, seen from the upper side (the punch's)"
            write_notices(folder / words, title, self.notices)
        return Path(out)

    @property
    def files(self) -> tuple[str, ...]:
        """Names of its files: `FILES`, of a ply of a stack with its number before them."""
        return tuple(f"ply_{self.ply}_{name}" if self.ply else name for name in FILES)


def flat_pattern(
    source: Result | Record | str | Path,
    trim: Line,
    *,
    within: float | None = None,
    scale: float = 1.0,
) -> FlatPattern:
    """Map a trim line on the formed part back to the flat blank.

    Parameters
    ----------
    source : Result, Record or path
        A run, or the folder of one.
    trim : (k, 3) or (k, 2) array, path, "edge" or "die"
        Closed line in space or seen along z; a CSV of x, y[, z] (and loop, for several); the edge
        of the formed sheet; the opening of the scene's die, seen along z.
    within : float, optional
        mm; a line farther than this from the sheet has left it. The thickness if not given.
    scale : float
        mm per unit of the line.

    Returns
    -------
    FlatPattern

    Raises
    ------
    InputError
        For a line that cannot be read, of less than three points, or nowhere near the part.
    """
    import shapely

    check_number("scale", scale)
    record = read_formed(source)
    sheet, notices = record.sheet, [*limits_of(record)]
    reach = record.fabric["thickness"] if within is None else check_number("within", within)
    edges, slits = cut_lines(sheet)
    if isinstance(trim, str) and trim == "edge":
        lines = edges
    elif isinstance(trim, str) and trim == "die":
        lines = _seen(sheet, _opening(record), notices)
        scene = "the run" if record.model else f"the scene '{Path(record.scene).name}'"
        notices.append(f"the die's opening is that of {scene}")
    else:
        lines = []
        for curve in curves(trim, scale):
            plan = shapely.Polygon(curve)
            if curve.shape[1] == 2 and (not plan.is_valid or not plan.area > 0):
                words = "must enclose an area and not cross itself"
                raise InputError(f"the trim line, seen along z, {words}")
            if curve.shape[1] == 2:
                lines += _seen(sheet, plan, notices)
            else:
                lines.append(_mapped(sheet, curve, reach, notices))
    for line in lines:
        if _closed(line) and not shapely.LinearRing(line).is_simple:
            notices.append("the flat line crosses itself")
    notices += _without_dxf()
    name = ", ".join(filter(None, [record.case, record.ply_name]))
    ply, notices = record.ply * bool(record.ply_name), (*notices, *NOT_MODELLED)
    return FlatPattern(name, lines, edges, sheet.along, slits, notices, ply)


def cut_lines(sheet: FormedSheet) -> tuple[list[FloatArray], list[FloatArray]]:
    """Flat outlines, the outer one first, and slits: where the edge of the sheet runs both ways."""
    import shapely

    flat, same, _ = together(sheet.flat, TOUCH * float(np.ptp(sheet.flat)))
    steps = [np.column_stack([loop[:-1], loop[1:]]) for loop in map(same.take, sheet.loops)]
    ends, count = np.unique(np.sort(np.vstack(steps), axis=1), axis=0, return_counts=True)
    if count.max() == 1:
        return [sheet.flat[loop] for loop in sheet.loops], []
    edges, slits = (joined(flat[part]) for part in (ends[count == 1], ends[count > 1]))
    return sorted(edges, key=lambda line: -shapely.Polygon(line).area), slits


def _without_dxf() -> list[str]:
    """Why there is no pattern.dxf; empty if there is one."""
    with suppress(InputError):
        optional("ezdxf", "cad", "a .dxf file needs ezdxf")
        return []
    return [NOTICES["no_dxf"]]


def curves(trim: Line, scale: float) -> list[FloatArray]:
    """Lines (k, 2) or (k, 3), mm, first point not repeated."""
    where = ""
    if isinstance(trim, str | Path):
        table, where = read_table(Path(trim)), f"{trim}: "
        names = [name for name in "xyz" if name in table]
        if names[:2] != ["x", "y"]:
            raise InputError(f"{where}expected columns x, y, z, got {', '.join(table)}")
        points = np.column_stack([table[name] for name in names])
        loop = table.get("loop", np.zeros(len(points)))
        curves = [points[loop == number] for number in dict.fromkeys(loop.tolist())]
    else:
        curves = [np.empty(0)]
        with suppress(TypeError, ValueError):
            curves = [np.asarray(trim, dtype=float)]
    found = []
    for curve in curves:
        if curve.ndim != 2 or curve.shape[1] not in (2, 3) or not np.isfinite(curve).all():
            raise InputError(f"{where}a trim line must be points (k, 3) or (k, 2) in mm")
        curve = curve[:-1] if len(curve) > 1 and np.allclose(curve[0], curve[-1]) else curve
        if len(curve) < 3:
            raise InputError(f"{where}a trim line needs three points, got {len(curve)}")
        found.append(scale * curve)
    return found


def _mapped(sheet: FormedSheet, curve: FloatArray, reach: float, notices: list[str]) -> FloatArray:
    """Flat closed line of a closed line in space."""
    import shapely

    size = spacing(sheet)
    dense = shapely.segmentize(shapely.LinearRing(curve), STEP * size)
    points = shapely.get_coordinates(dense, include_z=True)[:-1]
    flat, distance = on_surface(sheet.flat, sheet, points)
    if distance.min() > reach:
        raise InputError(
            f"the trim line is nowhere within {reach:.3g} mm of the formed sheet, at best "
            f"{distance.min():.3g} mm away: are its place and its unit (scale) those of the part?"
        )
    left = (distance > reach) | beyond_edge(sheet, points, ASIDE * size)
    step = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    if left.any():
        x, y, z = points[left][distance[left].argmax()]
        notices.append(
            f"the trim line leaves the sheet on {100 * step[left].sum() / step.sum():.3g} % of its "
            f"length, by up to {distance[left].max():.3g} mm near ({x:.4g}, {y:.4g}, {z:.4g}): "
            "there the pattern follows the closest points of the sheet, often its edge"
        )
    closed = np.vstack([flat, flat[:1]])
    jumps = np.linalg.norm(np.diff(closed, axis=0), axis=1) > JUMP * step + 0.5 * size
    if jumps.any():
        x, y = flat[jumps.argmax()]
        notices.append(
            f"the flat line jumps {jumps.sum()} times, first near ({x:.4g}, {y:.4g}): the part "
            "folds there, or the line is far from it"
        )
    return closed


def _seen(sheet: FormedSheet, plan: shapely.Polygon, notices: list[str]) -> list[FloatArray]:
    """Flat lines of the sheet that lie on a polygon's edge when seen along z."""
    import shapely

    shapely.prepare(plan)
    inside = shapely.contains_xy(plan, sheet.points[:, :2])
    edges = np.stack([sheet.triangles, np.roll(sheet.triangles, -1, axis=1)], axis=2)
    edges = np.sort(edges, axis=2)  # the same point from both sides
    crossed = inside[edges].sum(2) == 1
    cut = crossed.any(1)
    if not cut.any():
        raise InputError("the trim line, seen along z, does not cross the formed sheet")
    pairs, segment = np.unique(edges[cut][crossed[cut]], axis=0, return_inverse=True)
    a, b = pairs.T
    share = np.full(a.shape, 0.5)  # never 0: lines through a node would meet there
    for k in range(HALVINGS):
        place = sheet.points[a] + share[:, None] * (sheet.points[b] - sheet.points[a])
        first_side = shapely.contains_xy(plan, place[:, :2]) == inside[a]
        share += np.where(first_side, 0.25, -0.25) * 0.5**k
    points = sheet.flat[a] + share[:, None] * (sheet.flat[b] - sheet.flat[a])
    ends = points[segment.reshape(-1, 2)]
    chord = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max()
    notices.append(f"the line is straight between edges of triangles, up to {chord:.3g} mm long")
    lines = joined(ends)
    if not all(map(_closed, lines)):
        notices.append("the trim line leaves the sheet: what is left of it does not close")
    return sorted(lines, key=lambda line: -shapely.Polygon(line).area if len(line) > 3 else 0.0)


def _opening(record: Record) -> shapely.Polygon:
    """Opening of the die of the run's scene, seen along z: the wall below its fillet."""
    import shapely

    from ..scenes import scene_file
    from ..tools.shapes import Opening

    name = record.parameters.get("scene")
    if not isinstance(name, str):
        raise InputError("the result is of no forming scene: give the trim line by its points")
    if record.model is not None:  # as it was built
        dies = [tool for tool in (record.model.tools or [()])[0] if tool.motion != "free"]
    else:
        dies = [tool for tool in scene_file.load(record.scene).tools if tool.role == "die"]
    for tool in dies:
        if isinstance(tool.shape, Opening):
            hole = tool.shape.hole
            core = shapely.MultiPoint(hole.core[:, :2]).convex_hull
            section = shapely.buffer(core, hole.radius, quad_segs=90)
            return shapely.affinity.translate(section, *tool.place)
    raise InputError(f"the scene '{name}' has no die with an opening in closed form")


def _closed(line: FloatArray) -> bool:
    return len(line) > 3 and bool(np.array_equal(line[0], line[-1]))
