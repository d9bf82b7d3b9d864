"""Contradictions between solves of the same problem, and the requirements of the map."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from quasiform.result.estimate import discretisation_error

from .cells import Solved
from .scenes import CASES
from .settings import NAMED_SIZES, SETTINGS, Cell, is_check, rechecks

FULL = 0.95  # share of the settings at which the paper's scenes must reach full travel
MINUTES = 40.0  # for the whole map, on two cores
LEAST = 1e-3  # relative: as residuals may be 1e-3 of the force
ROUND_OFF = 1e-6  # degrees, mm, N
Map = Mapping[tuple[str, str], Solved]


@dataclass(frozen=True)
class Contradiction:
    """A certified cell with another result than another solve of its problem."""

    cell: Solved
    check: Solved
    name: str
    difference: float
    allowed: float

    def __str__(self) -> str:
        value, other = self.cell.averages[self.name], self.check.averages[self.name]
        return (
            f"{self.name} {value:.4g} against {other:.4g}: {self.difference:.2g} apart, "
            f"{self.allowed:.2g} allowed"
        )


def errors(scene: str, kept: Mapping[Cell, Solved]) -> dict[tuple[str, str], tuple[float, str]]:
    """Estimated error of the mesh in each average of a scene, by size and name, and its origin.

    It is the program's own estimate, that of the default setting at that size, if it exists.
    Otherwise (a coarser mesh cannot be built, stops or collapses, or the average is not one of the
    program's) the same formula is applied to the sizes of the map; for the coarsest it is twice the
    difference from the next finer one. If that fails too, the error is zero: solves must agree to
    the tolerance of the solver.
    """
    at = {size: kept.get(Cell(scene, SETTINGS[size])) for size in NAMED_SIZES}
    names = {name for solved in at.values() if solved for name in solved.averages}
    found = {}
    for i, size in enumerate(NAMED_SIZES):
        for name in names:
            if at[size] and name in at[size].estimate:
                found[size, name] = at[size].estimate[name], "program"
                continue
            values = [
                at[s].averages.get(name) if at[s] and at[s].outcome == "completed" else None
                for s in NAMED_SIZES
            ]
            coarser = [values[i], *values[:i][::-1]]
            while coarser and coarser[-1] is None:
                coarser.pop()
            sizes = [2.0**k for k in range(len(coarser))]
            pair = values[i : i + 2]
            if len(coarser) > 1 and None not in coarser:
                found[size, name] = float(discretisation_error(coarser, sizes)), "sizes of the map"
            elif len(pair) == 2 and None not in pair:
                found[size, name] = 2 * abs(pair[0] - pair[1]), "the next finer size"
            else:
                found[size, name] = 0.0, "none"
    return found


def allowed(error: float, value: float) -> float:
    """Allowed difference of an average between two solves of a problem on one mesh."""
    return max(error, LEAST * abs(value), ROUND_OFF)


def checks_of(solved: Solved, kept: Mapping[Cell, Solved]) -> list[Solved]:
    """Certified solves of the same problem that check a cell."""
    return [
        other
        for other in kept.values()
        if other.scene == solved.scene
        and other.certified == "yes"
        and is_check(other.setting, solved.setting)
    ]


def wanted(kept: Mapping[Cell, Solved]) -> list[Cell]:
    """Solves still needed: one for each certified cell without a check."""
    found: dict[Cell, None] = {}
    for solved in kept.values():
        if solved.certified != "yes" or checks_of(solved, kept):
            continue
        for setting in rechecks(solved.setting):
            cell = Cell(solved.scene, setting)
            if cell not in kept:
                found[cell] = None
                break
    return list(found)


def contradictions(cells: Iterable[Solved], kept: Mapping[Cell, Solved]) -> list[Contradiction]:
    """The worst contradiction of each certified cell, if any."""
    found = []
    estimated = {scene: errors(scene, kept) for scene in {c.scene for c in kept.values()}}
    for cell in cells:
        if cell.certified != "yes":
            continue
        worst = None
        for check in checks_of(cell, kept):
            for name, value in cell.averages.items():
                difference = abs(value - check.averages[name])
                error, _ = estimated[cell.scene].get((cell.setting.size, name), (0.0, ""))
                limit = allowed(error, value)
                if difference > limit and (
                    worst is None or difference / limit > worst.difference / worst.allowed
                ):
                    worst = Contradiction(cell, check, name, difference, limit)
        if worst:
            found.append(worst)
    return found


def is_right(solved: Solved) -> bool:
    """Whether a cell has the required outcome: full travel, or refused."""
    if CASES[solved.scene].refused:
        return solved.outcome == "refused"
    return solved.arrived


@dataclass(frozen=True)
class Bar:
    """A requirement, the result, and whether it is met."""

    name: str
    found: str
    met: bool


def bars(
    cells: Map, kept: Mapping[Cell, Solved], against: Sequence[Contradiction], minutes: float
) -> list[Bar]:
    """The requirements of the map.

    Parameters
    ----------
    cells : mapping of (scene, setting) to Solved
    kept : mapping of Cell to Solved
        Including the solves that check others.
    against : sequence of Contradiction
    minutes : float
        Time of the whole map on two cores.
    """
    paper = {k: s for k, s in cells.items() if CASES[k[0]].paper}
    at_end = [s for s in paper.values() if s.arrived]
    default = [s for (_, name), s in paper.items() if name == "default"]
    reached = [s for s in default if s.arrived]
    share = len(at_end) / len(paper) if paper else 1.0
    short = [s for s in cells.values() if not is_right(s)]
    unexplained = [s for s in short if not s.reason]
    certified = [s for s in cells.values() if s.certified == "yes"]
    alone = [s for s in certified if not checks_of(s, kept)]
    refused = [s for s in cells.values() if CASES[s.scene].refused]
    states = [s for s in cells.values() if s.outcome == "completed" and s.reason]
    found = [
        Bar(
            f"the paper's scenes reach full travel in at least {FULL:.0%} of the settings",
            f"{len(at_end)} of {len(paper)}: {share:.1%}",
            share >= FULL,
        ),
        Bar(
            "and in all of them at the default",
            f"{len(reached)} of {len(default)}",
            len(reached) == len(default),
        ),
        Bar("each other cell has a reason", f"{len(unexplained)} without", not unexplained),
    ]
    for outcome in ("crash", "hang"):
        count = sum(s.outcome == outcome for s in kept.values())
        plural = "crashes" if outcome == "crash" else "hangs"
        found.append(Bar(f"no {plural}", str(count), count == 0))
    found += [
        Bar(
            "no certified cell is contradicted by another solve of its problem",
            f"{len(against)} of {len(certified)}",
            not against,
        ),
        Bar("each certified cell has been checked", f"{len(alone)} not", not alone),
        Bar("no completed cell ends in a wrong state", str(len(states)), not states),
        Bar(
            "a sheet without bending stiffness is refused",
            f"{sum(s.outcome == 'refused' for s in refused)} of {len(refused)}",
            all(s.outcome == "refused" for s in refused),
        ),
        Bar(f"the map takes less than {MINUTES:g} minutes", f"{minutes:.1f}", minutes < MINUTES),
    ]
    return found
