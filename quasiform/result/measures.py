"""What is read off a sheet: draw-in, means over areas, percentiles, and where not to trust it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..energy.membrane import Membrane
from ..net.blank import Blank
from ..net.edges import EdgePoint, disc, edge_points

__all__ = ["EdgePoint", "disc", "edge_points"]

FloatArray = np.ndarray
SLIP_GRADIENT = 2.4
"""Shear gradient at which rovings may slip, degrees/mm: in the 45° off-axis tension test the paper
saw slippage from u = 30 mm on, where the shear jumps by 12° between zones; over a width of 5 mm
(*inferred* from stated facts, the width *assumed*)."""


def percentile(values: FloatArray, areas: FloatArray, share: float) -> float:
    """Value below which `share` of the area lies.

    Examples
    --------
    >>> percentile(np.array([3.0, 1.0, 2.0]), np.array([1.0, 1.0, 8.0]), 0.5)
    2.0
    """
    order = np.argsort(values)
    below = np.cumsum(areas[order])
    return float(values[order][np.searchsorted(below, share * below[-1])])


def shear_stability(membrane: Membrane, x: FloatArray) -> FloatArray:
    """(n_triangles,) stiffness against a local turn of the fibres, MPa; negative: unstable.

    With the tension S_aa along a family, S_aa + W6'' (I8 - I6²/I4) > 0, and the same for the other
    family: the ellipticity of the law for a rotation of the fibres. Softening shear makes bands
    where it fails.
    """
    I4, I6, I8 = membrane.invariants(x)
    S = membrane.stress(x)
    W2 = membrane.fabric.shear.stiffness(I6)
    return np.minimum(S[:, 0, 0] + W2 * (I8 - I6**2 / I4), S[:, 1, 1] + W2 * (I4 - I6**2 / I8))


def shear_gradient(blank: Blank, gamma: FloatArray) -> FloatArray:
    """(n_triangles,) gradient of the shear angle over the flat blank, in units of gamma by mm.

    That of the linear interpolation of area-weighted means at the nodes.
    """
    corners = blank.triangles.ravel()
    weight = np.repeat(blank.areas, 3)
    total = np.bincount(corners, weight, minlength=len(blank.nodes))
    at_nodes = np.bincount(corners, weight * np.repeat(gamma, 3), minlength=len(total)) / total
    grad = blank.basis.interpolate(at_nodes).grad[:, :, 0]
    return np.linalg.norm(grad, axis=0)


def waves(flat: FloatArray, along: FloatArray, curvature: FloatArray) -> tuple[int, float | None]:
    """Count the fibre lines of a family that wave, and measure their wavelength.

    A line that a tool bends turns its curvature twice, from the flange to the punch and back; one
    that waves does so at least four times. Curvature below a tenth of the largest is no wave.

    Parameters
    ----------
    flat : (n, 2) array
        Nodes of the flat sheet, mm.
    along : (2,) array
        Direction of the family.
    curvature : (n,) array
        Normal curvature of the family at the nodes, 1/mm; nan where it has none.

    Returns
    -------
    lines : int
    wavelength : float or None
        Twice the median distance of inflections on these lines, on the flat sheet, mm.
    """
    bent = np.abs(curvature) > 0.1 * np.nanmax(np.abs(curvature), initial=0.0)
    t = np.round(flat[bent] @ [along[1], -along[0]], 6)
    s, kappa = flat[bent] @ along, curvature[bent]
    order = np.lexsort((s, t))
    s, t, kappa = s[order], t[order], kappa[order]
    turns = (t[1:] == t[:-1]) & (kappa[1:] * kappa[:-1] < 0)
    at, line = 0.5 * (s[1:] + s[:-1])[turns], t[1:][turns]
    lines, count = np.unique(line, return_counts=True)
    wavy = lines[count >= 4]
    keep = np.isin(line, wavy)
    spacing = np.diff(at[keep])[np.diff(line[keep]) == 0]
    return len(wavy), 2.0 * float(np.median(spacing)) if len(spacing) else None


def discretisation_error(values: Sequence[FloatArray | float]) -> FloatArray | float:
    """Error of the mesh from the same quantity on meshes that double in size, finest first.

    The differences between the levels go on as they did, by the ratio r of the last two, over three
    more halvings: error = 5/4 d (r + r² + r³), with the safety factor of the grid convergence
    index [1]_. r is kept between a quarter (second order) and two: where a boundary layer is not
    resolved yet, differences grow for a while. Where two levels happen to agree, the quarter of the
    difference before stands in. Two levels alone tell no ratio: the error is twice their
    difference.

    Parameters
    ----------
    values : sequence of float or (n,) arrays
        At least two.

    Returns
    -------
    float or (n,) array

    References
    ----------
    .. [1] P. J. Roache, Journal of Fluids Engineering 116 (1994) 405-413.
    """
    last = np.abs(np.subtract(values[0], values[1]))
    if len(values) == 2:
        return 2.0 * last
    before = np.abs(np.subtract(values[1], values[2]))
    last = np.maximum(last, before / 4)
    r = np.clip(np.divide(last, before, out=np.ones_like(last), where=before > 0), 0.25, 2.0)
    return (1.25 * last * (r + r**2 + r**3))[()]
