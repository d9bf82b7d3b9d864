"""Hemisphere: every increment reaches the end and finds the same shear; the frame does not matter.

The slowest case of the suite: the whole sheet with its fibres at 45 degrees forms shear bands.
"""

from dataclasses import replace

import numpy as np
import shapely

import quasiform as qf
from quasiform.result.measures import percentile
from quasiform.scenes import scene_file
from quasiform.scenes.scene_file import Region, SceneFile


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
            found[f"least travel, {case}"] = min(run.states[-1].travel for run in runs)
            found[f"spread of p99, {case}"] = max(p99) - min(p99)
            found[f"largest residual, {case}"] = max(run.residual for run in runs)
            found[f"negative pivots, {case}"] = max(run.negative_pivots for run in runs)
            found[f"energy balance to 5 mm, {case}"] = max(r.energy_balance for r in runs[:2])
            found[f"p99, {case}"] = p99[1]
            found[f"linear solves at 5 mm, {case}"] = runs[1].linear_solves

    # the three go different ways to the same state: solved far below the bands
    whole, turned, quarter = (
        qf.solve(
            qf.forming(_turned(turn), size=10, symmetry=symmetry),
            estimate=False,
            tolerance=1e-8,
        )
        for symmetry, turn in (("none", 0.0), ("none", 30.0), ("auto", 0.0))
    )
    found["turned by 30 deg: force"] = abs(turned.force / whole.force - 1)
    found["turned by 30 deg: shear"] = np.abs(turned.shear_angle - whole.shear_angle).max()
    found["quarter: force"] = abs(quarter.force / whole.force - 1)
    return found


def _turned(angle: float) -> SceneFile:
    """The scene with blank and fibres turned by an angle (degrees) about its round tools."""
    file = scene_file.load("hemisphere")
    outline = shapely.affinity.rotate(file.outline, angle, origin=(0, 0))
    return replace(file, blank=Region.of(outline), orientation=angle)
