"""The table of unknowns: which numbers of x belong to what, and where they lie.

x is one flat vector. Its *fields* are the positions of the nodes of a sheet, the height and tilts
of a tool, a load factor, or what a term of your own needs (two scalars a node, say). A field knows
its numbers in x, its flat places (for the order of elimination and for the transfer to another
mesh) and what its derivative counts for in the residual. Nothing else slices x.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from .fabric import Fabric
from .net.blank import Blank, rotation

FloatArray = np.ndarray
IntArray = np.ndarray
Unfolding = tuple[Blank, np.ndarray, FloatArray, np.ndarray, FloatArray]


@dataclass(frozen=True, eq=False)
class Field:
    """A block of unknowns.

    Parameters
    ----------
    name : str
        Unique in a table, such as "sheet", "punch" or "sheet slip".
    dofs : (n_points, n_components) int array
        Numbers in x.
    places : (n_points, 2) array, optional
        Flat places, mm; without them the field is eliminated last and is copied, not interpolated,
        to another mesh.
    areas : (n_points,) array, optional
        Area that a point stands for, mm²; needed with places.
    scale : float
        What its derivative counts for in the residual, N per unit of the derivative; 0: nothing.
    positions : bool
        Whether these are positions of the nodes of a sheet.
    """

    name: str
    dofs: IntArray
    places: FloatArray | None = None
    areas: FloatArray | None = None
    scale: float = 1.0
    positions: bool = False

    def of(self, x: FloatArray) -> FloatArray:
        """(n_points, n_components) values in x."""
        return x[self.dofs]


@dataclass
class Unknowns:
    """All fields of a model, in the order of their numbers.

    Examples
    --------
    >>> table = Unknowns()
    >>> punch = table.add("punch", 1)
    >>> slip = table.add("slip", 2, places=np.zeros((3, 2)), areas=np.ones(3))
    >>> table.size, slip.dofs.tolist()
    (7, [[1, 2], [3, 4], [5, 6]])
    """

    fields: list[Field] = field(default_factory=list)

    def add(
        self,
        name: str,
        components: int,
        places: FloatArray | None = None,
        areas: FloatArray | None = None,
        scale: float = 1.0,
        positions: bool = False,
    ) -> Field:
        """Append a field with `components` numbers a place, or as many numbers without places.

        Raises
        ------
        ValueError
            If the name is taken.
        """
        if any(known.name == name for known in self.fields):
            raise ValueError(f"there is a field '{name}' already")
        points, each = (components, 1) if places is None else (len(places), components)
        dofs = self.size + np.arange(points * each).reshape(points, each)
        self.fields.append(Field(name, dofs, places, areas, scale, positions))
        return self.fields[-1]

    def sheet(self, blank: Blank, fabric: Fabric, dim: int, turn: float = 0.0, name: str = "sheet"):
        """Append the positions of a sheet's nodes, and return the sheet."""
        own = self.add(name, dim, blank.nodes, blank.node_areas, positions=True)
        return Sheet(name, blank, fabric, own, turn)

    @property
    def size(self) -> int:
        """Length of x."""
        return sum(known.dofs.size for known in self.fields)

    def __getitem__(self, name: str) -> Field:
        """Return the field of that name."""
        return next(known for known in self.fields if known.name == name)

    @property
    def positions(self) -> Iterator[Field]:
        """The fields that are positions of nodes."""
        return (known for known in self.fields if known.positions)

    def places(self) -> FloatArray:
        """(n_dofs, 2) flat place of each unknown, mm; nan without one."""
        found = np.full((self.size, 2), np.nan)
        for known in self.fields:
            if known.places is not None:
                found[known.dofs] = known.places[:, None]
        return found

    def areas(self) -> FloatArray:
        """(n_dofs,) area that each unknown stands for, mm²; without one that of all positions."""
        found = np.full(self.size, sum(known.areas.sum() for known in self.positions))
        for known in self.fields:
            if known.areas is not None:
                found[known.dofs] = known.areas[:, None]
        return found

    def norm(self, r: FloatArray) -> float:
        """Sum of the forces of all points of (n_dofs,) residuals, N."""
        total = 0.0
        for known in self.fields:
            if known.scale:
                total += known.scale * float(np.linalg.norm(known.of(r), axis=1).sum())
        return total

    def largest(self, r: FloatArray) -> tuple[float, FloatArray]:
        """Largest force at a node, N, and the flat place of that node (2,), mm."""
        found = []
        for known in self.positions:
            force = np.linalg.norm(known.of(r), axis=1)
            found.append((float(force.max()), known.places[force.argmax()]))
        return max(found, key=lambda entry: entry[0])

    def longest(self, d: FloatArray) -> float:
        """Longest motion of a node, mm."""
        return max(float(np.linalg.norm(known.of(d), axis=1).max()) for known in self.positions)

    def at_nodes(self) -> np.ndarray:
        """(n_dofs,) bool array: which unknowns are positions of nodes."""
        found = np.zeros(self.size, dtype=bool)
        for known in self.positions:
            found[known.dofs] = True
        return found


@dataclass(frozen=True, eq=False)
class Sheet:
    """A blank of a fabric, with its place among the unknowns.

    Parameters
    ----------
    name : str
    blank : Blank
        The part that is modelled.
    fabric : Fabric
    field : Field
        Positions of its nodes; two components in the plane, three in space.
    turn : float
        Angle of the model's x axis to the user's, degrees.
    """

    name: str
    blank: Blank
    fabric: Fabric
    field: Field
    turn: float = 0.0

    @property
    def dim(self) -> int:
        """Components of a position: 2 for a plane problem, 3 in space."""
        return self.field.dofs.shape[1]

    @property
    def dofs(self) -> IntArray:
        """(n_nodes, dim) numbers of the positions in x."""
        return self.field.dofs

    def positions(self, x: FloatArray) -> FloatArray:
        """(n_nodes, dim) positions of the nodes, mm."""
        return self.field.of(x)

    @cached_property
    def whole(self) -> Unfolding:
        """The whole sheet in the user's axes (mirrored where a part is modelled)."""
        unfolding = self.blank.unfolded()
        return (unfolding[0].turned(self.turn), *unfolding[1:])

    def whole_positions(self, x: FloatArray) -> FloatArray:
        """(n_nodes, 3) positions of the whole sheet in the user's axes, mm."""
        _, source, sign, _, _ = self.whole
        part = self.positions(x)
        whole = np.pad(part, ((0, 0), (0, 3 - part.shape[1])))[source] * sign
        whole[:, :2] = self.to_user(whole[:, :2])
        return whole

    def to_user(self, points: FloatArray) -> FloatArray:
        """Turn (..., 2) flat points of the model into the user's axes."""
        return points @ rotation(self.turn).T
