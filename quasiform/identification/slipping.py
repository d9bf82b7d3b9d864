"""Inverse identification of shear law and slip together (`energy.slip`).

Slip lowers the force already where it is elastic, so a law that was found without it is too soft.
The forces, and the angle at the centre where it was measured, are those of finite elements with
slip. The load of such a test only grows: slip is taken without its memory, as a potential D(|d|).
So the derivatives of a converged state hold for slip too: with g_θ the derivative of all forces by
K or τ,

    df/dθ = g_θ·v,      K dx/dθ = -g_θ,      v = dx/du.

K and τ lower the same forces: their intervals and their correlation show how far the tests tell
them apart. A test of 5 % noise that is not there yet adds its derivatives: the test that would
narrow the wider interval most is named.

A pull-out test has them alone. Rovings of a strip of length L and width w are drawn out of held
ones, with the stiffness EA per width and λ = √(K/EA), elastically with

    F = w u √(K EA) tanh(λ L),

then sliding over a length a from the pulled end, and as a whole with F = τ w L:

    F = w [τ a + τ √(EA/K) tanh(λ (L - a))],    u = τ/K + (F/w) a/EA - τ a²/(2 EA).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy as sp  # its parts load when they are used

from ..checks import InputError, check_number
from ..energy.slip import ENDLESS, SlipWidth
from ..fabric import Fabric, Slip, TabulatedLaw, ThreeStageLaw
from ..scenes.fabric_tests import off_axis_tension
from ..solve.equilibrium import Equilibrium
from .energy_method import Forces
from .fit import NAMES, UNSEEN, Fit, Parameter, Trial, report, search, variance
from .fit import Unknowns as LawUnknowns
from .inverse import POINTS, TOLERANCE, Sheet
from .records import Curve
from .specimen import OffAxis

FloatArray = np.ndarray
WIDEST = 7.0  # of the logarithm of K and τ from their start
NOISE = 0.05  # of a force, in a further test
PROFILE = 1e-4  # relative change of the cost at the end of an interval
MINIMA, LOWER = 3, 1 - 1e-3  # fits at most; a cost by which one is a better minimum
SURE = 1.0  # half a 95 % interval of such a logarithm: beyond, it is not identified


@dataclass(frozen=True)
class SlippingLaw:
    """Shear law and slip."""

    shear: ThreeStageLaw | TabulatedLaw
    slip: Slip

    def __getattr__(self, name: str) -> Any:
        """Stress and parameters are those of the shear law."""
        return getattr(self.shear, name)


class Table:
    """A tabulated law as numbers of order one: the steps of its stress over those of a start."""

    def __init__(self, start: TabulatedLaw) -> None:
        self.I6, self.steps = start.I6[1:], np.diff(start.S12)
        self.free = [f"S12 at I6 = {I6:.3g}" for I6 in self.I6]
        self.start = np.ones(len(self.steps))
        self.bounds = np.outer([1e-3, 1e3], self.start)

    @classmethod
    def through(cls, law: TabulatedLaw, degrees: Sequence[float]) -> Table:
        """Start with the stress of a law at some shear angles."""
        I6 = np.sin(np.radians(degrees))
        S12 = np.maximum.accumulate(law.stress(I6))
        rise = 1e-4 * S12[-1] * np.arange(1, len(I6) + 1)  # where it does not rise
        return cls(TabulatedLaw(tuple(I6.tolist()), tuple((S12 + rise).tolist())))

    def law(self, p: FloatArray) -> TabulatedLaw:
        """The law of (k,) numbers."""
        return TabulatedLaw(self.I6, tuple(np.cumsum(p * self.steps).tolist()))


class SlipUnknowns(LawUnknowns):
    """The numbers of a shear law, then the logarithms of K and τ over those of a start.

    Those in `keep` are not fitted, nor is a resistance that is infinite: elastic slip only.
    """

    def __init__(self, of_law: LawUnknowns | Table, start: Slip, keep: Sequence[str] = ()) -> None:
        self.of_law, self.slip = of_law, start
        names = [n for n in ("stiffness", "resistance") if getattr(start, n) < ENDLESS]
        self.names = names = [name for name in names if name not in keep]
        more = np.zeros(len(names))
        self.free = [*of_law.free, *names]
        self.start = np.append(of_law.start, more)
        self.bounds = np.hstack([of_law.bounds, np.outer([-WIDEST, WIDEST], more + 1)])

    def law(self, p: FloatArray) -> SlippingLaw:
        """Law and slip of (k,) numbers."""
        n = len(self.of_law.start)
        found = {
            name: getattr(self.slip, name) * float(np.exp(q))
            for name, q in zip(self.names, p[n:], strict=True)
        }
        return SlippingLaw(self.of_law.law(p[:n]), replace(self.slip, **found))


class SlippingSheet(Sheet):
    """The finite-element model of one off-axis test with slip.

    Its force is smooth enough to be interpolated itself: the power balance ends at the limit of
    inextensible fibres, beyond which slip shows best.
    """

    def __init__(
        self, specimen: OffAxis, curve: Curve, fabric: Fabric, size: float, slip: Slip
    ) -> None:
        self.curve, self.force, self.sigma = curve, curve.force, curve.sigma
        self.fabric, u = replace(fabric, slip=slip), curve.displacement
        sizes = specimen.length, specimen.width, float(u.max())
        self.model = off_axis_tension(specimen.angle, self.fabric, *sizes, size)
        self.angle = self.model.measures["shear_angle_center_deg"]
        self.width = next(t for t in self.model.terms if isinstance(t, SlipWidth))
        self.width.quadratic = False  # its Hessian changes with K
        self.unit = self.width.H / slip.coupling  # of G = 1
        self.equilibrium = Equilibrium(self.model, tolerance=1e-6)
        stations = np.linspace(np.sqrt(u[0]), np.sqrt(u[-1]), POINTS)  # more where it is steep
        self.points = stations**2
        self.to_rows = sp.interpolate.CubicSpline(stations, np.eye(POINTS))(np.sqrt(u))
        self.with_angle = curve.shear_angle is not None
        self.rows = len(u) * (2 if self.with_angle else 1)

    def predicted(self, law: SlippingLaw) -> FloatArray:
        """(n,) forces of the rows; NotConvergedError as `states`."""
        return self.to_rows @ [self._force(x) for x in self.states(law)]

    def _misfit(
        self, force: FloatArray, dforce: FloatArray, unknowns: SlipUnknowns, p: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        r = (self.to_rows @ force - self.force) / self.sigma
        return r, self.to_rows @ dforce / self.sigma[:, None]

    def states(self, law: SlippingLaw) -> list[FloatArray]:
        """Equilibria at the points; NotConvergedError where there is none."""
        resistance = self.model.slip
        resistance.K, resistance.tau = law.slip.stiffness, min(law.slip.resistance, ENDLESS)
        self.width.H = law.slip.coupling * self.unit
        self.width.changed()
        return super().states(law.shear)

    def _slopes(
        self, x: FloatArray, v: FloatArray, unknowns: SlipUnknowns, p: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        dforce, dangle = super()._slopes(x, v, unknowns, p)
        law = unknowns.law(p)
        for i, name in enumerate(unknowns.names, start=len(unknowns.of_law.start)):
            g = getattr(law.slip, name) * self._by(name, x)
            dforce[i] = g @ v
            if self.with_angle:
                dangle[i] = self._angle_slope(x, g)
        return dforce, dangle

    def _by(self, name: str, x: FloatArray) -> FloatArray:
        """(n_dofs,) derivative of all forces by K, mm³, or by τ, mm²."""
        term, g = self.model.slip, np.zeros(len(x))
        d = x[term.dofs]
        r = np.sqrt((d * d).sum(1))
        slides = (r > term.tau / term.K)[:, None]
        if name == "resistance":
            g[term.dofs] = np.where(slides, d / np.maximum(r, 1e-300)[:, None], 0.0)
            g[term.dofs] *= term.area[:, None]
            return g
        self.width.add_gradient(g, x, None)
        g /= term.K
        g[term.dofs] += np.where(slides, 0.0, d) * term.area[:, None]
        return g


@dataclass(frozen=True)
class PullOut:
    """A pull-out test: rovings of a strip drawn out of those of the other family, which are held.

    InputError if a size is not positive.
    """

    length: float  # of the crossing, L, mm
    width: float  # of the drawn rovings, w, mm
    curve: Curve
    EA: float = np.nan  # stiffness of the drawn family per width, N/mm

    def __post_init__(self) -> None:
        for name in ("length", "width"):
            check_number(name, getattr(self, name))

    @property
    def force(self) -> FloatArray:
        """(n,) measured forces, N."""
        return self.curve.force

    def predicted(self, law: SlippingLaw) -> FloatArray:
        """(n,) forces, N, at the displacements of the curve."""
        K, tau, EA, L = law.slip.stiffness, law.slip.resistance, self.EA, self.length
        rate, u = np.sqrt(K / EA), self.curve.displacement
        elastic = u * np.sqrt(K * EA) * np.tanh(rate * L)
        if not np.isfinite(tau):
            return self.width * elastic
        a = L * np.linspace(0.0, 1.0, 400)
        F = tau * a + tau * np.sqrt(EA / K) * np.tanh(rate * (L - a))
        at = tau / K + F * a / EA - tau * a**2 / (2 * EA)
        return self.width * np.where(u < tau / K, elastic, np.interp(u, at, F))

    def residual(self, unknowns: SlipUnknowns, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As `Forces.residual`."""
        columns = []
        for i in range(len(p)):
            step = 1e-5 * (np.arange(len(p)) == i) * (i >= len(unknowns.of_law.start))
            rise = self.predicted(unknowns.law(p + step)) - self.predicted(unknowns.law(p - step))
            columns.append(rise / (2e-5 * self.curve.sigma))
        off = (self.predicted(unknowns.law(p)) - self.curve.force) / self.curve.sigma
        return off, np.stack(columns, axis=-1)


