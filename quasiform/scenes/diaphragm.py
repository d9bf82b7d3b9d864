"""An elastic diaphragm of a scene: one more sheet, over the plies or under them."""

from __future__ import annotations

from dataclasses import fields, replace

import shapely

from ..checks import InputError
from ..energy.diaphragm import Diaphragm
from ..energy.membrane import Membrane, membrane_of
from ..energy.pressure import free_edges
from ..fabric import Fabric, ThreeStageLaw
from ..model import DIAPHRAGM, Model
from .scene_file import SceneFile
from .scene_parts import ElasticSheet
from .stack import Layer, outline_of

DENSITY = 1100.0  # g per m² and mm of thickness, of silicone (assumed)
LARGER = 1.25  # times the blank, where the scene gives no outline


def with_diaphragm(file: SceneFile, layers: list[Layer]) -> list[Layer]:
    """Layers from above with that of the diaphragm, if the scene has one."""
    given = file.diaphragm
    if given is None:
        return layers
    if file.supports or file.grippers or file.mesh != "fibre":
        key = "[[supports]]" if file.supports else "[[grippers]]" if file.grippers else "mesh"
        raise InputError(f"[diaphragm] is not possible together with {key}")
    if layers[0].fabric.slip is not None:
        raise InputError("[diaphragm] is not possible with slip of the rovings")
    plies = outline_of(layers)
    hull = shapely.affinity.scale(plies.convex_hull, LARGER, LARGER)
    outline = given.blank.polygon if given.blank else hull
    if not outline.intersects(plies):
        raise InputError("[diaphragm] does not lie over the blank")
    t, mu = given.thickness, given.friction
    B = given.modulus * t**3 / (12.0 * (1.0 - given.poisson**2))
    linear = ThreeStageLaw(given.modulus / 4.0)  # where a modulus of fibres is asked for
    fabric = replace(
        Fabric("diaphragm", linear, linear, linear, t, B, B, in_plane_bending=1.0),
        areal_weight=DENSITY * t,
        compaction=layers[0].fabric.compaction,
        friction=mu,
    )
    layer = Layer(DIAPHRAGM, outline, layers[0].orientation, fabric, mu, ())
    if given.side == "under":
        return [*layers, layer]
    return [layer, replace(layers[0], friction=mu), *layers[1:]]


def assumed_defaults(file: SceneFile) -> list[str]:
    """Dotted names of numbers of the diaphragm that are its defaults."""
    own = {f.name: f.default for f in fields(ElasticSheet) if f.name in ("poisson", "friction")}
    given = file.diaphragm
    return [f"diaphragm.{name}" for name, it in own.items() if given and getattr(given, name) == it]


def membranes_of(model: Model, file: SceneFile) -> list[Membrane]:
    """Membrane energies of all sheets, that of the diaphragm with its edge clamped."""
    found: list[Membrane] = []
    for sheet in model.sheets:
        if sheet.name != DIAPHRAGM:
            found.append(membrane_of(sheet))
            continue
        given = file.diaphragm
        found.append(Diaphragm(sheet, given.modulus, given.poisson, given.prestretch))
        if given.clamped:
            model.fixed[sheet.dofs[free_edges(sheet.blank)]] = True
        edge = "clamped" if given.clamped else "free"
        why = f"{given.thickness:g} mm of {given.modulus:g} MPa, its edge {edge}"
        model.description.append((f"diaphragm {given.side} the plies", why))
    return found
