"""The plies of a stack: all in one sheet with the cell field `ply`, and what is between them.

The thickness of the stack at a node is the sum of t0/J (constant volume) over the plies that lie on
each other there: those parted by less than a tenth of their thickness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..checks import InputError
from ..energy.plies import PlyContact
from ..model import Model
from ..unknowns import Sheet
from .sheet import FormedSheet

FloatArray = np.ndarray
PARTED = 0.1  # of the thickness: plies farther apart do not lie on each other


def in_one(plies: Sequence[FormedSheet]) -> FormedSheet:
    """All plies in one sheet, number 1 first; the sheet itself of one only."""
    if len(plies) == 1:
        return plies[0]
    starts = np.cumsum([0, *(len(ply.places) for ply in plies)])
    number = [np.full(len(ply.triangles), float(k)) for k, ply in enumerate(plies, 1)]
    point_fields, cell_fields = (
        {
            name: np.concatenate([fields[name] for fields in of_each])
            for name in of_each[0]
            if all(name in fields for fields in of_each)
        }
        for of_each in ([p.point_fields for p in plies], [p.cell_fields for p in plies])
    )
    return FormedSheet(
        np.vstack([ply.points for ply in plies]),
        np.vstack([ply.triangles + n for ply, n in zip(plies, starts[:-1], strict=True)]),
        np.vstack([ply.flat for ply in plies]),
        point_fields,
        cell_fields | {"ply": np.concatenate(number)},
        travel=plies[0].travel,
    )


def numbers_of(sheet: FormedSheet) -> np.ndarray:
    """(m,) number of the ply of each triangle: the field `ply`, 1 where there is none."""
    return np.ravel(sheet.cell_fields.get("ply", np.ones(len(sheet.triangles))))


def one_of(sheet: FormedSheet, ply: int) -> FormedSheet:
    """One ply of several, all of them for 0; InputError if there is none of that number.

    A sheet without the field `ply` is the first and only one.
    """
    if not ply:
        return sheet
    own = (numbers := numbers_of(sheet)) == ply
    if not own.any():
        raise InputError(f"no ply {ply} of {int(numbers.max(initial=1))}")
    if own.all():
        return sheet
    used, triangles = np.unique(sheet.triangles[own], return_inverse=True)
    return replace(
        sheet,
        points=sheet.points[used],
        triangles=triangles.reshape(-1, 3),
        flat=None if sheet.flat is None else sheet.flat[used],
        point_fields={name: values[used] for name, values in sheet.point_fields.items()},
        cell_fields={name: values[own] for name, values in sheet.cell_fields.items()},
    )


def apart(sheet: FormedSheet) -> list[tuple[np.ndarray, FormedSheet]]:
    """Each ply of a sheet of all, after the numbers of its nodes there."""
    number = numbers_of(sheet)
    if (number == number[0]).all():
        return [(np.arange(len(sheet.places)), sheet)]
    plies = np.unique(number).astype(int)
    return [(np.unique(sheet.triangles[number == k]), one_of(sheet, k)) for k in plies]


def summary_of_ply(summary: dict[str, Any], ply: int) -> dict[str, Any]:
    """Summary of a run whose numbers of a sheet are those of one ply; as it is for 1 and 0 (all).

    InputError if there is no ply of that number.
    """
    plies = summary.get("plies") or [{}]
    if ply > len(plies):
        raise InputError(f"no ply {ply} of {len(plies)}")
    if ply < 2:
        return summary
    errors, start = summary.get("estimated_errors") or {}, f"ply_{ply}_"
    own = {name.removeprefix(start): e for name, e in errors.items() if name.startswith(start)}
    own |= {name: e for name, e in errors.items() if name.startswith(("force", "load", "slip"))}
    error = {"shear_angle_deg": own.get("shear_angle_deg"), "path_deg": None}
    more = {"estimated_errors": own, "error_estimate": summary["error_estimate"] | error}
    return summary | {k: v for k, v in plies[ply - 1].items() if k != "fabric"} | more


def between_plies(model: Model, x: FloatArray) -> list[dict[str, FloatArray]]:
    """Fields by node of each whole ply at x (n_dofs,), mm: `slip_1_2`, ... and `stack_thickness`.

    A slip is that since the start; zero where the two plies do not lie over each other. A diaphragm
    is no ply.
    """
    plies = [view.sheet for view in model.plies]
    own = {sheet.name: _thickness(sheet, x) for sheet in plies}
    named = model.named_pairs.items()
    pairs = {name: pair for name, pair in named if all(c.sheet.name in own for c in pair)}
    above, below = (_beyond(plies, [*pairs.values()], x, own, side) for side in (-1.0, 1.0))
    found = []
    for sheet in plies:
        fields = {"stack_thickness": above[sheet.name] + own[sheet.name] + below[sheet.name]}
        for name, pair in pairs.items():
            slid = [np.nan_to_num(c.slid(model.x0, x)) for c in pair if c.sheet is sheet]
            fields[f"slip_{name}"] = slid[0] if slid else 0.0 * own[sheet.name]
        found.append({name: values[sheet.whole[1]] for name, values in fields.items()})
    return found


def _thickness(sheet: Sheet, x: FloatArray) -> FloatArray:
    """(n_nodes,) thickness of a ply at constant volume, mm."""
    bare = FormedSheet(sheet.positions(x), sheet.blank.triangles, sheet.blank.nodes)
    return bare.at_nodes(sheet.fabric.thickness / bare.area_ratio)


def _beyond(
    plies: Sequence[Sheet],
    between: Sequence[Sequence[PlyContact]],
    x: FloatArray,
    own: dict[str, FloatArray],
    side: float,
) -> dict[str, FloatArray]:
    """(n_nodes,) thickness of what lies under the nodes of each ply (side 1), or on them (-1)."""
    found = {name: np.zeros_like(t) for name, t in own.items()}
    contacts = [c for pair in between for c in pair if c.side == side]
    for sheet in plies[:: int(-side)]:  # from the far end on
        for contact in (c for c in contacts if c.sheet is sheet):
            pairs, other = contact.pairs(x), contact.other
            beyond = (own[other.name] + found[other.name])[other.blank.triangles[pairs.triangles]]
            lies = contact.penetration(x, pairs) > -PARTED * contact.reach
            there = np.where(lies, (pairs.weights * beyond).sum(1), 0.0)
            found[sheet.name] = np.maximum(found[sheet.name], there)
    return found
