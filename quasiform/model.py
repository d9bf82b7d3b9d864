"""A model: sheets, energy terms, supports and the travel that drives them; what is solved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .checks import force_column
from .energy.contact import Contact, surrounds
from .energy.diaphragm import Diaphragm
from .energy.friction import Friction
from .energy.membrane import Membrane
from .energy.plies import PlyContact, folds, pair_name
from .energy.pressure import Pressure
from .energy.slip import SlipResistance
from .energy.term import Term
from .fingerprint import fingerprint
from .net.edges import EdgePoint, edge_points
from .unknowns import Field, FloatArray, Sheet, Unknowns

COLLAPSE = np.radians(85.0)
MOST_TILT = 10.0  # degrees
DIAPHRAGM = "diaphragm"  # name of the sheet that is none of the fabric


@dataclass(repr=False)
class Model:
    """What is solved: built by `forming` and the other ready scenes, or by hand.

    Append terms of your own to `terms`, or best through `including`.

    Parameters
    ----------
    name : str
        Of the case, and of its folder.
    unknowns : Unknowns
        The table of x.
    sheets : list of Sheet
    terms : list of Term
        The energies.
    x0, fixed : (n_dofs,) arrays, the second bool
        Start, mm, and which unknowns are prescribed.
    drive : (n_dofs,) array, or a function of the travel
        Their motion per unit of travel; or a function that returns their positions and the rate.
    travel, increment, rows : float
        Where to end, the largest increment that the program chooses, and of what the travel of a
        history row is a multiple, mm (or load factor).
    every : bool
        Whether every other converged increment is a row too.
    travel_name : str
        Column of the travel in the history.
    share : float
        Modelled share of the whole (1/4 with two mirror planes), by which forces are divided.
    resting : float
        Load that keeps the model together (holder weight of the modelled share), N: residuals are
        relative to 2 % of it while the driving force is smaller.
    loads : dict of number in x to (n, 2) array
        Prescribed loads, N, or pressures, MPa, over the travel, mm: rows, linear in between,
        constant beyond.
    strokes : dict of number in x to (n, 2) array
        Motion along `drive` over the travel, mm, of driven tools that do not just follow it.
    dead_load : float
        Whole load, N, to which residuals are relative where the travel is its factor.
    description : list of (entry, reason)
        What is modelled and what was left out.
    parameters : dict
        The user's input, as written into `summary.json`.
    measures : dict of name to a function of x
        Columns of the history.
    areas : dict of name to (centre, radius)
        Discs of the flat blank with their mean shear angle, mm, in the user's axes.
    edges : dict of direction to EdgePoint
        Where the draw-in is measured, on the whole sheet in the user's axes.
    coarsest : float
        Largest size at which the path is worth following, mm.
    outputs : dict of str to bool
        Whether `pictures` and `increments` are written by default.
    files : dict of path to SHA-256
        Files of tools, outlines and meshes, as they were read.
    tools : optional
        Those of the whole sheet, for the same model on another mesh.
    recipe : Recipe, optional
        From which the same model is built at any size.
    built : str
        Fingerprint when it was built.
    """

    name: str
    unknowns: Unknowns
    sheets: list[Sheet]
    terms: list[Term]
    x0: FloatArray
    fixed: np.ndarray
    drive: FloatArray | Callable[[float], tuple[FloatArray, FloatArray]]
    travel: float
    increment: float
    rows: float
    every: bool = False
    travel_name: str = "displacement_mm"
    share: float = 1.0
    resting: float = 0.0
    loads: dict[int, FloatArray] = field(default_factory=dict)
    strokes: dict[int, FloatArray] = field(default_factory=dict)
    dead_load: float = 0.0
    description: list[tuple[str, str]] = field(default_factory=list)
    parameters: dict[str, Any] = field(default_factory=dict)
    measures: dict[str, Callable[[FloatArray], float]] = field(default_factory=dict)
    areas: dict[str, tuple[tuple[float, float], float]] = field(default_factory=dict)
    edges: dict[str, EdgePoint] = field(default_factory=dict)
    coarsest: float = 0.0
    outputs: dict[str, bool] = field(default_factory=lambda: {"pictures": True, "increments": True})
    files: dict[str, str] = field(default_factory=dict)
    tools: Any = None
    recipe: Any = None
    built: str = ""

    def __repr__(self) -> str:
        terms = ", ".join(term.name for term in self.terms)
        triangles = sum(len(sheet.blank.triangles) for sheet in self.sheets)
        return (
            f"<Model {self.name}: {triangles} triangles, {(~self.fixed).sum()} dofs, "
            f"travel {self.travel:.4g}; {terms}>"
        )

    @property
    def sheet(self) -> Sheet:
        """The only sheet; of a stack of plies the first, from above."""
        return self.sheets[0]

    @property
    def plies(self) -> list[Model]:
        """The model seen with one of its plies each; itself where it has one sheet only."""
        if len(self.sheets) == 1:
            return [self]
        views = []
        for sheet in (sheet for sheet in self.sheets if sheet.name != DIAPHRAGM):
            terms = [term for term in self.terms if getattr(term, "sheet", sheet) is sheet]
            edges = edge_points(sheet.whole[0])
            views.append(replace(self, sheets=[sheet], terms=terms, edges=edges, measures={}))
        return views

    @property
    def ply_contacts(self) -> list[PlyContact]:
        """The contact terms between plies, two a pair."""
        return [term for term in self.terms if isinstance(term, PlyContact)]

    @property
    def size(self) -> float:
        """Size of the mesh as the user gives it, mm."""
        return float(self.parameters.get("size", self.sheets[0].blank.size))

    @property
    def force_name(self) -> str:
        """Column of the derivative of the energy by the travel, with its unit."""
        return force_column(self.travel_name)

    @property
    def membranes(self) -> list[Membrane]:
        """The membrane terms, one a sheet."""
        return [term for term in self.terms if isinstance(term, Membrane)]

    @property
    def membrane(self) -> Membrane:
        """The membrane term of the first sheet."""
        return self.membranes[0]

    @property
    def contacts(self) -> list[Contact]:
        """The contact terms."""
        return [term for term in self.terms if isinstance(term, Contact)]

    @property
    def frictions(self) -> list[Friction]:
        """The friction terms."""
        return [term for term in self.terms if isinstance(term, Friction)]

    @property
    def ply_pairs(self) -> list[tuple[PlyContact, PlyContact]]:
        """Both contact terms of each pair of plies, that of the upper ply first."""
        found = self.ply_contacts if len(self.sheets) > 1 else []
        return list(zip(found[::2], found[1::2], strict=True))

    @property
    def named_pairs(self) -> dict[str, tuple[PlyContact, PlyContact]]:
        """`ply_pairs` by the numbers of their plies, such as 1_2."""
        return {pair_name(c.sheet for c in pair): pair for pair in self.ply_pairs}

    @property
    def pressures(self) -> list[Pressure]:
        """The pressure terms."""
        return [term for term in self.terms if isinstance(term, Pressure)]

    def add(self, name: str, components: int, sheet: Sheet | None = None, **given: Any) -> Field:
        """Append a field, free and zero at the start, at the nodes of a sheet or without places."""
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
        """Return the model built anew with a change, a function of it, on every mesh."""
        if self.recipe is None:
            raise ValueError("this model has no recipe: change it itself")
        return self.recipe.including(change).build(self.size, like=self)

    @property
    def slip(self) -> SlipResistance | None:
        """The resistance to slip of the rovings of the first sheet, or None where none slips."""
        return next((term for term in self.terms if isinstance(term, SlipResistance)), None)

    @property
    def changed(self) -> bool:
        """Whether the model is another one than its recipe builds, or has none."""
        return self.recipe is None or fingerprint(self) != self.built

    def prescribed(self, travel: float) -> tuple[FloatArray, FloatArray]:
        """Positions of the prescribed unknowns at a travel, and their rate; (n_dofs,)."""
        drive = self.drive
        x, rate = drive(travel) if callable(drive) else (self.x0 + travel * drive, drive)
        for dof, rows in self.loads.items():
            x[dof] = np.interp(travel, *rows.T)
        for dof, rows in self.strokes.items():
            x[dof] = self.x0[dof] + rate[dof] * np.interp(travel, *rows.T)
        return x, rate

    def next_stage(self, travel: float) -> float:
        """Travel at which loads or tools next change their rate, or the end."""
        rows = [*self.loads.values(), *self.strokes.values(), np.array([[self.travel, 0.0]])]
        ends = np.concatenate(rows)[:, 0]
        return float(ends[ends > travel * (1 + 1e-12)].min(initial=self.travel))

    def pressed(self, travel: float) -> float:
        """Force of the pressures on the flat sheet at a travel, N."""
        x = self.prescribed(travel)[0] if self.pressures else self.x0
        return float(sum(term.area * x[term.dof] for term in self.pressures))

    def collapsed(self, x: FloatArray, travel: float) -> dict[str, Any] | None:
        """Where triangles are sheared beyond 85 degrees or turned over at a travel, mm, or None."""
        for membrane in (m for m in self.membranes if not isinstance(m, Diaphragm)):
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
        """Why a free tool or a pressure finds no sound sheet any more; empty if it does."""
        tilting = {c.tool.name: c for c in self.contacts if c.tool.tilts}
        for name, contact in tilting.items():
            tilt = np.degrees(np.abs(x[contact.tool_dofs[1:]]).max() / contact.lever)
            if tilt > MOST_TILT:
                return f"the {name} tilts by more than {MOST_TILT:g} degrees"
            if not any(surrounds(c, x) for c in self.contacts if c.tool.name == name):
                return f"the sheet no longer surrounds the weight of the {name}"
        # which a pressure presses together
        return folds(self.sheets, x) if self.pressures else ""

    def turned_over(self, x: FloatArray, trial: FloatArray) -> bool:
        """Whether a triangle is turned over between two states."""
        return any(membrane.turned_over(x, trial) for membrane in self.membranes)
