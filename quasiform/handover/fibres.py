"""Fibre directions, thickness and areal weight by element, on the formed mesh or on another one.

The sheet keeps its volume and its mass (an assumption, the first): with the change of area J

    t = t0 / J,    areal weight = w0 / J

so the density w0/t0 stays. On another mesh an element takes the values of the closest point of the
formed surface to its centroid; there, the values by triangle are brought to the nodes, weighted by
area, and are linear between. The directions are turned into the element's plane by projection.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..checks import InputError, check_number
from ..comparison.mapping import beyond_edge, on_surface, spacing
from ..meshes.shells import Shells
from ..result.record import Record
from .keywords import NOTICES

FloatArray = np.ndarray
AXES = ("warp", "weft", "bisector")
FAMILIES = ("warp", "weft")
ASIDE = 0.01  # of the spacing: how far outside the rim a point has left the sheet
STEEP = 30.0  # degrees between an element and the sheet: beyond, the projection is doubtful


@dataclass(frozen=True, eq=False)
class Fibres:
    """What an element of a structural mesh has to know of the formed fabric."""

    name: str
    target: Shells  # all elements of the mesh
    known: np.ndarray  # (m,) which of them lie on the sheet; the values of the others are nan
    warp: FloatArray  # (m, 3) unit vectors in the element's plane
    weft: FloatArray  # (m, 3)
    area_ratio: FloatArray  # (m,) J, formed area over flat area
    fabric: Mapping[str, Any] = field(default_factory=dict)  # thickness, areal_weight, laws
    own: bool = True  # whether the mesh is the formed one
    notices: tuple[str, ...] = ()
    ply: int = 0  # its number, of a stack
    joined: int = 1  # how many plies are joined in it

    @property
    def prefix(self) -> str:
        """How the names of its files begin."""
        return f"ply_{self.ply}_" if self.ply else ""

    @property
    def bisector(self) -> FloatArray:
        """(m, 3) unit vectors half-way between warp and weft."""
        return _unit(self.warp + self.weft)

    @property
    def thickness_ratio(self) -> FloatArray:
        """(m,) t/t0 = 1/J."""
        return 1.0 / self.area_ratio

    @property
    def thickness(self) -> FloatArray:
        """(m,) t, mm."""
        return self.fabric["thickness"] / self.area_ratio

    @property
    def areal_weight(self) -> FloatArray:
        """(m,) g/m²."""
        return self.fabric["areal_weight"] / self.area_ratio

    @property
    def shear_angle(self) -> FloatArray:
        """(m,) γ, degrees: 90° less the angle between warp and weft."""
        return np.degrees(np.arcsin(np.clip((self.warp * self.weft).sum(1), -1.0, 1.0)))

    def angle(self, axis: str, reference: FloatArray) -> FloatArray:
        """(m,) angle from reference vectors (m, 3) to the fibres about the normal, degrees."""
        a, b = reference, getattr(self, axis)
        n = self.target.normals
        return np.degrees(np.arctan2((np.cross(a, b) * n).sum(1), (a * b).sum(1)))


def read_formed(source: Any) -> Record:
    """Record of a run (a `Result`, a `Record` or a folder) whose last sheet can be handed over."""
    record = Record.of(source)
    where = "the result" if record.folder is None else str(record.folder / "summary.json")
    if not record.fabric:
        raise InputError(f"{where}: no parameters.fabric")
    for name, zero in (("thickness", False), ("areal_weight", True)):
        given = f"{where}: parameters.fabric.{name}"
        check_number(given, record.fabric.get(name), zero_allowed=zero)
    sheet, where = record.sheet, record.folder or "the result"
    if not (sheet.area_ratio > 0).all():
        raise InputError(f"{where}: a triangle has no area")
    for name in FAMILIES:
        vectors = sheet.cell_fields[name]
        if vectors.shape[1:] != (3,) or (np.abs(np.linalg.norm(vectors, axis=1) - 1) > 1e-3).any():
            raise InputError(f"{where}: the cell field '{name}' must be unit vectors")
    return record


def limits_of(record: Record) -> tuple[str, ...]:
    """What makes the last sheet of a run doubtful."""
    doubt = np.asarray(record.sheet.cell_fields.get("doubt", ())) > 0
    values = {"reasons": "; ".join(record.reasons), "some": doubt.sum(), "all": len(doubt)}
    return tuple(
        NOTICES["limits"][name].format(**values)
        for name, doubtful in (
            ("stopped", record.summary.get("status") == "stopped"),
            ("not_certified", not record.certified),
            ("doubt", doubt.any()),
        )
        if doubtful
    )


def carry(record: Record, target: Shells | None = None, within: float | None = None) -> Fibres:
    """Fibres of a run's last sheet (`read_formed`) by element of its own or of another mesh.

    Elements whose centroid is farther than `within` from the sheet (mm; by default the spacing of
    the formed mesh) get nothing; InputError if none is near.
    """
    sheet, several = record.sheet, bool(record.ply_name)
    notices = [*limits_of(record), NOTICES["of_a_stack" if several else "one_ply"]]
    notices += NOTICES["fibres"]
    name = ", ".join(filter(None, [record.case, record.ply_name]))
    stack = {"ply": record.ply * several, "joined": len(record.layer.get("plies", [1]))}
    values = [sheet.cell_fields["warp"], sheet.cell_fields["weft"], sheet.area_ratio]
    if target is None:
        target = Shells.counted(sheet.points, sheet.triangles)
        known = np.ones(len(target.elements), dtype=bool)
        own = (name, target, known, *values, record.fabric, True)
        return Fibres(*own, tuple(notices), **stack)
    reach = spacing(sheet) if within is None else check_number("within", within)
    nodal = np.column_stack([sheet.at_nodes(column) for column in np.column_stack(values).T])
    found, distance = on_surface(nodal, sheet, target.centroids)
    known = distance <= reach
    if several:  # the next ply may lie there
        known &= ~beyond_edge(sheet, target.centroids, ASIDE * spacing(sheet))
    if not known.any():
        raise InputError(
            f"{record.ply_name}{': ' * several}no element of the mesh is within {reach:.3g} mm of "
            f"the formed sheet{' and not beyond its edge' * several}, the nearest is "
            f"{distance.min():.3g} mm away: are its place and its unit (scale) those of the sheet?"
        )
    found[~known] = np.nan
    n, axes, steep = target.normals, [], np.zeros(len(known), dtype=bool)
    for direction in (_unit(found[:, :3]), _unit(found[:, 3:6])):
        out = (direction * n).sum(1)
        steep |= np.abs(out) > np.sin(np.radians(STEEP))
        axes.append(_unit(direction - out[:, None] * n))
    off = f"{reach:.3g} mm from the sheet{' or lie outside its edge' * several}"
    far = f"are farther than {off} and get no"
    tilted = f"are tilted by more than {STEEP:g}° out of the sheet, which makes their fibres"
    turned = "have their normal against the sheet's upper side: seen along it the weft"
    for those, words in (
        (~known, f"{far} fibres"),
        (steep, f"{tilted} doubtful"),
        ((np.cross(*axes) * n).sum(1) < 0, f"{turned} lies clockwise of the warp"),
    ):
        if those.any():
            some = [*map(str, target.elements[those]), ""]
            some = [*some[:5], "..."] if len(some) > 6 else some[:-1]
            notices.append(f"{those.sum()} of {len(known)} elements {words}: {', '.join(some)}")
    most = f"{distance[known].max():.3g} mm"
    notices.append(f"mapped by the closest point of the formed mid-surface, at most {most} away")
    mapped = (name, target, known, *axes, found[:, 6], record.fabric, False)
    return Fibres(*mapped, tuple(notices), **stack)


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]
