"""Keyword files of formed fibres for Abaqus and CalculiX.

    mesh.inp     nodes and elements of the set FORMED
    fibres.inp   orientations (local 1 the fibre, 3 the normal) and thickness, by element
    part.inp     both included, with sections and stand-in materials; loads and steps to be added

Abaqus takes one *DISTRIBUTION a quantity; two layers of half the thickness, one along the warp, one
along the weft, carry both fibres also where they are no longer at right angles. CalculiX has no
distributions and layers only in elements of second order: it gets one *ORIENTATION and one set an
element, along one of the fibres or their bisector, and the thickness at the nodes.

The materials are stand-ins, linear with the constants of the flat, dry fabric at rest: density
w0/t0, E = 4 C_ini along a fibre, G = C_ini of the shear law; what the fabric's model has not (the
stiffness across the fibres of a layer, and through the thickness) is taken as G.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from ..checks import InputError
from ..comparison.sheet import at_nodes
from .fibres import AXES, Fibres
from .target import Target

FloatArray = np.ndarray
DENSITY = 1e-12  # t/mm³ of g/m² over mm: N, mm, s go with tonnes
FILES = ("mesh.inp", "fibres.inp", "part.inp")
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


def rows(labels: Iterable[int], values: FloatArray) -> Iterator[str]:
    """Lines of a label and its numbers."""
    for label, row in zip(labels, values, strict=True):
        yield ", ".join([str(label), *(f"{value:.9g}" for value in np.atleast_1d(row))])


def listed(labels: Iterable[int]) -> Iterator[str]:
    """Lines of at most 16 labels, as the data of sets are."""
    labels = list(map(str, labels))
    for first in range(0, len(labels), 16):
        yield ", ".join(labels[first : first + 16])


def comment(lines: Iterable[str]) -> Iterator[str]:
    """Comment lines, plain ASCII of at most 80 characters."""
    import textwrap

    for line in lines:
        for symbol, word in (("°", " deg"), ("²", "^2"), ("³", "^3"), ("γ", "gamma"), ("×", "x")):
            line = line.replace(symbol, word)
        plain = line.encode("ascii", "replace").decode()
        yield from (f"** {part}" for part in textwrap.wrap(plain, 76) or [""])


def write(path: Path, lines: Iterable[str]) -> None:
    """Write lines into a file."""
    path.write_text("\n".join([*lines, ""]), encoding="ascii")


def abaqus(fibres: Fibres, folder: Path, pair: bool = False) -> tuple[str, ...]:
    """Write the files for Abaqus; notices.

    Parameters
    ----------
    fibres : Fibres
    folder : path
    pair : bool
        Membranes and shells on the same nodes; else shells alone.
    """
    target, known = fibres.target, fibres.known
    labels = target.elements[known]
    offset = 10 ** len(str(target.elements.max())) if pair else 0
    _mesh(fibres, folder / "mesh.inp", ("S3", "S4R"), ("M3D3", "M3D4R"), offset)
    lines = list(
        comment(
            [
                f"Fibres of {fibres.name}: local 1 is the named direction, local 3 the element's "
                "normal. To be included in a model with these element labels."
            ]
        )
    )
    both = [labels, labels + offset] if pair else [labels]
    lines += ["*DISTRIBUTION TABLE, NAME=TWO_POINTS", "COORD3D, COORD3D"]
    lines += ["*DISTRIBUTION TABLE, NAME=LENGTHS", "LENGTH"]
    for axis in AXES:
        name = axis.upper()
        along, across = _frame(fibres, axis)
        lines += [f"*DISTRIBUTION, NAME={name}_POINTS, LOCATION=ELEMENT, TABLE=TWO_POINTS"]
        lines += [", 1., 0., 0., 0., 1., 0."]
        for numbers in both:
            lines += rows(numbers, np.hstack([along, across]))
        lines += [f"*ORIENTATION, NAME={name}_AXES, SYSTEM=RECTANGULAR", f"{name}_POINTS", "3, 0."]
    lines += ["*DISTRIBUTION, NAME=FORMED_THICKNESS, LOCATION=ELEMENT, TABLE=LENGTHS"]
    lines += [f", {fibres.fabric['thickness']:.9g}"]
    for numbers in both:
        lines += rows(numbers, fibres.thickness[known])
    write(folder / "fibres.inp", lines)

    warp, weft, shear = _moduli(fibres)
    sections = [
        "*SHELL SECTION, ELSET=FORMED, COMPOSITE, SHELL THICKNESS=FORMED_THICKNESS",
        "0.5, 3, WARP_LAYER, WARP_AXES",
        "0.5, 3, WEFT_LAYER, WEFT_AXES",
    ]
    materials = [("WARP_LAYER", 2 * warp), ("WEFT_LAYER", 2 * weft)]
    density = _density(fibres)
    if pair:
        density /= 2  # of each
        sections += [
            "*MEMBRANE SECTION, ELSET=FORMED_MEMBRANE, MATERIAL=MEMBRANE, "
            "ORIENTATION=BISECTOR_AXES, MEMBRANE THICKNESS=FORMED_THICKNESS",
            f"{fibres.fabric['thickness']:.9g}",
        ]
        materials.append(("MEMBRANE", shear))
    lines = ["*HEADING", *_told(fibres), "*INCLUDE, INPUT=mesh.inp", "*INCLUDE, INPUT=fibres.inp"]
    lines += sections
    for name, E in materials:
        lines += [f"*MATERIAL, NAME={name}", "*DENSITY", f"{density:.6g},"]
        lines += ["*ELASTIC, TYPE=LAMINA"]
        lines += [", ".join(f"{v:.6g}" for v in (E, shear, 0.0, *[shear] * 3))]
    write(folder / "part.inp", lines)
    return (STAND_IN, *([SHARED] if pair else []), NOT_RUN)


def calculix(fibres: Fibres, folder: Path, axis: str = "warp") -> tuple[str, ...]:
    """Write the files for CalculiX, local 1 along `axis`; notices."""
    target, known = fibres.target, fibres.known
    labels = target.elements[known]
    used, _ = _mesh(fibres, folder / "mesh.inp", ("S3", "S4"))
    along, across = _frame(fibres, axis)
    lines = list(comment([f"Fibres of {fibres.name}: local 1 is the {axis}."]))
    for label, row in zip(labels, np.hstack([along, across]), strict=True):
        lines += [f"*ELSET, ELSET=F{label}", str(label)]
        lines += [f"*ORIENTATION, NAME=O{label}, SYSTEM=RECTANGULAR"]
        lines += [", ".join(f"{v:.9g}" for v in row)]
    thickness = _at_nodes(fibres, fibres.thickness)
    lines += ["*NODAL THICKNESS", *rows(target.nodes[used], thickness[used])]
    write(folder / "fibres.inp", lines)

    warp, weft, shear = _moduli(fibres)
    E = {"warp": (warp, weft), "weft": (weft, warp), "bisector": (0.5 * (warp + weft),) * 2}[axis]
    lines = ["*HEADING", f"{_plain(fibres.name)}", *_told(fibres)]
    lines += ["*INCLUDE, INPUT=mesh.inp", "*INCLUDE, INPUT=fibres.inp"]
    lines += ["*MATERIAL, NAME=FABRIC", "*DENSITY", f"{_density(fibres):.6g}"]
    lines += ["*ELASTIC, TYPE=ENGINEERING CONSTANTS"]
    lines += [", ".join(f"{v:.6g}" for v in (*E, shear, 0.0, 0.0, 0.0, shear, shear)) + ","]
    lines += [f"{shear:.6g}"]
    for label in labels:
        lines += [
            f"*SHELL SECTION, ELSET=F{label}, MATERIAL=FABRIC, ORIENTATION=O{label}, "
            "NODAL THICKNESS",
            f"{fibres.fabric['thickness']:.9g}",
        ]
    write(folder / "part.inp", lines)
    notices = [STAND_IN, AT_NODES, ONE_EACH]
    largest = float(np.abs(fibres.shear_angle[known]).max())
    if axis != "bisector":
        other = "weft" if axis == "warp" else "warp"
        notices.append(
            f"one orthogonal frame an element: local 1 is the {axis}, and the {other} is up to "
            f"{largest:.1f}° off local 2 (the shear angle), which this frame cannot carry"
        )
    else:
        notices.append(
            "one orthogonal frame an element, along the bisector: the constants of a sheared "
            f"fabric differ with its angle (up to {largest:.1f}°), those written are of one"
        )
    return tuple(notices)


def _mesh(
    fibres: Fibres,
    path: Path,
    kinds: tuple[str, str],
    beside: tuple[str, str] = (),
    offset: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Write the elements that are known, with their nodes; rows of both."""
    target = fibres.target
    rows_known = np.flatnonzero(fibres.known)
    used = np.unique(target.corners[rows_known])
    used = used[used >= 0]
    lines = list(comment([f"Mesh of {fibres.name}, mm."]))
    lines += ["*NODE, NSET=FORMED_NODES", *rows(target.nodes[used], target.points[used])]
    sets = [("FORMED", kinds, 0)] + ([("FORMED_MEMBRANE", beside, offset)] if offset else [])
    for name, types, more in sets:
        for kind, chosen in zip(types, (target.triangular, ~target.triangular), strict=True):
            of_kind = rows_known[chosen[rows_known]]
            if len(of_kind):
                lines.append(f"*ELEMENT, TYPE={kind}, ELSET={name}")
                lines += _elements(target, of_kind, more)
    write(path, lines)
    return used, rows_known


