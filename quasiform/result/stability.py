"""Local stability of a formed sheet: bands of softening shear, and fibres that may buckle.

A wave of the wave number k along family a, with the amplitude along m ⟂ f_a in the tangent plane,
turns these fibres and stretches none. With H = (m·f_b)² = I8 - I6²/I4 it changes the energy by
k² t0 s + k⁴ r B, where

    s = S_aa + W6'' H = T_a + D,   T_a = S_aa + S_ab I6/I4,   D = W6'' H - S_ab I6/I4.

T_a is the tension of the fibres at constant γ, and D = d²W/dγ² (for I4 = I8 = 1) the stiffness of
shear: s < 0 with D < 0 is softening. Only wavelengths above λ = 2π √(r B/(t0 |s|)) are unstable.
Where such a band ends, it stretches the fibres b, along which it runs: this costs 4 W8'' H (π/l)²
for a length l, which is more than the best wave releases, unless l > λ √(4 W8'' H/|s|). Where
rovings slip, the ends cost next to nothing.

A wave along a out of the plane changes the energy by k² t0 S_aa + k⁴ B: where no tool holds the
sheet, fibres in compression buckle above λ = 2π √(B/(t0 |S_aa|)). In a region of the length L this
is Euler's stress of a clamped strip, 4π² B/(t0 L²).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..energy.bending import Bending
from ..energy.membrane import Membrane
from ..model import Model
from ..net.blank import Blank

FloatArray = np.ndarray
CLEAR = 0.1  # of the thickness: nearer to a tool, the sheet counts as supported
RESOLVED = 4  # spacings a wave: the shortest that a mesh shows (its k² is 19 % too low)
BAND = 15.0  # degrees: how much more than both sides a band is sheared (assumed)


def shear_stability(membrane: Membrane, x: FloatArray) -> FloatArray:
    """(n_triangles,) the smaller s of both families, MPa, at x (n_dofs,).

    It is the ellipticity of the law for a rotation of inextensible fibres.
    """
    return _turning(membrane, x)[0].min(0)


def local_waves(model: Model, x: FloatArray) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Where the mesh of the whole sheet may miss a wave at x (n_dofs,), and how long waves are.

    Returns
    -------
    flags : dict of `bands_may_form` and `fibres_may_buckle`
        (n_triangles,) bool: a wave fits in its region, but is shorter than the mesh shows. Waves
        that the mesh shows are tested by the pivots of the tangent.
    figures : dict of name to float, nan where there is none
        `softening_share` and `compressed_share` of the area, the latter off tools;
        `band_wavelength_mm` and `buckling_wavelength_mm`, the shortest there;
        `compression_by_buckling_stress`, the largest; `mesh_shows_mm`, the shortest wavelength.
    """
    blank, _, _, source, _ = model.sheet.whole
    fabric, along, shown = model.sheet.fabric, (blank.warp, blank.weft), RESOLVED * blank.size
    bends = any(isinstance(term, Bending) for term in model.terms)
    B_t0 = bends * np.array([fabric.bending_warp, fabric.bending_weft]) / fabric.thickness
    s, D, S, EH = (values[:, source] for values in _turning(model.membrane, x))
    free = (model.sheet.dim == 3) & ~_supported(model, x)[source]
    bands, buckles = np.zeros((2, len(source)), dtype=bool)
    band, buckling, ratio = np.full((3, 2, len(source)), np.nan)
    for f in (0, 1):
        soft, stiffness = (s[f] < 0) & (D[f] < 0), fabric.in_plane_bending * B_t0[f]
        across, turning = _runs(blank, along[f], -s[f], soft)
        length, pull = _runs(blank, along[1 - f], -s[f], soft)
        room, stress = _runs(blank, along[f], -S[f], free)
        band[f], buckling[f] = _critical(stiffness, turning), _critical(B_t0[f], stress)
        ends = 0.0 if model.slip else _critical(stiffness, pull) * np.sqrt(EH[f] / pull)
        bands |= (across >= band[f]) & (length >= ends) & (band[f] < shown)
        buckles |= (room >= buckling[f]) & (buckling[f] < shown)
        ratio[f] = stress * room**2 / (4.0 * np.pi**2 * (B_t0[f] or np.nan))
    share = blank.areas / blank.areas.sum()
    figures = {
        "softening_share": float(share @ np.isfinite(band).any(0)),
        "band_wavelength_mm": float(np.fmin.reduce(band, axis=None)),
        "compressed_share": float(share @ np.isfinite(buckling).any(0)),
        "buckling_wavelength_mm": float(np.fmin.reduce(buckling, axis=None)),
        "compression_by_buckling_stress": float(np.fmax.reduce(ratio, axis=None, initial=0.0)),
        "mesh_shows_mm": shown,
    }
    return {"bands_may_form": bands, "fibres_may_buckle": buckles}, figures


