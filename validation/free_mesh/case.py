"""Off-axis tension on meshes that do not follow the fibres, compared with theory."""

from dataclasses import replace

import numpy as np

import quasiform as qf
from quasiform.theory import OffAxisTension

# theory has no in-plane bending
LAW = replace(qf.Fabric.preset("locking"), in_plane_bending=0.0)
TESTS = (  # angle, cell edges (2000 and 4000 triangles), displacements
    (45, (10.4,), (5.0, 10.0, 20.0, 30.0, 40.0, 45.0), 5.0),
    (30, (10.4, 7.3), (2.0, 5.0, 10.0, 12.0), 1.0),
)


def values() -> dict[str, float]:
    """Largest deviation of the force from theory over the displacements, and over five meshes."""
    found = {}
    for angle, sizes, displacements, increment in TESTS:
        for size in sizes:
            # slightly different sizes give different meshes
            worst, counts = [], []
            for factor in (1.0, 0.985, 0.97, 1.015, 1.03):
                scene = qf.off_axis_tension(
                    angle, LAW, displacement=displacements[-1], size=factor * size, mesh="free"
                )
                result = qf.solve(scene, increment=increment, estimate=False)
                u, force = result.history["displacement_mm"], result.history["force_N"]
                theory = OffAxisTension(320, 160, np.radians(angle))
                fabric = scene.sheet.fabric
                exact = [
                    theory.force(d, fabric.shear.stress, fabric.thickness) for d in displacements
                ]
                worst.append(np.abs(np.interp(displacements, u, force) / exact - 1).max())
                counts.append(len(scene.sheet.blank.triangles))
            case = f"{angle} deg, {round(counts[0], -3)} triangles"
            found[f"{case}: largest deviation"] = worst[0]
            found[f"{case}: largest deviation of five meshes"] = max(worst)
            found[f"{case}: smallest deviation of five meshes"] = min(worst)
    return found
