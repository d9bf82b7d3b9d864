"""A part of 600 x 600 mm between matched tools from one STL file: the whole sheet, two sizes."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import quasiform as qf

SIZES = (10.0, 5.0)  # mm
DEPTHS = (45.0, 24.5)  # mm, of two hollows
MIDDLES = ((-70.0, -20.0), (110.0, 60.0))
WIDTHS = ((80.0, 65.0), (60.0, 70.0))  # standard deviations along x and y, mm
PULLS = {"+x": 60.0, "-x": 60.0, "+y": 30.0, "-y": 30.0}  # N
SCENE = """
name = "large-part"
travel = 20.0
[blank]
shape = "rectangle"
length = 600.0
width = 600.0
[tools.die]
file = "part.stl"
[tools.punch]
file = "part.stl"
flip = true
offset = 1.2
"""
GRIPPER = """
[[grippers]]
side = "{side}"
tension = {tension}
stiffness = 0.05
"""


def values() -> dict[str, float]:
    """Whether both sizes reach the end, their differences, and memory over unknowns."""
    with TemporaryDirectory() as folder:
        scene = _written(Path(folder))
        runs = [_in_its_own_process(scene, size) for size in SIZES]
    coarse, fine = runs
    found = {}
    for size, run in zip(SIZES, runs, strict=True):
        found[f"size {size:g} mm: reached"] = run["reached"]
        found[f"size {size:g} mm: energy balance"] = run["balance"]
        found[f"size {size:g} mm: factorisations"] = run["solves"]
    found["memory over unknowns, size 5 over size 10"] = (
        fine["memory"] / coarse["memory"] / (fine["dofs"] / coarse["dofs"])
    )
    found["force, size 10 over size 5"] = coarse["force"] / fine["force"]
    found["shear angle (p99), size 10 less size 5"] = coarse["p99"] - fine["p99"]
    return found


def _written(folder: Path) -> Path:
    """Write the scene and its surface, 26,450 facets; the scene's path."""
    import trimesh

    side = np.linspace(-320.0, 320.0, 116)
    x, y = np.meshgrid(side, side, indexing="ij")
    z = -sum(
        depth * np.exp(-0.5 * (((x - a) / w) ** 2 + ((y - b) / v) ** 2))
        for depth, (a, b), (w, v) in zip(DEPTHS, MIDDLES, WIDTHS, strict=True)
    )
    at = np.arange(z.size).reshape(z.shape)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    faces = np.vstack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    trimesh.Trimesh(points, faces, process=False).export(folder / "part.stl")
    pulls = (
        GRIPPER.format(side=s, tension=60.0 if "x" in s else 30.0) for s in "+x -x +y -y".split()
    )
    (folder / "scene.toml").write_text(SCENE + "".join(pulls), encoding="utf-8")
    return folder / "scene.toml"


def _in_its_own_process(scene: Path, size: float) -> dict[str, float]:
    command = [sys.executable, "-m", "validation.large_part.case", str(scene), str(size)]
    answer = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return json.loads(answer.stdout.splitlines()[-1])


def _one(scene: str, size: float) -> dict[str, float]:
    before = _peak_memory()
    model = qf.forming(scene, size=size)
    result = qf.solve(model, estimate=False)
    return {
        "reached": result.states[-1].travel,
        "balance": result.energy_balance,
        "solves": result.linear_solves,
        "dofs": int((~model.fixed).sum()),
        "memory": _peak_memory() - before,
        "force": result.force,
        "p99": result.quantities["shear_angle_deg"],
    }


def _peak_memory() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


if __name__ == "__main__":
    print(json.dumps(_one(sys.argv[1], float(sys.argv[2]))))
