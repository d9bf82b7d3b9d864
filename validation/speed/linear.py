"""Direct solvers and multigrid on the tangent at the end of a forming run.

    python -m validation.speed.linear [SIZE ...]

Processor time of a factorisation (with known pattern) and one solution by PARDISO and SuperLU;
and of conjugate gradients to 1e-8 with smoothed aggregation (PyAMG), with the rigid motions as
near-nullspace, or these and the motions of the fibres along themselves.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import pyamg
from rich.console import Console
from rich.table import Table
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import cg

import quasiform as qf
from quasiform.solve.equilibrium import Equilibrium

FloatArray = np.ndarray
TRAVEL = 40.0  # mm of the hemisphere, whole sheet


def main(sizes: list[float]) -> None:
    """Print a table with one row per solver."""
    table = Table("triangles", "unknowns", "solver", "factor or set-up, s", "solution, s")
    table.add_column("iterations")
    for size in sizes:
        result = qf.refine(qf.forming("hemisphere", size=size, travel=TRAVEL, symmetry="none"))
        for row in rows(result):
            table.add_row(*row)
    Console().print(table)


def rows(result: qf.Result) -> list[tuple[str, ...]]:
    """Rows of the table for the convex tangent at the end of a result."""
    scene, x = result.model, result.states[-1].x
    known = f"{len(scene.sheet.blank.triangles)}", f"{(~scene.fixed).sum()}"
    b = np.random.default_rng(0).normal(size=(~scene.fixed).sum())
    found = []
    for name in ("pardiso", "superlu"):
        try:
            equilibrium = Equilibrium(scene, name)
        except qf.InputError:  # not installed
            continue
        equilibrium.travel = scene.travel
        equilibrium.refresh(x)
        values, _ = equilibrium.potential.hessian(x, equilibrium.memory, convex=True)
        solver = equilibrium.tangent.solver
        solver.factor(values)
        factor, _ = timed(lambda s=solver, v=values: s.factor(v))
        solution, _ = timed(lambda s=solver: s.solve(b))
        found.append((*known, name, f"{factor:.2f}", f"{solution:.3f}", ""))
    p = equilibrium.potential.pattern
    upper = csr_array((values, p.indices, p.indptr), shape=p.shape)
    A = csr_array(upper + upper.T - diags_array(upper.diagonal()))
    rigid = rigid_motions(scene, x)
    for name, B in (("rigid", rigid), ("rigid and slides", np.hstack([rigid, slides(scene, x)]))):
        setup, levels = timed(lambda B=B: pyamg.smoothed_aggregation_solver(A, B=B))
        steps: list[int] = []
        solution, (_, failed) = timed(
            lambda m=levels, steps=steps: cg(
                A, b, rtol=1e-8, maxiter=5000, M=m.aspreconditioner(), callback=steps.append
            )
        )
        count = f"{len(steps)}{' (not converged)' * bool(failed)}"
        found.append((*known, f"PyAMG, {name}", f"{setup:.2f}", f"{solution:.2f}", count))
    return found


def rigid_motions(scene: qf.Model, x: FloatArray) -> FloatArray:
    """(n_free, 6) translations and rotations of the sheet."""
    sheet, motions = scene.sheet, np.zeros((len(x), 6))
    place = sheet.positions(x)
    for axis, unit in enumerate(np.eye(3)):
        motions[sheet.dofs, axis] = unit
        motions[sheet.dofs, 3 + axis] = np.cross(unit, place)
    return motions[~scene.fixed]


def slides(scene: qf.Model, x: FloatArray) -> FloatArray:
    """(n_free, 6) motions of the fibres along themselves: powers of the position across them."""
    blank = scene.sheet.blank
    triangles, n = blank.triangles, len(blank.nodes)
    motions = []
    for family, fibre in enumerate(np.moveaxis(scene.membrane.fibres(x), 1, 0)):
        along = np.zeros((n, 3))
        np.add.at(along, triangles, fibre[:, None])
        along /= np.linalg.norm(along, axis=1)[:, None]
        across = blank.nodes @ (blank.weft, blank.warp)[family]
        for power in (1, 2, 3):
            motion = np.zeros(len(x))
            motion[scene.sheet.dofs] = along * ((across / across.max()) ** power)[:, None]
            motions.append(motion[~scene.fixed])
    return np.stack(motions, axis=1)


def timed(work) -> tuple[float, object]:
    """Processor time of a call, s, and what it returned."""
    clock = time.process_time()
    value = work()
    return time.process_time() - clock, value


if __name__ == "__main__":
    main([float(size) for size in sys.argv[1:]] or [5.0, 2.5])
