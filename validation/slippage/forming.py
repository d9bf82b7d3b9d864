"""What slip changes in forming: the six configurations with and without the assumed slip of MD600.

    python -m validation.slippage.forming [hemisphere-45 ...]

writes a row of `forming.csv` after each run, of the configurations that are named or of all. A run
that takes more than LIMIT is stopped where it is.
"""

import csv
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import quasiform as qf
from validation.slippage.case import MD600

TABLE = Path(__file__).parent / "forming.csv"
SCENES = [f"{part}-{angle}" for part in ("hemisphere", "tetrahedron", "box") for angle in (0, 45)]
LIMIT = 1500.0  # s of processor time


def row(scene: str, slip: qf.Slip | None) -> dict[str, object]:
    """Figures of one run, with the law that the paper takes for forming."""
    part, angle = scene.split("-")
    fabric = replace(qf.Fabric.preset("locking"), slip=slip)
    model, start = qf.forming(part, float(angle), fabric), time.process_time()
    signal.signal(signal.SIGPROF, signal.default_int_handler)
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    result = qf.refine(model, estimate=False)
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    seconds, slid = time.process_time() - start, result.summary().get("slip", {})
    return {
        "scene": scene,
        "size_mm": f"{model.size:.2f}",
        "resistance_MPa": slip.resistance if slip else "",
        "travel_mm": f"{result.states[-1].travel:.1f}",
        "factorisations": result.linear_solves,
        "cpu_s": f"{seconds:.1f}",
        "force_N": f"{result.force:.2f}",
        "p99_deg": f"{result.quantities['shear_angle_deg']:.2f}",
        "largest_deg": f"{np.abs(result.shear_angle).max():.2f}",
        "slip_mm": f"{slid['largest_mm']:.2f}" if slid else "",
        "gap_share": f"{slid['gap_share']:.3f}" if slid else "",
        "balance_percent": f"{100 * result.energy_balance:.2f}",
        "certified": str(result.certified),
        "reason": result.reason,
    }


def main(scenes: list[str]) -> None:
    """Run each without and with slip; the hemisphere also with half and double the resistance."""
    runs = [(scene, slip) for scene in scenes for slip in (None, MD600)]
    changed = [replace(MD600, resistance=f * MD600.resistance) for f in (0.5, 2.0)]
    runs += [(scene, slip) for scene in scenes if "hemisphere" in scene for slip in changed]
    qf.solve(qf.forming("hemisphere", size=30.0), estimate=False)  # what is compiled is not timed
    for scene, slip in runs:
        found, new = row(scene, slip), not TABLE.exists()
        with TABLE.open("a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, found, lineterminator="\n")
            if new:
                writer.writeheader()
            writer.writerow(found)


if __name__ == "__main__":
    main(sys.argv[1:] or SCENES)
