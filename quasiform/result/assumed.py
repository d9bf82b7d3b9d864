"""Which assumed numbers decide an answer: those of the scene, and defaults of the fabric."""

from __future__ import annotations

from dataclasses import fields

from ..energy.bending import Bending
from ..fabric import PRESETS, Fabric
from ..model import Model

IN_SPACE = ("thickness", "bending_warp", "bending_weft", "in_plane_bending")
STATED = ("thickness", "bending_warp", "bending_weft", "friction")  # for the fabric of the presets


def assumed(model: Model) -> list[str]:
    """Dotted names of the numbers with the standing "assumed" that the answer depends on.

    A number of the fabric is assumed if its provenance says so, or if it is the default, without a
    provenance: the defaults are those of another fabric, but for the presets.
    """
    standings = model.parameters.get("standings", {})
    found = [name for name, standing in standings.items() if standing == "assumed"]
    found = [name for name in found if name != "travel"]  # an answer names its travel
    own = model.sheets[0].fabric
    for k, ply in enumerate(model.plies, 1):
        if k == 1:
            found += [f"fabric.{name}" for name in _of_fabric(ply)]
        elif ply.sheet.fabric != own:
            found += [f"plies {k}.fabric.{name}" for name in _of_fabric(ply)]
    return found


def _of_fabric(model: Model) -> list[str]:
    """Names of the assumed numbers of the fabric of a model with one sheet."""
    fabric, found = model.sheet.fabric, []
    bends = any(isinstance(term, Bending) for term in model.terms)
    used = IN_SPACE if model.sheet.dim == 3 else IN_SPACE[:1] + IN_SPACE[-1:] * bends
    used += ("compaction",) if model.contacts or model.ply_contacts else ()
    used += ("friction",) if model.frictions else ()
    for part in ("resistance", "stiffness", "pitch") if model.slip else ():
        origin = fabric.provenance.get(f"slip.{part}", fabric.provenance.get("slip", "assumed"))
        if str(origin).startswith("assumed"):
            found.append(f"slip.{part}")
    own = {law: Fabric.preset(law).shear for law in PRESETS}
    stated = STATED if fabric.shear in own.values() else ()
    defaults = {entry.name: entry.default for entry in fields(Fabric)}
    for name in used:
        origin = fabric.provenance.get(name)
        default = getattr(fabric, name) == defaults[name] and name not in stated
        if default if origin is None else str(origin).startswith("assumed"):
            found.append(name)
    return found
