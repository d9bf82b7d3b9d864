"""Newton's method on the summed potential, with the tangent that the state deserves.

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

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from ..energy import Potential, Term
from ..model import Scene
from .linear import LinearSolver, SingularMatrixError, linear_solver

FloatArray = np.ndarray
LEAST_FORCE = 1e-6  # N: what a driving force counts for where a tool has not touched yet
SLIDING = 60  # convex tangents in one solve, from which on a sheet slides off a saddle
LEAST_SHARE = 1 / 64  # of the convex tangent, while it does
LOOSER = 30.0  # tolerance on the way where friction has to settle, relative to that at the end


class NotConvergedError(ArithmeticError):
    """A solve that did not reach its tolerance; carries the state it had come to."""

    def __init__(self, reason: str, x: FloatArray, residual: float) -> None:
        super().__init__(reason)
        self.x, self.residual = x, residual


@dataclass
class Equilibrium:
    """The equations of a scene with their linear solver, and the count of the work done.

    Parameters
    ----------
    scene : Scene
    linear : str
        Name of the linear solver.
    tolerance : float
        Sum of the nodal force residuals relative to the driving force, at the end of the travel;
        on the way `LOOSER` times that.
    convex : "on demand", "always" or "never"
        When the convex tangent takes the place of the exact one.
    linear_solves : int
        Factorisations so far.
    solve_s : float
        Time spent on them with all solutions, s.
    travel : float
        Where the prescribed degrees of freedom are.
    carried : float
        Residual that friction may leave to the next increment where it does not settle.
    carried_on : int
        How often it did.
    convex_taken : int
        How often it did on demand.
    relaxed : int
        Iterations of dynamic relaxation so far.
    max_iterations : int
        Newton iterations of one solve.
    """

    scene: Scene
    linear: str = "auto"
    tolerance: float = 1e-4
    convex: str = "on demand"
    linear_solves: int = 0
    solve_s: float = 0.0
    travel: float = 0.0
    carried: float = 2e-2
    carried_on: int = 0
    convex_taken: int = 0
    relaxed: int = 0
    max_iterations: int = 400
    potential: Potential = field(init=False)
    solver: LinearSolver = field(init=False)
    _factored: tuple[FloatArray, float, int] | None = field(init=False, default=None)
    _foreseen: FloatArray | None = field(init=False, default=None)
    _share: float = field(init=False, default=1 / 4)

    def __post_init__(self) -> None:
        scene = self.scene
        free = ~scene.fixed
        self.potential = Potential(scene.terms, free)
        points = np.full((len(scene.x0), 2), np.nan)
        points[: scene.n_nodal] = np.repeat(scene.blank.nodes, scene.dim, axis=0)
        self.solver = linear_solver(
            self.linear, self.potential.pattern, points[free], rigid_motions(scene)[free]
        )

    @contextmanager
    def with_term(self, term: Term) -> Iterator[None]:
        """Add a term of diagonal Hessian to the potential for the time being."""
        own = self.potential
        self.potential, self._factored = Potential([*own.terms, term], own.free), None
        try:
            yield
        finally:
            self.potential, self._factored = own, None

    def force(self, g: FloatArray) -> float:
        """Derivative of the potential by the travel, N (of the modelled share)."""
        _, rate = self.scene.prescribed(self.travel)
        return float(np.where(self.scene.fixed, rate, 0.0) @ g)

    def residual(
        self, g: FloatArray, certified: bool = False, driven: FloatArray | None = None
    ) -> float:
        """Sum of the free nodal forces relative to the driving force, or to the dead load.

        The driving force is that of g, or of another gradient `driven`. Before it has grown to 2 %
        of a resting tool's weight the residual is measured against that, unless `certified`.
        """
        scene = self.scene
        r = np.where(scene.fixed, 0.0, g)
        total = np.linalg.norm(r[: scene.n_nodal].reshape(-1, scene.dim), axis=1).sum()
        total += np.abs(r[scene.n_nodal :]).sum()
        if scene.dead_load:
            return float(total / scene.dead_load)
        floor = LEAST_FORCE if certified else 0.02 * scene.resting + LEAST_FORCE
        return float(total / max(abs(self.force(g if driven is None else driven)), floor))

    @property
    def at_end(self) -> bool:
        """Whether the travel is at its end."""
        return self.travel >= self.scene.travel * (1 - 1e-12)

    @property
    def goal(self) -> float:
        """Residual that is asked for: on the way a looser one where friction has to settle."""
        return self.tolerance * (1.0 if self.at_end or not self.scene.frictions else LOOSER)

    def worst(self, g: FloatArray) -> str:
        """Where the residual is largest, in words."""
        r = np.where(self.scene.fixed, 0.0, g)[: self.scene.n_nodal].reshape(-1, self.scene.dim)
        size = np.linalg.norm(r, axis=1)
        X = self.scene.to_user(self.scene.blank.nodes[size.argmax()])
        return f"{size.max():.2g} N at X = ({X[0]:.1f}, {X[1]:.1f}) mm"

    def factor(
        self,
        x: FloatArray,
        convex: float,
        motion: FloatArray | None = None,
        stress: FloatArray | None = None,
    ) -> tuple[int, FloatArray]:
        """Factorise a tangent; number of negative pivots, and its product with a motion.

        `convex` is the share of the convex tangent in it, the rest that of the exact one.

        The factor of an accepted state, made for its certificate, serves the next prediction too.
        A foreseen stress takes the place of that at x.

        Raises
        ------
        NotConvergedError
            If the tangent is singular.
        """
        values, load = self.potential.hessian(x, convex == 1, motion, stress)
        if 0 < convex < 1:
            values += convex * (self.potential.hessian(x, True)[0] - values)
        known = self._factored if stress is None else None
        if known is None or known[1] != convex or not np.array_equal(known[0], x):
            self._factored = None
            self.linear_solves += 1
            clock = time.perf_counter()
            try:
                self._factored = x.copy(), convex, self.solver.factor(values)
            except SingularMatrixError as error:
                raise NotConvergedError(f"the tangent is singular: {error}", x, np.inf) from error
            finally:
                self.solve_s += time.perf_counter() - clock
        return self._factored[2], load

    def factor_definite(
        self,
        x: FloatArray,
        motion: FloatArray | None = None,
        stress: FloatArray | None = None,
        sliding: bool = False,
    ) -> tuple[bool, FloatArray]:
        """Factorise the exact tangent if it is positive definite, else the convex one.

        With `convex` "never", the exact one whatever it is. While a sheet is `sliding` off a saddle
        the convex tangent is much too stiff: the smallest share of it that does is taken.

        Returns
        -------
        exact : bool
        load : (n_free,) array
        """
        if self.convex == "never":
            return True, self.factor(x, False, motion, stress)[1]
        if self.convex == "on demand" and self.solver.inertia:
            try:
                negative, load = self.factor(x, False, motion, stress)
                if negative == 0:
                    return True, load
            except NotConvergedError:
                pass
            self.convex_taken += 1
            share = self._share
            while sliding and stress is None and share < 1:
                with suppress(NotConvergedError):
                    negative, load = self.factor(x, share, motion)
                    if negative == 0:
                        self._share = max(share / 4, LEAST_SHARE)
                        return False, load
                share *= 4
            self._share = 1 / 4
        _, load = self.factor(x, True, motion, stress)
        return False, load

    def accept(self, x: FloatArray) -> None:
        """Commit x to the terms with memory; their tangent is another one from there on.

        It is factorised at once, so that a run that is carried on from here goes the same way.
        """
        if not self.scene.remembering:
            return
        for term in self.scene.remembering:
            term.commit(x)
        self._factored = None
        self.certify(x)

    def certify(self, x: FloatArray) -> int | None:
        """Negative pivots of the exact tangent at x; None where nothing tells."""
        if self.solver.inertia:
            with suppress(NotConvergedError):  # a stopped run may have no tangent
                return self.factor(x, convex=False)[0]
        return None

    def predict(self, x: FloatArray, travel: float) -> FloatArray:
        """Move the prescribed degrees of freedom to `travel` and the others along the tangent."""
        motion = self.motion_to(x, travel)
        _, load = self.factor_definite(x, motion)
        free = ~self.scene.fixed
        moved = x + motion
        moved[free] += self._direction(x, self.potential.gradient(x)[free] + load)
        self.travel = travel
        if not np.isfinite(moved).all() or self.turns_over(x, moved):
            moved = x + motion
        self._foreseen = self._foresee(x, moved)
        return moved

    def _foresee(self, x: FloatArray, moved: FloatArray) -> FloatArray | None:
        """Stress that the linearisation at x foresees at the end of a step; see the head."""
        if self.scene.contacts:
            return None
        return self.scene.membrane.foreseen_stress(x, moved - x)

    def _direction(self, x: FloatArray, force: FloatArray) -> FloatArray:
        clock = time.perf_counter()
        try:
            return -self.solver.solve(force)
        except SingularMatrixError as error:
            raise NotConvergedError(str(error), x, np.inf) from error
        finally:
            self.solve_s += time.perf_counter() - clock

    def motion_to(self, x: FloatArray, travel: float) -> FloatArray:
        """(n_dofs,) motion of the prescribed degrees of freedom from x to `travel`, mm."""
        return np.where(self.scene.fixed, self.scene.prescribed(travel)[0] - x, 0.0)

    def turns_over(self, x: FloatArray, trial: FloatArray) -> bool:
        """Whether a triangle is turned over between two states."""
        membrane = self.scene.membrane
        return bool(((membrane.normals(x) * membrane.normals(trial)).sum(1) <= 0).any())

    def minimise(
        self, x: FloatArray, max_iterations: int | None = None, tolerance: float | None = None
    ) -> FloatArray:
        """Newton iterations with the lagged values as they are, to the tolerance or a looser one.

        Raises
        ------
        NotConvergedError
            With the reason, the place of the largest residual and the best state.
        """
        free = ~self.scene.fixed
        tolerance = tolerance or self.tolerance
        max_iterations = max_iterations or self.max_iterations
        convex_left = taken = 0
        self._factored = None  # what was lagged, or the bed, may be another one
        stress, self._foreseen = self._foreseen, None
        energies: list[float] = []
        for _ in range(max_iterations):
            g = self.potential.gradient(x)
            residual = self.residual(g)
            if residual < tolerance:
                return x
            sliding = taken > SLIDING
            if sliding:
                stress = None
            if convex_left:
                self.factor(x, True, stress=stress)
                convex_left -= 1
            else:
                exact, _ = self.factor_definite(x, stress=stress, sliding=sliding)
                taken += not exact
                convex_left = 0 if exact or sliding else 1
            d = np.zeros_like(x)
            d[free] = self._direction(x, g[free])
            if stress is not None:
                self._factored = None  # no tangent of this state
            energies = [*energies[-7:], self.potential.energy(x)]
            highest = energies[-1] if stress is None else max(energies)
            before, x = x, self._line_search(x, g, d, residual, highest)
            stress = None if sliding else self._foresee(before, x)
        raise NotConvergedError(
            f"no equilibrium in {max_iterations} Newton iterations: residual {residual:.1e} of the "
            f"driving force against {tolerance:.0e}, largest {self.worst(g)}",
            x,
            residual,
        )

    def _line_search(
        self, x: FloatArray, g: FloatArray, d: FloatArray, residual: float, highest: float
    ) -> FloatArray:
        """Armijo's rule by halving, with a floor of round-off, a longest step, the flip guard."""
        slope = float(g @ d)
        if self.convex == "never" and slope > 0:  # the tangent is not positive definite there
            d, slope = -d, -slope
        if not np.isfinite(slope) or slope >= 0:
            raise NotConvergedError("Newton's direction is no descent direction", x, residual)
        floor = 1e-12 * (abs(highest) + self.scene.resting + 1e-6)
        longest = np.linalg.norm(self.scene.positions(d), axis=1).max()
        alpha = min(1.0, 3.0 * self.scene.blank.size / max(longest, 1e-300))
        for _ in range(40):
            trial = x + alpha * d
            if self._energy_at(x, trial) <= highest + 1e-4 * alpha * slope + floor:
                return trial
            alpha *= 0.5
        raise NotConvergedError(
            f"no descent along Newton's direction: residual {residual:.1e} of the driving force, "
            f"largest {self.worst(g)}",
            x,
            residual,
        )

    def _energy_at(self, x: FloatArray, trial: FloatArray) -> float:
        """Energy of a trial state; infinite where a triangle has been turned over since x."""
        if self.turns_over(x, trial):
            return np.inf
        return self.potential.energy(trial)

    def settle(self, x: FloatArray) -> FloatArray:
        """Minimise and refresh the lagged values until the residual with fresh ones is small.

        The normal forces of friction are a fixed point, which Anderson's mixing (1965) speeds up:
        the next ones are those at which the changes of the last passes would cancel. A pass is
        solved to a fifth of what the last refreshing had left, no further. After a snap a sheet
        may still creep for dozens of passes; on the way, the next increment may carry on with the
        last of it.

        Raises
        ------
        NotConvergedError
        """
        frictions = self.scene.frictions
        passes, goal = 60 if self.at_end else 12, self.goal
        inner = max(goal, 0.1) if frictions else goal
        used, fresh = [], []  # normal forces that friction was solved with, and those then found
        for i in range(passes):
            used.append(np.concatenate([[0.0], *(term.limit for term in frictions)]))
            x = self.minimise(x, tolerance=inner)
            if not self.scene.remembering:
                return x
            for term in self.scene.remembering:
                term.refresh(x)
            self._factored = None
            residual = self.residual(self.potential.gradient(x))
            if residual < (3 if i < 8 else 8) * goal:
                return x
            inner = max(goal, 0.2 * residual) if frictions else goal
            if not self.at_end and i >= 6 and residual < self.carried:
                self.carried_on += 1
                return x
            fresh.append(np.concatenate([[0.0], *(term.limit for term in frictions)]))
            used, fresh = used[-6:], fresh[-6:]
            if i > 1:
                F = np.array(fresh)
                change = F - np.array(used)
                steps = np.diff(change, axis=0)
                shares = np.linalg.lstsq(steps.T, change[-1], rcond=1e-6)[0]
                mixed = np.maximum(F[-1] - shares @ np.diff(F, axis=0), 0.0)[1:]
                for term in frictions:
                    term.limit, mixed = np.split(mixed, [len(term.limit)])
        raise NotConvergedError(
            f"friction does not settle in {passes} passes: residual {residual:.1e}", x, residual
        )

    def downhill(self, x: FloatArray, stride: float = 1e-3) -> FloatArray:
        """Leave a saddle along the weakest unstable mode of the last factorised exact tangent.

        The mode is followed, on the side of lower energy, by a stride in units of the size of the
        mesh, and on as far as the energy falls.
        """
        n = self.potential.pattern.shape[0]
        inverse = LinearOperator((n, n), matvec=self.solver.solve, dtype=float)
        start = np.random.default_rng(0).normal(size=n)
        # the most negative eigenvalue of the inverse belongs to the weakest unstable mode
        try:
            _, modes = eigsh(inverse, k=1, which="SA", v0=start, tol=1e-2)
        except ArpackNoConvergence as error:
            raise NotConvergedError("no unstable mode found at a saddle", x, np.inf) from error
        d = np.zeros_like(x)
        d[~self.scene.fixed] = modes[:, 0]
        d *= stride * self.scene.blank.size / np.abs(self.scene.positions(d)).max()
        if self._energy_at(x, x - d) < self._energy_at(x, x + d):
            d = -d
        best = self.potential.energy(x)
        while (energy := self._energy_at(x, x + 2 * d)) < best:
            d, best = 2 * d, energy
        return x + d


def rigid_motions(scene: Scene) -> FloatArray:
    """(n_dofs, m) translations and rotations of the sheet."""
    dim = scene.dim
    X = scene.positions(scene.x0)
    motions = [np.broadcast_to(e, X.shape) for e in np.eye(dim)]
    for i in range(dim):
        for j in range(i):
            turn = np.zeros_like(X)
            turn[:, i], turn[:, j] = X[:, j], -X[:, i]
            motions.append(turn)
    B = np.zeros((len(scene.x0), len(motions)))
    B[: scene.n_nodal] = np.stack([m.ravel() for m in motions], axis=1)
    B[scene.n_nodal :, 0] = 1.0
    return B