def identify_with_slip(
    tests: Sequence[tuple[Any, Curve, Forces]],
    pulled: Sequence[PullOut],
    start: Fit,
    fabric: Fabric,
    size: float,
    slip: Slip,
) -> Fit:
    """Fit law, K and τ to tests solved by finite elements of an edge `size`, mm, with slip.

    The law starts from that by the power balance, K and τ from those of `slip`.
    """
    models: list[Any] = [
        SlippingSheet(*test[:2], fabric, size, slip) if isinstance(test[0], OffAxis) else test[2]
        for test in tests
    ]
    models += [replace(test, EA=_stiffness(fabric)) for test in pulled]
    top = max(float(np.sin(forces.angles).max()) for *_, forces in tests)
    free = NAMES if start.law.I_lo < top else NAMES[:4]
    unknowns = SlipUnknowns(LawUnknowns(start.law, free), slip)
    trial = search(models, unknowns, TOLERANCE)
    trial, ends = profiled(models, trial)
    parameters, correlation = slip_parameters(trial, ends)
    found = report(models, *trial, {})
    notices = [f"K and τ have a correlation of {correlation:.2f}"] if len(parameters) > 1 else []
    strips = [test[0] for test in tests if isinstance(test[0], OffAxis)]
    if further := next_test(trial, strips, fabric, size):
        notices.append(further)
    law = unknowns.law(trial[1].x)
    return replace(
        found,
        law=law.shear,
        slip=law.slip,
        parameters=(*found.parameters, *parameters),
        notices=tuple(notices),
    )


