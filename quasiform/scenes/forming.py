"""From a scene file to a model: forming with punch, die and blank holder (Schäfer et al., Fig. 4).

The model holds no more than the scene needs, and says what was left out: mirror planes that blank,
fibres and tools share, terms with a zero coefficient, contact between nodes where the mesh resolves
the tools.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ..checks import InputError, check_number, round_length
from ..energy.bending import Bending, PatchBending
from ..energy.contact import Contact, at_edges, surrounds
from ..energy.friction import Friction
from ..energy.plies import pair_name, slip_between
from ..energy.softening import Softening, bending_terms
from ..energy.stitches import Stitches
from ..energy.term import Term
from ..energy.weight import GRAVITY, SheetWeight, ToolWeight, load_of
from ..fabric import Fabric, fabric_of
from ..model import DIAPHRAGM, Model
from ..net import free_mesh
from ..net.blank import Blank, cut, rotation
from ..net.edges import edge_points
from ..net.free_mesh import PAIRED
from ..recipe import built, checksums, plain, reference
from ..tools import tool_file
from ..tools.shapes import Tool, turned
from ..unknowns import Unknowns
from . import scene_file, stack
from .blank_file import blank_from_file
from .diaphragm import assumed_defaults, membranes_of, with_diaphragm
from .loads import FORCE, PRESSURE, drive_tool, force_over_travel, pressure_on_sheet, sink
from .mechanics import check_mechanics
from .room import check_clearance, mirror_planes, smallest_radius, what_resolves
from .scene_file import SceneFile, SurfaceFile, ToolPart, check_increments
from .scene_parts import SYMMETRIES
from .slipping import let_slip
from .stack import Layer
from .supports import fix_supports, grips, keep_middles

LEAST = 0.5  # of the default size: how fine it may be for the sake of a fillet
FINE = 0.4  # of the smallest fillet: the mesh of the path
FACTOR = "load factor of the weight"


def forming(
    scene: str | Path | SceneFile = "hemisphere",
    orientation: float | None = None,
    law: str | Fabric | None = None,
    size: float | None = None,
    travel: float | None = None,
    symmetry: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    plies: Sequence[Any] | None = None,
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
    plies : sequence, optional
        Layers of a stack, from the punch down: angles, degrees, or tables with the keys of
        `[[plies]]` in a scene file. The `orientation` of the scene turns all of them.

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
    if plies is not None:
        overrides["plies"] = stack.as_tables(plies)
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
    if symmetry not in SYMMETRIES:
        *others, last = map(repr, SYMMETRIES)
        raise InputError(f"symmetry must be {', '.join(others)} or {last}, got {symmetry!r}")
    goal = file.travel if travel is None else float(check_number("travel", travel))
    if goal > file.travel:
        raise InputError(
            f"travel must not exceed {file.travel:g} mm in this scene, got {goal:g}: "
            f"--set travel={goal:g} makes another scene"
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
    usual = usual_length(outline)
    plies = stack.layers_of(file, fabric, orientation, outline)
    layers = with_diaphragm(file, plies)
    _check_layers(layers, size, own)
    outline = stack.outline_of(layers)
    thickness = sum(layer.fabric.thickness for layer in layers)
    increments = {"largest": file.increment or usual, "rows": file.rows or usual}
    check_increments(travel, **increments)
    from_files = like.tools[1] if like else _from_files(file, thickness, outline)
    tools = [_tool(part, layers, thickness, from_files.get(part.name)) for part in file.tools]
    for read in from_files.values():
        description += read.description(tools, outline, travel)
    description += blank_from_file(file, own, outline, tools, from_files)
    if not like:
        check_clearance(file, tools, from_files, outline, thickness, travel)
    mirrored = like and like.tools[2]
    mirrored = mirrored or _mirror_planes(file, tools, layers, travel, symmetry)
    mirror, why = mirrored
    description += stack.described(plies) + stack.cuts(layers) + why
    frame, unknowns = layers[0].orientation if mirror else 0.0, Unknowns()
    sheets = []
    for layer in layers:
        turn = layer.orientation - frame
        blank = own or _mesh(file.mesh, layer, size, frame, turn, mirror)
        sheets.append(unknowns.sheet(blank, layer.fabric, 3, frame, layer.name))
    tools_in_frame = [_in_frame(tool, frame, blank) for tool in tools]
    for tool in tools_in_frame:
        unknowns.add(tool.name, 3 if tool.tilts else 1)
        if len(tool.forces) > 1:
            unknowns.add(FORCE + tool.name, 1)
    for factor, acts in ((FACTOR, file.gravity), (PRESSURE, file.pressure is not None)):
        if acts:
            unknowns.add(factor, 1)
    x0, fixed, drive = unknowns.start(*sheets)
    fabric = plies[0].fabric if file.plies else fabric
    parameters = {"scene": name} | ({"scene_file": file.source} if file.source else {})
    parameters |= {"orientation": orientation, "law": fabric.name, "size": size, "travel": travel}
    defaults = dict.fromkeys(stack.assumed_between(file) + assumed_defaults(file), "assumed")
    parameters |= {"symmetry": symmetry, "fabric": asdict(fabric)}
    parameters["standings"] = defaults | dict(file.standings)
    if file.plies:
        parameters["plies"] = stack.written(plies)
    if file.diaphragm:
        parameters["diaphragm"] = asdict(file.diaphragm)
    model = Model(
        name=f"{file.name}-{orientation:g}",
        unknowns=unknowns,
        sheets=sheets,
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
    _assemble(model, file, tools_in_frame, layers)
    if not like:
        check_mechanics(file, tools, from_files, outline, thickness, travel)
    _measure(model)
    return model


@plain.register
def _(file: SceneFile) -> dict[str, Any]:
    content = {"toml": scene_file.scene_toml(file), "source": file.source}
    return {"read": reference(scene_file.read_text), "from": content}


def _check_layers(layers: Sequence[Layer], size: float, own: Blank | None) -> None:
    """Refuse (InputError) what a sheet in space cannot have."""
    for layer in layers:
        if layer.fabric.bending_warp == 0 or layer.fabric.bending_weft == 0:
            raise InputError(
                "forming in space needs a bending stiffness: bending_warp or _weft is zero"
            )
        if not own and size > (largest := _shorter_side(layer.outline) / 8):
            raise InputError(
                f"size must not exceed an eighth of the blank, {largest:g}, got {size:g}"
            )


def _mirror_planes(
    file: SceneFile, tools: Sequence[Tool], layers: Sequence[Layer], travel: float, symmetry: str
) -> tuple[tuple[str, ...], list[tuple[str, str]]]:
    """Mirror planes that all layers have, and why; see `room.mirror_planes`."""
    turns = {(layer.orientation - layers[0].orientation) % 90.0 for layer in layers}
    if len(turns) > 1:
        return (), [("the whole blank", "the plies have no mirror plane in common")]
    given = layers[0].orientation, travel, symmetry, layers[0].fabric
    shapes = [(layer.outline, layer.slits, layer.darts) for layer in layers]
    found = [mirror_planes(file, tools, *cuts, *given) for cuts in shapes]
    planes, why = min(found, key=lambda entry: len(entry[0]))
    if any(set(planes) - set(other) for other, _ in found):
        return (), [("the whole blank", "the plies have no mirror plane in common")]
    return planes, why


def _from_files(
    file: SceneFile, thickness: float, outline: shapely.Polygon
) -> dict[str, tool_file.ToolFile]:
    low, high = file.heights(outline, file.travel)
    deep = max(-low, high)
    return {
        part.name: tool_file.read(part, outline, deep, thickness)
        for part in file.tools
        if isinstance(part.shape, SurfaceFile)
    }


def _tool(
    part: ToolPart, layers: Sequence[Layer], thickness: float, read: tool_file.ToolFile | None
) -> Tool:
    """A tool on or under the flat plies."""
    shape, rest = part.shape, 0.0 if part.role == "die" else thickness
    fabric = layers[-1 if part.role == "die" else 0].fabric
    if read:
        shape, rest = read.grid, read.rest
    z = rest if part.z is None else part.z
    friction = fabric.friction if part.friction is None else part.friction
    tilts = part.motion == "free" and part.tilt is not False
    loads = part.mass, part.force
    return Tool(part.name, shape, z, part.motion, friction, *loads, part.place, tilts, part.stroke)


def _in_frame(tool: Tool, frame: float, blank: Blank) -> Tool:
    """Turn a tool into the model's axes; between two mirror planes it cannot tilt."""
    tool = replace(tool, tilts=tool.tilts and len(blank.mirror) < 2)
    if frame == 0:
        return tool
    place = tuple(np.array(tool.place) @ rotation(frame))
    return replace(tool, shape=turned(tool.shape, -frame), place=place)