def narrow_bands(blank: Blank, gamma: FloatArray) -> np.ndarray:
    """(n_triangles,) bool: in a band along a fibre that is narrower than the mesh shows.

    Half of `RESOLVED` spacings off on both sides the shear angle |gamma| (n_triangles,), degrees,
    averaged over squares of one spacing, is less by `BAND`. The mesh sets the width of such a band.
    """
    squares, index = _squares(blank, *blank.warp)
    off, at = RESOLVED // 2, tuple((squares - squares.min(0)).T)
    angle = np.full([side.max() + 1 for side in at], np.nan)
    angle[at] = np.bincount(index, blank.areas * np.abs(gamma)) / np.bincount(index, blank.areas)
    found = np.zeros(angle.shape, dtype=bool)
    for own, band in ((angle, found), (angle.T, found.T)):
        sides = np.maximum(own[: -2 * off], own[2 * off :])
        band[off:-off] |= own[off:-off] - sides > BAND
    return found[at][index]


def buckle(model: Model, x: FloatArray) -> float:
    """How far a sheet without contact has buckled out of its first plane, mm, at x (n_dofs,).

    The deviation w along z, taken as a virtual displacement, lets the membrane work as much as
    bending takes, where nothing but compression bends the sheet. A sheet that bends under a load is
    in tension or does far less work: the limit is a half.
    """
    deviation = np.zeros_like(x)
    for sheet in model.sheets:
        if sheet.dim == 3:
            deviation[sheet.dofs[:, 2]] = (x - model.x0)[sheet.dofs[:, 2]]
    work = {Membrane: 0.0, Bending: 0.0}
    for term in model.terms:
        for kind in work:
            if isinstance(term, kind):
                work[kind] += float((term.gradient(x) * deviation[term.dofs]).sum())
    bent = 0 < 0.5 * work[Bending] < -work[Membrane]
    return float(np.abs(deviation).max()) if bent else 0.0


def _turning(membrane: Membrane, x: FloatArray) -> tuple[FloatArray, ...]:
    """(2, n_triangles) of warp and weft: s, D, S_aa and 4 W8'' H, MPa."""
    (I4, I6, I8), S, fabric = membrane.invariants(x), membrane.stress(x), membrane.fabric
    along, own = S[:, [0, 1], [0, 1]].T, np.array([I4, I8])
    H = np.maximum(own[::-1] - I6**2 / own, 0.0)
    shear = fabric.shear.stiffness(I6) * H
    stretch = np.array([fabric.weft.stiffness(I8, 1.0), fabric.warp.stiffness(I4, 1.0)])
    return along + shear, shear - S[:, 0, 1] * I6 / own, along, 4.0 * stretch * H


def _supported(model: Model, x: FloatArray) -> np.ndarray:
    """(n_triangles,) bool of the modelled part: a node touches a tool or ply, or nearly so."""
    blank, least = model.sheet.blank, -CLEAR * model.sheet.fabric.thickness
    near = np.zeros(len(blank.nodes), dtype=bool)
    for contact in model.contacts:
        near[contact.points.nodes[contact.penetration(x) > least, 0]] = True
    for contact in model.ply_contacts:
        near |= contact.penetration(x, contact.pairs(x)) > least
    return near[blank.triangles].any(1)


def _critical(stiffness: float, stress: FloatArray) -> FloatArray:
    """2π √(stiffness/stress), mm, of B/t0 in N; nan without stress."""
    return 2.0 * np.pi * np.sqrt(stiffness / stress)


@lru_cache(maxsize=8)  # the same for all states of a run
def _squares(blank: Blank, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    """Squares (n, 2) along a fibre (x, y), row by row, and the square of each triangle."""
    axes = np.array([[-y, x], [x, y]])
    place = np.floor(blank.centroids @ axes.T / blank.size + 1e-6).astype(int)
    squares, index = np.unique(place, axis=0, return_inverse=True)
    return squares, index.ravel()


def _runs(
    blank: Blank, along: FloatArray, stress: FloatArray, where: np.ndarray
) -> tuple[FloatArray, FloatArray]:
    """(n_triangles,) lengths, mm, of the runs along a fibre in which a mean stress acts; the mean.

    The sheet is cut into squares of its size. A run is a row of squares in most of which `where` is
    true and whose mean (n_triangles,) `stress` is positive; elsewhere both are nan.
    """
    squares, index = _squares(blank, *along)
    area = np.bincount(index, blank.areas)
    mean = np.bincount(index, blank.areas * stress * where) / area
    inside = (np.bincount(index, blank.areas * where) > 0.5 * area) & (mean > 0)
    # a square without a centroid, where the mesh is out of step, is no end of a run
    beside = (np.diff(squares, axis=0) <= [0, 2]).all(1)
    start = np.append(True, ~(beside & inside[1:] & inside[:-1]))
    run, first = np.cumsum(start) - 1, np.flatnonzero(start)
    last = np.append(first[1:], len(squares)) - 1
    length = blank.size * (squares[last, 1] - squares[first, 1] + 1)
    found = length, np.bincount(run, mean) / np.bincount(run)
    return tuple(np.where(inside, values[run], np.nan)[index] for values in found)
