"""Outlines of blanks: polygons with holes, built or read from a drawing, a mesh or a table.

Everything is a `shapely.Polygon` in mm, its holes are the interiors. What is read becomes lines,
lines whose ends meet become loops; the largest loop is the outline and those inside are its holes.
"""

from __future__ import annotations

import logging
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely

from ..checks import InputError, check_file, check_number, naming, optional, suggestion
from ..meshes.shells import counted
from ..tables import read_numbers
from ..tools.mending import edges_of, position, together
from ..tools.surface_file import KINDS, read_with_notes
from .blank import check_unit

FloatArray = np.ndarray
CHORD = 3e-5  # of a curve's size: largest distance of its polygon from it
TINY = 1e-6  # of a hole's area beyond the edge: it only touches
GAP = 0.05  # mm, ends of lines nearer than this meet
CURVES = ("LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE")
NOT_DRAWN = ("DIMENSION", "LEADER", "MULTILEADER", "MLEADER", "ARC_DIMENSION", "ACAD_TABLE")
TABLES = (".csv", ".txt", ".xy", ".dat")


def rectangle(
    length: float, width: float, centre: tuple[float, float] = (0.0, 0.0)
) -> shapely.Polygon:
    """Rectangle, mm, length along x. InputError unless the sides are positive."""
    half = 0.5 * check_number("length", length), 0.5 * check_number("width", width)
    return shapely.box(*np.subtract(centre, half), *np.add(centre, half))


def disc(radius: float, centre: tuple[float, float] = (0.0, 0.0)) -> shapely.Polygon:
    """Disc, mm: a polygon in it, a corner a degree. InputError for a bad radius."""
    check_number("radius", radius)
    angle = 2 * np.pi * np.arange(360) / 360
    return shapely.Polygon(radius * np.column_stack([np.cos(angle), np.sin(angle)]) + centre)


def polygon(points: Sequence[tuple[float, float]]) -> shapely.Polygon:
    """Polygon through points (n, 2), mm, in either sense, closed or not.

    InputError for less than three points, or edges that cross.
    """
    try:
        points = np.asarray(points, dtype=float)
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise InputError("points must be a list of [x, y] in mm")
    return _loop(points)


def with_holes(
    outline: shapely.Polygon, holes: Iterable[shapely.Polygon], name: str = "hole"
) -> shapely.Polygon:
    """Cut holes out of an outline, and notches: holes that cross its edge; `name` is for errors.

    InputError for a hole outside, on another hole or touching the edge, and for a notch that
    divides the blank.
    """
    whole = shapely.Polygon(outline.exterior)
    for k, hole in enumerate(holes, 1):
        at = f"{name} {k} near {position(hole.centroid.coords[0])}"
        notch = TINY < hole.difference(whole).area / hole.area < 1 - TINY
        if not (notch or outline.contains_properly(hole)):
            words = "does not lie inside the outline, clear of its edge and of other holes"
            raise InputError(f"{at} {words}; a notch is a hole that crosses the edge")
        outline = outline.difference(hole)
        if not isinstance(outline, shapely.Polygon) or outline.is_empty:
            raise InputError(f"{at} divides the blank")
    return outline


@dataclass(frozen=True)
class Drawing:
    """An outline as it was read."""

    polygon: shapely.Polygon  # mm
    notes: tuple[str, ...] = ()  # what was used, and what was left out
    unit: tuple[str, float] = ("", 1.0)  # of a .dxf file by its header, and mm per unit


def read_outline(path: str | Path, scale: float = 1.0, layer: str | None = None) -> shapely.Polygon:
    """Outline of `read_drawing`."""
    return read_drawing(path, scale, layer).polygon


def read_drawing(path: str | Path, scale: float = 1.0, layer: str | None = None) -> Drawing:
    """Read the outline of a blank from a file.

    .dxf                          lines, polylines and curves of the model space, also in blocks;
                                  ends nearer than 0.05 mm meet; open lines inside, texts,
                                  dimensions and layers that are off or frozen are left out
    .msh .vtu .vtk .stl .obj .ply .step .iges .brep       the rim of a flat surface
    .csv .txt .xy .dat            a corner x, y a line, with or without a heading

    The scale is mm per unit of the file; where that names its unit ($INSUNITS of a .dxf, the units
    of a .step), a factor beside it; the layer is the only one of a .dxf that is read. The polygon
    is counter-clockwise. InputError names the file and its defect: not readable, no closed loop,
    edges that cross, ...
    """
    path = Path(path)
    with naming(path):
        kind = _kind(path, scale, layer, (".dxf", *KINDS, *TABLES))
        notes, unit = [], ("", 1.0)
        if kind == ".dxf":
            lines, notes, unit = _drawn(path, scale, layer)
            outline, ignored = _from_lines(lines, GAP)
            notes += [f"{ignored} lines inside that are open or drawn twice left out"] * (
                ignored > 0
            )
        elif kind in TABLES:
            outline = _loop(_table(path, scale))
        else:
            vertices, triangles, notes = read_with_notes(path, scale)
            height = np.ptp(vertices[:, 2])
            if height > 1e-3 * np.ptp(vertices, axis=0).max():
                raise InputError(f"the surface is not flat: its z spans {height:.3g} mm")
            edges, count, _ = edges_of(triangles)
            rim = list(vertices[np.sort(edges[count == 1], axis=1), :2])
            outline, _ = _from_lines(rim, 0.0)
        check_unit(np.ptp(np.reshape(outline.bounds, (2, 2)), axis=0).max(), scale)
    return Drawing(outline, tuple(notes), unit)


