"""Newton's method on the summed potential, with the tangent that suits the state.

The exact tangent is used where it is positive definite; where it is not, see `tangent`. Every step
is a descent step of one potential, searched along its line (Armijo) and refused where it would turn
a triangle over. A whole step is followed by others of the same factor as long as the energy falls
[3]_: they take back what the step has stretched the stiff fibres, and cost a solution each.
Convergence is measured against the driving force.

Stiff fibres that turn make Newton's steps short: the stress that a straight step of the nodes puts
into them has little to do with that of the linearisation. Without contact the geometric stiffness
therefore takes the stress that the last step foresaw (the mixed iteration of [1]_), and the energy
may rise for a while, but not above its largest value over the last steps [2]_. With contact this
was found to gain nothing.

References
----------
.. [1] D. Magisano, L. Leonetti, G. Garcea, Int. J. Numer. Methods Eng. 109 (2017) 1237-1262.
.. [2] L. Grippo, F. Lampariello, S. Lucidi, SIAM J. Numer. Anal. 23 (1986) 707-716.
.. [3] J. F. Traub, Iterative Methods for the Solution of Equations (1964).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from ..unknowns import FloatArray
from .equilibrium import Equilibrium
from .linear import NotConvergedError

LEAST_SHARE = 0.1  # of a change of the normal forces that is taken over where plies meet
FURTHER = 2  # steps of one factor after a whole step
PASSES, PASSES_PLIES = 60, 150  # most, with fresh lagged values each
STEPS_PLIES = 5  # of Newton's method in one pass, where pairs of plies are lagged


def predict(equations: Equilibrium, x: FloatArray, travel: float) -> FloatArray:
    """Move the prescribed unknowns to `travel` and the others along the tangent."""
    motion, free = equations.motion_to(x, travel), equations.free
    load = equations.tangent.factor_definite(x, equations.memory, motion)
    moved = x + motion
    moved[free] -= equations.tangent.solve(equations.gradient(x)[free] + load)
    equations.travel = travel
    if not np.isfinite(moved).all() or equations.model.turned_over(x, moved):
        moved = x + motion
    equations.foreseen = _foresee(equations, x, moved)
    return moved


def minimise(
    equations: Equilibrium,
    x: FloatArray,
    tolerance: float = 0.0,
    max_iterations: int = 0,
    steps: int = 0,
) -> FloatArray:
    """Newton iterations with the lagged values as they are, to the tolerance or a looser one.

    Ends after so many `steps` if they are given. Raises NotConvergedError with the reason and the
    place of the largest residual.
    """
    free, tangent = equations.free, equations.tangent
    tolerance = tolerance or equations.tolerance
    max_iterations = max_iterations or equations.max_iterations
    tangent.restart()  # what was lagged, or the bed, may be another one
    stress, equations.foreseen = equations.foreseen, None
    energies = [equations.energy(x)]
    for i in range(max_iterations):
        g = equations.gradient(x)
        residual = equations.residual(g)
        if residual < tolerance or 0 < steps <= i:
            return x
        d = np.zeros_like(x)
        d[free] = tangent.step(x, equations.memory, g[free], stress)
        highest = energies[-1] if stress is None else max(energies)
        before = x
        x, energy = _line_search(equations, x, g, d, highest)
        if stress is not None:
            tangent.forget()  # no tangent of this state
        stress = _foresee(equations, before, x)
        if (stress is None or equations.turns) and np.array_equal(x, before + d):
            x, energy = _further(equations, x, energy, tolerance)
        energies = [*energies[-7:], energy]
        equations.check_slide(x)
    raise NotConvergedError(
        f"no equilibrium in {max_iterations} Newton iterations: residual {residual:.1e} of the "
        f"driving force against {tolerance:.0e}, largest {equations.worst(g)}"
    )


def _further(
    equations: Equilibrium, x: FloatArray, energy: float, tolerance: float
) -> tuple[FloatArray, float]:
    """Take further steps with the present factor while they lower the energy; x and its energy."""
    for _ in range(FURTHER):
        g = equations.gradient(x)
        if equations.residual(g) < tolerance:
            break
        further = x.copy()
        further[equations.free] -= equations.tangent.solve(g[equations.free])
        lower = equations.energy_at(x, further)
        if not lower < energy:
            break
        x, energy = further, lower
    return x, energy


def _foresee(equations: Equilibrium, x: FloatArray, moved: FloatArray) -> FloatArray | None:
    """Stress that the linearisation at x foresees at the end of a step; see the head."""
    foreseeing = [term for term in equations.model.terms if term.foresees]
    if equations.model.contacts or len(foreseeing) != 1:
        return None
    return foreseeing[0].foreseen_stress(x, moved - x)


def _line_search(
    equations: Equilibrium, x: FloatArray, g: FloatArray, d: FloatArray, highest: float
) -> tuple[FloatArray, float]:
    """Armijo's rule by halving, with a floor of round-off, a longest step, the flip guard.

    The next state, and its energy, mJ.
    """
    slope = float(g @ d)
    # the tangent is not positive definite there, or singular where a sheet slides freely
    if slope > 0 and (equations.convex == "never" or equations.loaded):
        d, slope = -d, -slope
    if not np.isfinite(slope) or slope >= 0:
        raise NotConvergedError("Newton's direction is no descent direction")
    floor = 1e-12 * (abs(highest) + equations.least_energy)
    longest = equations.model.unknowns.longest(d)
    alpha = min(1.0, 3.0 * equations.mesh_size / max(longest, 1e-300))
    for _ in range(40):
        trial = x + alpha * d
        energy = equations.energy_at(x, trial)
        if energy <= highest + 1e-4 * alpha * slope + floor:
            return trial, energy
        alpha *= 0.5
    raise NotConvergedError(
        f"no descent along Newton's direction: residual {equations.residual(g):.1e} of the driving "
        f"force, largest {equations.worst(g)}"
    )


def settle(equations: Equilibrium, x: FloatArray) -> FloatArray:
    """Minimise and refresh the lagged values until the residual with fresh ones is small.

    The normal forces of friction are a fixed point, which Anderson's mixing (1965) speeds up: the
    next ones are those at which the changes of the last passes would cancel. A pass is solved to a
    fifth of what the last one left, no further. After a snap a sheet may still creep for dozens of
    passes; on the way, the next increment may take over the last of it. Between plies contact is at
    single nodes, whose normal forces answer to friction so strongly that mixing leads astray: there
    the share of each change that is taken over follows from the last two changes (Irons and Tuck,
    Int. J. Numer. Methods Eng. 1 (1969) 275-277). There a pass ends after `STEPS_PLIES`: farther on
    the pairs and forces that it began with are not true any more.
    """
    mixed, goal = equations.mixed, equations.goal
    stack = bool(equations.model.ply_contacts)
    passes = PASSES_PLIES if stack else PASSES if equations.at_end else 12
    few = STEPS_PLIES if stack else 0
    inner = max(goal, 0.1) if mixed else goal
    used, fresh = [], []  # lagged values that the state was solved with, and those then found
    share = 1.0
    for i in range(passes):
        used.append(equations.lagged())
        with equations.tangent.counted_as("friction" if i else "balance"):
            if i and equations.turns:
                x, _ = _further(equations, x, equations.energy(x), inner)
            x = minimise(equations, x, inner, steps=few)
        if not equations.remembers:
            return x
        equations.refresh(x)
        residual = equations.residual(equations.gradient(x))
        if residual < (3 if i < 8 else 8) * goal:
            return x
        inner = max(goal, 0.2 * residual) if mixed else goal
        if i >= 6 and residual < equations.left_over:
            equations.continued += 1
            return x
        fresh.append(equations.lagged())
        used, fresh = used[-6:], fresh[-6:]
        if not stack and i < 2:
            continue
        F = np.array(fresh)
        change = F - np.array(used)
        steps = np.diff(change, axis=0)
        if stack:
            if i:
                best = -share * (change[-2] @ steps[-1]) / max(steps[-1] @ steps[-1], 1e-300)
                share = float(np.clip(best, LEAST_SHARE, 1.0))
            equations.lag(used[-1] + share * change[-1])
        else:
            shares = np.linalg.lstsq(steps.T, change[-1], rcond=1e-6)[0]
            equations.lag(np.maximum(F[-1] - shares @ np.diff(F, axis=0), 0.0))
    raise NotConvergedError(f"friction does not settle in {passes} passes: residual {residual:.1e}")


def weakest_mode(equations: Equilibrium) -> FloatArray:
    """Weakest unstable mode (n_dofs,) of the last factorised exact tangent."""
    n = equations.potential.pattern.shape[0]
    inverse = LinearOperator((n, n), matvec=equations.tangent.solve, dtype=float)
    start = np.random.default_rng(0).normal(size=n)
    # the most negative eigenvalue of the inverse belongs to the weakest unstable mode
    try:
        _, modes = eigsh(inverse, k=1, which="SA", v0=start, tol=1e-2)
    except ArpackNoConvergence as error:
        raise NotConvergedError("no unstable mode found at a saddle") from error
    d = np.zeros(len(equations.free))
    d[equations.free] = modes[:, 0]
    return d


def downhill(equations: Equilibrium, x: FloatArray, mode: FloatArray, stride: float) -> FloatArray:
    """Leave a saddle along an unstable mode, on the side of lower energy.

    By a stride in units of the size of the mesh, and on as far as the energy falls.
    """
    nodes = equations.model.unknowns.at_nodes()
    d = stride * equations.mesh_size / np.abs(mode[nodes]).max() * mode
    if equations.energy_at(x, x - d) < equations.energy_at(x, x + d):
        d = -d
    best = equations.energy(x)
    while (energy := equations.energy_at(x, x + 2 * d)) < best:
        d, best = 2 * d, energy
    return x + d
