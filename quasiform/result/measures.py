"""What is read off a formed sheet and its tools: draw-in, means, penetration, wrinkles, limits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..energy.bending import Bending
from ..energy.contact import Contact, moment
from ..energy.diaphragm import Diaphragm
from ..energy.slip import Slipped
from ..model import COLLAPSE, Model
from ..net.blank import Blank
from ..net.transfer import percentile
from .sheet import DOUBTS, FormedSheet
from .stability import buckle, local_waves, narrow_bands, shear_stability

FloatArray = np.ndarray
LEAST_FORCE = 0.05  # of a contact force: a radius with less on it does not count
LIFTED = 0.1  # of the thickness: a sheet that is lifted or buckles further has wrinkled
GAP = 0.01  # strain across the rovings of a layer from which on they leave a gap
SLIP_GRADIENT = 2.4
"""Shear gradient at which rovings may slip, degrees/mm: in the 45° off-axis tension test the paper
saw slippage from u = 30 mm on, where the shear jumps by 12° between zones; over a width of 5 mm
(*inferred* from stated facts, the width *assumed*)."""


def nodal(blank: Blank, values: FloatArray) -> FloatArray:
    """(n_nodes,) means of (n_triangles,) values around the nodes, weighted by area."""
    return FormedSheet(flat=blank.nodes, triangles=blank.triangles).at_nodes(values)


def shear_gradient(blank: Blank, gamma: FloatArray) -> FloatArray:
    """(n_triangles,) gradient over the flat blank of gamma, linear between its nodal means."""
    grad = blank.basis.interpolate(nodal(blank, gamma)).grad[:, :, 0]
    return np.linalg.norm(grad, axis=0)


def waves(
    flat: FloatArray, along: FloatArray, curvature: FloatArray, least: float = 0.0
) -> tuple[int, float | None]:
    """Count the fibre lines of a family that wave, and measure their wavelength.

    A line that a tool bends turns its curvature twice, from the flange to the punch and back; one
    that waves does so at least four times. Curvature below a tenth of the largest is no wave, nor
    is a half-wave of curvature κ and length d whose height κ (d/π)² is below `least`, mm.
    `flat` (n, 2) are the nodes of the flat sheet (mm), `along` (2,) is the direction of the family
    and `curvature` (n,) its normal curvature (1/mm), nan where it has none. The wavelength is twice
    the median distance of inflections on these lines, on the flat sheet, mm.
    """
    bent = np.abs(curvature) > 0.1 * np.nanmax(np.abs(curvature), initial=0.0)
    if not bent.any():
        return 0, None
    t = np.round(flat[bent] @ [along[1], -along[0]], 6)
    s, kappa = flat[bent] @ along, curvature[bent]
    order = np.lexsort((s, t))
    s, t, kappa = s[order], t[order], kappa[order]
    begins = np.r_[True, (t[1:] != t[:-1]) | (kappa[1:] * kappa[:-1] < 0)]
    first = np.flatnonzero(begins)  # of each half-wave
    last = np.r_[first[1:], len(t)] - 1
    spacing = np.median(np.diff(np.unique(np.round(flat @ along, 6))))
    height = np.maximum.reduceat(np.abs(kappa), first)
    height *= ((last - first + 1) * spacing / np.pi) ** 2
    turns = np.flatnonzero((t[last[:-1]] == t[first[1:]]) & (height[:-1] >= least))
    at, line = 0.5 * (s[last[turns]] + s[first[turns + 1]]), t[first[turns]]
    lines, count = np.unique(line, return_counts=True)
    wavy = lines[count >= 4]
    keep = np.isin(line, wavy)
    spacing = np.diff(at[keep])[np.diff(line[keep]) == 0]
    return len(wavy), 2.0 * float(np.median(spacing)) if len(spacing) else None


def formed(
    model: Model, x: FloatArray, travel: float, error: FloatArray | None = None
) -> FormedSheet:
    """Formed sheet of the whole blank at x (n_dofs,), with all fields of `result.vtu`.

    `error` is that of the shear angle by triangle, degrees, where it was estimated.
    """
    sheet, membrane = model.sheet, model.membrane
    blank, node, _, source, sign = sheet.whole
    points, start = sheet.whole_positions(x), np.pad(blank.nodes, ((0, 0), (0, 1)))
    if sheet.dim == 3:
        start[:, 2] = sheet.positions(model.x0)[node, 2]
    force = sum((c.nodal_force(x) for c in model.contacts), np.zeros(len(sheet.blank.nodes)))
    at_nodes = {
        "displacement": points - start,
        "contact_pressure": (force / sheet.blank.node_areas)[node],
    }
    bare = FormedSheet(points, blank.triangles, blank.nodes, travel=travel)
    I4, _, I8 = membrane.invariants(x)
    gamma, stability = shear_angle(model, x), shear_stability(membrane, x)[source]
    warp, weft = _fibres(model, x, bare)
    slipping, at_slip = _slip(model, x)
    doubts = {
        "beyond_identified_range": np.abs(gamma) > sheet.fabric.shear_range,
        **local_waves(model, x)[0],
        "collapsed": np.abs(gamma) > np.degrees(COLLAPSE),
        "rovings_may_slip": far_slipped(model, x)
        if model.slip
        else shear_gradient(blank, np.abs(gamma)) > SLIP_GRADIENT,
        "narrow_bands": narrow_bands(blank, gamma),
    }
    fields = {} if error is None else {"shear_angle_error": error}
    fields |= {
        "shear_angle": gamma,
        "warp": warp,
        "weft": weft,
        "E11": (0.5 * (I4 - 1.0))[source],
        "E22": (0.5 * (I8 - 1.0))[source],
        "S12": membrane.stress(x)[source, 0, 1] * sign,
        "shear_stability": stability,
        **slipping,
        "doubt": sum(2**bit * doubts[name].astype(float) for bit, name in enumerate(DOUBTS)),
    }
    return replace(bare, point_fields=at_nodes | at_slip, cell_fields=fields)


def formed_diaphragm(model: Model, x: FloatArray, travel: float) -> FormedSheet | None:
    """Formed diaphragm with its `thickness` at x (n_dofs,); None of a model without."""
    for term in (term for term in model.membranes if isinstance(term, Diaphragm)):
        blank, _, _, source, _ = term.sheet.whole
        fields = {"thickness": term.thickness(x)[source]}
        given = {"cell_fields": fields, "name": term.sheet.name, "travel": travel}
        points = term.sheet.whole_positions(x)
        return FormedSheet(points, blank.triangles, blank.nodes, **given)
    return None


def _fibres(model: Model, x: FloatArray, bare: FormedSheet) -> FloatArray:
    """(2, m, 3) unit vectors of warp and weft, each of its own layer where these slip."""
    blank = model.sheet.whole[0]
    along = np.array([blank.warp, blank.weft])
    if not model.slip:
        return bare.fibres(along)
    half = 0.5 * model.sheet.unfolded(x[model.slip.dofs])
    layers = (replace(bare, points=bare.points + s * half) for s in (1.0, -1.0))
    return np.array([layer.fibres(along)[f] for f, layer in enumerate(layers)])


def _slip(model: Model, x: FloatArray) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Fields of slipping rovings by triangle and by node of the whole sheet; none without slip."""
    if not model.slip:
        return {}, {}
    _, node, sign, source, _ = model.sheet.whole
    E22, E11 = model.membrane.across(x)
    slid = model.slip.along_fibres(x)[node]
    blank = model.sheet.blank
    for axis in ("xy".index(plane) for plane in blank.mirror):
        slid[:, int(abs(blank.warp[axis]) < 0.5)] *= sign[:, axis]
    at_nodes = {"slip_warp": slid[:, 0], "slip_weft": slid[:, 1]}
    return {"E22_warp_layer": E22[source], "E11_weft_layer": E11[source]}, at_nodes


