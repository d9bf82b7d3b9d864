"""Ready scenes for the tests of a fabric: off-axis tension, picture frame, cantilever."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from math import atan2, cos, degrees, radians, sin
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ..checks import InputError, check_number, round_length
from ..energy.bending import Bending, PatchBending
from ..energy.membrane import Membrane, membrane_of
from ..energy.slip import SlippingMembrane
from ..energy.softening import bending_terms
from ..energy.term import Term
from ..energy.weight import SheetWeight
from ..fabric import Fabric, fabric_of
from ..model import Model
from ..net.blank import Blank, rectangle
from ..net.free_mesh import PAIRED, check_same_size, own_mesh, triangulate
from ..recipe import built
from ..unknowns import FloatArray, Sheet, Unknowns
from .slipping import let_slip


def off_axis_tension(
    angle: float = 45.0,
    law: str | Fabric = "locking",
    length: float = 320.0,
    width: float = 160.0,
    displacement: float = 80.0,
    size: float = 10.0,
    mesh: str | Path = "fibre",
) -> Model:
    """Off-axis tension test (Schäfer et al., Fig. 2 a) as a plane problem with rigid grips.

    The grips are the lines x = ±length/2; the right one moves along x. Fibre lines run through the
    grip corners, warp at -angle and weft at 90° - angle to the load, so that γ is positive.

    Parameters
    ----------
    angle : float
        Θ0, degrees, between load and warp.
    law : str or Fabric
        "locking", "best-fit", a TOML file or a `Fabric`.
    length, width, displacement : float
        l0, w0 and the largest grip displacement, mm.
    size : float
        Cell edge along the specimen's axes at 45°, mm: √2 times the spacing of the fibre lines.
    mesh : "fibre", "free" or a path
        Cut from the fibre lines; a free triangulation of as many triangles; or the user's own mesh
        of the specimen, centred at the origin. The last two do not follow the fibres.

    Returns
    -------
    Model

    Raises
    ------
    InputError
        For bad numbers, or an angle at which a fibre joins both grips.
    """
    fabric = fabric_of(law)
    _check(length=length, width=width, displacement=displacement, size=size)
    low = degrees(atan2(width, length))
    if not (isinstance(angle, Real) and low < angle < 90.0 - low):
        raise InputError(
            f"angle must lie between {low:.1f} and {90 - low:.1f} degrees for {length:g} x "
            f"{width:g} mm (elsewhere a fibre joins both grips), got {angle!r}"
        )
    if size > width:
        raise InputError(f"size must not exceed the width {width:g} mm, got {size:g}")
    given = {"angle": angle, "length": length, "width": width, "displacement": displacement}
    mesh = mesh if mesh in ("fibre", "free") else Path(mesh)
    return built(strip_under_tension, size, **given, fabric=fabric, mesh=mesh)


def strip_under_tension(
    size: float, like: Model | None, fabric: Fabric, mesh: str | Path, **given: float
) -> Model:
    """Build the model of an off-axis tension test."""
    angle, length, width = given["angle"], given["length"], given["width"]
    spacing = size / np.sqrt(2.0)
    if mesh == "fibre":
        blank = rectangle(length, width, spacing, orientation=-angle)
    elif mesh == "free":
        sides = np.array([-length, -width, length, width]) / 2
        blank = triangulate(shapely.box(*sides), spacing, -angle)
    else:
        check_same_size(size, like and like.size)
        blank = own_mesh(mesh, -angle)
    sheet = (unknowns := Unknowns()).sheet(blank, fabric, 2)
    left = blank.nodes[:, 0] < -length / 2 + 1e-6 * size
    right = blank.nodes[:, 0] > length / 2 - 1e-6 * size
    drive = np.zeros(unknowns.size)
    drive[sheet.dofs[:, 0]] = right
    numbers = {name: given[name] for name in ("length", "width", "displacement")}
    identity = {"angle": angle, "law": fabric.name, "fabric": asdict(fabric)}
    terms, share = [membrane_of(sheet)], fabric.in_plane_bending
    bending = ("bending left out", "held flat, and in_plane_bending is 0")
    if share:
        terms.append(Bending(sheet) if blank.pairs is None else PatchBending(sheet))
        bending = ("bending of warp and weft lines in the plane", f"in_plane_bending is {share:g}")
    model = _plane(
        f"oat-{angle:g}",
        unknowns,
        sheet,
        terms,
        fixed=left | right,
        step=length / 60,
        drive=drive,
        travel=float(given["displacement"]),
        parameters={**identity, **numbers, "size": size, "mesh": str(mesh)},
        description=[
            ("plane problem", "no tools and no load out of the plane: two dofs a node, held flat"),
            bending,
            ("contact and friction left out", "no tools"),
            ("weight left out", "acts out of the plane"),
            *([PAIRED] if blank.pairs is not None else []),
        ],
        coarsest=width / 4,
        every=True,
    )
    let_slip(model)
    model.measures = _centre_measures(model.membrane, _centre(blank, length, width, angle))
    return model


def _centre_measures(membrane: Membrane, weights: FloatArray) -> dict[str, Any]:
    """Columns of the history, with means by weights (n_triangles,)."""

    def mean(quantity: int, x: FloatArray) -> float:
        I4, _, I8 = membrane.invariants(x)
        field = (np.degrees(membrane.shear_angle(x)), 0.5 * (I4 - 1), 0.5 * (I8 - 1))[quantity]
        return float(weights @ field)

    found = {
        "shear_angle_center_deg": partial(mean, 0),
        "shear_angle_max_deg": membrane.largest_shear_angle,
        "E11_center": partial(mean, 1),
        "E22_center": partial(mean, 2),
    }
    if isinstance(membrane, SlippingMembrane):
        for i, name in enumerate(("E22_warp_layer_center", "E11_weft_layer_center")):
            found[name] = lambda x, i=i: float(weights @ membrane.across(x)[i])
    return found


def _plane(
    name: str,
    unknowns: Unknowns,
    sheet: Sheet,
    terms: list[Term],
    fixed: np.ndarray,
    step: float,
    **given: Any,
) -> Model:
    """Model of a plane test whose sheet is flat, with `fixed` (n_nodes,) bool nodes.

    Increments and rows are the round length nearest to `step`, mm.
    """
    x0, fixed = sheet.blank.nodes.ravel().copy(), np.repeat(fixed, 2)
    given |= dict.fromkeys(("increment", "rows"), round_length(step))
    return Model(name, unknowns, [sheet], terms, x0, fixed, **given)


def _check(**numbers: float) -> None:
    for name, value in numbers.items():
        check_number(name, value)


def _centre(blank: Blank, length: float, width: float, angle: float) -> FloatArray:
    """(n_triangles,) weights of the centre: in the zone of full shear, near the middle."""
    full = off_axis_zones(blank, length, width, angle)["full"]
    c, s = cos(radians(angle)), sin(radians(angle))
    band = min(length * s - width * c, length * c - width * s)
    near = np.linalg.norm(blank.centroids, axis=1)
    centre = full & (near < min(width / 8, band / 2))
    if not centre.any():
        centre = full & (near <= near[full].min() * (1 + 1e-9))
    return np.where(centre, blank.areas, 0.0) / blank.areas[centre].sum()


def off_axis_zones(
    blank: Blank, length: float, width: float, angle: float
) -> dict[str, np.ndarray]:
    """Triangles of the zones of Schäfer et al., Fig. 2 a, by which of their fibres reach a grip.

    Bool arrays (n_triangles,): "full" (no fibre is gripped), "warp free" and "weft free" (that
    family alone is free) and "rigid" (both gripped).
    """
    c, s = cos(radians(angle)), sin(radians(angle))
    # a warp line is free if it crosses both free edges: seen by its weft coordinate
    warp_free = np.abs(blank.centroids @ blank.weft) < (length * s - width * c) / 2
    weft_free = np.abs(blank.centroids @ blank.warp) < (length * c - width * s) / 2
    return {
        "full": warp_free & weft_free,
        "warp free": warp_free & ~weft_free,
        "weft free": weft_free & ~warp_free,
        "rigid": ~warp_free & ~weft_free,
    }


def picture_frame(
    side: float = 100.0, shear: float = 50.0, law: str | Fabric = "locking", size: float = 10.0
) -> Model:
    """Picture frame: a square net, fibres along the sides, sheared by a hinged rigid frame.

    The travel is the displacement d of the pulled corner, d = 2 L cos(π/4 - γ/2) - √2 L.

    Parameters
    ----------
    side : float
        L, mm.
    shear : float
        Shear angle at the end, degrees.
    law : str or Fabric
        As in `off_axis_tension`.
    size : float
        Spacing of the fibre lines, mm.

    Returns
    -------
    Model

    Raises
    ------
    InputError
        For bad numbers, or a shear angle of 90 degrees and more.
    """
    fabric = fabric_of(law)
    _check(side=side, size=size, shear=shear)
    if shear >= 90:
        raise InputError(f"shear must lie below 90 degrees, got {shear:g}")
    return built(sheet_in_frame, size, side=side, shear=shear, fabric=fabric)


def sheet_in_frame(
    size: float, like: Model | None, side: float, shear: float, fabric: Fabric
) -> Model:
    """Build the model of a picture frame."""
    blank = rectangle(side, side, size)
    sheet = (unknowns := Unknowns()).sheet(blank, fabric, 2)
    rim = np.isin(np.arange(len(blank.nodes)), blank.mesh.boundary_nodes())
    diagonal = np.array([[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(2.0)  # pulled, and across

    def frame(d: float) -> tuple[FloatArray, FloatArray]:
        """Affine motion of the frame: the pulled diagonal grows, the other one shrinks."""
        half = np.arccos((np.sqrt(2.0) * side + d) / (2.0 * side))  # π/4 - γ/2
        stretch = np.sqrt(2.0) * np.array([np.cos(half), np.sin(half)])
        rate = np.array([1.0, -1.0 / np.tan(half)]) / (np.sqrt(2.0) * side)
        along = blank.nodes @ diagonal.T
        return (along * stretch @ diagonal).ravel(), (along * rate @ diagonal).ravel()

    gamma = radians(shear)
    model = _plane(
        "picture-frame",
        unknowns,
        sheet,
        [Membrane(sheet)],
        fixed=rim,
        step=side / 20,
        drive=frame,
        travel=2.0 * side * cos(np.pi / 4 - gamma / 2) - np.sqrt(2.0) * side,
        parameters={"side": side, "shear": shear, "law": fabric.name, "size": size},
        description=[("plane problem", "held flat by the frame")],
    )
    let_slip(model)
    return model


def cantilever(
    length: float,
    load: float,
    width: float = 25.0,
    law: str | Fabric = "locking",
    size: float = 5.0,
    family: str = "warp",
) -> Model:
    """Strip clamped horizontally at one end, bending under its own weight (Peirce's test).

    Parameters
    ----------
    length, width : float
        Free length and width, mm.
    load : float
        Weight per area, N/mm²; its factor is raised from 0 to 1 as the travel.
    law : str or Fabric
        As in `off_axis_tension`.
    size : float
        Spacing of the fibre lines, mm.
    family : "warp" or "weft"
        Fibres along the strip.

    Returns
    -------
    Model

    Raises
    ------
    InputError
        For bad numbers, or an unknown family.
    """
    fabric = fabric_of(law)
    _check(length=length, load=load, width=width, size=size)
    if family not in ("warp", "weft"):
        raise InputError(f"family must be 'warp' or 'weft', got {family!r}")
    given = {"length": length, "load": load, "width": width, "family": family}
    return built(hanging_strip, size, **given, fabric=fabric)


def hanging_strip(size: float, like: Model | None, fabric: Fabric, **given: Any) -> Model:
    """Build the model of a cantilever."""
    length, load, width, family = (given[n] for n in ("length", "load", "width", "family"))
    angle = 0.0 if family == "warp" else -90.0
    blank = rectangle(length, width, size, angle, centre=(length / 2, 0.0))
    sheet = (unknowns := Unknowns()).sheet(blank, fabric, 3)
    factor = unknowns.add("load factor of the weight", 1)
    clamped = np.abs(blank.nodes[:, 0]) < 1e-9 * length
    x0, fixed, drive = unknowns.start(sheet)
    fixed[sheet.dofs[clamped]] = True
    fixed[factor.dofs], drive[factor.dofs] = True, 1.0
    weight = SheetWeight(sheet, load, int(factor.dofs[0, 0]))
    left_out = [("contact and friction left out", "no tools")]
    if slip := fabric.slip:
        why = f"its weight moves the layers by less than {load / slip.stiffness:.1g} mm"
        left_out.append(("slip of the rovings left out", why))
    return Model(
        name=f"cantilever-{family}",
        unknowns=unknowns,
        sheets=[sheet],
        terms=[Membrane(sheet), *bending_terms(Bending(sheet, clamped)), weight],
        x0=x0,
        fixed=fixed,
        drive=drive,
        travel=1.0,
        increment=0.25,
        rows=0.25,
        travel_name="load_factor",
        dead_load=load * length * width,
        parameters={"length": length, "load": load, "width": width, "size": size, "family": family},
        description=left_out,
    )
