"""The open-die hemisphere compared with CalculiX's result, field by field."""

from pathlib import Path

import quasiform as qf
from quasiform.comparison import compare
from validation.peers.calculix_hemisphere import SIZES, scene

FOLDER = Path(__file__).parent
SHAPE = {  # rows on the formed sheet, and their names in the comparison
    "difference of the shear angle, root mean square": "difference of |γ|, root mean square",
    "difference of the shear angle, 95th percentile": "difference of |γ|, 95th percentile",
    "difference of the shear angle, largest": "difference of |γ|, largest",
    "difference of the mean shear angle": "mean of |γ|",
    "distance of the outlines, mean": "distance of the outlines, mean",
    "distance of the outlines, largest": "distance of the outlines, largest",
}


def values() -> dict[str, float]:
    """Differences on the same triangles, at the end of the travel."""
    result = qf.solve(scene(SIZES[0]), estimate=False)
    found = compare(
        result, FOLDER / "calculix.vtu", history=FOLDER / "calculix.csv", standing="peer"
    )
    rows = SHAPE | {"relative difference of the force": "force at the end, relative"}
    return {row: found[name].difference for row, name in rows.items()}
