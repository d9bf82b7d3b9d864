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
from typing import Any

import numpy as np

from .fabric import Fabric
from .net.blank import Blank, rotation

FloatArray = np.ndarray
IntArray = np.ndarray
Unfolding = tuple[Blank, np.ndarray, FloatArray, np.ndarray, FloatArray]


@dataclass(frozen=True, eq=False)
class Field:
    """A block of unknowns."""

    name: str  # unique in a table, such as "sheet", "punch" or "sheet slip"
    dofs: IntArray  # (n_points, n_components) numbers in x
    # (n_points, 2) flat places, mm, and the area of each point, mm²; without them the field is
    # eliminated last and is copied, not interpolated, to another mesh
    places: FloatArray | None = None
    areas: FloatArray | None = None
    scale: float = 1.0  # of its derivative in the residual, N per unit of the derivative; 0: none
    positions: bool = False  # whether these are positions of the nodes of a sheet

    def of(self, x: FloatArray) -> FloatArray:
        """(n_points, n_components) values in x."""
        return x[self.dofs]

    def lengths(self, x: FloatArray) -> FloatArray:
        """(n_points,) lengths of these."""
        return np.sqrt((self.of(x) ** 2).sum(1))


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

    def add(self, name: str, components: int, **given: Any) -> Field:
        """Append a field with `components` numbers a place, or as many numbers without places.

        Given are its `places`, `areas`, `scale` and `positions`, as in `Field`.
        """
        if any(known.name == name for known in self.fields):
            raise ValueError(f"there is a field '{name}' already")
        places, areas = given.get("places"), given.get("areas")
        if places is not None and np.shape(places)[1:] != (2,):
            raise ValueError(f"places of '{name}' must be (n, 2), got {np.shape(places)}")
        if areas is not None and np.shape(areas) != np.shape(places)[:1]:
            raise ValueError(f"areas of '{name}' must be one a place, got {np.shape(areas)}")
        shape = (components, 1) if places is None else (len(places), components)
        dofs = self.size + np.arange(np.prod(shape)).reshape(shape)
        self.fields.append(Field(name, dofs, **given))
        return self.fields[-1]

    def sheet(self, blank: Blank, fabric: Fabric, dim: int, turn: float = 0.0, name: str = "sheet"):
        """Append the positions of a sheet's nodes, and return the sheet."""
        given = {"places": blank.nodes, "areas": blank.node_areas}
        own = self.add(name, dim, **given, positions=True)
        return Sheet(name, blank, fabric, own, turn)

    def start(self, *sheets: Sheet) -> tuple[FloatArray, np.ndarray, FloatArray]:
        """Start of a model with its sheets flat, nothing fixed and nothing driven; (n_dofs,)."""
        x0 = np.zeros(self.size)
        for sheet in sheets:
            x0[sheet.dofs[:, :2]] = sheet.blank.nodes
        return x0, np.zeros(self.size, dtype=bool), np.zeros(self.size)

    @property
    def size(self) -> int:
        """Length of x."""
        return sum(known.dofs.size for known in self.fields)

    def __getitem__(self, name: str) -> Field:
        names = [known.name for known in self.fields]
        if name not in names:
            raise KeyError(f"no field '{name}': there are {', '.join(names)}")
        return self.fields[names.index(name)]

    @property
    def positions(self) -> Iterator[Field]:
        return (known for known in self.fields if known.positions)

    def _spread(self, name: str, otherwise: FloatArray) -> FloatArray:
        """(n_dofs, ...) values of each unknown's place, or what stands for them without one."""
        found = np.tile(otherwise, (self.size, 1))
        for known in self.fields:
            if (values := getattr(known, name)) is not None:
                found[known.dofs] = values.reshape(len(values), 1, -1)
        return found

    def places(self) -> FloatArray:
        """(n_dofs, 2) flat place of each unknown, mm; nan without one."""
        return self._spread("places", np.full(2, np.nan))

    def areas(self) -> FloatArray:
        """(n_dofs,) area that each unknown stands for, mm²; without one that of all positions."""
        return self._spread("areas", sum(known.areas.sum() for known in self.positions))[:, 0]

    def norm(self, r: FloatArray) -> float:
        """Sum of the forces of all points of (n_dofs,) residuals, N."""
        return sum(k.scale * float(k.lengths(r).sum()) for k in self.fields if k.scale)

    def largest(self, r: FloatArray) -> tuple[float, FloatArray]:
        """Largest force at a node, N, and the flat place of that node (2,), mm."""
        forces = [(known.lengths(r), known.places) for known in self.positions]
        found = [(float(force.max()), places[force.argmax()]) for force, places in forces]
        return max(found, key=lambda entry: entry[0])

    def longest(self, d: FloatArray) -> float:
        """Longest motion of a node, mm."""
        return max(float(known.lengths(d).max()) for known in self.positions)

    def at_nodes(self) -> np.ndarray:
        """(n_dofs,) bool array: which unknowns are positions of nodes."""
        found = np.zeros(self.size, dtype=bool)
        for known in self.positions:
            found[known.dofs] = True
        return found


@dataclass(frozen=True, eq=False)
class Sheet:
    """A blank of a fabric, with its place among the unknowns."""

    name: str
    blank: Blank  # the part that is modelled
    fabric: Fabric
    field: Field  # positions of its nodes: two components in the plane, three in space
    turn: float = 0.0  # angle of the model's x axis to the user's, degrees

    @property
    def dim(self) -> int:
        """Components of a position: 2 for a plane problem, 3 in space."""
        return self.field.dofs.shape[1]

    @property
    def dofs(self) -> IntArray:
        """(n_nodes, dim) numbers of the positions in x."""
        return self.field.dofs

    def named(self, term: str) -> str:
        """Name of a term of this sheet; the only sheet of a model is not named."""
        return term if self.name == "sheet" else f"{term} of the {self.name}"

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
        return self.unfolded(self.positions(x))

    def unfolded(self, part: FloatArray) -> FloatArray:
        """(n_nodes, 3) vectors of the whole sheet in the user's axes, from those of its part."""
        _, source, sign, _, _ = self.whole
        whole = np.pad(part, ((0, 0), (0, 3 - part.shape[1])))[source] * sign
        whole[:, :2] = self.to_user(whole[:, :2])
        return whole

    def to_user(self, points: FloatArray) -> FloatArray:
        """Turn (..., 2) flat points of the model into the user's axes."""
        return points @ rotation(self.turn).T
