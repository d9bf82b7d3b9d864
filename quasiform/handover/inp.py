"""Keyword files of formed fibres for Abaqus and CalculiX.

    mesh.inp     nodes and elements of the set FORMED
    fibres.inp   orientations (local 1 the fibre, 3 the normal) and thickness, by element
    part.inp     both included, with sections and stand-in materials; loads and steps to be added

Abaqus takes one *DISTRIBUTION a quantity; two layers of half the thickness, one along the warp, one
along the weft, carry both fibres also where they are no longer at right angles. CalculiX has no
distributions and layers only in elements of second order: it gets one *ORIENTATION and one set an
element, along one of the fibres or their bisector, and the thickness at the nodes.

The materials are stand-ins, linear with the constants of the flat, dry fabric at rest: density
w0/t0, E = 4 C_ini along a fibre, G = C_ini of the shear law; what the fabric's model does not have
(stiffness across the fibres of a layer, and through the thickness) is taken as G.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..checks import InputError
from .fibres import AXES, Fibres
from .keywords import NOTICES, fill

FloatArray = np.ndarray
Sets = dict[str, tuple[dict[int, str], int]]  # type by number of nodes, and what is added to labels
SHELLS = {3: "S3", 4: "S4R", 6: "STRI65", 8: "S8R", 9: "S9R5"}
MEMBRANES = {3: "M3D3", 4: "M3D4R", 6: "M3D6", 8: "M3D8R", 9: "M3D9R"}
CALCULIX = {3: "S3", 4: "S4", 6: "S6", 8: "S8"}
DENSITY = 1e-12  # t/mm³ of g/m² over mm: N, mm, s go with tonnes
FILES = ("mesh.inp", "fibres.inp", "part.inp")


def abaqus(fibres: Fibres, folder: Path, pair: bool = False) -> tuple[str, ...]:
    """Write the files for Abaqus; with `pair`, membranes and shells on the same nodes; notices."""
    known = fibres.known
    offset = 10 ** len(str(fibres.target.elements.max()))
    sets: Sets = {"FORMED": (SHELLS, 0)}
    if pair:
        sets["FORMED_MEMBRANE"] = MEMBRANES, offset
    labels = [fibres.target.elements[known] + more for _, more in sets.values()]
    warp, weft, shear = moduli(fibres)
    fill_files(
        *("abaqus", fibres, folder, sets),
        labels=np.concatenate(labels),
        thickness=np.tile(fibres.thickness[known], len(sets)),
        frames={axis.upper(): np.tile(axes_of(fibres, axis), (len(sets), 1)) for axis in AXES},
        materials={"WARP_LAYER": 2 * warp, "WEFT_LAYER": 2 * weft, "MEMBRANE": shear},
        **{"pair": pair, "shear": shear},
    )
    names = ("stand_in", "shared", "not_run") if pair else ("stand_in", "not_run")
    return tuple(NOTICES[name] for name in names)


def calculix(fibres: Fibres, folder: Path, axis: str = "warp") -> tuple[str, ...]:
    """Write the files for CalculiX, local 1 along `axis`; notices."""
    if axis not in AXES:
        raise InputError(f"axis must be one of {', '.join(AXES)}, got {axis!r}")
    E, shear = moduli_along(fibres, axis)
    fill_files(
        *("calculix", fibres, folder, {"FORMED": (CALCULIX, 0)}),
        labels=fibres.target.elements[fibres.known],
        thickness=fibres.target.at_nodes(fibres.thickness),
        frame=axes_of(fibres, axis),
        **{"axis": axis, "E": E, "shear": shear},
    )
    angle = f"{np.abs(fibres.shear_angle[fibres.known]).max():.1f}°"
    frame = NOTICES["frame_along"][axis].format(angle=angle)
    return *(NOTICES[name] for name in ("stand_in", "at_nodes", "one_each")), frame


def fill_files(code: str, fibres: Fibres, folder: Path, sets: Sets, /, **values: Any) -> None:
    """Write mesh.inp with the known elements, once a set; fibres.inp and part.inp of a code."""
    target, fabric = fibres.target, fibres.fabric
    blocks, used = [], []
    for name, (kinds, offset) in sets.items():
        for nodes, kind in kinds.items():
            chosen = fibres.known & (target.kept_nodes(kinds) == nodes)
            rows = target.rows_of(chosen, nodes)
            used.append(rows.ravel())
            blocks.append((name, kind, target.elements[chosen] + offset, target.nodes[rows]))
    used = np.unique(np.concatenate(used))
    header = [
        f"Formed part of {fibres.name}, fabric {fabric.get('name', '')}; N, mm, s, t, MPa.",
        f"Flat: thickness {fabric['thickness']:g} mm, {fabric['areal_weight']:g} g/m².",
        *fibres.notices,
        NOTICES["stand_in"],
    ]
    values = {"header": header, "density": density(fibres), "t0": fabric["thickness"]} | values
    values |= {"name": fibres.name, "prefix": fibres.prefix}
    values |= {"target": target, "used": used, "blocks": blocks}
    for file, start in zip(FILES, ("", f"{code}_", f"{code}_"), strict=True):
        fill(f"{start}{file}", folder / f"{fibres.prefix}{file}", **values)


def density(fibres: Fibres) -> float:
    """Density of the fabric, t/mm³."""
    fabric = fibres.fabric
    return max(DENSITY * fabric["areal_weight"] / fabric["thickness"], 1e-20)


def axes_of(fibres: Fibres, axis: str) -> FloatArray:
    """(k, 6) local 1 along a fibre and local 2 at a right angle to it in the element's plane."""
    along = getattr(fibres, axis)[fibres.known]
    return np.hstack([along, np.cross(fibres.target.normals[fibres.known], along)])


def moduli_along(fibres: Fibres, axis: str) -> tuple[tuple[float, float], float]:
    """The same along local 1, which is `axis`, and 2; and in shear."""
    warp, weft, shear = moduli(fibres)
    along = {"warp": (warp, weft), "weft": (weft, warp), "bisector": (0.5 * (warp + weft),) * 2}
    return along[axis], shear


def moduli(fibres: Fibres) -> tuple[float, float, float]:
    """Stiffness of the flat, unloaded fabric along warp and weft and in shear, MPa.

    S = 2 dW/dI4 and E = (I4 - 1)/2, so that dS/dE = 4 d²W/dI4² = 4 C_ini; S12 = dW/dI6 and
    I6 = 2 E12, so that the shear modulus is C_ini.
    """
    found = []
    for name, factor in (("warp", 4.0), ("weft", 4.0), ("shear", 1.0)):
        law = fibres.fabric.get(name) or {}
        law = law if isinstance(law, dict) else vars(law)
        if "C_ini" in law:
            found.append(factor * float(law["C_ini"]))
        elif len(law.get("I6", ())) > 1:
            found.append(float(law["S12"][1]) / float(law["I6"][1]))
        else:
            raise InputError(f"the laws of the fabric are unknown: the summary has no {name} law")
    return tuple(found)