def _stiffness(fabric: Fabric) -> float:
    """EA of the warp per width, N/mm."""
    return 4.0 * float(fabric.warp.stiffness(np.ones(1), 1.0)[0]) * fabric.thickness


def next_test(trial: Trial, strips: Sequence[OffAxis], fabric: Fabric, size: float) -> str:
    """Sentence on the further test that would narrow the wider interval of K and τ most."""
    unknowns, found = trial
    law, count = unknowns.law(found.x), len(unknowns.names)
    information = np.linalg.pinv(_covariance(found.jac, found.fun), hermitian=True)
    u = np.linspace(0.0, 1.0, 21)[1:]
    offers = {}
    if strips:
        for angle in {45.0, 30.0} - {strip.angle for strip in strips}:
            try:
                strip = replace(strips[0], angle=angle)
            except InputError:  # a fibre would join both grips
                continue
            at = strip.net.displacement_limit * u
            curve = Curve(np.ones(20), at, None, np.ones(20))
            sheet = SlippingSheet(strip, curve, fabric, size, law.slip)
            offers[f"an off-axis test at {angle:g}°"] = sheet
    EA = _stiffness(fabric)
    if np.isfinite(law.slip.resistance):
        end = 2.0 * (law.slip.resistance / law.slip.stiffness + law.slip.resistance * 1e4 / EA)
        offers["a pull-out test over 100 mm"] = PullOut(
            100.0, 20.0, Curve(np.ones(20), end * u, None, np.ones(20)), EA
        )
    half = {}
    for name, model in offers.items():
        r, J = model.residual(unknowns, found.x)
        J = J / (NOISE * (r + 1.0))[:, None]  # r is the force less one
        if np.isfinite(J).all():
            C = np.linalg.pinv(information + J.T @ J, hermitian=True)[-count:, -count:]
            half[name] = 1.96 * float(np.sqrt(np.diag(C).max()))
    if not half:
        return ""
    best = min(half, key=lambda name: half[name])
    return f"{best} would narrow the wider interval of K and τ most, to ± {100 * half[best]:.0f} %"


