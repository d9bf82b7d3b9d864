"""Scenes of the stability map: those of the paper, and small difficult ones built by hand.

Each is a function of the size and the fabric (its friction and its stiffness under a tool are
settings of the map), with the data that the map needs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial, wraps

import numpy as np
from scipy.interpolate import LinearNDInterpolator

import quasiform as qf
from quasiform import theory
from quasiform.energy.bending import Bending
from quasiform.energy.contact import Contact, at_edges
from quasiform.energy.friction import Friction
from quasiform.energy.membrane import Membrane
from quasiform.energy.weight import GRAVITY, ToolWeight
from quasiform.recipe import built
from quasiform.scenes import scene_file
from quasiform.tools.shapes import Plane, bar, flipped
from quasiform.unknowns import Sheet, Unknowns

from ..friction_exact.case import EndLoad

FloatArray = np.ndarray
Build = Callable[[float, qf.Fabric], qf.Model]
Numbers = Callable[[qf.Result], dict[str, float]]
BLOCK = 5.0  # kg on the strip that sticks and slips
SPAN = 80.0  # mm: travel of which an increment of 1 mm is 1/80, for other kinds of travel


@dataclass(frozen=True)
class Case:
    """A scene of the map.

    Parameters
    ----------
    title : str
    build : function of the size (mm) and the fabric
    sizes : (3,) floats
        Coarse, default and fine, mm.
    law : "locking" or "best-fit"
    paper : bool
        Whether it is a scene of the paper: full travel is required of these.
    contact : bool
        Whether tools touch the sheet, so that contact stiffness and friction matter.
    scaled : bool
        Whether increments are parts of the travel: 20 mm stand for a quarter.
    averages : function of the Result
        Values that a second solve of the same problem must find too.
    wrong : function of the Result
        What is wrong with a completed end state; empty if nothing is.
    waves : function of the Result, optional
        Wavelength and envelope of its wrinkles.
    refused : bool
        Whether it must be refused, with a reason.
    """

    title: str
    build: Build
    sizes: tuple[float, float, float]
    law: str = "locking"
    paper: bool = False
    contact: bool = False
    scaled: bool = False
    averages: Numbers = field(default=lambda result: of_the_shear(result))
    wrong: Callable[[qf.Result], str] = field(default=lambda result: "")
    waves: Numbers | None = None
    refused: bool = False

    def fabric(self, contact: float = 1.0, friction: float | None = None) -> qf.Fabric:
        """The fabric, with its stiffness under a tool scaled and another friction."""
        fabric = qf.Fabric.preset(self.law)
        return replace(
            fabric,
            compaction=contact * fabric.compaction,
            friction=fabric.friction if friction is None else friction,
        )


def of_the_shear(result: qf.Result) -> dict[str, float]:
    """Mean |γ| of the sheet and of the named areas, degrees: averages, not peaks."""
    return {
        name: value
        for name, value in result.quantities.items()
        if name == "shear_angle_mean_deg" or name.startswith("area_")
    }


def height(result: qf.Result) -> FloatArray:
    """(n_nodes,) height of the nodes at the end, mm."""
    return result.positions()[:, 2]


# The scenes of the paper, and variants of them


def tension(angle: float, mesh: str, size: float, fabric: qf.Fabric) -> qf.Model:
    return qf.off_axis_tension(angle, fabric, size=size, mesh=mesh)


def compression(size: float, fabric: qf.Fabric) -> qf.Model:
    """The 45° specimen compressed by 30 mm in its plane: its grip moves the other way."""
    scene = qf.off_axis_tension(45.0, fabric, displacement=30.0, size=size)
    return scene.including(pressed_together)


def pressed_together(scene: qf.Model) -> None:
    """Drive the grip of a tension test the other way."""
    scene.name, scene.drive = "oat-45-compressed", -scene.drive


def forming(name: str, orientation: float, mesh: str, size: float, fabric: qf.Fabric) -> qf.Model:
    file = replace(scene_file.load(name), mesh=mesh)
    return qf.forming(file, orientation, fabric, size)


def without_bending(size: float, fabric: qf.Fabric) -> qf.Model:
    limp = replace(fabric, bending_warp=0.0, bending_weft=0.0)
    return qf.forming("hemisphere", 0.0, limp, size)


def of_any_size(build: Build) -> Build:
    """Give what a function builds by hand a recipe, so that it is built at other sizes too."""

    @wraps(build)
    def builder(size: float, fabric: qf.Fabric, like: qf.Model | None = None) -> qf.Model:
        return build(size, fabric)

    @wraps(build)
    def with_recipe(size: float, fabric: qf.Fabric, like: qf.Model | None = None) -> qf.Model:
        return built(builder, size, fabric=fabric)

    return with_recipe


# Sheets in space without tools


@of_any_size
def sheared_sheet(size: float, fabric: qf.Fabric) -> qf.Model:
    """Sheet with fibres at ±45° between two clamps, one of which slides along: it wrinkles.

    One fibre direction is in tension between the clamps and the other one in compression. The sheet
    starts exactly flat, with no force out of its plane. It is four times as stiff in bending as the
    fabric, so that a wrinkle is several elements wide.
    """
    length, width, slide = 200.0, 100.0, 2.0
    stiff = replace(
        fabric, bending_warp=4 * fabric.bending_warp, bending_weft=4 * fabric.bending_weft
    )
    blank = qf.rectangle(length, width, size, orientation=-45.0)
    edge = np.abs(blank.nodes[:, 1]) > width / 2 - 1e-6
    return _free_sheet(
        "sheared-sheet",
        blank,
        stiff,
        clamped=edge,
        moving=blank.nodes[:, 1] > width / 2 - 1e-6,
        travel=slide,
        size=size,
    )


@of_any_size
def flat_strip(size: float, fabric: qf.Fabric) -> qf.Model:
    """Clamped strip that starts exactly flat and is compressed along its fibres."""
    length, width, shortening = 100.0, 40.0, 5.0
    blank = qf.rectangle(length, width, size)
    end = np.abs(blank.nodes[:, 0]) > length / 2 - 1e-6
    return _free_sheet(
        "flat-strip",
        blank,
        fabric,
        clamped=end,
        moving=blank.nodes[:, 0] < -length / 2 + 1e-6,
        travel=shortening,
        size=size,
    )


def _free_sheet(
    name: str,
    blank: qf.Blank,
    fabric: qf.Fabric,
    clamped: np.ndarray,
    moving: np.ndarray,
    travel: float,
    size: float,
) -> qf.Model:
    """Flat sheet with clamped nodes, some of which move along x."""
    x0 = np.pad(blank.nodes, ((0, 0), (0, 1))).ravel()
    drive = np.zeros(len(x0))
    drive[0::3] = moving
    sheet = (unknowns := Unknowns()).sheet(blank, fabric, dim=3)
    return qf.Model(
        name=name,
        unknowns=unknowns,
        sheets=[sheet],
        terms=[Membrane(sheet), Bending(sheet, clamped)],
        x0=x0,
        fixed=np.repeat(clamped, 3),
        drive=drive,
        travel=travel,
        increment=travel / 16,
        rows=travel / 16,
        parameters={"size": size},
    )


class LineLoad(qf.Term):
    """Dead load along -z on some nodes: E = q P/n Σ z, the factor q a degree of freedom."""

    name = "line load"

    def __init__(self, sheet: Sheet, nodes: FloatArray, load: float, factor_dof: int) -> None:
        self.dofs = np.column_stack([sheet.dofs[nodes, 2], 0 * nodes + factor_dof])
        self.load = load / len(nodes)

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        z, q = x[self.dofs].T
        return self.load * q * z

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        return self.load * x[self.dofs[:, ::-1]]

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        H = np.zeros((len(self.dofs), 2, 2))
        H[:, 0, 1] = H[:, 1, 0] = self.load
        return H


@of_any_size
def arch(size: float, fabric: qf.Fabric) -> qf.Model:
    """Shallow arch of fibre lines between hinges, with a dead load on its middle: it snaps through.

    A strip 2 % longer than its span; the load is about twice the critical one, so that it snaps
    through to the lower branch.
    """
    span, width, extra = 100.0, 20.0, 0.02
    length = span * (1 + extra)
    load = 0.16  # N
    blank = qf.rectangle(length, width, size)
    s = blank.nodes[:, 0] / length
    rise = 2 / np.pi * span * np.sqrt(extra)
    flat = np.column_stack([span * s, blank.nodes[:, 1], rise * np.cos(np.pi * s)])
    x0 = np.append(flat.ravel(), 0.0)
    hinged = np.abs(blank.nodes[:, 0]) > length / 2 - 1e-6
    middle = np.flatnonzero(np.abs(blank.nodes[:, 0]) < np.abs(blank.nodes[:, 0]).min() + 1e-6)
    drive = np.zeros(len(x0))
    drive[-1] = 1.0
    sheet = (unknowns := Unknowns()).sheet(blank, fabric, dim=3)
    factor = unknowns.add("load factor", 1)
    return qf.Model(
        name="arch",
        unknowns=unknowns,
        sheets=[sheet],
        terms=[
            Membrane(sheet),
            Bending(sheet),
            LineLoad(sheet, middle, load, int(factor.dofs[0, 0])),
        ],
        x0=x0,
        fixed=np.append(np.repeat(hinged, 3), True),
        drive=drive,
        travel=1.0,
        increment=1 / 16,
        rows=1 / 16,
        travel_name="load_factor",
        dead_load=load,
        resting=load,
        parameters={"size": size},
    )


# Strips under and over tools


@of_any_size
def block(size: float, fabric: qf.Fabric) -> qf.Model:
    """A strip between a table and a loose plate of 5 kg, pulled out until it slips."""
    mass, pull = BLOCK, 2.0
    blank = qf.rectangle(100.0, 50.0, size)
    n, t0 = len(blank.nodes), fabric.thickness
    plates = [
        qf.Tool("table", Plane(), friction=fabric.friction),
        qf.Tool("plate", flipped(Plane()), t0, "free", fabric.friction, mass),
    ]
    sheet = (unknowns := Unknowns()).sheet(blank, fabric, dim=3)
    contacts = [Contact(sheet, plate, unknowns.add(plate.name, 1).dofs) for plate in plates]
    sunk = contacts[1].depth_under(1e3 * GRAVITY * mass, blank.areas.sum())
    flat = np.column_stack([blank.nodes, np.full(n, t0 / 2 - sunk)])
    x0 = np.append(flat.ravel(), [0.0, t0 - 2 * sunk])
    pulled = blank.nodes[:, 0] > 50.0 - 1e-9
    fixed = np.zeros(len(x0), dtype=bool)
    fixed[3 * n] = True
    fixed[0 : 3 * n : 3] = fixed[1 : 3 * n : 3] = pulled
    drive = np.zeros(len(x0))
    drive[0 : 3 * n : 3] = pulled
    return qf.Model(
        name="block",
        unknowns=unknowns,
        sheets=[sheet],
        terms=[
            Membrane(sheet),
            Bending(sheet),
            *contacts,
            *[Friction(contact) for contact in contacts if fabric.friction],
            ToolWeight(1e3 * GRAVITY * mass, 3 * n + 1),
        ],
        x0=x0,
        fixed=fixed,
        drive=drive,
        travel=pull,
        increment=pull / 4,
        rows=pull / 4,
        resting=1e3 * GRAVITY * mass,
        parameters={"size": size},
    )


@of_any_size
def fillet(size: float, fabric: qf.Fabric) -> qf.Model:
    """A strip under a dead load, drawn over a quarter of a rod of the radius of an element.

    Contact between nodes is added if the mesh is coarser than the rod, as in `forming`.
    """
    radius, lead, width, pull, load = 5.0, 30.0, 20.0, 20.0, 8.0
    mid = radius + fabric.thickness / 2
    arc = mid * np.pi / 2
    length = 2 * lead + arc
    blank = qf.rectangle(length, width, size, centre=(length / 2, 0.0))
    n = len(blank.nodes)
    s = blank.nodes[:, 0] - lead
    angle = np.clip(s / mid, 0.0, np.pi / 2)
    wrapped = np.column_stack(
        [
            mid * np.sin(angle) + np.minimum(s, 0.0),
            blank.nodes[:, 1],
            mid * np.cos(angle) - np.maximum(s - arc, 0.0),
        ]
    )
    x0 = np.append(wrapped.ravel(), 0.0)
    rod = qf.Tool("rod", bar(radius), friction=fabric.friction)
    sheet = (unknowns := Unknowns()).sheet(blank, fabric, dim=3)
    place = unknowns.add("rod", 1)
    contacts = [Contact(sheet, rod, place.dofs)]
    if radius < blank.size * (1 - 1e-9):
        contacts.append(Contact(sheet, rod, place.dofs, at_edges(blank)))
    loaded = np.flatnonzero(blank.nodes[:, 0] < 1e-9)
    pulled = np.flatnonzero(blank.nodes[:, 0] > length - 1e-9)
    fixed = np.zeros(len(x0), dtype=bool)
    fixed[3 * n] = True
    fixed[3 * loaded + 1] = fixed[3 * loaded + 2] = True
    for axis in range(3):
        fixed[3 * pulled + axis] = True
    drive = np.zeros(len(x0))
    drive[3 * pulled + 2] = -1.0
    return qf.Model(
        name="fillet",
        unknowns=unknowns,
        sheets=[sheet],
        terms=[
            Membrane(sheet),
            Bending(sheet),
            *contacts,
            EndLoad(sheet, loaded, load),
            *[Friction(contact) for contact in contacts if fabric.friction],
        ],
        x0=x0,
        fixed=fixed,
        drive=drive,
        travel=pull,
        increment=pull / 16,
        rows=pull / 16,
        resting=load,
        parameters={"size": size},
    )


# Averages and checks of the scenes built by hand


def of_the_height(result: qf.Result) -> dict[str, float]:
    """Root mean square of the height over the nodes, mm, and the force, N.

    The mean height has no meaning for a sheet that may buckle up or down.
    """
    return {
        "height_rms_mm": float(np.sqrt((height(result) ** 2).mean())),
        "force_N": result.force,
    }


def of_the_arch(result: qf.Result) -> dict[str, float]:
    return {"height_mean_mm": float(height(result).mean())}


def of_the_force(result: qf.Result) -> dict[str, float]:
    return {"force_N": result.force}


def of_the_wrinkled(result: qf.Result) -> dict[str, float]:
    return of_the_shear(result) | {"force_N": result.force}


def not_buckled(least: float, result: qf.Result) -> str:
    reached = float(np.abs(height(result)).max())
    return f"still flat: a saddle ({reached:.2g} mm)" if reached < least else ""


def not_snapped(result: qf.Result) -> str:
    middle = float(height(result).mean())
    return f"still on the upper branch (mean height {middle:.2g} mm)" if middle > 0 else ""


def not_coulomb(result: qf.Result) -> str:
    """When the block slips, its force is μ times the load, on two faces."""
    limit = theory.strip_friction(result.model.sheet.fabric.friction, BLOCK)
    off = abs(result.force - limit)
    return f"slips at {result.force:.4g} N, not {limit:.4g} N" if off > 0.01 * limit + 1e-3 else ""


def waves(line: FloatArray, result: qf.Result) -> dict[str, float | None]:
    """Wavelength of wrinkles along a line of the flat sheet, and envelope, mm.

    Parameters
    ----------
    line : (n, 2) array
        Evenly spaced points of the flat sheet, mm.
    result : Result

    Returns
    -------
    dict
        `wavelength_mm`: twice the mean distance of the zero crossings of the height, minus its
        linear trend, along the line (None with fewer than two); `envelope_mm`: largest height
        along it, minus the trend; `height_max_mm`: over the whole sheet.
    """
    z = LinearNDInterpolator(result.blank.nodes, height(result))(line)
    s = np.linalg.norm(line - line[0], axis=1)
    wave = z - np.polyval(np.polyfit(s, z, 1), s)
    return {
        "wavelength_mm": wavelength(s, wave),
        "envelope_mm": float(np.abs(wave).max()),
        "height_max_mm": float(np.abs(height(result)).max()),
    }


def wavelength(s: FloatArray, wave: FloatArray) -> float | None:
    """Twice the mean distance of the zero crossings of (n,) heights at (n,) positions, or None.

    Examples
    --------
    >>> s = np.linspace(0.0, 10.0, 400)
    >>> round(wavelength(s, np.sin(2 * np.pi * s / 2.5 + 0.3)), 3)
    2.5
    """
    at = np.flatnonzero(wave[:-1] * wave[1:] < 0)
    if len(at) < 2:
        return None
    crossing = s[at] + (s[at + 1] - s[at]) * wave[at] / (wave[at] - wave[at + 1])
    return float(2 * np.diff(crossing).mean())


def _along_x(reach: float, y: float) -> FloatArray:
    """Points every half millimetre along x."""
    x = np.arange(-reach, reach + 0.25, 0.5)
    return np.column_stack([x, np.full_like(x, y)])


# The map's scenes, in its order

_PLANE = (20.0, 10.0, 5.0)
_STRIP = (10.0, 5.0, 2.5)


def _cases() -> dict[str, Case]:
    cases = {}
    for angle in (30, 45):
        for law in ("locking", "best-fit"):
            build = partial(tension, float(angle), "fibre")
            title = f"off-axis tension {angle}°, {law}, 80 mm"
            cases[f"oat-{angle}-{law}"] = Case(title, build, _PLANE, law, paper=True)
    for name in ("hemisphere", "tetrahedron", "box"):
        for orientation in (0, 45):
            cases[f"{name}-{orientation}"] = Case(
                f"{name} {orientation}°, full path",
                partial(forming, name, float(orientation), "fibre"),
                _PLANE,
                paper=True,
                contact=True,
                waves=partial(waves, _along_x(130.0, 130.0)) if name == "box" else None,
            )
    cases["oat-45-compressed"] = Case("45° specimen compressed by 30 mm", compression, _PLANE)
    cases["oat-45-free"] = Case(
        "off-axis tension 45°, free mesh", partial(tension, 45.0, "free"), _PLANE
    )
    cases["hemisphere-free"] = Case(
        "hemisphere 0°, free mesh",
        partial(forming, "hemisphere", 0.0, "free"),
        _PLANE,
        contact=True,
    )
    cases["without-bending"] = Case(
        "hemisphere without bending stiffness", without_bending, _PLANE, contact=True, refused=True
    )
    cases["sheared-sheet"] = Case(
        "sheared sheet free to wrinkle",
        sheared_sheet,
        _STRIP,
        scaled=True,
        averages=of_the_wrinkled,
        wrong=partial(not_buckled, 0.5),
        waves=partial(waves, _along_x(40.0, 0.0)),
    )
    cases["flat-strip"] = Case(
        "strip pressed together, exactly flat",
        flat_strip,
        _STRIP,
        scaled=True,
        averages=of_the_height,
        wrong=partial(not_buckled, 5.0),
    )
    cases["arch"] = Case(
        "shallow arch, dead load: snaps through",
        arch,
        _STRIP,
        scaled=True,
        averages=of_the_arch,
        wrong=not_snapped,
    )
    cases["block"] = Case(
        "stick-slip block",
        block,
        _PLANE,
        contact=True,
        scaled=True,
        averages=of_the_force,
        wrong=not_coulomb,
    )
    cases["fillet"] = Case(
        "sheet drawn over a fillet of 5 mm",
        fillet,
        _STRIP,
        contact=True,
        scaled=True,
        averages=of_the_force,
    )
    return cases


CASES = _cases()
