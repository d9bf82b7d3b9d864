"""A CSV table and a VTU file of formed fibres by element.

The angles of the table run from the side between an element's first two nodes to the fibre, about
the element's normal, as THETA of Nastran's CTRIA3 and CQUAD4 does.
"""

from __future__ import annotations

import csv
from pathlib import Path

import meshio
import numpy as np

from .fibres import AXES, Fibres

HEADINGS = (
    *("element", "thickness_mm", "theta_warp_deg", "theta_weft_deg", "theta_bisector_deg"),
    *("thickness_ratio", "areal_weight_g_per_m2", "shear_angle_deg", "n1", "n2", "n3", "n4"),
    *("x_mm", "y_mm", "z_mm"),
    *(f"{axis}_{c}" for axis in AXES for c in "xyz"),
)
GENERAL = (
    "theta runs from the side between an element's first two nodes (Nastran's THETA); without "
    "an MCID",
)


def table(fibres: Fibres, folder: Path) -> tuple[str, ...]:
    """Write fibres.csv, a row an element that is known; notices."""
    target, known = fibres.target, np.flatnonzero(fibres.known)
    side = target.points[target.corners[:, 1]] - target.points[target.corners[:, 0]]
    numbers = [fibres.thickness, *(fibres.angle(axis, side) for axis in AXES)]
    numbers += [fibres.thickness_ratio, fibres.areal_weight, fibres.shear_angle]
    vectors = np.hstack([target.centroids, *(getattr(fibres, axis) for axis in AXES)])
    with (folder / "fibres.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(HEADINGS)
        for row in known:
            corners = ["" if c < 0 else target.nodes[c] for c in target.corners[row]]
            values = [f"{column[row]:.7g}" for column in numbers]
            places = [f"{v:.9g}" for v in vectors[row]]
            writer.writerow([target.elements[row], *values, *corners, *places])
    return GENERAL


def mesh(fibres: Fibres, folder: Path) -> tuple[str, ...]:
    """Write fibres.vtu with all fields by cell; nan in elements that are not known."""
    target = fibres.target
    fields = {axis: getattr(fibres, axis) for axis in AXES} | {
        "thickness": fibres.thickness,
        "thickness_ratio": fibres.thickness_ratio,
        "areal_weight": fibres.areal_weight,
        "shear_angle": fibres.shear_angle,
        "element": target.elements,
    }
    chosen = {"triangle": target.triangular, "quad": ~target.triangular}
    cells = {
        kind: target.corners[rows][:, : 3 + (kind == "quad")]
        for kind, rows in chosen.items()
        if rows.any()
    }
    by_cell = {
        name: [np.ascontiguousarray(values[chosen[kind]]) for kind in cells]
        for name, values in fields.items()
    }
    meshio.Mesh(target.points, list(cells.items()), {"node": target.nodes}, by_cell).write(
        folder / "fibres.vtu"
    )
    return ()
