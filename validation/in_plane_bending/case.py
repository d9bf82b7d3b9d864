"""In-plane bending: what it adds to off-axis tension, and the bands of the box at 45 degrees."""

from dataclasses import replace

import numpy as np

import quasiform as qf
from quasiform.fabric import Fabric
from validation.run import Outcome

DEFAULT = Fabric()
OPENING = 65.0  # mm: half of the opening and its fillet
TESTS = ((30, 5.0), (30, 10.0), (30, 15.0), (45, 50.0))  # degrees, mm


def run(quick: bool) -> Outcome:
    """Force of both tests relative to that without, and the sheared area of the box."""
    values = {}
    for angle, displacement in TESTS:
        test = {"angle": angle, "displacement": displacement, "size": 5.0}
        without, own, alike = (
            qf.solve(qf.off_axis_tension(law=_fabric(r), **test), estimate=False).force
            for r in (0.0, DEFAULT.in_plane_bending, 1.0)
        )
        place = f"{angle}°, {displacement:g} mm"
        values[f"{place}: force with the default"] = 100 * (own / without - 1)
        values[f"{place}: force with 1"] = 100 * (alike / without - 1)
    for r in () if quick else (DEFAULT.in_plane_bending, 1.0):
        box = qf.solve(qf.forming("box", 45, size=5.0, law=_fabric(r)), estimate=False)
        gamma, areas, off = np.abs(box.shear_angle), box.blank.areas, np.abs(box.blank.centroids)
        near = np.abs(off[:, 0] - off[:, 1]) < 0.25 * (off[:, 0] + off[:, 1])  # the diagonals
        flange = near & (off.max(1) > OPENING)
        share = 100 * areas[flange] @ (gamma[flange] > 45.0) / areas[flange].sum()
        values[f"box 45°: flange on the diagonals beyond 45°, with {r:g}"] = share
        values[f"box 45°: largest angle there, with {r:g}"] = gamma[flange].max()
        values[f"box 45°: largest curvature, with {r:g}"] = box.wrinkles[
            "largest_curvature_1_per_mm"
        ]
    return Outcome(values=values)


def _fabric(r: float) -> Fabric:
    return replace(DEFAULT, in_plane_bending=r)