def _mesh(
    mesh: str | Path, layer: Layer, size: float, turn: float, warp: float, mirror: tuple
) -> Blank:
    outline = shapely.affinity.rotate(layer.outline, -turn, origin=(0, 0))
    if mesh == "free":
        return free_mesh.triangulate(outline, size, warp)
    slits = [line @ rotation(turn) for line in layer.slits]
    return cut(outline, size, warp, ((0.0, 0.0),), mirror, slits, bool(layer.darts))


def _assemble(model: Model, file: SceneFile, tools: list[Tool], layers: Sequence[Layer]) -> None:
    """Put energies and supports into a model."""
    contacts = _with_tools(model, file, tools, layers)
    weights: list[Term] = _rest(model, contacts, layers)
    sink(model, file, contacts)
    for contact in contacts:
        if (contact.penetration(model.x0) > contact.sheet.fabric.thickness).any():
            read = model.tools[1].get(contact.tool.name)
            why = read.why_inside() if read else "check its z"
            raise InputError(f"the flat blank starts inside the {contact.tool.name}: {why}")
    supported, bent = fix_supports(model, file, layers), list[Term]()
    for sheet in model.sheets:
        blank = sheet.blank
        for axis, plane in enumerate("xy"):
            if plane in blank.mirror:
                model.fixed[sheet.dofs[:, axis]] |= np.abs(blank.nodes[:, axis]) < 1e-9
        clamped = supported.get(sheet.name)
        clamped = None if clamped is None or not clamped.any() else clamped
        if blank.pairs is not None:
            model.description.append(PAIRED)
            if clamped is not None:
                raise InputError("clamp = true needs a mesh that follows the fibres")
        bending = Bending(sheet, clamped) if blank.pairs is None else PatchBending(sheet)
        bent += bending_terms(bending)
    contacts += _between_nodes(model, contacts)
    between = stack.between_plies(model, layers) if len(layers) > 1 else []
    pulls = grips(model, file, layers)
    model.sheets.sort(key=lambda sheet: sheet.name == DIAPHRAGM)  # results are those of the plies
    membranes = membranes_of(model, file)
    frictions = [Friction(c) for c in contacts if c.tool.friction]
    if not frictions:
        model.description.append(("friction left out", "its coefficient is zero"))
        keep_middles(model, {pull.sheet.name for pull in pulls}, between)
    weights += [*_sheet_weights(model, file, layers), *pressure_on_sheet(model, file, layers)]
    model.resting += sum(g.tension for g in file.grippers)
    model.resting += sum(
        file.gravity * 1e-6 * GRAVITY * sheet.fabric.areal_weight * sheet.blank.areas.sum()
        for sheet in model.sheets
    )
    if softened := [term for term in bent if isinstance(term, Softening)]:
        model.description.append((softened[0].name, "moment_warp or moment_weft of the fabric"))
    model.terms = [*membranes, *bent, *contacts, *frictions, *between, *weights, *pulls]
    let_slip(model)


