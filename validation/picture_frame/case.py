"""Picture frame: homogeneous shear, force by the power balance."""

import numpy as np

import quasiform as qf
from quasiform import theory


def values() -> dict[str, float]:
    """Largest deviation of the force from the closed form, and from uniform shear."""
    side = 100.0
    result = qf.solve(qf.picture_frame(side=side, shear=50.0), estimate=False)
    fabric = result.model.sheet.fabric
    off = []
    for state in result.states[1:]:
        gamma = np.pi / 2 - 2 * np.arccos((np.sqrt(2) * side + state.travel) / (2 * side))
        force = theory.picture_frame_force(gamma, side, fabric.shear.stress, fabric.thickness)
        off.append(100 * abs(state.force / force - 1))
    return {
        "largest deviation of the force": max(off),
        "shear angle at the end": result.shear_angle.mean(),
    }