def slip_parameters(
    found: Trial, ends: Sequence[tuple[float, float]] = ()
) -> tuple[list[Parameter], float]:
    """K and τ with their 95 % intervals, and their correlation (nan for one of them alone).

    The intervals are between `ends`, see `profiled`; without these by the curvature of the cost.
    """
    unknowns, fitted = found
    law, count = unknowns.law(fitted.x), len(unknowns.names)
    covariance = _covariance(fitted.jac, fitted.fun)[-count:, -count:]
    deviation = np.sqrt(np.diag(covariance))
    ends = ends or [(-wide, wide) for wide in (1.96 * deviation).tolist()]
    units = {"stiffness": "N/mm³", "resistance": "MPa"}
    parameters = []
    for name, both in zip(unknowns.names, ends, strict=True):
        value, widest = getattr(law.slip, name), max(np.abs(both))
        low, high = (value * float(np.exp(np.clip(end, -99.0, 99.0))) for end in both)
        state = "fitted" if widest < SURE else "not identified"
        high = high if widest < 99.0 else np.inf
        parameters.append(Parameter(f"slip.{name}", value, low, high, units[name], state))
    both = covariance[0, -1] / np.prod(deviation) if count == 2 else np.nan
    return parameters, float(both)


def profiled(models: Sequence[Any], found: Trial) -> tuple[Trial, list[tuple[float, float]]]:
    """Ends of the 95 % intervals of the logarithms of K and τ, from their values.

    There the cost, with all other numbers fitted again, has risen by that of 95 %. Strips show less
    of slip the less they slip, so that intervals by curvature are too narrow on one side. From the
    ends of these the root of the rise is taken as quadratic (profile t, [1]_). Where a cost there
    is lower than that of the fit, this was in a local minimum, and is repeated from there.

    References
    ----------
    .. [1] D. M. Bates, D. G. Watts, Nonlinear Regression Analysis (1988), 6.1.
    """
    for again in reversed(range(MINIMA)):
        unknowns, fitted = found
        covariance, lowest, ends = _covariance(fitted.jac, fitted.fun), fitted.cost, []
        for i in range(len(unknowns.of_law.start), len(fitted.x)):
            wide = 1.96 * float(np.sqrt(covariance[i, i]))
            tried = [(np.inf, fitted.x)] * 2
            if wide < SURE:
                along = covariance[:, i] / covariance[i, i]
                tried = [_held(models, found, along * end, i) for end in (-wide, wide)]
            for cost, p in tried:
                if cost < LOWER * lowest:
                    lowest, unknowns.start = cost, p
            rises = [2 * max(cost - fitted.cost, 0.0) for cost, _ in tried]
            roots = np.sqrt(np.array(rises) / variance(fitted.jac, fitted.fun))
            bent = np.where(np.isfinite(roots), roots / 1.96 - 1.0, 0.0)
            # root = 1.96 (t + bent t²) at t of the end
            t = 2.0 / (1.0 + np.sqrt(np.maximum(1.0 + 4.0 * bent, 0.0)))
            ends.append((-wide * float(t[0]), wide * float(t[1])))
        if lowest == fitted.cost or not again:
            break
        found = search(models, unknowns, TOLERANCE)
    return found, ends


def _held(
    models: Sequence[Any], found: Trial, step: FloatArray, i: int
) -> tuple[float, FloatArray]:
    """Least cost with number i held a step from the fit, infinite if there is none; its numbers."""
    unknowns, fitted = found
    n = len(unknowns.of_law.start)
    p = np.clip(fitted.x + step, *(unknowns.bounds + np.array([[1e-9], [-1e-9]])))
    held = SlipUnknowns(unknowns.of_law, unknowns.law(p).slip, (unknowns.names[i - n],))
    held.start[:n] = p[:n]
    try:
        best = search(models, held, PROFILE)[1]
    except InputError:  # no equilibrium there
        return np.inf, p
    p[:n], others = best.x[:n], [j for j in range(n, len(p)) if j != i]
    p[others] += best.x[n:]
    return best.cost, p


def _covariance(J: FloatArray, r: FloatArray) -> FloatArray:
    """(k, k) of the numbers; infinite if unseen."""
    size = np.linalg.norm(J, axis=0)
    seen = size > UNSEEN * size.max()
    found = np.diag(np.full(len(size), 1e8))
    pseudo = np.linalg.pinv(J[:, seen].T @ J[:, seen], hermitian=True)
    found[np.ix_(seen, seen)] = variance(J, r) * pseudo
    return found
