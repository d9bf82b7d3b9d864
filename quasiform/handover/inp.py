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

import numpy as np

from ..checks import InputError
from .fibres import AXES, Fibres
from .keywords import comment, elements, numbers, rows, write

FloatArray = np.ndarray
DENSITY = 1e-12  # t/mm³ of g/m² over mm: N, mm, s go with tonnes
FILES = ("mesh.inp", "fibres.inp", "part.inp")
INCLUDES = ("*INCLUDE, INPUT=mesh.inp", "*INCLUDE, INPUT=fibres.inp")
STAND_IN = (
    "the materials in part.inp are stand-ins, the dry fabric's stiffness at rest: replace them by "
    "those of the part"
)
SHARED = (
    "membranes and shells share nodes and each has half the mass; the shells' stand-in "
    "has the whole stiffness, the membranes' next to none: divide it as you model it"
)
NOT_RUN = "the files for Abaqus are not run: their syntax is checked only"
AT_NODES = (
    "CalculiX takes the thickness at the nodes: the mean of the elements around, weighted by "
    "area (a step between elements would stiffen their nodes)"
)
ONE_EACH = "one orientation an element, none binned"
GENERAL = (STAND_IN, SHARED, NOT_RUN, AT_NODES, ONE_EACH)  # true of every part


def abaqus(fibres: Fibres, folder: Path, pair: bool = False) -> tuple[str, ...]:
    """Write the files for Abaqus; with `pair`, membranes and shells on the same nodes; notices."""
    known, t0 = fibres.known, f"{fibres.fabric['thickness']:.9g}"
    offset = 10 ** len(str(fibres.target.elements.max()))
    sets = [("FORMED", ("S3", "S4R"), 0)]
    sets += [("FORMED_MEMBRANE", ("M3D3", "M3D4R"), offset)] if pair else []
    _write_mesh(fibres, folder, sets)
    labels = np.concatenate([fibres.target.elements[known] + more for *_, more in sets])

    def by_element(values: FloatArray) -> list[str]:
        return list(rows(labels, np.tile(values, (len(sets), *[1] * (values.ndim - 1)))))

    lines = comment(
        [
            f"Fibres of {fibres.name}: local 1 is the named direction, local 3 the element's "
            "normal. To be included in a model with these element labels."
        ]
    )
    lines += ["*DISTRIBUTION TABLE, NAME=TWO_POINTS", "COORD3D, COORD3D"]
    lines += ["*DISTRIBUTION TABLE, NAME=LENGTHS", "LENGTH"]
    for name in map(str.upper, AXES):
        lines += [f"*DISTRIBUTION, NAME={name}_POINTS, LOCATION=ELEMENT, TABLE=TWO_POINTS"]
        lines += [", 1., 0., 0., 0., 1., 0.", *by_element(_frame(fibres, name.lower()))]
        lines += [f"*ORIENTATION, NAME={name}_AXES, SYSTEM=RECTANGULAR", f"{name}_POINTS", "3, 0."]
    lines += ["*DISTRIBUTION, NAME=FORMED_THICKNESS, LOCATION=ELEMENT, TABLE=LENGTHS"]
    write(folder / "fibres.inp", [*lines, f", {t0}", *by_element(fibres.thickness[known])])

    warp, weft, shear = moduli(fibres)
    materials = {"WARP_LAYER": 2 * warp, "WEFT_LAYER": 2 * weft}
    lines = ["*HEADING", *_header(fibres), *INCLUDES]
    lines += ["*SHELL SECTION, ELSET=FORMED, COMPOSITE, SHELL THICKNESS=FORMED_THICKNESS"]
    lines += ["0.5, 3, WARP_LAYER, WARP_AXES", "0.5, 3, WEFT_LAYER, WEFT_AXES"]
    if pair:
        materials["MEMBRANE"] = shear
        lines += [
            "*MEMBRANE SECTION, ELSET=FORMED_MEMBRANE, MATERIAL=MEMBRANE, "
            "ORIENTATION=BISECTOR_AXES, MEMBRANE THICKNESS=FORMED_THICKNESS",
            t0,
        ]
    for name, E in materials.items():
        lines += [f"*MATERIAL, NAME={name}", "*DENSITY", f"{_density(fibres) / len(sets):.6g},"]
        lines += ["*ELASTIC, TYPE=LAMINA", numbers((E, shear, 0.0, shear, shear, shear), 6)]
    write(folder / "part.inp", lines)
    return (STAND_IN, SHARED, NOT_RUN) if pair else (STAND_IN, NOT_RUN)


