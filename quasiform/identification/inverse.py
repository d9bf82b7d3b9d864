"""Inverse identification: the six parameters with the finite-element test in the loop.

Each off-axis test is solved at a few displacements, more of them where the force rises steeply; in
between, the ratio of its force to the power balance of inextensible fibres (`specimen`) is
interpolated, which is smooth where the force is not.

The derivatives come from the converged states. With the tangent K, the response v = dx/du of the
sheet to the grip, the volumes V and the gradient dI6 of the invariant of each triangle,

    df/dθ = Σ V (∂S12/∂θ) dI6·v,      K dx/dθ = -Σ V (∂S12/∂θ) dI6,

so one factorisation of each state serves all parameters. scipy's `least_squares` takes the steps; a
law under which a test finds no equilibrium shortens them. A picture frame is in uniform shear and
needs no elements.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from ..checks import InputError
from ..fabric import Fabric, ThreeStageLaw
from ..scenes.fabric_tests import off_axis_tension
from ..solve.newton import Equilibrium, NotConvergedError
from .energy_method import Forces
from .fit import LOCKING, NAMES, Fit, Unknowns, choose, misfit_of, report, search
from .records import Curve
from .specimen import OffAxis, Specimen

FloatArray = np.ndarray
TOLERANCE = 1e-5  # relative change of cost and parameters
POINTS = 20  # displacements at which a test is solved
ANGLE_SIGMA = np.radians(0.5)  # of a measured angle at the centre, *assumed*
Measured = tuple[Specimen, Curve, Forces]


def identify_by_elements(
    tests: Sequence[Measured],
    start: Fit,
    fabric: Fabric,
    size: float,
    keep: Mapping[str, float] | None = None,
) -> Fit:
    """Fit the three-stage law to tests solved by finite elements.

    Parameters
    ----------
    tests : sequence of (specimen, curve, forces)
    start : Fit
        By the power balance; its choice of a third stage is tried first.
    fabric : Fabric
        Thickness and tension laws.
    size : float
        Cell edge of the off-axis meshes, mm.
    keep : mapping, optional
        Parameters that are kept.

    Raises
    ------
    InputError
        If no test can be solved under the law to start from.
    """
    keep = dict(keep or {})
    if len(keep) == len(NAMES):
        return start
    top = max(float(np.sin(forces.angles).max()) for *_, forces in tests)
    models = [
        Sheet(*test, fabric, size, start.law) if isinstance(test[0], OffAxis) else Frame(test[2])
        for test in tests
    ]
    early = [name for name in NAMES[:4] if name not in keep]
    trials = []
    untested = keep.get("I_lo", 0.0) >= top  # then nothing tells of stage three
    for late in [[name for name in LOCKING if name not in keep and not untested], []]:
        law = start.law
        if late and law.I_lo >= top:  # no third stage so far: let one begin late in the range
            begun = {"I_lo": 0.8 * top, "C_lo": max(law.C_mid, 0.1 * law.C_ini)}
            law = replace(law, **(begun | {k: v for k, v in keep.items() if k in LOCKING}))
        elif not late and not keep.keys() & set(LOCKING):
            law = replace(law, I_lo=top, C_lo=0.0)
        unknowns = Unknowns(law, [*early, *late])
        trials.append((late, unknowns, search(unknowns, *_together(models, unknowns), TOLERANCE)))
        if not np.isfinite(trials[-1][2].cost):
            raise InputError("a test finds no equilibrium under the law of the power balance")
        if not late or keep.keys() & set(LOCKING):
            break
    _, unknowns, found = choose(trials)
    law = unknowns.law(found.x)
    relative = misfit_of([model.forces_under(law) for model in models], [t[2] for t in tests])
    return report(law, unknowns, found, keep, top, relative)


def _together(
    models: Sequence[Sheet | Frame], unknowns: Unknowns
) -> tuple[Callable[[FloatArray], FloatArray], Callable[[FloatArray], FloatArray]]:
    """Residuals of all tests and their derivatives, computed at once and remembered."""
    last: dict[bytes, tuple[FloatArray, FloatArray]] = {}

    def both(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        if p.tobytes() not in last:
            last.clear()
            try:
                parts = [model.residual(unknowns, p) for model in models]
                r, J = (np.concatenate(part) for part in zip(*parts, strict=True))
            except NotConvergedError:
                n = sum(model.rows for model in models)
                r, J = np.full(n, np.inf), np.full((n, len(p)), np.nan)
            last[p.tobytes()] = r, J
        return last[p.tobytes()]

    return lambda p: both(p)[0], lambda p: both(p)[1]


class Frame:
    """A test that the power balance describes exactly."""

    def __init__(self, forces: Forces) -> None:
        self.forces, self.rows = forces, len(forces.force)

    def forces_under(self, law: ThreeStageLaw) -> FloatArray:
        """(n,) forces of the rows."""
        return self.forces.predicted(law)

    def residual(self, unknowns: Unknowns, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (n,) of the rows over their deviations, and derivatives (n, k) by unknowns."""
        sigma = self.forces.sigma
        r = (self.forces.predicted(unknowns.law(p)) - self.forces.force) / sigma
        return r, unknowns.slopes(p, self.forces.predicted) / sigma[:, None]


