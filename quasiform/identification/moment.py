"""Nonlinear bending: moment per width over curvature, as a pure-bending tester measures it.

Fibres slide in a bent fabric, which softens. Few points are taken as they are; a record of many
rows becomes the smooth increasing curve that predicts them best, as the shear stress
(`energy_method`, with one zone whose share in the moment is 1).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..checks import InputError, naming
from ..fabric import MomentCurve
from ..tables import name_unit, read_numbers
from .energy_method import Forces, energy_method
from .loading import noise

FEW = 12  # points that are taken as they are
CURVATURE = {"1/mm": 1.0, "1/m": 1e-3, "1/cm": 0.1}
MOMENT = {"N": 1.0, "N mm/mm": 1.0, "Nmm/mm": 1.0, "N m/m": 1.0, "Nm/m": 1.0, "mN": 1e-3}


def read_moments(path: Path) -> MomentCurve:
    """Moment over curvature from a CSV file of these two columns, with their units.

    Moments are per width, N (or N mm/mm, N m/m). InputError names the file and its defect.
    """
    headings, units, numbers = read_numbers(path, most=2)
    with naming(path):
        if numbers.shape[1] != 2 or np.isnan(numbers).any():
            raise InputError("expected two columns, curvature and moment")
        factors = []
        for k, (name, known) in enumerate((("curvature", CURVATURE), ("moment", MOMENT))):
            unit = units[k] or (name_unit(headings[k])[1] if len(headings) > k else None)
            if unit not in known:
                words = f"unit of the {name} {unit or 'missing'}"
                raise InputError(f"{words}: expected one of {', '.join(known)} in its heading")
            factors.append(known[unit])
        curvature, moment = (numbers * factors)[: np.argmax(numbers[:, 0]) + 1].T
        return fitted(curvature, moment)


def fitted(curvature: np.ndarray, moment: np.ndarray) -> MomentCurve:
    """The curve through few points (n,) in 1/mm and N, or the smooth one through many."""
    kept = (curvature > 0) & (moment > 0)
    if not kept.any():
        raise InputError("no positive moment at a positive curvature: is a sign reversed?")
    curvature, moment = curvature[kept], moment[kept]
    if len(curvature) <= FEW:
        return MomentCurve(tuple(curvature.tolist()), tuple(moment.tolist()))
    if (np.diff(curvature) <= 0).any():
        raise InputError("the curvature must increase: one loading, without unloading")
    # the coordinate of the energy method is the sine of an angle
    unit = 1.1 * curvature[-1]
    angles = np.arcsin(curvature / unit)
    forces = Forces(moment, noise(curvature, moment), np.ones((1, len(moment))), angles[None])
    law = energy_method([forces]).law()
    at = np.unique(np.r_[0.0, np.linspace(0.0, 1.0, FEW + 1) ** 1.5 * law.I6[-1]])
    S = law.stress(at)
    return MomentCurve(tuple((unit * at).tolist()), tuple(S.tolist()))
