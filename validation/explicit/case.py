"""An explicit time integration of a forming scene compared with the implicit result."""

from pathlib import Path
from tempfile import TemporaryDirectory

import quasiform as qf
from quasiform.comparison import compare
from validation.explicit.integration import Motion, integrate

MOTION = Motion()


def values() -> dict[str, float]:
    """Differences at the end of the travel, energies and times; hemisphere, quarter, size 10."""
    result = qf.solve(qf.forming("hemisphere", size=10), estimate=False)
    explicit = integrate(qf.forming("hemisphere", size=10), MOTION)
    with TemporaryDirectory() as folder:
        explicit.save(Path(folder))
        found = compare(result, folder, standing="own")
    energies = "kinetic by internal energy of the reference, "
    return {
        "shear angle, root mean square": found["difference of |γ|, root mean square"].difference,
        "shear angle, 95th percentile": found["difference of |γ|, 95th percentile"].difference,
        "shear angle, largest": found["difference of |γ|, largest"].difference,
        "mean shear angle": found["mean of |γ|"].difference,
        "outline, mean": found["distance of the outlines, mean"].difference,
        "outline, largest": found["distance of the outlines, largest"].difference,
        "force at the end": found["force at the end, relative"].difference,
        "force along the travel": found[
            "force along the travel, root mean square of the largest"
        ].difference,
        "kinetic by internal energy, at the end": found[energies + "at the end"].reference,
        "kinetic by internal energy, at most": found[energies + "at most"].reference,
        "time of the explicit run": explicit.wall_s,
        "processor time of the explicit run": explicit.processor_s,
        "time by that of the implicit run": explicit.wall_s / result.wall_s,
    }