def _elements(target: Target, which: np.ndarray, offset: int = 0) -> Iterator[str]:
    for row in which:
        corners = [str(target.nodes[c]) for c in target.corners[row] if c >= 0]
        yield ", ".join([str(target.elements[row] + offset), *corners])


def _frame(fibres: Fibres, axis: str) -> tuple[FloatArray, FloatArray]:
    """Local 1 along a fibre and local 2 at a right angle to it in the element's plane."""
    if axis not in AXES:
        raise InputError(f"axis must be one of {', '.join(AXES)}, got {axis!r}")
    known = fibres.known
    along = getattr(fibres, axis)[known]
    return along, np.cross(fibres.target.normals[known], along)


def _at_nodes(fibres: Fibres, values: FloatArray) -> FloatArray:
    """(n,) means at the nodes of the elements that are known, weighted by area."""
    target, known = fibres.target, fibres.known
    triangles, of = [target.corners[known][:, :3]], [np.flatnonzero(known)]
    quads = np.flatnonzero(known & ~target.triangular)
    triangles.append(target.corners[quads][:, [0, 2, 3]])
    of.append(quads)
    return at_nodes(values[np.concatenate(of)], target.points, np.concatenate(triangles))


def _moduli(fibres: Fibres) -> tuple[float, float, float]:
    moduli = fibres.fabric.get("moduli")
    if moduli is None:
        raise InputError("the summary of the run does not tell the laws of its fabric")
    return moduli


def _density(fibres: Fibres) -> float:
    """t/mm³."""
    return max(DENSITY * fibres.fabric["areal_weight"] / fibres.fabric["thickness"], 1e-20)


def _told(fibres: Fibres) -> list[str]:
    fabric = fibres.fabric
    return list(
        comment(
            [
                f"Formed part of {fibres.name}, fabric {fabric.get('name', '')}; N, mm, s, t, MPa.",
                f"Flat: thickness {fabric['thickness']:g} mm, {fabric['areal_weight']:g} g/m².",
                *fibres.notices,
                STAND_IN,
            ]
        )
    )


def _plain(text: str) -> str:
    return text.encode("ascii", "replace").decode()
