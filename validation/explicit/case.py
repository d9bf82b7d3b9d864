"""An explicit time integration of a forming scene compared with the implicit result."""

from pathlib import Path
from tempfile import TemporaryDirectory

import quasiform as qf
from quasiform.comparison import compare
from validation.another_code.case import SHAPE
from validation.explicit.integration import Motion, integrate

MOTION = Motion()


def values() -> dict[str, float]:
    """Differences at the end of the travel, energies and times; hemisphere, quarter, size 10."""
    result = qf.solve(qf.forming("hemisphere", size=10), estimate=False)
    explicit = integrate(qf.forming("hemisphere", size=10), MOTION)
    with TemporaryDirectory() as folder:
        explicit.save(Path(folder))
        found = compare(result, folder, standing="own")
    rows = SHAPE | {
        "relative difference of the force at the end": "force at the end, relative",
        "relative difference of the force along the travel": (
            "force along the travel, root mean square of the largest"
        ),
    }
    energies = "kinetic by internal energy of the reference, "
    return {row: found[name].difference for row, name in rows.items()} | {
        "kinetic energy / internal energy, at the end": found[energies + "at the end"].reference,
        "kinetic energy / internal energy, at most": found[energies + "at most"].reference,
        "time of the explicit run": explicit.wall_s,
        "processor time of the explicit run": explicit.processor_s,
        "time / time of the implicit run": explicit.wall_s / result.wall_s,
    }
