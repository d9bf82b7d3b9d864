"""A model: sheets, energy terms, supports and the travel that drives them; what is solved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .energy.contact import LEVER, Contact, surrounds
from .energy.friction import Friction
from .energy.membrane import Membrane
from .energy.term import Term
from .fingerprint import fingerprint
from .net.edges import EdgePoint
from .unknowns import Field, FloatArray, Sheet, Unknowns

COLLAPSE = np.radians(85.0)
MOST_TILT = 10.0  # degrees


@dataclass(repr=False)
class Model:
    """What is solved: built by `forming` and the other ready scenes, or by hand.

    The travel and what is measured by it are mm for a punch or a grip, and 1 for a load factor.
    Append terms of your own to `terms`, or best through `including`.
    """

    name: str  # of the case, and of its folder
    unknowns: Unknowns  # the table of x
    sheets: list[Sheet]
    terms: list[Term]
    x0: FloatArray  # (n_dofs,) start
    fixed: np.ndarray  # (n_dofs,) bool: which unknowns are prescribed
    # (n_dofs,) their motion per unit of travel; or a function of the travel that returns their
    # positions (n_dofs,) and the rate of these (n_dofs,)
    drive: FloatArray | Callable[[float], tuple[FloatArray, FloatArray]]
    travel: float  # where to end
    increment: float  # of the travel, the largest when the program chooses
    rows: float  # rows of the history fall on multiples of this travel
    travel_name: str = "displacement_mm"  # column of the history
    share: float = 1.0  # modelled share of the whole (1/4 with two mirror planes) in all forces
    # load that keeps the model together (holder weight of the modelled share), N: residuals are
    # relative to 2 % of it while the driving force is smaller
    resting: float = 0.0
    dead_load: float = 0.0  # N, to which residuals are relative where the travel is a load factor
    description: list[tuple[str, str]] = field(default_factory=list)  # (what is modelled, why)
    parameters: dict[str, Any] = field(default_factory=dict)  # the user's, for `summary.json`
    # columns of the history: name and function of x
    measures: dict[str, Callable[[FloatArray], float]] = field(default_factory=dict)
    # discs (centre, radius) of the flat blank in the user's axes, mm, with their mean shear angle
    areas: dict[str, tuple[tuple[float, float], float]] = field(default_factory=dict)
    # where the draw-in is measured by direction, on the whole sheet in the user's axes
    edges: dict[str, EdgePoint] = field(default_factory=dict)
    coarsest: float = 0.0  # mm, largest size at which the path is worth following
    # which files are written by default
    outputs: dict[str, bool] = field(default_factory=lambda: {"pictures": True, "increments": True})
    tools: Any = None  # of the whole sheet, for the same model on another mesh
    recipe: Any = None  # a `Recipe`, from which the same model is built at any size
    built: str = ""  # fingerprint when it was built from its recipe

    def __repr__(self) -> str:
        terms = ", ".join(term.name for term in self.terms)
        triangles = sum(len(sheet.blank.triangles) for sheet in self.sheets)
        return (
            f"<Model {self.name}: {triangles} triangles, {(~self.fixed).sum()} dofs, "
            f"travel {self.travel:.4g}; {terms}>"
        )

    @property
    def sheet(self) -> Sheet:
        """The sheet of a model that has one only."""
        (only,) = self.sheets
        return only

    @property
    def size(self) -> float:
        """Size of the mesh as the user gives it, mm."""
        return float(self.parameters.get("size", self.sheets[0].blank.size))

    @property
    def membranes(self) -> list[Membrane]:
        return [term for term in self.terms if isinstance(term, Membrane)]

    @property
    def membrane(self) -> Membrane:
        """The membrane term of the first sheet."""
        return self.membranes[0]

    @property
    def contacts(self) -> list[Contact]:
        return [term for term in self.terms if isinstance(term, Contact)]

    @property
    def frictions(self) -> list[Friction]:
        return [term for term in self.terms if isinstance(term, Friction)]

    def add(self, name: str, components: int, sheet: Sheet | None = None, **given: Any) -> Field:
        """Append a field of unknowns, free and zero at the start; see `Unknowns.add`.

        It has so many components at each node of `sheet`, or in all without one.
        """
        if sheet is not None:
            given |= {"places": sheet.blank.nodes, "areas": sheet.blank.node_areas}
        added = self.unknowns.add(name, components, **given)
        more = self.unknowns.size - len(self.x0)
        self.x0, self.fixed = np.pad(self.x0, (0, more)), np.pad(self.fixed, (0, more))
        if callable(drive := self.drive):
            self.drive = lambda s: tuple(np.pad(values, (0, more)) for values in drive(s))
        else:
            self.drive = np.pad(drive, (0, more))
        return added

    def including(self, change: Callable[[Model], None]) -> Model:
        """Return the model built anew with a change that is part of its recipe.

        Every mesh of a refined run, the error estimate and every worker then has it. `change` is
        called with the model: it may append terms, fields, areas and measures, and set supports.
        Defined in a module, it can also be sent to another process.
        """
        if self.recipe is None:
            raise ValueError("this model has no recipe: change it itself")
        return self.recipe.including(change).build(self.size, like=self)

    @property
    def changed(self) -> bool:
        """Whether the model is another one than its recipe builds, or has none."""
        return self.recipe is None or fingerprint(self) != self.built

    def prescribed(self, travel: float) -> tuple[FloatArray, FloatArray]:
        """Positions of the prescribed unknowns at a travel, and their rate; (n_dofs,)."""
        if callable(self.drive):
            return self.drive(travel)
        return self.x0 + travel * self.drive, self.drive

    def collapsed(self, x: FloatArray, travel: float) -> dict[str, Any] | None:
        """Where triangles are sheared beyond 85 degrees or turned over at this travel, or None.

        `travel_mm`, `at` (flat position, mm), `shear_angle_deg` and `triangles` (their number).
        """
        for membrane in self.membranes:
            sheet, gamma = membrane.sheet, np.abs(membrane.shear_angle(x))
            bad = gamma > COLLAPSE
            if sheet.dim == 2:
                bad |= membrane.normals(x)[:, 0] <= 0.0
            if bad.any():
                worst = np.where(bad, gamma, -1.0).argmax()
                return {
                    "travel_mm": travel,
                    "at": sheet.to_user(sheet.blank.centroids[worst]).tolist(),
                    "shear_angle_deg": float(np.degrees(gamma[worst])),
                    "triangles": int(bad.sum()),
                }
        return None

    def lost(self, x: FloatArray) -> str:
        """Why a free tool no longer rests safely on the sheet; empty if it does."""
        for contact in self.contacts:
            tool = contact.tool
            if not tool.tilts:
                continue
            tilt = np.degrees(np.abs(x[contact.tool_dofs[1:]]).max() / LEVER)
            if tilt > MOST_TILT:
                return f"the {tool.name} tilts by more than {MOST_TILT:g} degrees"
            if not surrounds(contact, x):
                return f"the sheet no longer surrounds the weight of the {tool.name}"
        return ""

    def turned_over(self, x: FloatArray, trial: FloatArray) -> bool:
        """Whether a triangle is turned over between two states."""
        turns = ((m.normals(x) * m.normals(trial)).sum(1) for m in self.membranes)
        return any(bool((turn <= 0).any()) for turn in turns)
