"""From a scene file to a model: forming with punch, die and blank holder (Schäfer et al., Fig. 4).

The model holds no more than the scene needs, and says what was left out: mirror planes that blank,
fibres and tools share, terms with a zero coefficient, contact between nodes where the mesh resolves
the tools.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ..checks import InputError, check_number, round_length
from ..energy.bending import Bending, PatchBending
from ..energy.contact import Contact, at_edges, surrounds
from ..energy.friction import Friction
from ..energy.membrane import membrane_of
from ..energy.softening import bending_terms
from ..energy.term import Term
from ..energy.weight import GRAVITY, SheetWeight, ToolForce, ToolWeight, load_of
from ..fabric import Fabric, fabric_of
from ..model import Model
from ..net import free_mesh
from ..net.blank import Blank, cut, rotation
from ..net.edges import edge_points
from ..net.free_mesh import PAIRED
from ..recipe import built, checksums, plain, reference
from ..tools import tool_file
from ..tools.shapes import Tool, turned
from ..unknowns import Unknowns
from . import scene_file
from .blank_file import blank_from_file
from .mechanics import check_mechanics
from .room import check_clearance, mirror_planes, smallest_radius, what_resolves
from .scene_file import SceneFile, SurfaceFile, ToolPart, check_increments
from .slipping import let_slip
from .supports import fix_supports, grips, keep_middle

LEAST = 0.5  # of the default size: how fine it may be for the sake of a fillet
FINE = 0.4  # of the smallest fillet: the mesh of the path
FACTOR, FORCE = "load factor of the weight", "force on the "


def forming(
    scene: str | Path | SceneFile = "hemisphere",
    orientation: float | None = None,
    law: str | Fabric | None = None,
    size: float | None = None,
    travel: float | None = None,
    symmetry: str | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Model:
    """Forming of a blank between rigid tools.

    What is not given is taken from the scene file.

    Parameters
    ----------
    scene : str or SceneFile
        Name of a built-in scene, or a TOML file.
    orientation : float, optional
        Angle of the warp to x, degrees; outline and tools stay.
    law : str or Fabric, optional
    size : float, optional
        Spacing of the fibre lines, mm; by default that of the file, or near 1/60 of the blank (5 on
        310 mm), or finer (to the half) where the path needs it: 0.4 of the smallest fillet.
    travel : float, optional
        Travel of the punch from first touch, mm; at most the file's own.
    symmetry : "auto", "half" or "none", optional
        Whether mirror planes of blank, fibres and tools are used: all, at most one, or none.
    overrides : mapping of str to value, optional
        Other values of keys of the scene, by dotted name: `{"tools.holder.mass": 8.0}`; those of
        the fabric as `fabric.friction`.

    Returns
    -------
    Model

    Raises
    ------
    InputError
        For bad input, and for a fabric without bending stiffness: a sheet without it has no
        wavelength for its wrinkles and no stiffness before it is stretched.
    """
    name = scene.name if isinstance(scene, SceneFile) else str(scene)
    overrides = dict(overrides or {})
    if law is not None and any(key.startswith("fabric.") for key in overrides):
        overrides = {"law": "locking", "fabric": fabric_of(law).written(), **overrides}
        law = None
    if not isinstance(scene, SceneFile):
        file = scene_file.load(name, overrides)
    else:
        file = scene_file.changed(scene, overrides) if overrides else scene
    if isinstance(law, str):
        file = replace(file, law=str(Path(law).absolute()) if law.endswith(".toml") else law)
    fabric = fabric_of(file.law if law is None else law)
    size = file.size if size is None else size
    if size is not None:
        check_number("size", size)
    orientation = file.orientation if orientation is None else orientation
    if not isinstance(orientation, Real) or not np.isfinite(orientation):
        raise InputError(f"orientation must be a number of degrees, got {orientation!r}")
    symmetry = symmetry or file.symmetry
    if symmetry not in ("auto", "half", "none"):
        raise InputError(f"symmetry must be 'auto' or 'none', got {symmetry!r}")
    goal = file.travel if travel is None else float(check_number("travel", travel))
    if goal > file.travel:
        raise InputError(
            f"travel must not exceed {file.travel:g} mm in this scene, got {goal:g}: "
            f"--set travel={goal:g} makes another scene"
        )
    if fabric.bending_warp == 0 or fabric.bending_weft == 0:
        raise InputError(
            "forming in space needs a bending stiffness: bending_warp or _weft is zero"
        )
    given = {"orientation": float(orientation), "travel": goal, "symmetry": symmetry}
    given |= {"file": file, "name": name, "fabric": fabric}
    usual = size or usual_length(file.outline if file.blank else _own_outline(file))
    model = built(formed_between_tools, usual, **given)
    if size is None and 0 < model.coarsest < usual and file.blank:
        size = fitting(max(model.coarsest, LEAST * usual), file.outline)
        model = replace(model.recipe, size=size).build(like=model)
    return model


def fitting(size: float, outline: shapely.Polygon) -> float:
    """Return the spacing next to `size` that fits half of the shorter side of an outline, mm."""
    half = 0.5 * _shorter_side(outline)
    return half / max(round(half / size), 1)


def usual_length(outline: shapely.Polygon) -> float:
    """Default size and increment, mm: a round length near 1/60 of the blank's shorter side."""
    return round_length(_shorter_side(outline) / 60)