def far_slipped(model: Model, x: FloatArray) -> np.ndarray:
    """(m,) bool: triangles of the whole sheet that have slipped by more than a size of the mesh."""
    blank = model.sheet.blank
    far = np.linalg.norm(x[model.slip.dofs], axis=1) > blank.size
    return far[blank.triangles].any(1)[model.sheet.whole[3]]


def slip_account(model: Model, x: FloatArray, state: Slipped) -> dict[str, Any]:
    """Largest slip (mm), energy that slip has dissipated and stores (mJ, whole sheet), and gaps.

    A gap is where the strain across the rovings of a layer exceeds `GAP`; its share is of the area.
    """
    fields, slid = _slip(model, x)
    areas = model.sheet.whole[0].areas
    across = np.maximum(*fields.values())
    found = {f"largest_{name}_mm": float(np.abs(values).max()) for name, values in slid.items()}
    return found | {
        "largest_mm": float(np.linalg.norm(x[model.slip.dofs], axis=1).max()),
        "dissipated_mJ": float(state.lost.sum()) / model.share,
        "stored_mJ": float(model.slip.energy(x, state).sum()) / model.share,
        "gap_share": float(areas @ (across > GAP) / areas.sum()),
        "gap_strain_p99": percentile(across, areas, 0.99),
    }


def shear_angle(model: Model, x: FloatArray) -> FloatArray:
    """(n_triangles,) signed shear angle of the whole blank at x (n_dofs,), degrees."""
    _, _, _, source, sign = model.sheet.whole
    return np.degrees(model.membrane.shear_angle(x))[source] * sign


def flange_lift(model: Model, x: FloatArray) -> float:
    """How far the sheet leaves the flat faces of fixed tools, mm, at positions x (n_dofs,)."""
    lift = 0.0
    for contact in model.contacts:
        if contact.tool.motion == "fixed":
            d, n, _ = contact.distance(contact.relative(x))
            above = np.abs(n[:, 2]) > 0.99
            gaps = (d - contact.reach - contact.points.sag)[above]
            lift = max(lift, float(gaps.max(initial=0.0)))
    return lift


