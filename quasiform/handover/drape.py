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

from .fibres import Fibres
from .inp import write

FloatArray = np.ndarray
FLAT = np.sin(np.radians(5.0))  # a reference nearer to the normal has no projection
NOT_RUN = "the tables follow the published format and were not run in the solver"
NO_WEIGHT = "areal weight is not in the table: it falls as the thinning does"
GENERAL = (NOT_RUN, NO_WEIGHT)  # true of every part


def radioss(fibres: Fibres, folder: Path, reference: FloatArray) -> tuple[str, ...]:
    """Write drape_0000.rad, with the formed mesh as /NODE and /SH3N; notices."""
    thinning, angles, kept, notices = _table(fibres, reference)
    target = fibres.target
    lines = ["#RADIOSS STARTER", *_told(fibres, "#", reference)]
    if fibres.own:
        lines += ["/NODE"]
        for label, x in zip(target.nodes, target.points, strict=True):
            lines.append(f"{label:>10}" + "".join(f"{c:>20.9g}" for c in x))
        lines += ["/SH3N/1"]
        for label, corners in zip(target.elements, target.nodes[target.corners], strict=True):
            lines.append(f"{label:>10}" + "".join(f"{c:>10}" for c in corners[:3]))
    for number, (name, angle) in enumerate(angles.items(), 1):
        lines += [f"/DRAPE/{number}", f"{name} plies of {fibres.name}"]
        for row in np.flatnonzero(kept):
            kind = "SH3N" if target.triangular[row] else "SHELL"
            lines.append(
                f"{kind:<10}{target.elements[row]:>10}{thinning[row]:>20.6f}{angle[row]:>20.4f}"
            )
    write(folder / "drape_0000.rad", _ascii(lines))
    return notices


def optistruct(fibres: Fibres, folder: Path, reference: FloatArray) -> tuple[str, ...]:
    """Write drape.fem, with the formed mesh as GRID and CTRIA3; notices."""
    thinning, angles, kept, notices = _table(fibres, reference)
    target = fibres.target
    lines = _told(fibres, "$", reference)
    if fibres.own:
        for label, x in zip(target.nodes, target.points, strict=True):
            lines.append(f"{'GRID*':<8}{label:>16}{'':>16}{x[0]:>16.8E}{x[1]:>16.8E}")
            lines.append(f"{'*':<8}{x[2]:>16.8E}")
        for label, corners in zip(target.elements, target.nodes[target.corners], strict=True):
            fields = [label, 1, *corners[:3]]
            lines.append(f"{'CTRIA3':<8}" + "".join(f"{v:>8}" for v in fields))
    for number, (name, angle) in enumerate(angles.items(), 1):
        lines += [f"$ {name} plies", f"{'DRAPE':<8}{number:>8}"]
        for row in np.flatnonzero(kept):
            label = target.elements[row]
            lines.append(f"{'+':<8}{'ELEM':<8}{label:>8}{thinning[row]:>8.5f}{angle[row]:>8.2f}")
    write(folder / "drape.fem", _ascii(lines))
    return notices


def _table(
    fibres: Fibres, reference: FloatArray
) -> tuple[FloatArray, dict[str, FloatArray], np.ndarray, tuple[str, ...]]:
    """Thinning (m,), angles (m,) of warp and weft, which rows to write, and notices."""
    n = fibres.target.normals
    projected = reference - (n @ reference)[:, None] * n
    steep = np.linalg.norm(projected, axis=1) < FLAT
    notices = [NOT_RUN]
    if (lost := steep & fibres.known).any():
        notices.append(
            f"{lost.sum()} elements stand across the reference direction and have no angle to it; "
            "they are left out of the table: choose another reference"
        )
    angles = {name: fibres.angle(name, projected) for name in ("warp", "weft")}
    notices.append(
        "the angles are from the direction ({:g}, {:g}, {:g}) projected into the element; the "
        "thinning is the thickness over that of the flat fabric".format(*reference)
    )
    notices.append(NO_WEIGHT)
    return fibres.thickness_ratio, angles, fibres.known & ~steep, tuple(notices)


def _told(fibres: Fibres, mark: str, reference: FloatArray) -> list[str]:
    return [
        f"{mark} Formed part of {fibres.name}; 1 warp plies, 2 weft plies, nominal angle 0",
        f"{mark} Thinning t/t0; angle in degrees from ({', '.join(f'{c:g}' for c in reference)}) "
        "projected into the element",
        *(f"{mark} {notice}" for notice in fibres.notices),
    ]


def _ascii(lines: list[str]) -> list[str]:
    return [line.replace("°", " deg").encode("ascii", "replace").decode() for line in lines]
