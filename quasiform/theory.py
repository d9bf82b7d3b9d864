"""Closed forms and ordinary differential equations that a fabric model is held against.

Nothing here knows about meshes. A shear law enters as two callables on arrays, ``S12(I6)`` in MPa
and its energy ``W(I6)`` in mJ/mm^3, ``W' = S12``; with inextensible fibres ``I6 = sin(gamma)``, so
that a zone of area A and thickness t0 stores ``t0 A W(sin gamma)``. Lengths are in mm, forces in N,
angles in radians.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import OdeSolution, solve_bvp, solve_ivp
from scipy.optimize import OptimizeResult

Law = Callable[[NDArray], NDArray]


@dataclass(frozen=True)
class OffAxisTension:
    """Off-axis tension test of a strip with inextensible fibres and uniform bands.

    With a0 = (cos theta0, sin theta0) and b0 = (sin theta0, -cos theta0), the pull along (1, 0),
    the net is x = A(xi) + B(eta), xi = X . a0, eta = X . b0. The rigid grips fix the fibre
    directions at the xi and eta they reach; what is left of each range,

        alpha = l0 cos(theta0) - w0 sin(theta0),    beta = l0 sin(theta0) - w0 cos(theta0),

    turns by phi_a and phi_b towards the pull. The strip divides into a zone of full shear
    gamma = phi_a + phi_b, zones sheared by phi_a or phi_b alone, and two rigid ends. The closure

        alpha a + beta b = (D + u, e),    D = l0 - w0 sin(2 theta0),    e = w0 cos(2 theta0)

    gives the angles. At 45 degrees this is the bias-extension test of [1]_. At other angles the
    field is admissible, but letting the turn vary across a family of fibres would lower the energy,
    which is therefore an upper bound.

    Parameters
    ----------
    l0 : float
        Length between the grips [mm].
    w0 : float
        Width [mm].
    theta0 : float
        Angle between the pull and the fibres a [rad], between 0 and pi/2.

    Raises
    ------
    ValueError
        If a size or the angle is out of range, or if a fibre joins both grips, that is unless
        ``l0 > w0 max(tan(theta0), cot(theta0))``.

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

    def __post_init__(self):
        """Refuse a strip outside the range of the kinematics."""
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
        """Length of the fibres a between the ends reached by the grips [mm]."""
        return self.l0 * np.cos(self.theta0) - self.w0 * np.sin(self.theta0)

    @property
    def beta(self) -> float:
        """Length of the fibres b between the ends reached by the grips [mm]."""
        return self.l0 * np.sin(self.theta0) - self.w0 * np.cos(self.theta0)

    @property
    def chord(self) -> tuple[float, float]:
        """D and e, the sum of alpha a0 and beta b0 along and across the pull [mm]."""
        D = self.l0 - self.w0 * np.sin(2 * self.theta0)
        return D, self.w0 * np.cos(2 * self.theta0)

    @property
    def displacement_limit(self) -> float:
        """Displacement at which the full-shear zone has collapsed, gamma = pi/2 [mm]."""
        D, _ = self.chord
        return -D + np.sqrt(D**2 + 2 * self.alpha * self.beta)

    @property
    def zone_areas(self) -> NDArray:
        """Areas of the zones in full shear, phi_a only, phi_b only, and rigid, shape (4,) [mm^2].

        The bands cross the strip from edge to edge. They meet in a rectangle alpha by beta, less
        the two corners that a long strip cuts off.
        """
        s, c = np.sin(self.theta0), np.cos(self.theta0)
        overhang = max(self.l0 * s * c - self.w0, 0)
        band_a, band_b = self.alpha * self.w0 / c, self.beta * self.w0 / s
        full = self.alpha * self.beta - overhang**2 / (s * c)
        rigid = self.l0 * self.w0 - band_a - band_b + full
        return np.array([full, band_a - full, band_b - full, rigid])

    def angles(self, u: ArrayLike) -> NDArray:
        """Shear angles gamma, phi_a and phi_b of the three deforming zones.

        Parameters
        ----------
        u : array_like, shape (...)
            Grip displacement [mm]; negative in compression, of a strip that is held flat.

        Returns
        -------
        ndarray, shape (3, ...)
            gamma, phi_a, phi_b [rad].

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
        """Energy stored in the strip, ``t0 sum A_i W(sin gamma_i)``.

        Parameters
        ----------
        u : array_like, shape (...)
            Grip displacement [mm].
        W : callable
            Shear energy as a function of I6 [mJ/mm^3].
        t0 : float
            Thickness [mm].

        Returns
        -------
        ndarray, shape (...)
            Energy [mJ]; away from 45 degrees an upper bound.
        """
        return t0 * np.tensordot(self.zone_areas[:3], W(np.sin(self.angles(u))), axes=1)

    def force(self, u: ArrayLike, S12: Law, t0: float) -> NDArray:
        """Grip force by power balance, ``t0 sum A_i S12(sin gamma_i) cos(gamma_i) dgamma_i/du``.

        Parameters
        ----------
        u : array_like, shape (...)
            Grip displacement [mm].
        S12 : callable
            Shear stress as a function of I6 [MPa].
        t0 : float
            Thickness [mm].

        Returns
        -------
        ndarray, shape (...)
            Force [N], the derivative of `energy`.
        """
        angles = self.angles(u)
        power = S12(np.sin(angles)) * np.cos(angles) * self.angle_rates(u)
        return t0 * np.tensordot(self.zone_areas[:3], power, axes=1)


def picture_frame_displacement(gamma: ArrayLike, side: float) -> NDArray:
    """Displacement of a picture frame along its diagonal, ``2 L cos(pi/4 - gamma/2) - sqrt(2) L``.

    Parameters
    ----------
    gamma : array_like, shape (...)
        Shear angle [rad].
    side : float
        Side L of the frame [mm].

    Returns
    -------
    ndarray, shape (...)
        Displacement [mm].
    """
    return 2 * side * np.cos(np.pi / 4 - np.asarray(gamma) / 2) - np.sqrt(2) * side


def picture_frame_force(gamma: ArrayLike, side: float, S12: Law, t0: float) -> NDArray:
    """Force on a picture frame along its diagonal, ``2 t0 L S12(sin gamma) cos(pi/4 - gamma/2)``.

    It is the derivative of the energy ``t0 L^2 W(sin gamma)`` with respect to the displacement.

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

    Returns
    -------
    ndarray, shape (...)
        Force [N].
    """
    gamma = np.asarray(gamma)
    return 2 * t0 * side * S12(np.sin(gamma)) * np.cos(np.pi / 4 - gamma / 2)


def heavy_elastica(k: float) -> tuple[float, float, float]:
    """Inextensible strip drooping under its own weight from a horizontal clamp.

    Parameters
    ----------
    k : float
        ``w L^3 / B`` with weight per length w [N/mm], length L [mm], bending stiffness B [N mm^2].

    Returns
    -------
    x, drop : float
        Reach and drop of the free end over the length L.
    slope : float
        Slope of the free end below the horizontal [rad].

    Raises
    ------
    ValueError
        If k is negative or not finite.
    RuntimeError
        If the boundary-value problem is not solved to tolerance.
    """
    slope, _, x, drop = _cantilever(k, _weight_beyond).y[:, -1].tolist()
    return x, drop, slope


def heavy_elastica_shape(k: float, s: ArrayLike) -> tuple[NDArray, NDArray]:
    """Curve of the strip of `heavy_elastica`.

    Parameters
    ----------
    k : float
        ``w L^3 / B`` with weight per length w [N/mm], length L [mm], bending stiffness B [N mm^2].
    s : array_like, shape (...)
        Stations along the strip from the clamp over the length L, between 0 and 1.

    Returns
    -------
    x, drop : ndarray, shape (...)
        Reach and drop of the stations over the length L.

    Raises
    ------
    ValueError
        If k is negative or not finite, or a station lies off the strip.
    RuntimeError
        If the boundary-value problem is not solved to tolerance.
    """
    s = np.asarray(s, dtype=float)
    if not np.all((s >= 0) & (s <= 1)):
        raise ValueError(f"s must lie between 0 and 1, got {np.min(s):g} to {np.max(s):g}")
    _, _, x, drop = _cantilever(k, _weight_beyond).sol(s)
    return x, drop


def tip_loaded_elastica(k: float) -> tuple[float, float]:
    """Inextensible cantilever under a dead load across its free end.

    Parameters
    ----------
    k : float
        ``P L^2 / B`` with load P [N], length L [mm], bending stiffness B [N mm^2].

    Returns
    -------
    u, w : float
        Shortening and deflection of the free end over the length L.

    Raises
    ------
    ValueError
        If k is negative or not finite.
    RuntimeError
        If the boundary-value problem is not solved to tolerance.
    """
    _, _, x, w = _cantilever(k, np.ones_like).y[:, -1].tolist()
    return 1 - x, w


def _weight_beyond(s: NDArray) -> NDArray:
    """Weight of the strip beyond the station s over its whole weight."""
    return 1 - s


def _cantilever(k: float, load_beyond: Callable[[NDArray], NDArray]) -> OptimizeResult:
    """Solve theta'' = -k load_beyond(s) cos(theta), theta(0) = theta'(1) = 0, over s in [0, 1].

    The states of the solution are theta, theta', x and drop.
    """
    if not 0 <= k < np.inf:
        raise ValueError(f"the load parameter k must be finite and not negative, got {k}")

    def rates(s, state):
        theta, curvature, _, _ = state
        return np.array(
            [curvature, -k * load_beyond(s) * np.cos(theta), np.cos(theta), np.sin(theta)]
        )

    def clamp_and_free_end(clamp, tip):
        return np.array([clamp[0], tip[1], clamp[2], clamp[3]])

    # First guess: a long cantilever under a tip load, theta'' = -k cos(theta), theta -> pi/2.
    s = np.linspace(0, 1, 101)
    decay = np.tan(np.pi / 8) * np.exp(-np.sqrt(k) * s)
    theta = np.pi / 2 - 4 * np.arctan(decay)
    curvature = 4 * np.sqrt(k) * decay / (1 + decay**2)
    guess = np.array([theta, curvature, s * np.cos(theta), s * np.sin(theta)])
    tolerance = 1e-9
    solution = solve_bvp(rates, clamp_and_free_end, s, guess, tol=tolerance, max_nodes=20_000)
    if not solution.success:
        raise RuntimeError(
            f"elastica with k = {k:g} not solved after {solution.niter} iterations: residual "
            f"{solution.rms_residuals.max():.1e}, tolerance {tolerance:.0e}; take a smaller k"
        )
    return solution


def hemisphere_net(a: ArrayLike, b: ArrayLike, radius: float) -> NDArray:
    """Shear angle of the inextensible net on a sphere, two of whose fibres cross at the pole.

    The angle obeys gamma_ab = cos(gamma) / R^2 and vanishes on the two fibres through the pole,
    hence gamma = g(p), p = a b / R^2, with p g'' + g' = cos(g), g(0) = 0, g'(0) = 1. The net is
    the same for every shear law.

    Parameters
    ----------
    a, b : array_like, shape (...)
        Lengths along the fibres from the two that cross at the pole, with sign [mm].
    radius : float
        Radius R of the sphere in which the mid-surface lies [mm].

    Returns
    -------
    ndarray, shape (...)
        Shear angle [rad], with the sign of a b.

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
    """Shear angle and material coordinate on the bias line of the net of `hemisphere_net`.

    On the line a = b = s both fibres make the angle pi/4 - gamma/2 with the meridian, therefore
    R d(colatitude) = 2 cos(pi/4 - gamma/2) ds.

    Parameters
    ----------
    colatitude : array_like, shape (...)
        Angle from the pole [rad], from 0 to pi/2.
    radius : float
        Radius R of the sphere in which the mid-surface lies [mm].

    Returns
    -------
    gamma : ndarray, shape (...)
        Shear angle [rad].
    s : ndarray, shape (...)
        Fibre length a = b = s from the fibres that cross at the pole [mm].

    Raises
    ------
    ValueError
        If the radius is not positive or a colatitude lies outside the hemisphere.
    """
    colatitude = np.asarray(colatitude, dtype=float)
    if not np.all((colatitude >= 0) & (colatitude <= np.pi / 2)):
        raise ValueError("colatitude must lie between 0 and pi/2 radians")

    def fibre_length_rate(_, s):
        return radius / (2 * np.cos(np.pi / 4 - hemisphere_net(s, s, radius) / 2))

    solution = solve_ivp(
        fibre_length_rate,
        (0, np.pi / 2),
        [0.0],
        method="DOP853",
        dense_output=True,
        rtol=1e-11,
        atol=1e-12 * radius,
    )
    s = solution.sol(colatitude.ravel())[0].reshape(colatitude.shape)
    return hemisphere_net(s, s, radius), s


