"""A layup: one mesh of composite shells for Abaqus or CalculiX, with a layer a ply.

    mesh.inp     nodes and elements of the set FORMED
    fibres.inp   the orientation of every ply in every element, and one set an element
    part.inp     both included, with one composite section an element and stand-in materials

The first layer of a section is the lowest against the element's normal. Ply 1 is on the upper side
of the sheet, where the punch is: seen from there the weft is counter-clockwise of the warp. Local 1
of a layer is the warp of its ply, the weft or their bisector, local 3 the element's normal.
CalculiX has layers in S6 and S8R only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..checks import InputError
from .fibres import AXES, Fibres
from .inp import SHELLS, axes_of, density, fill_files, moduli_along
from .keywords import NOTICES

CODES = {"abaqus": SHELLS, "calculix": {6: "S6", 8: "S8R"}}
Layer = tuple[float, int]  # thickness (mm), and the number of the ply from 0 on


def layup(plies: Sequence[Fibres], folder: Path, code: str, axis: str = "warp") -> tuple[str, ...]:
    """Write the files of a layup of plies on one mesh, from the punch down; notices."""
    if axis not in AXES:
        raise InputError(f"axis must be one of {', '.join(AXES)}, got {axis!r}")
    first, known = plies[0], np.logical_or.reduce([ply.known for ply in plies])
    target = first.target.of_second_order() if code == "calculix" else first.target
    materials = [_material(ply, k, axis) for k, ply in enumerate(plies, 1)]
    whole = replace(first, name=first.name.partition(",")[0], ply=0, known=known, target=target)
    labels = first.target.elements
    fill_files(
        *("layup", replace(whole, notices=()), folder, {"FORMED": (CODES[code], 0)}),
        header=[
            f"Layup of {whole.name}; N, mm, s, t, MPa.",
            *(material["words"] for material in materials),
            *(NOTICES[name] for name in ("layup", "stand_in")),
        ],
        **{"code": code, "axis": axis, "materials": materials},
        frames=[(labels[ply.known], axes_of(ply, axis)) for ply in plies],
        sections=list(zip(labels[known], _layers(plies, known), strict=True)),
    )
    names = ("layup", "stand_in", "not_run") if code == "abaqus" else ("layup", "stand_in", "steps")
    more = [NOTICES["second_order"]] * (len(target.points) > len(first.target.points))
    angle = max(np.abs(ply.shear_angle[ply.known]).max() for ply in plies)
    frame = NOTICES["frame_along"][axis].format(angle=f"{angle:.1f}°")
    return *(NOTICES[name] for name in names), *more, frame


def _layers(plies: Sequence[Fibres], known: np.ndarray) -> list[list[Layer]]:
    """Layers of the elements that have any, the lowest against the normal first."""
    upper = [np.einsum("mi,mi->m", np.cross(p.warp, p.weft), p.target.normals) for p in plies]
    upper = np.nansum(np.where([ply.known for ply in plies], upper, 0.0), axis=0) > 0
    found = []
    for row in np.flatnonzero(known):
        layers: list[Layer] = []
        for k, ply in enumerate(plies):
            if ply.known[row]:
                layers += [(ply.thickness[row] / ply.joined, k)] * ply.joined
        found.append(layers[::-1] if upper[row] else layers)
    return found


def _material(ply: Fibres, number: int, axis: str) -> dict[str, object]:
    """Stand-in for a ply, linear with the constants of the flat, dry fabric at rest."""
    E, shear = moduli_along(ply, axis)
    flat = f"flat {ply.fabric['thickness']:g} mm, {ply.fabric['areal_weight']:g} g/m²"
    words = f"PLY_{number}: {ply.name.partition(', ')[2] or 'the only ply'}, "
    words += f"fabric {ply.fabric.get('name', '')}, {flat}" + ", joined" * (ply.joined > 1)
    return {"E": E, "shear": shear, "density": density(ply), "words": words}