def read_lines(path: str | Path, scale: float = 1.0, layer: str | None = None) -> list[FloatArray]:
    """Lines (k, 2), mm, of a layer of a .dxf file, or the one in a table; as `read_drawing`.

    Lines whose ends meet are one; a closed one repeats its first point.
    """
    path = Path(path)
    with naming(path):
        if _kind(path, scale, layer, (".dxf", *TABLES)) != ".dxf":
            return [_table(path, scale)]
        lines = _joined(_drawn(path, scale, layer)[0], GAP)
        merged = shapely.get_parts(shapely.line_merge(shapely.MultiLineString(lines)))
        if not len(merged):
            raise InputError("no lines found")
        return [shapely.get_coordinates(line) for line in merged]


def read_loops(
    path: str | Path, scale: float = 1.0, layer: str | None = None
) -> list[shapely.Polygon]:
    """Polygons of all lines of `read_lines`; InputError for an open line."""
    lines = read_lines(path, scale, layer)
    with naming(path):
        loose = np.array([shapely.LineString(p) for p in lines if (p[0] != p[-1]).any()])
        if len(loose) and Path(path).suffix.lower() == ".dxf":
            raise InputError(_open_end(loose))
        return [_loop(line) for line in lines]


def _kind(path: Path, scale: float, layer: str | None, known: Sequence[str]) -> str:
    """Ending of the name of a file that can be read."""
    kind = path.suffix.lower()
    check_number("scale", scale)
    if kind not in known:
        expected = f"expected one of {', '.join(known)}"
        raise InputError(f"unknown kind of outline '{kind}': {expected}")
    check_file(path)
    if layer is not None and kind != ".dxf":
        raise InputError(f"layer = {layer!r}: only a .dxf file has layers")
    return kind


def _table(path: Path, scale: float) -> FloatArray:
    """(n, 2) points of a table, mm."""
    points = read_numbers(path, most=2)[2]
    if not np.isfinite(points).all():
        raise InputError("not all coordinates are finite numbers")
    return scale * points


def _drawn(
    path: Path, scale: float, layer: str | None
) -> tuple[list[FloatArray], list[str], tuple[str, float]]:
    """Lines (n, 2), mm, of the model space of a drawing; notes; the unit of its header."""
    ezdxf, paths, blocks, units = (
        optional(f"ezdxf{part}", "cad", "a .dxf file needs ezdxf")
        for part in ("", ".path", ".disassemble", ".units")
    )
    logging.getLogger("ezdxf").addHandler(logging.NullHandler())  # else it prints warnings
    lines, seen, used, left_out = [], set[str](), Counter(), Counter()
    try:
        drawing = ezdxf.readfile(path)
        unit = drawing.header.get("$INSUNITS", 0)
        factor = units.conversion_factor(unit, units.MM) if unit else 1.0
        scale *= factor
        hidden = {
            entry.dxf.name.casefold(): "off" if entry.is_off() else "frozen"
            for entry in drawing.layers
            if entry.is_off() or entry.is_frozen()
        }
        for top in drawing.modelspace():
            inner = [top] if top.dxftype() in NOT_DRAWN else blocks.recursive_decompose([top])
            for entity in inner:
                kind, on = entity.dxftype(), entity.dxf.layer
                on = top.dxf.layer if on == "0" else on  # of the block it is in
                seen.add(on)
                state = hidden.get(on.casefold()) or hidden.get(top.dxf.layer.casefold())
                if state or (layer is not None and on.casefold() != layer.casefold()):
                    left_out[f"{kind} on layer {on}" + f" ({state})" * bool(state)] += 1
                elif kind not in CURVES:
                    left_out[kind] += 1
                else:
                    used[on] += 1
                    curve = paths.make_path(entity)
                    across = np.ptp([p.vec2 for p in curve.control_vertices()], axis=0).max()
                    points = [p.vec2 for p in curve.flattening(CHORD * across or 1.0)]
                    lines.append(scale * np.array(points, dtype=float).reshape(-1, 2))
    except Exception as error:  # any that the parser raises
        reason = " ".join(str(error).replace(f"'{path}'", "it").split()) or type(error).__name__
        raise InputError(f"not a readable .dxf file: {reason}") from error
    if layer is not None and not used:
        raise InputError(f"no lines on layer '{layer}': {suggestion(layer, sorted(seen))}")
    if not lines and left_out:
        raise InputError(f"no lines found: the drawing holds {counted(left_out)}")
    notes = ["drawn on " + ", ".join(f"layer {on} ({n} lines)" for on, n in used.items())]
    notes += [f"left out: {counted(left_out)}"] * bool(left_out)
    return lines, notes, (units.unit_name(unit).lower() if unit else "", factor)


