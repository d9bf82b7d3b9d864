"""Rows of the chart as data: errors, Pareto front, expected time of a run, CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
from pydantic.dataclasses import dataclass as checked

from quasiform.result.estimate import discretisation_error

from ..bands import OptionalNumber
from ..tables import read_table

FloatArray = np.ndarray
REFERENCE = "reference"
GAIN = 0.02  # part by which an error must decrease to count; less is the solver's tolerance
GROWTH = 6.0  # of the work when the size is halved: four times the unknowns, to the power of 1.25


@checked(frozen=True)
class Row:
    """One run.

    Parameters
    ----------
    scene, strategy : str
    size : float
        Of the mesh, mm.
    increment : float
        Of the travel, mm; 0 where the program chooses.
    seconds, wall : float
        Processor and wall time, s.
    dofs : int
        Unknowns of the finest mesh.
    solves : float
        Linear solves in units of that mesh, as the program counts them (`Result.linear_solves`).
    units : float
        Work in linear solves of the scene's default mesh: solves x dofs^1.25 over all meshes,
        independent of clocks. 0 where nothing is factorised.
    force, p99 : float
        At the end: driving force, N, and 99th percentile of the shear angle, degrees.
    certified : str
        "yes", or the reasons why not.
    estimate, estimate_force : float or None
        The program's own error estimate of p99, degrees, and of the force, N.
    version : str
        Of the package, with a digest of its sources.
    error : float or None
        In p99, degrees, to the reference.
    error_force : float or None
        In the force, % of the reference.
    error_field : float or None
        Mean over the sheet of the error of the shear angle, degrees.
    """

    scene: str
    strategy: str
    size: float
    increment: float
    seconds: float
    wall: float
    dofs: int
    solves: float
    units: float
    force: float
    p99: float
    certified: str
    estimate: OptionalNumber
    estimate_force: OptionalNumber
    version: str
    error: OptionalNumber = None
    error_force: OptionalNumber = None
    error_field: OptionalNumber = None

    @property
    def key(self) -> tuple[str, str, float, float, str]:
        """Identifies a run."""
        return (self.scene, self.strategy, self.size, self.increment, self.version)

    @property
    def name(self) -> str:
        """The key as text."""
        return "|".join(map(str, self.key))


def judged(rows: Sequence[Row], fields: Mapping[str, FloatArray] | None = None) -> list[Row]:
    """Rows with their errors relative to the reference of their scene, if there is one.

    Parameters
    ----------
    rows : sequence of Row
    fields : mapping of `Row.name` to (n_points,) arrays
        Shear angles at the same points, degrees.

    Returns
    -------
    list of Row

    Notes
    -----
    A full path that was solved without an error estimate gets the estimate that the program would
    give, from the same path on the mesh twice as coarse, if that is a row too.
    """
    references = {row.scene: row for row in rows if row.strategy == REFERENCE}
    paths = {(r.scene, r.strategy, r.increment, r.size): r for r in rows}
    found = []
    for row in rows:
        error = error_force = error_field = None
        reference = references.get(row.scene)
        if reference is not None and row is not reference:
            error = abs(row.p99 - reference.p99)
            error_force = 100 * abs(row.force / reference.force - 1)
            if fields and row.name in fields and reference.name in fields:
                error_field = float(np.abs(fields[row.name] - fields[reference.name]).mean())
        row = replace(row, error=error, error_force=error_force, error_field=error_field)
        coarse = paths.get((row.scene, row.strategy, row.increment, 2 * row.size))
        if row.estimate is None and coarse is not None:
            p99, force, sizes = [row.p99, coarse.p99], [row.force, coarse.force], (1.0, 2.0)
            row = replace(
                row,
                estimate=float(discretisation_error(p99, sizes)),
                estimate_force=float(discretisation_error(force, sizes)),
            )
        found.append(row)
    return found


def pareto(points: Sequence[tuple[float, float]], gain: float = GAIN) -> list[int]:
    """Find the points for which no other point has less work and less error.

    Parameters
    ----------
    points : sequence of (work, error)
    gain : float
        Part by which the error must decrease to justify more work.

    Returns
    -------
    list of int
        Their indices, by increasing work and decreasing error; of equal points the first.

    Examples
    --------
    >>> pareto([(2.0, 1.0), (1.0, 3.0), (3.0, 2.0)])
    [1, 0]
    """
    front: list[int] = []
    for i in sorted(range(len(points)), key=lambda i: (*points[i], i)):
        if not front or points[i][1] < (1 - gain) * points[front[-1]][1]:
            front.append(i)
    return front


def expected_seconds(
    scene: str, strategy: str, size: float, increment: float, known: Iterable[Row]
) -> float | None:
    """Expected processor time of a run, from the nearest coarser similar one.

    A row of the same strategy and increment is preferred, then one of the same strategy, then any
    other; None if the scene has no coarser row.
    """
    coarser = [row for row in known if row.scene == scene and row.size > size * (1 + 1e-9)]
    likely = [
        [r for r in coarser if (r.strategy, r.increment) == (strategy, increment)],
        [r for r in coarser if r.strategy == strategy],
        [r for r in coarser if r.strategy not in (REFERENCE, "relaxation")],
    ]
    for rows in likely:
        if rows:
            nearest = min(rows, key=lambda row: row.size)
            halvings = 0
            while nearest.size / 2**halvings > size * (1 + 1e-9):
                halvings += 1
            return nearest.seconds * GROWTH**halvings
    return None


def write(rows: Sequence[Row], path: Path) -> None:
    """Write `rows.csv`."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Row)])
        writer.writeheader()
        for row in rows:
            writer.writerow(asdict(row))


def read(path: Path) -> list[Row]:
    """Read `rows.csv`; empty if it does not exist."""
    if not path.exists():
        return []
    return read_table(path, Row, keyed=False)
