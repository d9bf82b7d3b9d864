"""Hemisphere: each increment reaches the end with the same shear; a rotation has no influence.

The slowest case of the suite: the whole sheet with its fibres at 45 degrees forms shear bands.
"""

from dataclasses import replace

import numpy as np
import shapely

import quasiform as qf
from quasiform.result.measures import percentile
from quasiform.scenes import scene_file
from quasiform.scenes.scene_file import Region


def values() -> dict[str, float]:
    """Travel reached and spread of the 99th percentile over increments of 2, 5 and 10 mm."""
    found = {}
    for orientation in (0, 45):
        for size in (10, 5):
            case = f"{orientation} deg, size {size}"
            runs = [
                qf.solve(
                    qf.forming("hemisphere", orientation, size=size),
                    increment=increment,
                    estimate=False,
                )
                for increment in (2.0, 5.0, 10.0)
            ]
            p99 = [percentile(np.abs(r.shear_angle), r.blank.areas, 0.99) for r in runs]
            found[f"smallest travel reached, {case}"] = min(run.states[-1].travel for run in runs)
            found[f"spread of the 99th percentile, {case}"] = max(p99) - min(p99)
            found[f"largest residual, {case}"] = max(run.residual for run in runs)
            found[f"negative pivots, {case}"] = max(run.negative_pivots for run in runs)
            found[f"energy balance with increments to 5 mm, {case}"] = max(
                r.energy_balance for r in runs[:2]
            )
            found[f"99th percentile, {case}"] = p99[1]
            found[f"linear solves with increments of 5 mm, {case}"] = runs[1].linear_solves

    # three ways to the same state, with residuals far below the tolerances
    file = scene_file.load("hemisphere")
    outline = shapely.affinity.rotate(file.outline, 30.0, origin=(0.0, 0.0))
    whole, turned, quarter = (
        qf.solve(
            qf.forming(scene, orientation, size=10, symmetry=symmetry),
            estimate=False,
            tolerance=1e-8,
        )
        for scene, orientation, symmetry in (
            (file, 0.0, "none"),
            (replace(file, blank=Region.of(outline)), 30.0, "none"),
            (file, 0.0, "auto"),
        )
    )
    found["rotated by 30 deg: relative difference of the force"] = abs(
        turned.force / whole.force - 1
    )
    found["rotated by 30 deg: largest difference of the shear angle"] = np.abs(
        turned.shear_angle - whole.shear_angle
    ).max()
    found["quarter: relative difference of the force"] = abs(quarter.force / whole.force - 1)
    return found
