"""Newton's method on the summed potential, with the tangent that suits the state.

The exact tangent is used where it is positive definite; where it is not, the nearby convex one is
for this and the next iteration. Every step is a descent step of one potential, searched along its
line (Armijo) and refused where it would turn a triangle over. Convergence is measured against the
driving force.

Stiff fibres that turn make Newton's steps short: the stress that a straight step of the nodes puts
into them has little to do with that of the linearisation. Without contact the geometric stiffness
therefore takes the stress that the last step foresaw (the mixed iteration of [1]_), and the energy
may rise for a while, but not above its largest value over the last steps [2]_. With contact this
was found to gain nothing.

References
----------
.. [1] D. Magisano, L. Leonetti, G. Garcea, Int. J. Numer. Methods Eng. 109 (2017) 1237-1262.
.. [2] L. Grippo, F. Lampariello, S. Lucidi, SIAM J. Numer. Anal. 23 (1986) 707-716.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from ..unknowns import FloatArray
from .equilibrium import Equilibrium
from .linear import NotConvergedError

SLIDING = 60  # convex tangents in one solve, from which on a sheet slides off a saddle


def predict(equations: Equilibrium, x: FloatArray, travel: float) -> FloatArray:
    """Move the prescribed unknowns to `travel` and the others along the tangent."""
    motion, free = equations.motion_to(x, travel), equations.free
    _, load = equations.tangent.factor_definite(x, equations.memory, motion=motion)
    moved = x + motion
    moved[free] -= equations.tangent.solve(equations.gradient(x)[free] + load)
    equations.travel = travel
    if not np.isfinite(moved).all() or equations.model.turned_over(x, moved):
        moved = x + motion
    equations.foreseen = _foresee(equations, x, moved)
    return moved


def minimise(
    equations: Equilibrium, x: FloatArray, tolerance: float = 0.0, max_iterations: int = 0
) -> FloatArray:
    """Newton iterations with the lagged values as they are, to the tolerance or a looser one.

    Raises NotConvergedError with the reason and the place of the largest residual.
    """
    free, tangent = equations.free, equations.tangent
    tolerance = tolerance or equations.tolerance
    max_iterations = max_iterations or equations.max_iterations
    convex_left = taken = 0
    tangent.forget()  # what was lagged, or the bed, may be another one
    stress, equations.foreseen = equations.foreseen, None
    energies: list[float] = []
    for _ in range(max_iterations):
        g = equations.gradient(x)
        residual = equations.residual(g)
        if residual < tolerance:
            return x
        sliding = taken > SLIDING
        if sliding:
            stress = None
        if convex_left:
            equations.factor(x, 1.0, stress=stress)
            convex_left -= 1
        else:
            exact, _ = tangent.factor_definite(x, equations.memory, sliding, stress=stress)
            taken += not exact
            convex_left = 0 if exact or sliding else 1
        d = np.zeros_like(x)
        d[free] = -tangent.solve(g[free])
        if stress is not None:
            tangent.forget()  # no tangent of this state
        energies = [*energies[-7:], equations.energy(x)]
        highest = energies[-1] if stress is None else max(energies)
        before, x = x, _line_search(equations, x, g, d, highest)
        equations.check_slide(x)
        stress = None if sliding else _foresee(equations, before, x)
    raise NotConvergedError(
        f"no equilibrium in {max_iterations} Newton iterations: residual {residual:.1e} of the "
        f"driving force against {tolerance:.0e}, largest {equations.worst(g)}"
    )


def _foresee(equations: Equilibrium, x: FloatArray, moved: FloatArray) -> FloatArray | None:
    """Stress that the linearisation at x foresees at the end of a step; see the head."""
    foreseeing = [term for term in equations.model.terms if term.foresees]
    if equations.model.contacts or len(foreseeing) != 1:
        return None
    return foreseeing[0].foreseen_stress(x, moved - x)


def _line_search(
    equations: Equilibrium, x: FloatArray, g: FloatArray, d: FloatArray, highest: float
) -> FloatArray:
    """Armijo's rule by halving, with a floor of round-off, a longest step, the flip guard."""
    slope = float(g @ d)
    # the tangent is not positive definite there, or singular where a sheet slides freely
    if slope > 0 and (equations.convex == "never" or equations.loaded):
        d, slope = -d, -slope
    if not np.isfinite(slope) or slope >= 0:
        raise NotConvergedError("Newton's direction is no descent direction")
    floor = 1e-12 * (abs(highest) + equations.model.resting + 1e-6)
    longest = equations.model.unknowns.longest(d)
    alpha = min(1.0, 3.0 * equations.mesh_size / max(longest, 1e-300))
    for _ in range(40):
        trial = x + alpha * d
        if equations.energy_at(x, trial) <= highest + 1e-4 * alpha * slope + floor:
            return trial
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
    passes; on the way, the next increment may take over the last of it.
    """
    mixed, goal = equations.mixed, equations.goal
    passes = 60 if equations.at_end else 12
    inner = max(goal, 0.1) if mixed else goal
    used, fresh = [], []  # lagged values that the state was solved with, and those then found
    for i in range(passes):
        used.append(equations.lagged())
        x = minimise(equations, x, inner)
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
        if i > 1:
            F = np.array(fresh)
            change = F - np.array(used)
            steps = np.diff(change, axis=0)
            shares = np.linalg.lstsq(steps.T, change[-1], rcond=1e-6)[0]
            equations.lag(np.maximum(F[-1] - shares @ np.diff(F, axis=0), 0.0))
    raise NotConvergedError(f"friction does not settle in {passes} passes: residual {residual:.1e}")


def downhill(equations: Equilibrium, x: FloatArray, stride: float = 1e-3) -> FloatArray:
    """Leave a saddle along the weakest unstable mode of the last factorised exact tangent.

    The mode is followed, on the side of lower energy, by a stride in units of the size of the
    mesh, and on as far as the energy falls.
    """
    n = equations.potential.pattern.shape[0]
    inverse = LinearOperator((n, n), matvec=equations.tangent.solve, dtype=float)
    start = np.random.default_rng(0).normal(size=n)
    # the most negative eigenvalue of the inverse belongs to the weakest unstable mode
    try:
        _, modes = eigsh(inverse, k=1, which="SA", v0=start, tol=1e-2)
    except ArpackNoConvergence as error:
        raise NotConvergedError("no unstable mode found at a saddle") from error
    d = np.zeros_like(x)
    d[equations.free] = modes[:, 0]
    nodes = equations.model.unknowns.at_nodes()
    d *= stride * equations.mesh_size / np.abs(d[nodes]).max()
    if equations.energy_at(x, x - d) < equations.energy_at(x, x + d):
        d = -d
    best = equations.energy(x)
    while (energy := equations.energy_at(x, x + 2 * d)) < best:
        d, best = 2 * d, energy
    return x + d