def calculix(fibres: Fibres, folder: Path, axis: str = "warp") -> tuple[str, ...]:
    """Write the files for CalculiX, local 1 along `axis`; notices."""
    if axis not in AXES:
        raise InputError(f"axis must be one of {', '.join(AXES)}, got {axis!r}")
    target, known = fibres.target, fibres.known
    labels = target.elements[known]
    used = _write_mesh(fibres, folder, [("FORMED", ("S3", "S4"), 0)])
    lines = comment([f"Fibres of {fibres.name}: local 1 is the {axis}."])
    for label, row in zip(labels, _frame(fibres, axis), strict=True):
        lines += [f"*ELSET, ELSET=F{label}", str(label)]
        lines += [f"*ORIENTATION, NAME=O{label}, SYSTEM=RECTANGULAR", numbers(row)]
    thickness = target.at_nodes(fibres.thickness)[used]
    lines += ["*NODAL THICKNESS", *rows(target.nodes[used], thickness)]
    write(folder / "fibres.inp", lines)

    warp, weft, shear = moduli(fibres)
    E = {"warp": (warp, weft), "weft": (weft, warp), "bisector": (0.5 * (warp + weft),) * 2}[axis]
    lines = ["*HEADING", fibres.name, *_header(fibres), *INCLUDES]
    lines += ["*MATERIAL, NAME=FABRIC", "*DENSITY", f"{_density(fibres):.6g}"]
    lines += ["*ELASTIC, TYPE=ENGINEERING CONSTANTS"]
    lines += [numbers((*E, shear, 0.0, 0.0, 0.0, shear, shear), 6) + ",", f"{shear:.6g}"]
    for label in labels:
        lines += [
            f"*SHELL SECTION, ELSET=F{label}, MATERIAL=FABRIC, ORIENTATION=O{label}, "
            "NODAL THICKNESS",
            f"{fibres.fabric['thickness']:.9g}",
        ]
    write(folder / "part.inp", lines)
    largest = float(np.abs(fibres.shear_angle[known]).max())
    other = {"warp": "weft", "weft": "warp"}.get(axis)
    frame = (
        f"one orthogonal frame an element: local 1 is the {axis}, and the {other} is up to "
        f"{largest:.1f}° off local 2 (the shear angle), which this frame cannot carry"
        if other
        else "one orthogonal frame an element, along the bisector: the constants of a sheared "
        f"fabric differ with its angle (up to {largest:.1f}°), those written are of one"
    )
    return STAND_IN, AT_NODES, ONE_EACH, frame


def _write_mesh(
    fibres: Fibres, folder: Path, sets: list[tuple[str, tuple[str, str], int]]
) -> np.ndarray:
    """Write mesh.inp: the known elements, once a set, with their nodes; rows of the nodes."""
    target = fibres.target
    used = np.unique(target.corners[fibres.known])
    used = used[used >= 0]
    lines = comment([f"Mesh of {fibres.name}, mm."])
    lines += ["*NODE, NSET=FORMED_NODES", *rows(target.nodes[used], target.points[used])]
    for name, kinds, offset in sets:
        for kind, corners, chosen in zip(
            kinds, (3, 4), (target.triangular, ~target.triangular), strict=True
        ):
            chosen = chosen & fibres.known
            if chosen.any():
                nodes = target.nodes[target.corners[chosen, :corners]]
                lines += [f"*ELEMENT, TYPE={kind}, ELSET={name}"]
                lines += elements(target.elements[chosen] + offset, nodes)
    write(folder / "mesh.inp", lines)
    return used


def _frame(fibres: Fibres, axis: str) -> FloatArray:
    """(k, 6) local 1 along a fibre and local 2 at a right angle to it in the element's plane."""
    along = getattr(fibres, axis)[fibres.known]
    return np.hstack([along, np.cross(fibres.target.normals[fibres.known], along)])


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


def _density(fibres: Fibres) -> float:
    """t/mm³."""
    return max(DENSITY * fibres.fabric["areal_weight"] / fibres.fabric["thickness"], 1e-20)


def _header(fibres: Fibres) -> list[str]:
    fabric = fibres.fabric
    return comment(
        [
            f"Formed part of {fibres.name}, fabric {fabric.get('name', '')}; N, mm, s, t, MPa.",
            f"Flat: thickness {fabric['thickness']:g} mm, {fabric['areal_weight']:g} g/m².",
            *fibres.notices,
            STAND_IN,
        ]
    )
