"""A scene: blank, fabric, energy terms, supports and the travel that drives them.

x is the flat vector of node positions (dim components a node) followed by the rigid degrees of
freedom. Some are prescribed as a function of the travel; all others are solved for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from .energy import Remembering, Term
from .energy.contact import LEVER, Contact
from .energy.friction import Friction
from .energy.membrane import Membrane
from .fabric import Fabric
from .net.blank import Blank, rotation
from .result.measures import EdgePoint

FloatArray = np.ndarray
COLLAPSE = np.radians(85.0)
MOST_TILT = 10.0  # degrees
Unfolding = tuple[Blank, np.ndarray, FloatArray, np.ndarray, FloatArray]


@dataclass(repr=False)
class Scene:
    """What is solved. Built by `experiments`, or by hand.

    Parameters
    ----------
    name : str
        Of the case, and of its folder.
    blank : Blank
    fabric : Fabric
    dim : int
        2 for a plane problem, 3 in space.
    terms : list of Term
        Energies; the first is the membrane. Append your own.
    x0 : (n_dofs,) array
        Start: node positions, then rigid degrees of freedom.
    fixed : (n_dofs,) bool array
        Prescribed degrees of freedom.
    drive : (n_dofs,) array, or a function of the travel
        Their motion per unit of travel; or a function that returns their positions (n_dofs,) and
        the rate of these (n_dofs,).
    travel : float
        Where to end (mm for a punch or a grip; 1 for a load factor).
    increment : float
        Largest increment of travel when the program chooses, mm (or of the load factor).
    rows : float
        History rows fall on multiples of this travel, mm (or of the load factor).
    travel_name : str
        Column of the travel in the history.
    share : float
        Modelled share of the whole (1/4 with two mirror planes); forces are divided by it.
    resting : float
        Dead load that holds the scene together (holder weight of the modelled share), N. The
        residual is measured against 2 % of it while the driving force is smaller.
    dead_load : float
        Where the travel is a load factor: the whole load, N, that the residual is measured against.
    model : list of (entry, reason)
        What is modelled and what was left out, and why.
    parameters : dict
        The user's input, as written into `summary.json`.
    measures : dict
        Functions of x whose values go into `history` (name: function).
    areas : dict of name to (centre, radius)
        Discs of the flat blank over which the shear angle is averaged, mm, in the user's axes.
    edges : dict of direction to EdgePoint
        Where the draw-in is measured, on the whole sheet in the user's axes.
    resized : callable, optional
        Builds the same scene at another size, for the error estimate and for mesh continuation.
    coarsest : float
        Largest size at which the path is worth following: that of the sharpest tool, mm.
    turn : float
        Angle of the model's x axis to the user's, degrees: where mirror planes are used they are
        the model's coordinate planes. Results are given in the user's axes.
    outputs : dict
        `pictures` and `increments`: whether these files are written by default.
    """

    name: str
    blank: Blank
    fabric: Fabric
    dim: int
    terms: list[Term]
    x0: FloatArray
    fixed: np.ndarray
    drive: FloatArray | Callable[[float], tuple[FloatArray, FloatArray]]
    travel: float
    increment: float
    rows: float
    travel_name: str = "displacement_mm"
    share: float = 1.0
    resting: float = 0.0
    dead_load: float = 0.0
    model: list[tuple[str, str]] = field(default_factory=list)
    parameters: dict[str, Any] = field(default_factory=dict)
    measures: dict[str, Callable[[FloatArray], float]] = field(default_factory=dict)
    areas: dict[str, tuple[tuple[float, float], float]] = field(default_factory=dict)
    edges: dict[str, EdgePoint] = field(default_factory=dict)
    resized: Callable[[float], Scene] | None = None
    coarsest: float = 0.0
    turn: float = 0.0
    outputs: dict[str, bool] = field(default_factory=lambda: {"pictures": True, "increments": True})

    def __repr__(self) -> str:
        terms = ", ".join(term.name for term in self.terms)
        return (
            f"<Scene {self.name}: {len(self.blank.triangles)} triangles, "
            f"{(~self.fixed).sum()} dofs, travel {self.travel:.4g}; {terms}>"
        )

    @property
    def size(self) -> float:
        """Size of the mesh as the user gives it, mm."""
        return float(self.parameters.get("size", self.blank.size))

    def prescribed(self, travel: float) -> tuple[FloatArray, FloatArray]:
        """Positions of the prescribed degrees of freedom at a travel, and their rate; (n_dofs,)."""
        if callable(self.drive):
            return self.drive(travel)
        return self.x0 + travel * self.drive, self.drive

    def collapsed(self, x: FloatArray, travel: float) -> dict[str, Any] | None:
        """Where a triangle is sheared beyond 85 degrees or turned over, or None.

        Parameters
        ----------
        x : (n_dofs,) array
            Positions and rigid degrees of freedom, mm.
        travel : float
            At which this is so, mm.

        Returns
        -------
        dict with `travel_mm`, `at` (flat position, mm), `shear_angle_deg` and `triangles` (count)
        """
        gamma = np.abs(self.membrane.shear_angle(x))
        bad = gamma > COLLAPSE
        if self.dim == 2:
            bad |= self.membrane.normals(x)[:, 0] <= 0.0
        if not bad.any():
            return None
        worst = np.where(bad, gamma, -1.0).argmax()
        return {
            "travel_mm": travel,
            "at": self.to_user(self.blank.centroids[worst]).tolist(),
            "shear_angle_deg": float(np.degrees(gamma[worst])),
            "triangles": int(bad.sum()),
        }

    def lost(self, x: FloatArray) -> str:
        """Why a free tool no longer rests safely on the sheet, in words; empty if it does."""
        for contact in self.contacts:
            tool = contact.tool
            if not tool.tilts:
                continue
            tilt = np.degrees(np.abs(x[contact.tool_dofs[1:]]).max() / LEVER)
            if tilt > MOST_TILT:
                return f"the {tool.name} tilts by more than {MOST_TILT:g} degrees"
            if not contact.surrounds(x, self.blank.mirror):
                return f"the sheet no longer surrounds the weight of the {tool.name}"
        return ""

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

    @property
    def membrane(self) -> Membrane:
        """The membrane term."""
        return next(term for term in self.terms if isinstance(term, Membrane))

    @property
    def contacts(self) -> list[Contact]:
        """The contact terms."""
        return [term for term in self.terms if isinstance(term, Contact)]

    @property
    def frictions(self) -> list[Friction]:
        """The friction terms."""
        return [term for term in self.terms if isinstance(term, Friction)]

    @property
    def remembering(self) -> list[Remembering]:
        """The terms with memory, a user's own among them."""
        return [term for term in self.terms if isinstance(term, Remembering)]

    @property
    def n_nodal(self) -> int:
        """Number of nodal degrees of freedom; the rigid ones follow."""
        return self.dim * len(self.blank.nodes)

    def positions(self, x: FloatArray) -> FloatArray:
        """(n_nodes, dim) positions of the nodes, mm."""
        return x[: self.n_nodal].reshape(-1, self.dim)