def _pole_series(p: ArrayLike) -> tuple[ArrayLike, ArrayLike]:
    """Return g and p g' to p^5, from p g'' + g' = sum of n^2 c_n p^(n-1) = cos(g)."""
    return p - p**3 / 18 + 7 * p**5 / 1800, p - p**3 / 6 + 7 * p**5 / 360


@cache
def _hemisphere_solution() -> OdeSolution:
    """Integrate g' = h/p, h' = cos(g) from the series at the pole to the collapse g = pi/2."""

    def collapse(_, state):
        return state[0] - np.pi / 2

    collapse.terminal = True
    p0 = 0.01
    return solve_ivp(
        lambda p, state: [state[1] / p, np.cos(state[0])],
        (p0, 10),
        _pole_series(p0),
        method="DOP853",
        events=collapse,
        dense_output=True,
        rtol=1e-12,
        atol=1e-14,
    ).sol


def strip_friction(mu: float, mass: float) -> float:
    """Force that draws a strip from between two plates, ``2 mu m g`` [N].

    Parameters
    ----------
    mu : float
        Friction coefficient of each face.
    mass : float
        Mass that presses the plates together [kg]; g = 9.81 m/s^2.

    Returns
    -------
    float
        Force [N].
    """
    return 2 * mu * mass * 9.81


def capstan_ratio(mu: float, angle: ArrayLike) -> NDArray:
    """Ratio of the pulls on a strip sliding over a cylinder, ``exp(mu angle)``.

    Parameters
    ----------
    mu : float
        Friction coefficient.
    angle : array_like, shape (...)
        Angle of wrap [rad].

    Returns
    -------
    ndarray, shape (...)
        Larger pull over the smaller one.
    """
    return np.exp(mu * np.asarray(angle))
