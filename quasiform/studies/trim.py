"""The flat blank whose edge lies on a given line after forming.

Fixed point: the blank is formed, each point p of the line is mapped back to the flat blank by the
formed sheet, and these points are the outline of the next blank. With the closest point x of the
formed sheet, its flat place X and F of the triangle there,

    X(p) = X + F⁺ (p - x),

which also continues the sheet in its own plane where the line lies beyond its edge.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import shapely

from ..checks import number
from ..comparison.mapping import closest, on_surface, spacing
from ..result.sheet import FormedSheet, legs_of
from ..scenes import scene_file
from ..scenes.scene_parts import Region, SceneFile
from ..toml_file import toml_text
from .answer import Answer, Row, Solve, completed, shortfall
from .plan import Plan
from .questions import target

ROUND = "round"
FINE = 0.05  # of the distance that is allowed: spacing of the points that are compared
DIGITS = 6  # of a coordinate, mm

FloatArray = np.ndarray


def answer(plan: Plan, solve: Solve, fields: Callable[[str], dict[str, FloatArray]]) -> Answer:
    """Repeat until edge and line are near enough, and say how near they are in each round."""
    trim, file = plan.study.trim, dict(plan.first[0].recipe.given)["file"]
    lines = target(trim)
    plan.jobs[:] = [replace(plan.jobs[0], values={ROUND: 1})]
    table: dict[str, list[Any]] = {n: [] for n in (ROUND, "run", "largest_mm", "mean_mm")}
    sheets: list[FormedSheet] = []
    rows: list[Row] = []
    why: list[str] = []
    while True:
        job = plan.jobs[-1]
        rows += solve([job])
        if not completed(rows[-1]):
            break
        sheets.append(_sheet(fields(job.id)))
        off = distances(sheets[-1], lines, FINE * trim.within)
        entry = len(sheets), job.id, float(off.max()), float(off.mean())
        for column, value in zip(table.values(), entry, strict=True):
            column.append(value)
        if off.max() <= trim.within or len(sheets) == trim.runs:
            break
        flat = [shapely.Polygon(np.round(ring, DIGITS)) for ring in flat_of(sheets[-1], lines)]
        if not all(ring.is_valid for ring in flat):
            why = [f"round {len(sheets)}: the flat line crosses itself, the part folds there"]
            break
        blank = {"blank": _blank(file, [ring.exterior for ring in flat])}
        plan.jobs.append(replace(plan.described(blank), values={ROUND: len(sheets) + 1}))
    why += shortfall(rows)
    if not sheets:
        return Answer([*why, "no blank: the first one was not formed"])
    return _found(trim.within, table, sheets, lines, file, why)


def _sheet(arrays: dict[str, FloatArray]) -> FormedSheet:
    return FormedSheet(arrays["points"], arrays["triangles"], arrays["flat"])


def _blank(file: SceneFile, rings: list[Any]) -> dict[str, Any]:
    """Table [blank] of the scene with another outline, and holes; its own where there are none."""
    outline, *holes = rings
    blank = Region.of(shapely.Polygon(outline, holes or file.outline.interiors))
    return tomllib.loads(scene_file.scene_toml(replace(file, blank=blank)))["blank"]


def flat_of(sheet: FormedSheet, lines: list[FloatArray]) -> list[FloatArray]:
    """(k, 2) flat lines of lines on or beside a formed sheet, a point for each of its cells."""
    found = []
    for line in lines:
        seen = _seen(sheet, line)
        ring = shapely.segmentize(shapely.LinearRing(line), spacing(sheet))
        p = shapely.get_coordinates(ring, include_z=True)[:-1]
        p = np.nan_to_num(p)  # a line seen along z has none
        flat, _ = on_surface(sheet.flat, seen, p)
        _, corners, x = closest(p, seen)
        a, b = (legs_of(points, corners).swapaxes(1, 2) for points in (sheet.flat, seen.points))
        F = b @ np.linalg.inv(a)
        found.append(flat + np.einsum("nij,nj->ni", np.linalg.pinv(F), p - x))
    return found


def _seen(sheet: FormedSheet, line: FloatArray) -> FormedSheet:
    """The sheet, or its shadow along z where the line is known only so."""
    flat = [1.0, 1.0, 1.0 if line.shape[1] == 3 else 0.0]
    return FormedSheet(sheet.points * flat, sheet.triangles, sheet.flat)


def distances(sheet: FormedSheet, lines: list[FloatArray], step: float) -> FloatArray:
    """(n,) distances of the points of lines from the edge of the sheet, and of it from them, mm."""
    from scipy.spatial import cKDTree

    edges = _seen(sheet, lines[0]).outline
    both = []
    for rings in (lines, edges if len(lines) > 1 else edges[:1]):  # else holes stay as they are
        dense = shapely.segmentize([shapely.LinearRing(ring) for ring in rings], step)
        both.append(np.nan_to_num(shapely.get_coordinates(dense, include_z=True)))
    return np.concatenate([cKDTree(a).query(b)[0] for a, b in (both, both[::-1])])


def _found(
    within: float,
    table: dict[str, list[Any]],
    sheets: list[FormedSheet],
    lines: list[FloatArray],
    file: SceneFile,
    why: list[str],
) -> Answer:
    words = [
        f"round {k}: edge and line {far:.2f} mm apart at most, {mean:.2f} in the mean (run {run})"
        for k, run, far, mean in zip(*table.values(), strict=True)
    ]
    best = int(np.argmin(table["largest_mm"]))
    near = table["largest_mm"][best]
    if near > within:
        words.append(f"not within {within:g} mm: the best is round {best + 1}")
    rings = [sheets[best].flat[loop] for loop in sheets[best].loops]
    area = shapely.Polygon(rings[0], rings[1:]).area
    words.append(f"blank of round {best + 1}: {number(area)} mm²")
    text = "x,y\n" + "".join(f"{x:.6f},{y:.6f}\n" for x, y in rings[0][:-1])
    scene = toml_text({"blank": _blank(file, rings)})
    tables = {"trim.csv": table, "blank.csv": text, "blank.toml": scene}
    picture = "trim", (sheets[0], sheets[best], lines, table, within)
    return Answer([*why, *words], tables, {"trim.png": picture})
