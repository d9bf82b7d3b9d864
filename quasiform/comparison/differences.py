"""Rows of a comparison: what two sheets and two histories differ in, each with its band.

The difference is result minus reference. Where the reference has triangles it lives at the result's
nodes, weighted by the area they stand for; where it is points only, at these, all alike. What each
sheet has of its own (mean, percentile, maximum, means over areas) is of its triangles, as in
summary.json, where both are known by triangle and compared whole; else of what is compared.
Outlines are compared seen along z, at points a millimetre apart on both: their mean distance from
the other one, and the largest (Hausdorff's). Forces are compared over the common travel, on the
travels of both histories.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..checks import InputError
from ..result.measures import percentile
from ..result.sheet import FormedSheet
from .mapping import ANGLE, SIDES, SLIPS, WAYS, mapped, on_surface, way
from .place import rim
from .read import SAME, Side

FloatArray = np.ndarray
Disc = tuple[tuple[float, float], float]  # centre and radius, mm
Own = list[tuple[FloatArray, FloatArray, FloatArray | None]]
"""Of result and reference: shear angles, areas and flat places of what they are known by."""
STEP = 1.0  # mm between the points of an outline
SAME_BLANK = 0.02  # of their area: flat blanks that differ by more are two
FEW = 10  # points in an area: with fewer their mean says little
EARLY = 0.05  # of the largest internal energy: before, its ratio to the kinetic one says nothing
COLUMNS = "quantity result reference difference unit standing band held over".split()


@dataclass(frozen=True)
class Row:
    """One quantity of both; the difference is a distance where neither has a value of its own."""

    quantity: str
    unit: str
    result: float | None
    reference: float | None
    difference: float | None
    standing: str  # of the reference
    band: float | None = None  # what |difference| may be
    over: str = ""  # how many triangles or points of both a mean over an area is of

    @property
    def held(self) -> bool | None:
        """Whether the difference is within its band; None without one."""
        if self.band is None or self.difference is None:
            return None
        return bool(abs(self.difference) <= self.band)

    def cells(self, form: str) -> dict[str, str]:
        """Text by column, empty where there is nothing; "within" or "OUTSIDE" with a band."""
        numbers = {name: getattr(self, name) for name in ("result", "reference", "difference")}
        found = {key: "" if v is None else format(v, form) for key, v in numbers.items()}
        verdict = {None: "", True: "within", False: "OUTSIDE"}[self.held]
        found |= {"held": verdict, "band": f"{self.band:g}" if verdict else ""}
        return {name: found.get(name, getattr(self, name, "")) for name in COLUMNS}


@dataclass
class Rows:
    """Rows in the making, with the standing of the reference."""

    standing: str
    notes: list[str]
    rows: list[Row] = field(default_factory=list)

    def both(self, quantity: str, unit: str, a: float, b: float, **more: Any) -> None:
        """Add a quantity that result and reference have."""
        a, b = float(a), float(b)
        self.rows.append(Row(quantity, unit, a, b, a - b, self.standing, **more))

    def off(self, quantity: str, unit: str, distance: float, band: float | None = None) -> None:
        """Add a distance between the two."""
        self.rows.append(Row(quantity, unit, None, None, float(distance), self.standing, band))

    def angles(
        self, own: Own, field: FormedSheet, gamma: FloatArray, word: str, band: float | None
    ) -> None:
        """Add the shear angles of both, and their difference at the points that are compared."""
        compared = np.isfinite(gamma[0])
        w, off = field.weights[compared], (gamma[0] - gamma[1])[compared]
        far = np.abs(off)
        for name, measure in (
            ("mean", lambda v, w: np.average(v, weights=w)),
            ("99th percentile", lambda v, w: percentile(v, w, 0.99)),
            ("maximum", lambda v, _: v.max()),
        ):
            self.both(f"{name} of {word}", "deg", *(measure(v, w) for v, w, _ in own))
        for name, value, limit in (
            ("mean", np.average(off, weights=w), None),
            ("mean absolute", np.average(far, weights=w), None),
            ("root mean square", np.average(off**2, weights=w) ** 0.5, None),
            ("95th percentile", percentile(far, w, 0.95), band),
            ("largest", far.max(), None),
        ):
            self.off(f"difference of {word}, {name}", "deg", value, limit)

    def areas(self, own: Own, what: str, areas: Mapping[str, Disc], band: float | None) -> None:
        """Add the means over named areas of the flat blank, of triangles or points (`what`)."""
        if any(X is None for *_, X in own):
            words = "no means over areas: flat coordinates are not known there"
            self.notes += [words] if areas else []
            return
        few = []
        for name, (centre, radius) in areas.items():
            inside = [np.linalg.norm(X - centre, axis=1) <= radius for *_, X in own]
            counts = [int(one.sum()) for one in inside]
            if not min(counts):
                self.notes.append(f"area {name}: no {what} of both lies in it")
                continue
            means = [
                np.average(np.abs(values[one]), weights=w[one])
                for (values, w, _), one in zip(own, inside, strict=True)
            ]
            over = " and ".join(map(str, dict.fromkeys(counts)))
            over += f" {what}" + "s" * (max(counts) > 1)
            self.both(f"mean |γ| in area {name}", "deg", *means, band=band, over=over)
            few += [f"{name} ({over})"] * (min(counts) < FEW)
        if few:
            self.notes.append(f"means of few say little of an area: {', '.join(few)}")

    def slips(self, sheets: tuple[FormedSheet, FormedSheet]) -> None:
        """Add how far the rovings of both have slipped along themselves."""
        for family, name in SLIPS.items():
            slid = [one.point_fields.get(name) for one in sheets]
            known = [side for side, values in zip(SIDES, slid, strict=True) if values is not None]
            if len(known) == 1:
                self.notes.append(f"slip of the {family} is known of the {known[0]} only")
            if len(known) < 2:
                continue
            values = [percentile(v, s.weights, 0.99) for v, s in zip(slid, sheets, strict=True)]
            self.both(f"99th percentile of the slip of the {family}", "mm", *values)
            self.both(f"largest slip of the {family}", "mm", *(v.max() for v in slid))

    def outlines(self, sheet: FormedSheet, theirs: FormedSheet, band: float | None) -> None:
        """Add the distances of the outlines, and the areas within."""
        import shapely

        mine, other = rim(sheet), rim(theirs)
        if mine is None or other is None:
            return
        found, largest = [], 0.0
        for one, goal in [(other, mine), (mine, other)][: 1 + other.is_closed]:  # or a part of it
            along = shapely.line_interpolate_point(one, np.arange(0.0, one.length, STEP))
            found.append(shapely.distance(along, goal))
            corners = shapely.points(shapely.get_coordinates(one))
            largest = max(largest, found[-1].max(), shapely.distance(corners, goal).max())
        self.off("distance of the outlines, mean", "mm", np.mean(np.concatenate(found)))
        self.off("distance of the outlines, largest", "mm", largest, band)
        if mine.is_closed and other.is_closed:
            a, b = (1e-2 * shapely.Polygon(line).area for line in (mine, other))
            self.both("area within the outline", "cm²", a, b)

    def forces(self, forces: FloatArray | None, band: float | None) -> None:
        """Add the forces at the end of the common travel and along it (`common_forces`)."""
        if forces is None:
            return
        s, mine, theirs = forces
        a, b = mine[-1], theirs[-1]
        self.both(f"force at {s[-1]:.6g} mm", "N", a, b)
        if b:
            self.off("force at the end, relative", "%", 100 * (a / b - 1), band)
        largest = np.abs(theirs).max()
        if len(s) > 1 and largest:
            mean_square = np.trapezoid((mine - theirs) ** 2, s) / (s[-1] - s[0])
            words = "force along the travel, root mean square of the largest"
            self.off(words, "%", 100 * np.sqrt(mean_square) / largest, band)

    def energies(self, sides: tuple[Side, Side], travel: float | None) -> None:
        """Add the ratio of kinetic to internal energy of explicit runs: at the end, at most."""
        for name, side in zip(SIDES, sides, strict=True):
            if not {"kinetic", "internal"} <= set(side.history):
                continue
            kinetic, internal = side.history["kinetic"], side.history["internal"]
            known = internal > EARLY * internal.max()
            if travel is not None and "travel" in side.history:
                known &= side.history["travel"] <= travel * (1 + SAME)
            ratio = 100 * kinetic[known] / internal[known]
            for words, values in (("at the end", ratio[-1:]), ("at most", ratio)):
                if len(values):
                    quantity = f"kinetic by internal energy of the {name}, {words}"
                    row = Row(quantity, "%", None, None, None, self.standing)
                    self.rows.append(replace(row, **{name: float(values.max())}))


def matched(
    sheet: FormedSheet, theirs: FormedSheet, by: str, within: float | None, notes: list[str]
) -> tuple[FormedSheet, FloatArray, float]:
    """Where the difference lives, both shear angles there, and the share that is compared."""
    by = way(by, sheet, theirs)
    if len(theirs.triangles):
        field, words = sheet, ("result", "the area")
        gamma = np.stack([sheet.point_fields[ANGLE], mapped(theirs, sheet, by, within)])
    else:
        field, words = theirs, ("reference", "them")
        gamma = np.stack([mapped(sheet, theirs, by, within), theirs.point_fields[ANGLE]])
        if field.flat is None and sheet.flat is not None:  # for the means over areas
            field = replace(field, flat=on_surface(sheet.flat, sheet, field.points)[0])
    compared, weights = np.isfinite(gamma).all(0), field.weights
    if not compared.any():
        raise InputError(
            "no point of the reference lies on the result: is it in the same place and unit? "
            "(align, scale)"
        )
    share = float(weights[compared].sum() / weights.sum())
    notes.append(
        f"matched {WAYS[by]}, at the {words[0]}'s points; {100 * share:.1f} % of {words[1]} "
        "compared"
    )
    return field, np.where(compared, gamma, np.nan), share


def weighed_alike(sheet: FormedSheet, theirs: FormedSheet) -> tuple[FormedSheet, FormedSheet]:
    """Let means of both go by the formed area where only one of them has a flat one."""
    both = sheet, theirs
    meshes = all(len(one.triangles) and one.points is not None for one in both)
    if not meshes or (sheet.flat is None) == (theirs.flat is None):
        return both
    found = []
    for one in both:
        one = replace(one, by_formed_area=True)
        if ANGLE in one.cell_fields and ANGLE in one.point_fields:
            points = {**one.point_fields, ANGLE: one.at_nodes(np.ravel(one.cell_fields[ANGLE]))}
            one = replace(one, point_fields=points)
        found.append(one)
    return found[0], found[1]


def own_values(
    sheets: tuple[FormedSheet, FormedSheet],
    field: FormedSheet,
    gamma: FloatArray,
    whole: bool,
    notes: list[str],
) -> tuple[Own, str]:
    """Shear angles of both, and of what: their triangles if these are known and all compared."""
    whole = whole and all(ANGLE in sheet.cell_fields for sheet in sheets)
    formed = ", by formed area: the flat one is known of one sheet only; not those of summary.json"
    flat = ", as in summary.json (there of |γ| at the end)"
    own = "of each sheet's own triangles" + (formed if sheets[0].by_formed_area else flat)
    source = own if whole else "at the points compared alone: not those of summary.json"
    notes.append(
        "differences at points, where a sheet of triangles has the mean of those around; "
        f"means, percentile, maxima and areas {source}"
    )
    if whole:
        flat = [None if s.flat is None else s.flat[s.triangles].mean(1) for s in sheets]
        fields = [(sheet.cell_fields[ANGLE], sheet.weighing_areas) for sheet in sheets]
        return [(*f, X) for f, X in zip(fields, flat, strict=True)], "triangle"
    compared = np.isfinite(gamma[0])
    X = None if field.flat is None else field.flat[compared]
    return [(g[compared], field.weights[compared], X) for g in gamma], "point"


def other_blank(sheet: FormedSheet, theirs: FormedSheet) -> list[str]:
    """Warn where the flat sheets do not cover the same."""
    import shapely

    sheets = (sheet, theirs)
    if any(one.flat is None or not len(one.triangles) for one in sheets):
        return []
    blanks = [shapely.make_valid(shapely.Polygon(one.flat[one.loops[0]])) for one in sheets]
    share = blanks[0].symmetric_difference(blanks[1]).area / blanks[0].union(blanks[1]).area
    if share <= SAME_BLANK:
        return []
    sizes = [
        f"{x1 - x0:.4g} x {y1 - y0:.4g} mm around "
        f"({0.5 * (x0 + x1) + 0.0:.3g}, {0.5 * (y0 + y1) + 0.0:.3g})"
        for x0, y0, x1, y1 in (blank.bounds for blank in blanks)
    ]
    return [
        f"the flat blanks differ on {100 * share:.0f} % of what they cover (result {sizes[0]}, "
        f"reference {sizes[1]}): another part, another place (--align), a part of it (--mirror) or "
        "another unit (--scale)?"
    ]


def common_forces(mine: Side, other: Side, travel: float | None) -> FloatArray | None:
    """(3, k) common travels and the forces of both there; one column where it is one number."""
    if not all({"travel", "force"} <= set(side.history) for side in (mine, other)):
        return None
    curves = []
    for side in (mine, other):
        order = np.argsort(side.history["travel"], kind="stable")
        curves.append(np.stack([side.history[name][order] for name in ("travel", "force")]))
    (first, last), (start, end) = (curve[0, [0, -1]] for curve in curves)
    low, high = max(first, start), min(last, end)
    slack = SAME * max(abs(high), 1.0)
    high = high if travel is None else min(high, travel)
    if low > high + slack:
        raise InputError(
            f"travels do not overlap: the force of {mine.name} is known from {first:g} to "
            f"{last:g} mm, that of {other.name} from {start:g} to {end:g} mm"
        )
    s = np.concatenate([curve[0] for curve in curves])
    s = np.unique(np.concatenate([s[(s >= low) & (s <= high)], [high]]))
    return np.stack([s, *(np.interp(s, *curve) for curve in curves)])