def wrinkles(model: Model, x: FloatArray) -> dict[str, float | None]:
    """Largest curvature (1/mm), and of each family how many lines wave and how far apart (mm).

    Off punch and die, at x (n_dofs,). Empty without bending. Without contact also how far the sheet
    has buckled, mm.
    """
    blank, source, *_ = model.sheet.whole
    found: dict[str, float | None] = {}
    for term in model.terms:
        if not isinstance(term, Bending) or term.sheet.dim == 2:
            continue
        kappa = term.curvature(x)
        found["largest_curvature_1_per_mm"] = float(np.abs(kappa).max())
        at_nodes = np.full((source.max() + 1, 2), np.nan)
        at_nodes[term.nodes[:, 0]] = kappa
        for contact in model.contacts:
            if contact.tool.motion != "free":
                at_nodes[contact.nodal_force(x) > 0] = np.nan
        for f, family in enumerate(("warp", "weft")):
            bent = blank.nodes, getattr(blank, family), at_nodes[source, f]
            lines, wavelength = waves(*bent, LIFTED * term.sheet.fabric.thickness)
            found[f"waving_{family}_lines"] = lines
            found[f"{family}_wavelength_mm"] = wavelength
        if not model.contacts:
            found["buckle_mm"] = buckle(model, x)
    return found


def max_penetration(model: Model, x: FloatArray) -> float:
    """Deepest penetration into a tool at the contact points, mm."""
    return max([0.0, *(float(contact.penetration(x).max()) for contact in model.contacts)])


def max_ply_penetration(model: Model, x: FloatArray) -> float:
    """Deepest penetration of plies into each other at their nodes, mm; 0 of one sheet.

    Beyond the depth to which they are soft.
    """
    found = (c.penetration(x, c.pairs(x)).max() - c.loft for pair in model.ply_pairs for c in pair)
    return max([0.0, *map(float, found)])


def left_out_penetration(model: Model, x: FloatArray) -> float:
    """Deepest penetration of a ply into a tool from which others should keep it, mm."""
    deepest, tools = 0.0, {c.tool.name: c for c in model.contacts}
    for sheet in model.sheets:
        met = {c.tool.name for c in model.contacts if c.sheet is sheet}
        for name in tools.keys() - met:
            contact = Contact(sheet, tools[name].tool, tools[name].tool_dofs)
            deepest = max(deepest, float(contact.penetration(x).max()))
    return deepest


def chord_penetration(model: Model, x: FloatArray, fibres: bool = False) -> float:
    """Deepest penetration at the middle of an element edge, mm: chords cut fillets.

    With `fibres` only at edges that are chords of a fibre; a diagonal carries none.
    """
    deepest, half = 0.0, 0.5 * model.sheet.fabric.thickness
    blank = model.sheet.blank
    if fibres and blank.pairs is None:
        edges = np.vstack([blank.fibre_lines(family).t.T for family in ("warp", "weft")])
    else:
        edges = blank.mesh.facets.T
    middles = model.sheet.positions(x)[edges].mean(1)
    for contact in model.contacts:
        y = contact.in_tool_frame(x, middles - contact.origin(x))
        deepest = max(deepest, half - float(contact.distance(y)[0].min()))
    return deepest


def bent_radius(model: Model, x: FloatArray) -> float:
    """Smallest radius that the sheet bends over, mm; inf if it touches flat faces only.

    Of each tool, that with at least a twentieth of the contact force on it or on sharper ones:
    facets of a surface file are no fillets.
    """
    sharpest = 0.0
    for contact in model.contacts:
        touching = contact.active(x)
        if not touching.size:
            continue
        bend = np.linalg.norm(contact.at(x)[3][touching], 2, axis=(1, 2))
        force = (contact.area * contact.pressure(x))[touching]
        sharpest = max(sharpest, percentile(bend, force, 1 - LEAST_FORCE))
    return 1.0 / sharpest - 0.5 * model.sheet.fabric.thickness if sharpest > 1e-9 else np.inf


def resting_tools(
    model: Model, x: FloatArray, start: FloatArray
) -> dict[str, dict[str, float | list[float]]]:
    """Lift (mm) and tilt (degrees) of each free tool, or the moment its guide takes (N mm).

    x and start (n_dofs,) are positions and rigid degrees of freedom now and at the start, mm.
    """
    found: dict[str, dict[str, Any]] = {}
    for contact in model.contacts:
        tool, dofs = contact.tool, contact.tool_dofs
        if tool.motion != "free":
            continue
        entry = found.setdefault(tool.name, {"lift_mm": float(x[dofs[0]] - start[dofs[0]])})
        if tool.tilts:
            tilt = model.sheet.to_user(x[dofs[1:]]) / contact.lever
            entry["tilt_deg"] = np.degrees(tilt).tolist()
            continue
        turning = moment(contact, x) / model.share
        for axis, plane in enumerate("xy"):
            if plane in model.sheet.blank.mirror:
                turning[1 - axis] = 0.0
        turning = model.sheet.to_user(turning) + entry.get("held_moment_Nmm", np.zeros(2))
        entry["held_moment_Nmm"] = turning.tolist()
    return found
