"""In-plane bending: what it adds to off-axis tension, and the bands of the box at 45 degrees."""

from dataclasses import replace

import numpy as np

import quasiform as qf
from quasiform.fabric import Fabric
from validation.run import Outcome

DEFAULT = Fabric()
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
    size = 10.0 if quick else 5.0
    for r in (DEFAULT.in_plane_bending, 1.0):
        box = qf.solve(qf.forming("box", 45, size=size, law=_fabric(r)), estimate=False)
        gamma, areas = np.abs(box.shear_angle), box.blank.areas
        share = 100 * areas @ (gamma > 30.0) / areas.sum()
        values[f"box 45°, size {size:g}: area beyond 30°, with {r:g}"] = share
        values[f"box 45°, size {size:g}: largest curvature, with {r:g}"] = box.wrinkles[
            "largest_curvature_1_per_mm"
        ]
    return Outcome(values=values)


def _fabric(r: float) -> Fabric:
    return replace(DEFAULT, in_plane_bending=r)