class Sheet:
    """The finite-element model of one off-axis test.

    Parameters
    ----------
    specimen : OffAxis
    curve : Curve
    forces : Forces
        The same test in the power balance.
    fabric : Fabric
        All but its shear law.
    size : float
        Cell edge, mm.
    law : ThreeStageLaw
        An estimate, by which the points are placed.
    """

    def __init__(
        self,
        specimen: OffAxis,
        curve: Curve,
        forces: Forces,
        fabric: Fabric,
        size: float,
        law: ThreeStageLaw,
    ) -> None:
        self.curve, self.forces, self.fabric = curve, forces, fabric
        u = specimen.displacement(curve)
        # between the points the force follows the kinematic angle, whatever angle was measured
        kinematic = replace(curve, displacement=u, shear_angle=None)
        self.balance = replace(forces, **_named(specimen.shares(kinematic, fabric.thickness)))
        self.scene = off_axis_tension(
            specimen.angle, fabric, specimen.length, specimen.width, float(u.max()), size
        )
        self.angle = self.scene.measures["shear_angle_center_deg"]
        self.equilibrium = Equilibrium(self.scene, tolerance=1e-6)
        # along this, the ratio is smooth at the onset of locking too
        along = u / u.max() + 0.5 * np.log(self.balance.predicted(law))
        stations = np.linspace(along[0], along[-1], POINTS)
        self.points = np.interp(stations, along, u)
        # from values at the points to values at the rows
        self.to_rows = CubicSpline(stations, np.eye(POINTS))(along)
        at_points = Curve(self.points, self.points, None, self.points)
        self.ideal = Forces(self.points, self.points, *specimen.shares(at_points, fabric.thickness))
        self.with_angle = curve.shear_angle is not None and curve.displacement is not None
        self.rows = len(u) * (2 if self.with_angle else 1)

    def states(self, law: ThreeStageLaw) -> list[FloatArray]:
        """Equilibria at the points.

        Raises
        ------
        NotConvergedError
        """
        self.scene.membrane.fabric = replace(self.fabric, shear=law)
        x, u, found = self.scene.x0, 0.0, []
        for goal in self.points:
            x, u = self._advance(x, u, goal), goal
            found.append(x)
        return found

    def _advance(self, x: FloatArray, u: float, goal: float, halvings: int = 5) -> FloatArray:
        self.equilibrium.travel = u
        try:
            return self.equilibrium.minimise(self.equilibrium.predict(x, goal), 60)
        except NotConvergedError:
            if not halvings:
                raise
        middle = 0.5 * (u + goal)
        x = self._advance(x, u, middle, halvings - 1)
        return self._advance(x, middle, goal, halvings - 1)

    def forces_under(self, law: ThreeStageLaw) -> FloatArray:
        """(n,) forces of the rows.

        Raises
        ------
        NotConvergedError
        """
        force = [self._force(x) for x in self.states(law)]
        return self.to_rows @ (force / self.ideal.predicted(law)) * self.balance.predicted(law)

    def _force(self, x: FloatArray) -> float:
        return self.equilibrium.force(self.equilibrium.potential.gradient(x))

    def residual(self, unknowns: Unknowns, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (n,) of the rows over their deviations, and derivatives (n, k) by unknowns.

        Raises
        ------
        NotConvergedError
            Where the test has no equilibrium under this law.
        """
        law = unknowns.law(p)
        states = self.states(law)
        slopes = [self._slopes(x, unknowns, p) for x in states]
        dforce, dangle = (np.array(part) for part in zip(*slopes, strict=True))
        # force(u) = ratio(u) balance(u), the ratio interpolated
        balance, along = self.ideal.predicted(law), self.balance.predicted(law)
        ratio = np.array([self._force(x) for x in states]) / balance
        dbalance = unknowns.slopes(p, self.ideal.predicted)
        dratio = (dforce - ratio[:, None] * dbalance) / balance[:, None]
        sigma = self.forces.sigma
        r = (self.to_rows @ ratio * along - self.forces.force) / sigma
        J = (self.to_rows @ ratio)[:, None] * unknowns.slopes(p, self.balance.predicted)
        J = (J + along[:, None] * (self.to_rows @ dratio)) / sigma[:, None]
        if not self.with_angle:
            return r, J
        angle = np.radians([self.angle(x) for x in states])
        off = (self.to_rows @ angle - self.curve.shear_angle) / ANGLE_SIGMA
        return np.append(r, off), np.vstack([J, self.to_rows @ dangle / ANGLE_SIGMA])

    def _slopes(
        self, x: FloatArray, unknowns: Unknowns, p: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Derivatives (k,) of the force (N) and of the centre angle (rad) by the unknowns."""
        scene, equilibrium, membrane = self.scene, self.equilibrium, self.scene.membrane
        free = ~scene.fixed
        motion = np.where(scene.fixed, scene.drive, 0.0)
        _, load = equilibrium.factor(x, False, motion)
        v = motion.copy()
        v[free] = -equilibrium.solver.solve(load)
        f, fv = membrane.fibres(x), membrane.fibres(v)
        I6 = (f[:, 0] * f[:, 1]).sum(1)
        rate = (f[:, 0] * fv[:, 1] + f[:, 1] * fv[:, 0]).sum(1)
        dS12 = membrane.volume[:, None] * unknowns.slopes(p, lambda law: law.stress(I6))
        dforce = rate @ dS12
        if not self.with_angle:
            return dforce, np.zeros(len(p))
        dangle = []
        for column in dS12.T:
            push = membrane.g.transpose(0, 2, 1) @ (column[:, None, None] * f[:, ::-1])
            g = np.bincount(membrane.dofs.ravel(), push.ravel(), minlength=len(x))
            dx = np.zeros(len(x))
            dx[free] = -equilibrium.solver.solve(g[free])
            h = 1e-3 / max(np.abs(dx).max(), 1e-300)
            dangle.append((self.angle(x + h * dx) - self.angle(x - h * dx)) / (2 * h))
        return dforce, np.radians(dangle)


def _named(shares: tuple[FloatArray, FloatArray]) -> dict[str, FloatArray]:
    return dict(zip(("shares", "angles"), shares, strict=True))