def _from_lines(lines: list[FloatArray], gap: float) -> tuple[shapely.Polygon, int]:
    """Join lines (n, 2) with ends nearer than `gap` (mm) into loops: an outline and its holes.

    Returns too how many lines are left out: open ones inside and loops drawn twice.
    """
    lines = _joined(lines, gap)
    if not lines:
        raise InputError("no lines found")
    merged = shapely.get_parts(shapely.line_merge(shapely.MultiLineString(lines)))
    closed = shapely.is_closed(merged)
    loops = [_loop(shapely.get_coordinates(line)) for line in merged[closed]]
    loops.sort(key=lambda loop: -loop.area)
    loose = merged[~closed]
    if loops:
        loose = loose[~shapely.covers(loops[0].buffer(GAP), loose)]
    if len(loose):
        raise InputError(_open_end(loose))
    outline, *others = loops
    holes: list[shapely.Polygon] = []
    ignored = int((~closed).sum())
    for loop in others:
        apart = [loop.symmetric_difference(other).area for other in (outline, *holes)]
        if min(apart) < GAP * loop.length:
            ignored += 1  # drawn twice
            continue
        at = position(loop.centroid.coords[0])
        if not outline.contains_properly(loop):
            words = f"a second loop near {at} does not lie inside the largest"
            raise InputError(f"more than one outline: {words}; choose one with layer")
        if any(hole.intersects(loop) for hole in holes):
            raise InputError(f"a loop lies inside or across another hole near {at}: choose a layer")
        holes.append(loop)
    return shapely.orient_polygons(with_holes(outline, holes)), ignored


def _joined(lines: list[FloatArray], gap: float) -> list[FloatArray]:
    """Bring ends nearer than `gap` together; leave out points and lines drawn twice."""
    lines = [line for line in lines if len(line) > 1 and np.ptp(line, axis=0).max() > gap]
    if not lines:
        return []
    ends = np.vstack([line[[0, -1]] for line in lines])
    middle, group, _ = together(ends, gap)
    different = {}
    for line, (start, end) in zip(lines, middle[group.reshape(-1, 2)], strict=True):
        line = np.vstack([start, line[1:-1], end])
        different.setdefault(min(p.round(3).tobytes() for p in (line, line[::-1])), line)
    return list(different.values())


def _open_end(lines: np.ndarray) -> str:
    """Say where lines that do not close end or branch."""
    from scipy.spatial import cKDTree

    ends = np.vstack([shapely.get_coordinates(line)[[0, -1]] for line in lines])
    points, times = np.unique(ends, axis=0, return_counts=True)
    free = points[times == 1]
    if len(free) < 2:
        return f"lines branch at {position(points[times.argmax()])}: expected closed loops"
    distance, nearest = cKDTree(free).query(free, k=2)
    gap, k = min(zip(distance[:, 1], range(len(free)), strict=True))
    ends = f"{position(free[k])} and {position(free[nearest[k, 1]])}"
    return f"no closed loop: gap of {gap:.3g} mm between {ends}"


def _loop(points: FloatArray) -> shapely.Polygon:
    """Polygon through points (n, 2) if it encloses an area and its edges do not cross."""
    if len(points) < 3:
        raise InputError(f"an outline needs three points, got {len(points)}")
    loop = shapely.Polygon(points)
    nothing = 1e-9 * loop.length**2
    place = re.search(r"\[(\S+) (\S+)\]", shapely.is_valid_reason(loop))
    if place and shapely.convex_hull(loop).area > nothing:
        at = position([float(x) for x in place.groups()])
        raise InputError(f"the outline crosses itself at {at}")
    if not loop.is_valid or loop.area <= nothing:
        raise InputError("the outline encloses no area")
    return shapely.orient_polygons(loop)