def _shorter_side(outline: shapely.Polygon) -> float:
    return float(np.ptp(np.reshape(outline.bounds, (2, 2)), axis=0).min())


def _own_outline(file: SceneFile) -> shapely.Polygon:
    return free_mesh.outline_of(free_mesh.own_mesh(file.mesh, scale=file.mesh_scale))


def formed_between_tools(
    size: float, like: Model | None, file: SceneFile, name: str, fabric: Fabric, **given: Any
) -> Model:
    """Build the model of a forming scene, with what a model `like` it has read from files."""
    orientation, travel, symmetry = (given[n] for n in ("orientation", "travel", "symmetry"))
    description = [("bending of warp and weft lines", "the sheet leaves its plane")]
    own = None
    if isinstance(file.mesh, Path):
        free_mesh.check_same_size(size, like and like.size)
        own = free_mesh.own_mesh(file.mesh, orientation, file.mesh_scale)
    outline = free_mesh.outline_of(own) if own else file.outline
    if not own and size > (largest := _shorter_side(outline) / 8):
        raise InputError(f"size must not exceed an eighth of the blank, {largest:g}, got {size:g}")
    usual = usual_length(outline)
    increments = {"largest": file.increment or usual, "rows": file.rows or usual}
    check_increments(travel, **increments)
    from_files = like.tools[1] if like else _from_files(file, fabric, outline)
    tools = [_tool(part, fabric, from_files.get(part.name)) for part in file.tools]
    for read in from_files.values():
        description += read.description(tools, outline, travel)
    description += blank_from_file(file, own, outline, tools, from_files)
    if not like:
        check_clearance(tools, from_files, outline, fabric.thickness, travel)
    mirrored = like and like.tools[2]
    mirrored = mirrored or mirror_planes(
        file, tools, outline, orientation, travel, symmetry, fabric
    )
    mirror, why = mirrored
    description += why
    frame = orientation if mirror else 0.0
    blank = own or _mesh(file.mesh, outline, size, frame, orientation - frame, mirror)
    tools_in_frame = [_in_frame(tool, frame, blank) for tool in tools]
    sheet = (unknowns := Unknowns()).sheet(blank, fabric, 3, frame)
    for tool in tools_in_frame:
        unknowns.add(tool.name, 3 if tool.tilts else 1)
        if len(tool.forces) > 1:
            unknowns.add(FORCE + tool.name, 1)
    if file.gravity:
        unknowns.add(FACTOR, 1)
    x0, fixed, drive = unknowns.start(sheet)
    parameters = {"scene": name} | ({"scene_file": file.source} if file.source else {})
    parameters |= {"orientation": orientation, "law": fabric.name, "size": size, "travel": travel}
    parameters |= {"symmetry": symmetry, "fabric": asdict(fabric), "standings": file.standings}
    model = Model(
        name=f"{file.name}-{orientation:g}",
        unknowns=unknowns,
        sheets=[sheet],
        terms=[],
        x0=x0,
        fixed=fixed,
        drive=drive,
        travel=travel,
        increment=increments["largest"],
        rows=increments["rows"],
        travel_name="travel_mm",
        share=0.5 ** len(blank.mirror),
        description=description,
        parameters=parameters,
        areas=dict(file.areas),
        outputs=file.outputs,
        files=like.files if like else checksums(file.files() + file.texts()),
        tools=(tools, from_files, mirrored),
        coarsest=FINE * min((getattr(tool.shape, "sharpest", 0.0) for tool in tools), default=0.0),
    )
    _assemble(model, file, tools_in_frame, outline)
    if not like:
        check_mechanics(file, tools, from_files, outline, fabric.thickness, travel)
    _measure(model)
    return model


