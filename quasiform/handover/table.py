"""A CSV table and a VTU file of formed fibres by element.

The angles of the table run from the side between an element's first two nodes to the fibre, about
the element's normal, as THETA of Nastran's CTRIA3 and CQUAD4 does.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..tables import write_rows
from .fibres import AXES, Fibres
from .keywords import NOTICES


def table(fibres: Fibres, folder: Path) -> tuple[str, ...]:
    """Write fibres.csv, a row an element that is known; notices."""
    target = fibres.target
    side = target.points[target.corners[:, 1]] - target.points[target.corners[:, 0]]
    values = {"thickness_mm": fibres.thickness}
    values |= {f"theta_{axis}_deg": fibres.angle(axis, side) for axis in AXES}
    values |= {"thickness_ratio": fibres.thickness_ratio}
    values |= {"areal_weight_g_per_m2": fibres.areal_weight, "shear_angle_deg": fibres.shear_angle}
    vectors = {f"{c}_mm": column for c, column in zip("xyz", target.centroids.T, strict=True)}
    for axis in AXES:
        vectors |= dict(zip([f"{axis}_{c}" for c in "xyz"], getattr(fibres, axis).T, strict=True))
    rows = [["element", *values, *(f"n{k}" for k in (1, 2, 3, 4)), *vectors]]
    for row in np.flatnonzero(fibres.known):
        cells = [target.elements[row], *(f"{column[row]:.7g}" for column in values.values())]
        cells += ["" if c < 0 else target.nodes[c] for c in target.corners[row]]
        rows.append([*cells, *(f"{column[row]:.9g}" for column in vectors.values())])
    write_rows(folder / f"{fibres.prefix}fibres.csv", rows)
    return (NOTICES["theta"],)


def lookup(fibres: Fibres, folder: Path) -> tuple[str, ...]:
    """Write lookup.csv, the columns of a look-up table of PyACP, a row an element; notices.

    About the sheet's upper side the weft is 90° - γ from the warp, the transverse direction 90°.
    """
    known = fibres.known
    values = [fibres.target.centroids, fibres.warp, fibres.thickness, -fibres.shear_angle]
    heading = "x_mm,y_mm,z_mm,warp_x,warp_y,warp_z,thickness_mm,draping_angle_2_deg"
    look = {"fmt": "%.9g", "delimiter": ",", "newline": "\r\n", "comments": ""}
    path = folder / f"{fibres.prefix}lookup.csv"
    np.savetxt(path, np.column_stack(values)[known], header=heading, **look)
    return (NOTICES["pyacp"],)


def grid(fibres: Fibres, folder: Path) -> tuple[str, ...]:
    """Write fibres.vtu with all fields by cell; nan in elements that are not known."""
    import meshio

    target = fibres.target
    names = (*AXES, "thickness", "thickness_ratio", "areal_weight", "shear_angle")
    fields = {name: getattr(fibres, name) for name in names} | {"element": target.elements}
    kinds = ("triangle", 3, target.triangular), ("quad", 4, ~target.triangular)
    blocks = [(kind, corners, rows) for kind, corners, rows in kinds if rows.any()]
    cells = [(kind, target.corners[rows, :corners]) for kind, corners, rows in blocks]
    by_cell = {name: [v[rows] for *_, rows in blocks] for name, v in fields.items()}
    mesh = meshio.Mesh(target.points, cells, {"node": target.nodes}, by_cell)
    mesh.write(folder / f"{fibres.prefix}fibres.vtu")
    return ()
