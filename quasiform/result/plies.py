"""The plies of a stack in one formed sheet with the cell field `ply`, as files hold them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..checks import InputError
from .sheet import FormedSheet


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


def one_of(sheet: FormedSheet, ply: int) -> FormedSheet:
    """One ply of several; InputError if there is none of that number.

    A sheet without the field `ply` is the first and only one.
    """
    numbers = np.ravel(sheet.cell_fields.get("ply", np.ones(len(sheet.triangles))))
    own = numbers == ply
    if not own.any():
        raise InputError(f"no ply {ply}: there are {int(numbers.max(initial=1))}")
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
