"""Dynamic relaxation alone finds the same state as Newton's method."""

from collections.abc import Callable

import numpy as np

import quasiform as qf


def values() -> dict[str, float]:
    """Differences in force and shear angle: off-axis tension, one increment of the hemisphere."""
    return _differ(
        "tension u=30", lambda: qf.off_axis_tension(45, displacement=30), increment=30.0
    ) | _differ("hemisphere, 5 mm", lambda: qf.forming("hemisphere", size=10, travel=5), 5.0)


def _differ(name: str, scene: Callable[[], qf.Model], increment: float) -> dict[str, float]:
    newton, relaxed = (
        qf.solve(scene(), increment=increment, method=method, estimate=False)
        for method in ("newton", "relaxation")
    )
    return {
        f"difference of the force, {name}": 100 * abs(relaxed.force / newton.force - 1),
        f"difference of the shear angle, {name}": np.abs(
            relaxed.shear_angle - newton.shear_angle
        ).max(),
    }
