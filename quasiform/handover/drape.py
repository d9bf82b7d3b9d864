"""DRAPE tables: thinning and change of the fibre angle by element, for Radioss and OptiStruct.

    Radioss      /DRAPE/id, title, then: kind, label, thinning, angle    (10, 10, 20, 20 wide)
    OptiStruct   DRAPE, id, then: +, ELEM, label, thinning, angle        (8 wide)

Table 1 is for a ply of the warp, table 2 for one of the weft, both with a nominal angle of 0°. The
angle runs from the reference direction, projected into the element, to the fibre, about the
element's normal; the ply's reference (skew, MCID) must be that direction. The thinning is t/t0.

References
----------
Altair Radioss 2021, Starter keyword /DRAPE; Altair OptiStruct 2021, bulk data entry DRAPE.
"""

from __future__ import annotations

from collections import namedtuple
from pathlib import Path

import numpy as np

from .fibres import FAMILIES, Fibres
from .keywords import write

FloatArray = np.ndarray
STEEP = np.sin(np.radians(5.0))  # a reference nearer to the normal has no projection
NOT_RUN = "the tables follow the published format and were not run in the solver"
NO_WEIGHT = "areal weight is not in the table: it falls as the thinning does"
GENERAL = (NOT_RUN, NO_WEIGHT)  # true of every part


Code = namedtuple("Code", "file mark start nodes node cells cell table row")
"""How a code writes: name of the file, mark of comments, lines, and patterns of `str.format`."""

RADIOSS = Code(
    *("drape_0000.rad", "#", ["#RADIOSS STARTER"]),
    *(["/NODE"], "{:>10}{:>20.9g}{:>20.9g}{:>20.9g}"),
    *(["/SH3N/1"], "{:>10}{:>10}{:>10}{:>10}"),
    table="/DRAPE/{number}\n{family} plies of {part}",
    row="{kind:<10}{label:>10}{thinning:>20.6f}{angle:>20.4f}",
)
OPTISTRUCT = Code(
    *("drape.fem", "$", []),
    *([], "GRID*   {:>16}                {:>16.8E}{:>16.8E}\n*       {:>16.8E}"),
    *([], "CTRIA3  {:>8}       1{:>8}{:>8}{:>8}"),
    table="$ {family} plies\nDRAPE   {number:>8}",
    row="+       ELEM    {label:>8}{thinning:>8.5f}{angle:>8.2f}",
)


def drape(fibres: Fibres, folder: Path, code: Code, reference: FloatArray) -> tuple[str, ...]:
    """Write the tables, with the formed mesh where that is the one handed over; notices."""
    target, known = fibres.target, fibres.known
    n = target.normals
    projected = reference - (n @ reference)[:, None] * n
    steep = np.linalg.norm(projected, axis=1) < STEEP
    along = "({:g}, {:g}, {:g})".format(*reference)
    notices = [NOT_RUN]
    if (lost := steep & known).any():
        notices.append(
            f"{lost.sum()} elements stand across the reference direction and have no angle to it; "
            "they are left out of the table: choose another reference"
        )
    notices.append(
        f"the angles are from the direction {along} projected into the element; the thinning is "
        "the thickness over that of the flat fabric"
    )
    header = [
        f"Formed part of {fibres.name}; 1 warp plies, 2 weft plies, nominal angle 0",
        f"Thinning t/t0; angle in degrees from {along} projected into the element",
        *fibres.notices,
    ]
    lines = [*code.start, *(f"{code.mark} {line}" for line in header)]
    if fibres.own:
        corners = target.nodes[target.corners[:, :3]]
        lines += code.nodes
        lines += [code.node.format(*v) for v in zip(target.nodes, *target.points.T, strict=True)]
        lines += code.cells
        lines += [code.cell.format(*v) for v in zip(target.elements, *corners.T, strict=True)]
    thinning = fibres.thickness_ratio
    for number, family in enumerate(FAMILIES, 1):
        angle = fibres.angle(family, projected)
        lines.append(code.table.format(number=number, family=family, part=fibres.name))
        lines += [
            code.row.format(
                kind="SH3N" if target.triangular[row] else "SHELL",
                label=target.elements[row],
                thinning=thinning[row],
                angle=angle[row],
            )
            for row in np.flatnonzero(known & ~steep)
        ]
    write(folder / code.file, lines)
    return (*notices, NO_WEIGHT)
