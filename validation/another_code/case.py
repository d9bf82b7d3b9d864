"""The open-die hemisphere compared with CalculiX's result, field by field."""

from pathlib import Path

import quasiform as qf
from quasiform.comparison import compare
from validation.peers.calculix_hemisphere import SIZES, scene

FOLDER = Path(__file__).parent


def values() -> dict[str, float]:
    """Differences on the same triangles, at the end of the travel."""
    result = qf.solve(scene(SIZES[0]), estimate=False)
    found = compare(
        result, FOLDER / "calculix.vtu", history=FOLDER / "calculix.csv", standing="peer"
    )
    return {
        "shear angle, root mean square": found["difference of |γ|, root mean square"].difference,
        "shear angle, 95th percentile": found["difference of |γ|, 95th percentile"].difference,
        "shear angle, largest": found["difference of |γ|, largest"].difference,
        "mean shear angle": found["mean of |γ|"].difference,
        "outline, mean": found["distance of the outlines, mean"].difference,
        "outline, largest": found["distance of the outlines, largest"].difference,
        "force": found["force at the end, relative"].difference,
    }
