"""Fibre directions, thickness and areal weight by element, on the formed mesh or on another one.

The sheet keeps its volume and its mass (an assumption, the first): with the change of area J

    t = t0 / J,    areal weight = w0 / J

so the density w0/t0 stays. On another mesh an element takes the values of the closest point of the
formed surface to its centroid; there, the values by triangle are brought to the nodes, weighted by
area, and are linear between. The directions are turned into the element's plane by projection.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..checks import InputError, check_number
from ..comparison.mapping import on_surface
from ..comparison.sheet import at_nodes
from .part import Part
from .target import Target, of_triangles

FloatArray = np.ndarray
AXES = ("warp", "weft", "bisector")
STEEP = 30.0  # degrees between an element and the sheet: beyond, the projection is doubted
NOT_MODELLED = (
    "one ply is handed over: several plies, and their sliding on each other, are not modelled",
    "rovings do not slip in the model, and the fabric does not tear or open: gaps are not carried",
    "thickness and areal weight follow from the area at constant volume and mass (assumed); "
    "compaction by tools and by a later infusion is not in them",
    "stresses and contact pressures of the forming are not carried: the part is free of stress",
)


@dataclass(frozen=True, eq=False)
class Fibres:
    """What an element of a structural mesh has to know of the formed fabric.

    Parameters
    ----------
    name : str
    target : Target
        All elements of the mesh.
    known : (m,) bool array
        Which of them lie on the sheet; the values of the others are nan.
    warp, weft : (m, 3) arrays
        Unit vectors in the element's plane.
    area_ratio : (m,) array
        J, formed area over flat area.
    fabric : dict
    own : bool
        Whether the mesh is the formed one.
    notices : tuple of str
    """

    name: str
    target: Target
    known: np.ndarray
    warp: FloatArray
    weft: FloatArray
    area_ratio: FloatArray
    fabric: dict = field(default_factory=dict)
    own: bool = True
    notices: tuple[str, ...] = ()

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


def carry(
    part: Part,
    target: Target | None = None,
    within: float | None = None,
) -> Fibres:
    """Fibres of a part by element of its own or of another mesh.

    Parameters
    ----------
    part : Part
    target : Target, optional
        The part's own mesh if not given.
    within : float, optional
        mm; elements whose centroid is farther from the sheet get nothing. The spacing of the
        formed mesh if not given.

    Raises
    ------
    InputError
        If no element is near the sheet.
    """
    notices = [*part.notices, *NOT_MODELLED]
    if target is None:
        target = of_triangles(part.points, part.triangles)
        known = np.ones(len(target.elements), dtype=bool)
        return Fibres(
            *(part.name, target, known, part.warp, part.weft, part.area_ratio, part.fabric, True),
            tuple(notices),
        )
    sheet = part.sheet
    reach = sheet.spacing if within is None else check_number("within", within)
    flat = np.pad(part.flat, ((0, 0), (0, 1)))
    values = np.column_stack([part.warp, part.weft, part.area_ratio])
    nodal = np.column_stack([at_nodes(column, flat, part.triangles) for column in values.T])
    found, distance = on_surface(nodal, sheet, target.centroids)
    known = distance <= reach
    if not known.any():
        raise InputError(
            f"no element of the mesh is within {reach:.3g} mm of the formed sheet, the nearest is "
            f"{distance.min():.3g} mm away: are its place and its unit (scale) those of the sheet?"
        )
    if not known.all():
        far = target.elements[~known]
        notices.append(
            f"{len(far)} of {len(known)} elements are farther than {reach:.3g} mm from the sheet "
            f"and get no fibres: {_some(far)}"
        )
    found[~known] = np.nan
    n = target.normals
    axes, steep = [], np.zeros(len(known), dtype=bool)
    for direction in (found[:, :3], found[:, 3:6]):
        direction = _unit(direction)
        out = (direction * n).sum(1)
        steep |= np.abs(out) > np.sin(np.radians(STEEP))
        axes.append(_unit(direction - out[:, None] * n))
    if steep.any():
        notices.append(
            f"{steep.sum()} elements are tilted by more than {STEEP:g}° out of the sheet, their "
            f"fibres are doubtful: {_some(target.elements[steep])}"
        )
    against = (np.cross(*axes) * n).sum(1) < 0
    if against.any():
        notices.append(
            f"{against.sum()} elements have their normal against the sheet's upper side: seen "
            "along it the weft lies clockwise of the warp"
        )
    moved = distance[known].max()
    notices.append(
        f"mapped by the closest point of the formed mid-surface, at most {moved:.3g} mm away"
    )
    return Fibres(
        *(part.name, target, known, *axes, found[:, 6], part.fabric, False), tuple(notices)
    )


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def _some(labels: np.ndarray) -> str:
    return ", ".join(map(str, labels[:5])) + (", ..." if len(labels) > 5 else "")
