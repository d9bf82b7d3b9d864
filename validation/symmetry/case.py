"""Quarter, half and whole sheet give the same result as long as the sheet is symmetric."""

import numpy as np

import quasiform as qf
from quasiform.result.measures import percentile


def values() -> dict[str, float]:
    """Differences to the whole sheet in p99 of the shear angle and in force."""
    found = {}
    for name, orientation, travel in (
        ("hemisphere", 0, 75),
        ("hemisphere", 45, 75),
        ("box", 0, 20),
        ("box", 45, 20),
    ):
        runs = {
            symmetry: qf.solve(
                qf.forming(name, orientation, size=10, travel=travel, symmetry=symmetry),
                estimate=False,
            )
            for symmetry in ("none", "half", "auto")
        }
        whole = runs["none"]
        case = f"{name} {orientation} deg"
        for symmetry, part in (("half", "half"), ("auto", "quarter")):
            run = runs[symmetry]
            found[f"{case}, {part}: difference of the 99th percentile"] = abs(
                _p99(run) - _p99(whole)
            )
            found[f"{case}, {part}: relative difference of the force"] = abs(
                run.force / whole.force - 1
            )
        found[f"{case}: saddle points left by the whole sheet"] = whole.rescues.get(
            "saddle left", 0
        )
    for part in ("half", "none"):
        run = qf.solve(qf.forming("tetrahedron", 0, size=10, symmetry=part), estimate=False)
        found[f"tetrahedron 0 deg, {'whole' if part == 'none' else part}: 99th percentile"] = _p99(
            run
        )
    found["tetrahedron 45 deg: mirror planes"] = len(
        qf.forming("tetrahedron", 45, size=20).sheet.blank.mirror
    )
    return found


def _p99(run: qf.Result) -> float:
    return percentile(np.abs(run.shear_angle), run.blank.areas, 0.99)