def _with_tools(
    model: Model, file: SceneFile, tools: list[Tool], layers: Sequence[Layer]
) -> list[Contact]:
    """Contact of each ply with each tool that it can touch."""
    contacts, left_out, plies = [], [], max(1, sum(len(layer.plies) for layer in layers))
    for part, tool in zip(file.tools, tools, strict=True):
        dofs = model.unknowns[tool.name].dofs
        for k, sheet in enumerate(model.sheets):
            if len(layers) == 1 or stack.meets(layers, k, part.role):
                contacts.append(Contact(sheet, tool, dofs, plies=plies))
            else:
                left_out.append(f"{sheet.name} with {tool.name}")
    if left_out:
        entry = f"contact left out: {', '.join(left_out)}"
        model.description.append((entry, "other plies cover it"))
    return contacts


def _sheet_weights(model: Model, file: SceneFile, layers: Sequence[Layer]) -> list[Term]:
    """The weights of the sheets, or why they are left out."""
    if not file.gravity:
        loads = (layer.fabric.areal_weight * layer.outline.area for layer in layers)
        total, resting = 1e-6 * GRAVITY * sum(loads), model.resting / model.share
        beside = f" beside the {resting:.3g} N that rest on it" if resting else ""
        why = f"{total:.2g} N{beside} (gravity = false)"
        model.description.append(("weight of the sheet left out", why))
        return []
    factor = int(model.unknowns[FACTOR].dofs[0, 0])
    model.fixed[factor], model.x0[factor] = True, 1.0
    return [
        SheetWeight(sheet, 1e-6 * GRAVITY * sheet.fabric.areal_weight, factor)
        for sheet in model.sheets
    ]