@plain.register
def _(file: SceneFile) -> dict[str, Any]:
    content = {"toml": scene_file.scene_toml(file), "source": file.source}
    return {"read": reference(scene_file.read_text), "from": content}


def _from_files(
    file: SceneFile, fabric: Fabric, outline: shapely.Polygon
) -> dict[str, tool_file.ToolFile]:
    return {
        part.name: tool_file.read(part, outline, file.travel, fabric.thickness)
        for part in file.tools
        if isinstance(part.shape, SurfaceFile)
    }


def _tool(part: ToolPart, fabric: Fabric, read: tool_file.ToolFile | None) -> Tool:
    shape, rest = part.shape, 0.0 if part.role == "die" else fabric.thickness
    if read:
        shape, rest = read.grid, read.rest
    z = rest if part.z is None else part.z
    friction = fabric.friction if part.friction is None else part.friction
    tilts = part.motion == "free" and part.tilt is not False
    loads = part.mass, part.force
    return Tool(part.name, shape, z, part.motion, friction, *loads, part.place, tilts)


def _in_frame(tool: Tool, frame: float, blank: Blank) -> Tool:
    """Turn a tool into the model's axes; between two mirror planes it cannot tilt."""
    tool = replace(tool, tilts=tool.tilts and len(blank.mirror) < 2)
    if frame == 0:
        return tool
    place = tuple(np.array(tool.place) @ rotation(frame))
    return replace(tool, shape=turned(tool.shape, -frame), place=place)


def _mesh(
    mesh: str | Path, outline: shapely.Polygon, size: float, turn: float, warp: float, mirror: tuple
) -> Blank:
    outline = shapely.affinity.rotate(outline, -turn, origin=(0, 0))
    if mesh == "free":
        return free_mesh.triangulate(outline, size, warp)
    return cut(outline, size, warp, through=((0.0, 0.0),), mirror=mirror)


def _assemble(model: Model, file: SceneFile, tools: list[Tool], outline: shapely.Polygon) -> None:
    """Put energies and supports into a model."""
    sheet = model.sheet
    blank, fabric = sheet.blank, sheet.fabric
    contacts = [Contact(sheet, tool, model.unknowns[tool.name].dofs) for tool in tools]
    weights: list[Term] = _rest(model, contacts)
    for contact in contacts:
        if (contact.penetration(model.x0) > fabric.thickness).any():
            read = model.tools[1].get(contact.tool.name)
            why = read.why_inside() if read else "check its z"
            raise InputError(f"the flat blank starts inside the {contact.tool.name}: {why}")
    for axis, plane in enumerate("xy"):
        if plane in blank.mirror:
            model.fixed[sheet.dofs[:, axis]] |= np.abs(blank.nodes[:, axis]) < 1e-9
    clamped = fix_supports(model, file, outline)
    if blank.pairs is not None:
        model.description.append(PAIRED)
        if clamped is not None:
            raise InputError("clamp = true needs a mesh that follows the fibres")
    bending = Bending(sheet, clamped) if blank.pairs is None else PatchBending(sheet)
    contacts += _between_nodes(model, contacts)
    frictions = [Friction(c) for c in contacts if c.tool.friction]
    if not frictions:
        model.description.append(("friction left out", "its coefficient is zero"))
        keep_middle(model, file)
    if file.gravity:
        factor = int(model.unknowns[FACTOR].dofs[0, 0])
        model.fixed[factor], model.x0[factor] = True, 1.0
        weights.append(SheetWeight(sheet, 1e-6 * GRAVITY * fabric.areal_weight, factor))
    else:
        total = 1e-6 * fabric.areal_weight * outline.area * GRAVITY
        resting = model.resting / model.share
        beside = f" beside the {resting:.3g} N that rest on it" if resting else ""
        why = f"{total:.2g} N{beside} (gravity = false)"
        model.description.append(("weight of the sheet left out", why))
    model.resting += sum(g.tension for g in file.grippers)
    model.resting += file.gravity * 1e-6 * GRAVITY * fabric.areal_weight * blank.areas.sum()
    pulls = grips(model, file, outline)
    if len(bent := bending_terms(bending)) > 1:
        model.description.append((bent[1].name, "moment_warp or moment_weft of the fabric"))
    model.terms = [membrane_of(sheet), *bent, *contacts, *frictions, *weights, *pulls]
    let_slip(model)


