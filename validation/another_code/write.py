"""Write `calculix.vtu` and `calculix.csv`: the open-die hemisphere by CalculiX, as in `peers`.

    python -m validation.another_code.write

Needs `ccx`; takes 15 s on a quiet machine. The sheet is mirrored (z to -z), as the tools of
quasiform move downwards.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import meshio
import numpy as np

import quasiform as qf
from quasiform.result.sheet import FormedSheet
from validation.peers import calculix_hemisphere as peer

FOLDER = Path(__file__).parent


def main() -> None:
    if not shutil.which("ccx"):
        raise SystemExit(peer.missing())
    blank = qf.rectangle(peer.SIDE, peer.SIDE, peer.SIZES[0], through=((0.0, 0.0),))
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "sheet.npz"
        np.savez(mesh, nodes=blank.nodes, triangles=blank.triangles)
        first, largest = peer.CONTROLS["to 10 mm"]
        answer = peer.calculix(str(mesh), first, largest, keep=folder)
        if answer.failed:
            raise SystemExit(answer.failed)
        u = peer.displacements((Path(folder) / "sheet.frd").read_text(), len(blank.nodes))
    write(blank.nodes, blank.triangles, u * [1.0, 1.0, -1.0], answer.value)


def write(nodes: np.ndarray, triangles: np.ndarray, u: np.ndarray, force: float) -> None:
    """Write the formed mesh with displacements (mm) and shear angle (degrees); travel and force."""
    x = np.pad(nodes, ((0, 0), (0, 1))) + u
    meshio.Mesh(
        x.round(5),
        [("triangle", triangles)],
        point_data={"displacement": u.round(5)},
        cell_data={"shear_angle": [FormedSheet(x, triangles, nodes).sheared(np.eye(2)).round(4)]},
    ).write(FOLDER / "calculix.vtu")
    travel = peer.TRAVEL - peer.GAP + peer.THICKNESS / 2
    text = f"travel_mm,force_N\n{travel:.6f},{force:.6g}\n"
    (FOLDER / "calculix.csv").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
