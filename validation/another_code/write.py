"""Write `calculix.csv` and `calculix.vtu`: the open-die hemisphere by CalculiX, as in `peers`.

    python -m validation.another_code.write

Needs `ccx`; takes a quarter of an hour on two processors. Runs that are in `calculix.csv` already
are not repeated. The sheet is mirrored (z to -z), as the tools of quasiform move downwards.
"""

from __future__ import annotations

import csv
import shutil
import tempfile
from dataclasses import asdict, replace
from pathlib import Path

import meshio
import numpy as np

from quasiform.result.sheet import FormedSheet
from validation.peers import calculix_hemisphere as peer

FOLDER = Path(__file__).parent
FORCES = FOLDER / "calculix.csv"
SIZES = (10.0, 5.0, 2.5)  # mm
FINEST = 1.25  # mm, at R 40 alone: six minutes
RUNS = [
    *((peer.Press(), size) for size in (*SIZES, FINEST)),
    *((replace(peer.Press(), friction=mu), 10.0) for mu in (0.0, 0.157, 0.5)),
    *((peer.LARGER, size) for size in SIZES),
    *((replace(peer.LARGER, transverse=1.0), size) for size in SIZES),
]


def main() -> None:
    if not shutil.which("ccx"):
        raise SystemExit(peer.missing())
    known = forces() if FORCES.exists() else {}
    for press, size in RUNS:
        if (press, size) in known:
            continue
        blank = peer.sheet(size)
        with tempfile.TemporaryDirectory() as folder:
            mesh = peer.written(blank, Path(folder))
            control = (0.05, 0.25) if size > FINEST else (0.1, 0.5)  # parts of the travel
            answer = peer.calculix(mesh, *control, press=asdict(press), keep=folder)
            if answer.failed:
                raise SystemExit(answer.failed)
            if (press, size) == (peer.Press(), SIZES[-1]):
                u = peer.displacements((Path(folder) / "sheet.frd").read_text(), len(blank.nodes))
                write(blank.nodes, blank.triangles, u * [1.0, 1.0, -1.0])
        row = asdict(press) | {"size": size, "force_N": round(answer.value, 4)}
        row |= {"largest_shear_deg": round(answer.angle, 3), "solves": answer.iterations}
        new = not FORCES.exists()
        with FORCES.open("a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(row), lineterminator="\n")
            if new:
                writer.writeheader()
            writer.writerow(row)


def forces() -> dict[tuple[peer.Press, float], float]:
    """Forces of the whole sheet by `Press` and size, N."""
    names = peer.Press.__dataclass_fields__
    with FORCES.open(encoding="utf-8") as file:
        return {
            (peer.Press(*(float(row[n]) for n in names)), float(row["size"])): float(row["force_N"])
            for row in csv.DictReader(file)
        }


def write(nodes: np.ndarray, triangles: np.ndarray, u: np.ndarray) -> None:
    """Write the formed mesh with its displacements (mm) and shear angle (degrees)."""
    x = np.pad(nodes, ((0, 0), (0, 1))) + u
    meshio.Mesh(
        x.round(5),
        [("triangle", triangles)],
        point_data={"displacement": u.round(5)},
        cell_data={"shear_angle": [FormedSheet(x, triangles, nodes).sheared(np.eye(2)).round(4)]},
    ).write(FOLDER / "calculix.vtu")


if __name__ == "__main__":
    main()
