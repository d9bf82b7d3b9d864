"""Exact solutions that a fabric model is compared with: closed forms and differential equations.

Nothing here depends on a mesh or on the rest of the package. A shear law is passed as two functions
of arrays, ``S12(I6)`` in MPa and its energy ``W(I6)`` in mJ/mm^3, ``W' = S12``. With inextensible
fibres ``I6 = sin(gamma)``, so a zone of area A and thickness t0 stores ``t0 A W(sin gamma)``.
Lengths are in mm, forces in N, angles in radians.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy as sp  # its parts load when they are used
from numpy.typing import ArrayLike, NDArray

Law = Callable[[NDArray], NDArray]


@dataclass(frozen=True)
class OffAxisTension:
    """Off-axis tension test of a strip with inextensible fibres and uniform bands.

    With a0 = (cos theta0, sin theta0) and b0 = (sin theta0, -cos theta0), the pull along (1, 0),
    the net is x = A(xi) + B(eta), xi = X . a0, eta = X . b0. The rigid grips fix the fibre
    directions at the xi and eta that they reach. The rest of each range,

        alpha = l0 cos(theta0) - w0 sin(theta0),    beta = l0 sin(theta0) - w0 cos(theta0),

    turns by phi_a and phi_b towards the pull. The strip divides into a zone of full shear
    gamma = phi_a + phi_b, zones sheared by phi_a or phi_b alone, and two rigid ends. The closure

        alpha a + beta b = (D + u, e),    D = l0 - w0 sin(2 theta0),    e = w0 cos(2 theta0)

    gives the angles. At 45 degrees this is the bias-extension test of [1]_. At other angles the
    field is admissible, but a turn that varies across a family of fibres has a lower energy: the
    energy given here is an upper bound.

    Parameters
    ----------
    l0, w0 : float
        Length between the grips and width [mm].
    theta0 : float
        Angle between the pull and the fibres a [rad], between 0 and pi/2.

    Raises
    ------
    ValueError
        If a size or the angle is out of range, or if a fibre joins both grips, that is if
        ``l0 <= w0 max(tan(theta0), cot(theta0))``.

    References
    ----------
    .. [1] J. Cao et al., Composites Part A 39 (2008) 1037-1053, Eq. 18.

    Examples
    --------
    >>> strip = OffAxisTension(l0=320, w0=160, theta0=np.pi / 4)
    >>> np.degrees(strip.angles(40)).round(2)
    array([34.23, 17.11, 17.11])
    """

    l0: float
    w0: float
    theta0: float

    def __post_init__(self) -> None:
        for name, size in (("l0", self.l0), ("w0", self.w0)):
            if not 0 < size < np.inf:
                raise ValueError(f"`OffAxisTension({name}=...)` must be positive, got {size}")
        if not 0 < self.theta0 < np.pi / 2:
            raise ValueError(
                "`OffAxisTension(theta0=...)` must lie between 0 and pi/2 radians, "
                f"got {self.theta0}"
            )
        shortest = self.w0 * max(np.tan(self.theta0), 1 / np.tan(self.theta0))
        if not self.l0 > shortest:
            raise ValueError(
                f"fibres join both grips: at {np.degrees(self.theta0):g} degrees and "
                f"w0 = {self.w0:g} mm the length l0 must exceed {shortest:.6g} mm, got {self.l0:g}"
            )

    @property
    def alpha(self) -> float:
        """Length of the fibres a that is free to turn [mm]."""
        return self.l0 * np.cos(self.theta0) - self.w0 * np.sin(self.theta0)

    @property
    def beta(self) -> float:
        """Length of the fibres b that is free to turn [mm]."""
        return self.l0 * np.sin(self.theta0) - self.w0 * np.cos(self.theta0)

    @property
    def chord(self) -> tuple[float, float]:
        """D and e, the sum of alpha a0 and beta b0 along and across the pull [mm]."""
        angle = 2 * self.theta0
        return self.l0 - self.w0 * np.sin(angle), self.w0 * np.cos(angle)

    @property
    def displacement_limit(self) -> float:
        """Displacement at which the full-shear zone has collapsed, gamma = pi/2 [mm]."""
        D, _ = self.chord
        return -D + np.sqrt(D**2 + 2 * self.alpha * self.beta)

    @property
    def zone_areas(self) -> NDArray:
        """Areas of the zones in full shear, phi_a only, phi_b only, and rigid, shape (4,) [mm^2].

        The two bands cross the strip from edge to edge. They meet in a rectangle of alpha by beta,
        without the two corners that lie outside a long strip.
        """
        s, c = np.sin(self.theta0), np.cos(self.theta0)
        overhang = max(self.l0 * s * c - self.w0, 0)
        band_a, band_b = self.alpha * self.w0 / c, self.beta * self.w0 / s
        full = self.alpha * self.beta - overhang**2 / (s * c)
        rigid = self.l0 * self.w0 - band_a - band_b + full
        return np.array([full, band_a - full, band_b - full, rigid])

    def angles(self, u: ArrayLike) -> NDArray:
        """Shear angles gamma, phi_a and phi_b of the three deforming zones, shape (3, ...) [rad].

        Parameters
        ----------
        u : array_like, shape (...)
            Grip displacement [mm]; negative where a flat strip is compressed.

        Raises
        ------
        ValueError
            If a displacement reaches the collapse of the net, ``abs(gamma) = pi/2``.
        """
        u = np.asarray(u, dtype=float)
        alpha, beta, (D, e) = self.alpha, self.beta, self.chord
        I6 = u * (2 * D + u) / (2 * alpha * beta)
        if not np.all((u > -D) & (np.abs(I6) < 1)):
            shortest = -D + np.sqrt(D**2 - 2 * alpha * beta)
            raise ValueError(
                f"u must lie between {shortest:.6g} and {self.displacement_limit:.6g} mm, where "
                f"the shear angle is 90 degrees, got {np.min(u):.6g} to {np.max(u):.6g}"
            )
        gamma = np.arcsin(I6)
        direction_a = np.arctan2(e, D + u) + np.arctan2(beta * np.cos(gamma), alpha + beta * I6)
        phi_a = self.theta0 - direction_a
        return np.array([gamma, phi_a, gamma - phi_a])

    def angle_rates(self, u: ArrayLike) -> NDArray:
        """Differentiate `angles` with respect to the displacement, shape (3, ...) [rad/mm]."""
        u = np.asarray(u, dtype=float)
        alpha, beta, (D, e) = self.alpha, self.beta, self.chord
        gamma = self.angles(u)[0]
        dgamma = (D + u) / (alpha * beta * np.cos(gamma))
        dphi_a = (e + beta * (beta + alpha * np.sin(gamma)) * dgamma) / ((D + u) ** 2 + e**2)
        return np.array([dgamma, dphi_a, dgamma - dphi_a])

    def energy(self, u: ArrayLike, W: Law, t0: float) -> NDArray:
        """Energy of the strip, ``t0 sum A_i W(sin gamma_i)``, shape (...) [mJ].

        `u` as in `angles`, shear energy ``W(I6)`` [mJ/mm^3], thickness `t0` [mm].
        """
        return t0 * np.tensordot(self.zone_areas[:3], W(np.sin(self.angles(u))), axes=1)

    def force(self, u: ArrayLike, S12: Law, t0: float) -> NDArray:
        """Grip force, the derivative of `energy`, shape (...) [N].

        It follows from the power balance, ``t0 sum A_i S12(sin gamma_i) cos(gamma_i) dgamma_i/du``,
        with `u` as in `angles`, shear stress ``S12(I6)`` [MPa] and thickness `t0` [mm].
        """
        angles = self.angles(u)
        power = S12(np.sin(angles)) * np.cos(angles) * self.angle_rates(u)
        return t0 * np.tensordot(self.zone_areas[:3], power, axes=1)


def picture_frame_displacement(gamma: ArrayLike, side: float) -> NDArray:
    """Displacement of a picture frame along its diagonal, ``2 L cos(pi/4 - gamma/2) - sqrt(2) L``.

    Parameters
    ----------
    gamma : array_like, shape (...)
        Shear angle [rad]; the displacement [mm] has its shape.
    side : float
        Side L of the frame [mm].
    """
    return 2 * side * np.cos(np.pi / 4 - np.asarray(gamma) / 2) - np.sqrt(2) * side


def picture_frame_force(gamma: ArrayLike, side: float, S12: Law, t0: float) -> NDArray:
    """Force on a picture frame along its diagonal, shape (...) [N].

    The force ``2 t0 L S12(sin gamma) cos(pi/4 - gamma/2)`` is the derivative of the energy
    ``t0 L^2 W(sin gamma)`` with respect to the displacement.

    Parameters
    ----------
    gamma : array_like, shape (...)
        Shear angle [rad].
    side : float
        Side L of the frame and of the fabric in it [mm].
    S12 : callable
        Shear stress as a function of I6 [MPa].
    t0 : float
        Thickness [mm].
    """
    gamma = np.asarray(gamma)
    return 2 * t0 * side * S12(np.sin(gamma)) * np.cos(np.pi / 4 - gamma / 2)


def heavy_elastica(k: float) -> tuple[float, float, float]:
    """Free end of an inextensible strip that bends under its own weight from a horizontal clamp.

    Parameters
    ----------
    k : float
        ``w L^3 / B`` with weight per length w [N/mm], length L [mm], bending stiffness B [N mm^2].

    Returns
    -------
    x, drop, slope : float
        Reach and drop over the length L, and slope below the horizontal [rad].

    Raises
    ------
    ValueError
        If k is negative or not finite.
    RuntimeError
        If the boundary-value problem does not converge.
    """
    slope, _, x, drop = _cantilever(k, lambda s: 1 - s).y[:, -1].tolist()
    return x, drop, slope


def heavy_elastica_shape(k: float, s: ArrayLike) -> tuple[NDArray, NDArray]:
    """Reach and drop over the length L of points on the strip of `heavy_elastica`, shape (...).

    `s` are their distances from the clamp along the strip over L, between 0 and 1, shape (...); `k`
    and errors as in `heavy_elastica`.
    """
    s = np.asarray(s, dtype=float)
    if not np.all((s >= 0) & (s <= 1)):
        raise ValueError(f"s must lie between 0 and 1, got {np.min(s):g} to {np.max(s):g}")
    _, _, x, drop = _cantilever(k, lambda s: 1 - s).sol(s)
    return x, drop


def tip_loaded_elastica(k: float) -> tuple[float, float]:
    """Free end of an inextensible cantilever under a load across it; errors as `heavy_elastica`.

    With ``k = P L^2 / B``, load P [N], length L [mm], bending stiffness B [N mm^2], these are the
    shortening and the deflection of the end over the length L.
    """
    _, _, x, w = _cantilever(k, np.ones_like).y[:, -1].tolist()
    return 1 - x, w


def _cantilever(k: float, load_beyond: Callable[[NDArray], NDArray]) -> sp.optimize.OptimizeResult:
    """Solve theta'' = -k load_beyond(s) cos(theta), theta(0) = theta'(1) = 0, for 0 <= s <= 1.

    `load_beyond(s)` is the part of the load that acts between s and the free end. The rows of the
    solution are theta, theta', x and drop.
    """
    if not 0 <= k < np.inf:
        raise ValueError(f"the load parameter k must be finite and not negative, got {k}")

    def rates(s: NDArray, state: NDArray) -> NDArray:
        c = np.cos(state[0])
        return np.array([state[1], -k * load_beyond(s) * c, c, np.sin(state[0])])

    def ends(clamp: NDArray, tip: NDArray) -> NDArray:
        return np.array([clamp[0], tip[1], clamp[2], clamp[3]])

    # first guess: a long cantilever under a tip load, theta'' = -k cos(theta), theta -> pi/2
    s = np.linspace(0, 1, 101)
    decay = np.tan(np.pi / 8) * np.exp(-np.sqrt(k) * s)
    theta = np.pi / 2 - 4 * np.arctan(decay)
    curvature = 4 * np.sqrt(k) * decay / (1 + decay**2)
    guess = np.array([theta, curvature, s * np.cos(theta), s * np.sin(theta)])
    solution = sp.integrate.solve_bvp(rates, ends, s, guess, tol=1e-9, max_nodes=20_000)
    if not solution.success:
        raise RuntimeError(
            f"elastica with k = {k:g} not solved after {solution.niter} iterations: residual "
            f"{solution.rms_residuals.max():.1e}, tolerance 1e-09; take a smaller k"
        )
    return solution


def heavy_strip(
    length: float, weight: float, curvature: NDArray, moment: NDArray
) -> tuple[float, float, float]:
    """Free end of a strip under its own weight whose moment is not proportional to its curvature.

    As `heavy_elastica`, with ``M' = -w (L - s) cos(theta)``, ``theta' = kappa(M)``, M(L) = 0. The
    moment at the clamp is found by shooting.

    Parameters
    ----------
    length, weight : float
        Free length [mm] and weight per area [N/mm^2].
    curvature, moment : ndarray
        Points of the curve from (0, 0), both increasing [1/mm, N], linear between and beyond them.

    Returns
    -------
    x, drop, slope : float
        Reach and drop of the free end [mm], and its slope below the horizontal [rad].
    """
    slope = (curvature[-1] - curvature[-2]) / (moment[-1] - moment[-2])

    def kappa(M: float) -> float:
        beyond = max(abs(M) - moment[-1], 0.0) * slope
        return np.sign(M) * (np.interp(abs(M), moment, curvature) + beyond)

    def rates(s: float, state: NDArray) -> list[float]:
        theta, M = state[:2]
        turn, weighs = kappa(M), weight * (length - s)
        return [turn, -weighs * np.cos(theta), np.cos(theta), np.sin(theta)]

    def end(clamp: float) -> NDArray:
        start = [0.0, clamp, 0.0, 0.0]
        run = sp.integrate.solve_ivp(rates, (0.0, length), start, rtol=1e-8, atol=1e-10)
        return run.y[:, -1]

    most = weight * length**2 / 2  # of a strip that does not bend
    clamp = sp.optimize.brentq(lambda M: end(M)[1], 0.0, most, xtol=1e-12 * most, rtol=1e-12)
    theta, _, x, drop = end(clamp).tolist()
    return x, drop, theta


def hemisphere_net(a: ArrayLike, b: ArrayLike, radius: float) -> NDArray:
    """Shear angle of an inextensible net on a sphere, with the sign of a b, shape (...) [rad].

    Two fibres cross at the pole. The angle obeys gamma_ab = cos(gamma) / R^2 and is zero on these
    two, hence gamma = g(p), p = a b / R^2, with p g'' + g' = cos(g), g(0) = 0, g'(0) = 1. The net
    is the same for every shear law.

    Parameters
    ----------
    a, b : array_like, shape (...)
        Lengths along the fibres from the two that cross at the pole, with sign [mm].
    radius : float
        Radius R of the sphere in which the mid-surface lies [mm].

    Raises
    ------
    ValueError
        If the radius is not positive or a point lies where the net has collapsed, gamma = pi/2.
    """
    if not 0 < radius < np.inf:
        raise ValueError(f"`hemisphere_net(radius=...)` must be positive, got {radius}")
    p = np.asarray(a, dtype=float) * b / radius**2
    g = _hemisphere_solution()
    if not np.all(np.abs(p) <= g.t_max):
        raise ValueError(
            f"the net collapses at a b / radius^2 = {g.t_max:.6g}, got {np.abs(p).max():.6g}"
        )
    outside_series = np.clip(np.abs(p), g.t_min, None)
    gamma = np.sign(p) * g(outside_series.ravel())[0].reshape(p.shape)
    return np.where(np.abs(p) < g.t_min, _pole_series(p)[0], gamma)


def hemisphere_bias(colatitude: ArrayLike, radius: float) -> tuple[NDArray, NDArray]:
    """Shear angle and fibre length on the bias line of the net of `hemisphere_net`.

    On the line a = b = s the angle between both fibres and the meridian is pi/4 - gamma/2, hence
    R d(colatitude) = 2 cos(pi/4 - gamma/2) ds.

    Parameters
    ----------
    colatitude : array_like, shape (...)
        Angle from the pole [rad], from 0 to pi/2.
    radius : float
        Radius R of the sphere [mm].

    Returns
    -------
    gamma, s : ndarray, shape (...)
        Shear angle [rad] and length a = b = s from the fibres that cross at the pole [mm].

    Raises
    ------
    ValueError
        If the radius is not positive or a colatitude lies outside the hemisphere.
    """
    colatitude = np.asarray(colatitude, dtype=float)
    if not np.all((colatitude >= 0) & (colatitude <= np.pi / 2)):
        raise ValueError("colatitude must lie between 0 and pi/2 radians")

    def fibre_length_rate(_: float, s: NDArray) -> NDArray:
        return radius / (2 * np.cos(np.pi / 4 - hemisphere_net(s, s, radius) / 2))

    length = _integrate(fibre_length_rate, (0, np.pi / 2), [0.0], 1e-11, 1e-12 * radius)
    s = length(colatitude.ravel())[0].reshape(colatitude.shape)
    return hemisphere_net(s, s, radius), s


def _pole_series(p: ArrayLike) -> tuple[ArrayLike, ArrayLike]:
    """Return g and p g' up to p^5, from p g'' + g' = sum of n^2 c_n p^(n-1) = cos(g)."""
    return p - p**3 / 18 + 7 * p**5 / 1800, p - p**3 / 6 + 7 * p**5 / 360


@cache
def _hemisphere_solution() -> sp.integrate.OdeSolution:
    """Solution of g' = h/p, h' = cos(g) from the series at the pole to the collapse g = pi/2."""

    def collapse(_: float, state: NDArray) -> float:
        return state[0] - np.pi / 2

    collapse.terminal, p0 = True, 0.01
    span, start = (p0, 10), _pole_series(p0)
    return _integrate(lambda p, y: [y[1] / p, np.cos(y[0])], span, start, 1e-12, 1e-14, collapse)


def _integrate(rates, span, start, rtol, atol, events=None) -> sp.integrate.OdeSolution:
    settings = {"dense_output": True, "events": events, "rtol": rtol, "atol": atol}
    return sp.integrate.solve_ivp(rates, span, start, "DOP853", **settings).sol


def strip_friction(mu: float, mass: float) -> float:
    """Force ``2 mu m g``, g = 9.81 m/s^2, that pulls a strip out of two plates [N].

    `mu` is the friction coefficient of each face, `mass` presses the plates together [kg].
    """
    return 2 * mu * mass * 9.81


def capstan_ratio(mu: float, angle: ArrayLike) -> NDArray:
    """Larger over smaller pull on a strip that slides over a cylinder, ``exp(mu angle)``.

    `mu` is the friction coefficient, `angle` that of the wrap, shape (...) [rad].
    """
    return np.exp(mu * np.asarray(angle))