def _rest(model: Model, contacts: Sequence[Contact], layers: Sequence[Layer]) -> list[Term]:
    """Place the tools; start at the equilibrium of resting ones, sunk in with the plies."""
    x0, fixed, heights = model.x0, model.fixed, stack.heights(layers)
    weights, sunk = list[Term](), 0.0
    first: dict[str, Contact] = {}
    for contact in contacts:
        first.setdefault(contact.tool.name, contact)
    for contact in first.values():
        tool, dof, sheet = contact.tool, int(contact.tool_dofs[0]), contact.sheet
        x0[dof] = tool.height
        fixed[dof] = tool.motion != "free"
        drive_tool(model, tool, dof)
        if tool.motion != "free":
            continue
        for axis, plane in enumerate("xy"):
            if plane in sheet.blank.mirror and tool.tilts:  # only the turn in that plane remains
                fixed[dof + 2 - axis] = True
        t0 = sheet.fabric.thickness
        x0[sheet.dofs[:, 2]] = tool.height - 0.5 * t0
        under = contact.penetration(x0) > -1e-6 * t0
        if not under.any():
            raise InputError(f"the blank does not reach under the {tool.name}")
        if tool.tilts and not surrounds(contact, x0):
            raise InputError(f"the blank does not surround the weight of the {tool.name}")
        load = load_of(tool) * model.share
        constant = load
        if len(tool.forces) > 1:
            weights.append(force_over_travel(model, tool, dof))
            constant -= tool.forces[0, 1] * model.share
        weights.append(ToolWeight(constant, dof, f"weight of the {tool.name}"))
        model.resting += load
        sunk = max(sunk, contact.depth_under(load, sheet.blank.node_areas[under].sum()))
    for k, sheet in enumerate(model.sheets):
        x0[sheet.dofs[:, 2]] = heights[k] - (len(layers) - k) * sunk
    for contact in first.values():
        if contact.tool.motion == "free":
            x0[contact.tool_dofs[0]] -= (len(layers) + 1) * sunk
    return weights


def _between_nodes(model: Model, contacts: Sequence[Contact]) -> list[Contact]:
    """Contact between nodes, for the tools whose edges are sharper than the mesh."""
    size = min(sheet.blank.size for sheet in model.sheets)
    finest = size * (1 - 1e-9)
    sharp = [c for c in contacts if getattr(c.tool.shape, "sharpest", 0.0) < finest]
    why = "no tool bends more sharply than the elements"
    if sharp:
        radii = {tool: smallest_radius(tool, model.tools[1]) for tool in (c.tool for c in sharp)}
        why = f"a tool bends more sharply than the elements{what_resolves(radii, size)}"
    model.description.append((f"contact at nodes{' and mid-edges' * bool(sharp)}", why))
    edges = {sheet.name: at_edges(sheet.blank) for sheet in model.sheets}
    return [Contact(c.sheet, c.tool, c.tool_dofs, edges[c.sheet.name], c.plies) for c in sharp]


def _measure(model: Model) -> None:
    """Set the columns of the history, and where the draw-in is measured."""
    share = model.share
    model.edges = edge_points(model.sheet.whole[0])
    resting = [c for c in model.contacts if c.tool.motion == "free"]
    model.measures["holder_force_N"] = lambda x: float(
        -sum(c.gradient(x)[:, c.height_column].sum() for c in resting) / share
    )
    for k, ply in enumerate(model.plies, 1):
        start = f"ply_{k}_" * (k > 1)
        model.measures[f"{start}shear_angle_max_deg"] = ply.membrane.largest_shear_angle
        model.measures[f"{start}draw_in_mm"] = partial(_draw_in, ply)
    for term in model.terms:
        if isinstance(term, Stitches):
            model.measures[f"stitch_{pair_name(term.sheets)}_N"] = term.largest_force
    for name, pair in model.named_pairs.items():
        model.measures[f"slip_{name}_mm"] = partial(slip_between, model.x0, pair)


def _draw_in(ply: Model, x: np.ndarray) -> float:
    positions = ply.sheet.whole_positions(x)
    return float(np.mean([edge.draw_in(positions) for edge in ply.edges.values()]))
