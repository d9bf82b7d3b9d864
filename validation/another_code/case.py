"""The open-die hemisphere compared with CalculiX: limits of the force, and the field."""

from dataclasses import replace
from pathlib import Path

import quasiform as qf
from quasiform.comparison import compare
from validation.another_code.write import SIZES, forces
from validation.peers.calculix_hemisphere import LARGER, Press, scene

FOLDER = Path(__file__).parent
SHAPE = {  # rows on the formed sheet, and their names in the comparison
    "difference of the shear angle, root mean square": "difference of |γ|, root mean square",
    "difference of the shear angle, 95th percentile": "difference of |γ|, 95th percentile",
    "difference of the shear angle, largest": "difference of |γ|, largest",
    "difference of the mean shear angle": "mean of |γ|",
    "distance of the outlines, mean": "distance of the outlines, mean",
    "distance of the outlines, largest": "distance of the outlines, largest",
}
ORDER = {"quasiform": 1, "CalculiX": 2}  # of the error of the force in the size, see README


def limit(middle: float, fine: float, order: int) -> float:
    """Richardson's limit of two values, the second at half the size."""
    return fine + (fine - middle) / (2**order - 1)


def values() -> dict[str, float]:
    """Forces of quasiform and their limit, differences from CalculiX, and friction's part."""
    theirs, found = forces(), {}
    for name, press in {"R 40": Press(), "R 50": LARGER}.items():
        sizes = [size for other, size in theirs if other == press]
        runs = {size: qf.refine(scene(size, press)) for size in sizes}
        found |= {f"{name}: force at {size:g} mm": run.force for size, run in runs.items()}
        middle, fine = sizes[-2:]
        mine = limit(runs[middle].force, runs[fine].force, ORDER["quasiform"])
        other = limit(theirs[press, middle], theirs[press, fine], ORDER["CalculiX"])
        found[f"{name}: limit of the force"] = mine
        found[f"{name}: limit of the force, relative difference"] = 100 * (mine / other - 1)
        if press == Press():
            at = compare(runs[SIZES[-1]], FOLDER / "calculix.vtu", mirror=("x", "y"))
            found |= {row: at[quantity].difference for row, quantity in SHAPE.items()}
    rubbed = [replace(Press(), friction=mu) for mu in (0.0, 0.157, 0.5)]
    both = {
        "quasiform": [qf.solve(scene(SIZES[0], one), estimate=False).force for one in rubbed],
        "CalculiX": [theirs[one, SIZES[0]] for one in rubbed],
    }
    for code, force in both.items():
        change = 100 * (max(force) / min(force) - 1)
        found[f"R 40: change of the force by friction, {code}"] = change
    return found
