"""What the map is judged by: contradictions between solves of one problem, and the bars."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from quasiform.result.estimate import discretisation_error

from .cells import Solved
from .scenes import CASES
from .settings import NAMED_SIZES, SETTINGS, Cell, rechecks, tells

FULL = 0.95  # share of the settings at which the paper's scenes have to reach full travel
MINUTES = 40.0  # for the whole map, on two cores
LEAST = 1e-3  # relative: two solves whose residuals may be 1e-3 of the force tell no more
ROUND_OFF = 1e-6  # degrees, mm, N
Map = Mapping[tuple[str, str], Solved]


@dataclass(frozen=True)
class Contradiction:
    """A certified cell that another solve of its problem does not find again."""

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

    It is the program's own where there is one: that of the default setting at that size. Where
    there is none (a coarser mesh cannot be built, stops or collapses, or the average is not among
    the program's), the same formula takes the sizes of the map; the coarsest takes twice the
    difference to the next finer one. Where that fails too the error counts as nothing: solves
    have to agree to the tolerance of the solver.
    """
    at = {
        size: kept.get(Cell(scene, SETTINGS["default" if size == "default" else size]))
        for size in NAMED_SIZES
    }
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
            pair = values[i : i + 2]
            if len(coarser) > 1 and None not in coarser:
                found[size, name] = float(discretisation_error(coarser)), "sizes of the map"
            elif len(pair) == 2 and None not in pair:
                found[size, name] = 2 * abs(pair[0] - pair[1]), "the next finer size"
            else:
                found[size, name] = 0.0, "none"
    return found


def allowed(error: float, value: float) -> float:
    """How far two solves of a problem on one mesh may differ in an average."""
    return max(error, LEAST * abs(value), ROUND_OFF)


def checks_of(solved: Solved, kept: Mapping[Cell, Solved]) -> list[Solved]:
    """Certified solves of the same problem that tell whether a cell holds."""
    return [
        other
        for other in kept.values()
        if other.scene == solved.scene
        and other.certified == "yes"
        and tells(other.setting, solved.setting)
    ]


def wanted(kept: Mapping[Cell, Solved]) -> list[Cell]:
    """Solves that are needed still: one for each certified cell that none tells about."""
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
    """Find the worst contradiction of each certified cell, if any."""
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
    """Whether a cell is as it must be: at its end, or refused where it has to be."""
    if CASES[solved.scene].refused:
        return solved.outcome == "refused"
    return solved.arrived


@dataclass(frozen=True)
class Bar:
    """A bar, what was found, and whether it holds."""

    words: str
    found: str
    holds: bool


def bars(
    cells: Map, kept: Mapping[Cell, Solved], against: Sequence[Contradiction], minutes: float
) -> list[Bar]:
    """The bars of the map.

    Parameters
    ----------
    cells : mapping of (scene, setting) to Solved
    kept : mapping of Cell to Solved
        With the solves that check others.
    against : sequence of Contradiction
    minutes : float
        That the whole map takes on two cores.
    """
    paper = {k: s for k, s in cells.items() if CASES[k[0]].paper}
    at_end = [s for s in paper.values() if s.arrived]
    default = [s for (_, name), s in paper.items() if name == "default"]
    reached = [s for s in default if s.arrived]
    share = len(at_end) / len(paper) if paper else 1.0
    short = [s for s in cells.values() if not is_right(s)]
    mute = [s for s in short if not s.reason]
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
            "and in all at the default",
            f"{len(reached)} of {len(default)}",
            len(reached) == len(default),
        ),
        Bar("every cell that does not has a reason", f"{len(mute)} without", not mute),
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
        Bar("every certified cell has been checked", f"{len(alone)} not", not alone),
        Bar("no completed cell ends in a state that it must not", str(len(states)), not states),
        Bar(
            "a sheet without bending stiffness is refused",
            f"{sum(s.outcome == 'refused' for s in refused)} of {len(refused)}",
            all(s.outcome == "refused" for s in refused),
        ),
        Bar(f"the map takes less than {MINUTES:g} minutes", f"{minutes:.1f}", minutes < MINUTES),
    ]
    return found