def _rest(model: Model, contacts: Sequence[Contact]) -> list[Term]:
    """Place the tools; start at the equilibrium of resting ones, sunk in with the sheet."""
    sheet, x0, fixed = model.sheet, model.x0, model.fixed
    heights, t0 = sheet.dofs[:, 2], sheet.fabric.thickness
    weights, sunk = list[Term](), 0.0
    for contact in contacts:
        tool, dof = contact.tool, int(contact.tool_dofs[0])
        x0[dof] = tool.height
        fixed[dof] = tool.motion != "free"
        model.drive[dof] = -1.0 if tool.motion == "driven" else 0.0
        if tool.motion != "free":
            continue
        for axis, plane in enumerate("xy"):
            if plane in sheet.blank.mirror and tool.tilts:  # only the turn in that plane remains
                fixed[dof + 2 - axis] = True
        x0[heights] = tool.height - 0.5 * t0
        under = contact.penetration(x0) > -1e-6 * t0
        if not under.any():
            raise InputError(f"the blank does not reach under the {tool.name}")
        if tool.tilts and not surrounds(contact, x0):
            raise InputError(f"the blank does not surround the weight of the {tool.name}")
        load = load_of(tool) * model.share
        constant = load
        if len(tool.forces) > 1:
            weights.append(_force_over_travel(model, tool, dof))
            constant -= tool.forces[0, 1] * model.share
        weights.append(ToolWeight(constant, dof, f"weight of the {tool.name}"))
        model.resting += load
        sunk = max(sunk, contact.depth_under(load, sheet.blank.node_areas[under].sum()))
    x0[heights] = 0.5 * t0 - sunk
    for contact in contacts:
        if contact.tool.motion == "free":
            x0[contact.tool_dofs[0]] -= 2 * sunk
    return weights


def _force_over_travel(model: Model, tool: Tool, dof: int) -> ToolForce:
    """Prescribe the force on a tool over the travel, and return its energy."""
    force = int(model.unknowns[FORCE + tool.name].dofs[0, 0])
    rows = tool.forces * [1.0, model.share]
    model.loads[force], model.fixed[force], model.x0[force] = rows, True, rows[0, 1]
    shown = ", ".join(f"{newton:g} N at {travel:g} mm" for travel, newton in tool.forces)
    model.description.append((f"{FORCE}{tool.name} over the travel", shown))
    return ToolForce(dof, force, tool.height, FORCE + tool.name)


def _between_nodes(model: Model, contacts: Sequence[Contact]) -> list[Contact]:
    """Contact between nodes, for the tools whose edges are sharper than the mesh."""
    blank = model.sheet.blank
    edges, finest = at_edges(blank), blank.size * (1 - 1e-9)
    sharp = [c for c in contacts if getattr(c.tool.shape, "sharpest", 0.0) < finest]
    why = "no tool bends more sharply than the elements"
    if sharp:
        radii = {tool: smallest_radius(tool, model.tools[1]) for tool in (c.tool for c in sharp)}
        why = f"a tool bends more sharply than the elements{what_resolves(radii, blank.size)}"
    model.description.append((f"contact at nodes{' and mid-edges' * bool(sharp)}", why))
    return [Contact(model.sheet, c.tool, c.tool_dofs, edges) for c in sharp]


def _measure(model: Model) -> None:
    """Set the columns of the history, and where the draw-in is measured."""
    sheet, share = model.sheet, model.share
    model.edges = edge_points(sheet.whole[0])
    resting = [c for c in model.contacts if c.tool.motion == "free"]
    model.measures = {
        "holder_force_N": lambda x: float(
            -sum(c.gradient(x)[:, c.height_column].sum() for c in resting) / share
        ),
        "shear_angle_max_deg": model.membrane.largest_shear_angle,
        "draw_in_mm": lambda x: float(
            np.mean([e.draw_in(sheet.whole_positions(x)) for e in model.edges.values()])
        ),
    }
