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

from pathlib import Path

import numpy as np

from .fibres import FAMILIES, Fibres
from .keywords import NOTICES, fill

FloatArray = np.ndarray
STEEP = np.sin(np.radians(5.0))  # a reference nearer to the normal has no projection


def drape(fibres: Fibres, folder: Path, file: str, reference: FloatArray) -> tuple[str, ...]:
    """Write drape_0000.rad or drape.fem, with the mesh where it is the formed one; notices."""
    target, known = fibres.target, fibres.known
    n = target.normals
    projected = reference - (n @ reference)[:, None] * n
    steep = np.linalg.norm(projected, axis=1) < STEEP
    along = "({:g}, {:g}, {:g})".format(*reference)
    notices = [NOTICES["tables_not_run"]]
    if (lost := steep & known).any():
        notices.append(NOTICES["drape"]["across"].format(count=lost.sum()))
    notices.append(NOTICES["drape"]["angles"].format(along=along))
    corners, kept = target.nodes[target.corners[:, :3]], known & ~steep
    columns = [v[kept] for v in (target.triangular, target.elements, fibres.thickness_ratio)]
    angles = {family: fibres.angle(family, projected)[kept] for family in FAMILIES}
    fill(
        file,
        folder / f"{fibres.prefix}{file}",
        **{"header": fibres.notices, "name": fibres.name, "along": along},
        nodes=list(zip(target.nodes, *target.points.T, strict=True)) if fibres.own else [],
        cells=list(zip(target.elements, *corners.T, strict=True)) if fibres.own else [],
        tables={k: list(zip(*columns, angle, strict=True)) for k, angle in angles.items()},
    )
    return (*notices, NOTICES["no_weight"])
