"""The scenes of the chart, the strategies, and one run of them with its work counted."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import quasiform as qf
from quasiform.result.summary import package_version
from quasiform.scenes import scene_file

from .rows import REFERENCE, Row

FloatArray = np.ndarray
POINTS = 5000
GROWTH = 1.25  # power of the unknowns in the time of a sparse factorisation of a sheet


@dataclass(frozen=True)
class Problem:
    """A scene at any size.

    Parameters
    ----------
    title : str
        In the chart.
    build : callable
        (size, symmetry, mesh) to a scene.
    default : (strategy, size)
        The default of the command line.
    finest : float
        Size of the reference, mm; 0 where there is none.
    runs : tuple of (strategy, sizes, increments)
        With an increment of 0 the program chooses it.
    charted : bool
        Whether it has a panel; else its rows are only compared with one another.
    followed : bool
        Whether the reference takes the full path, as mesh continuation does not reach the end.
    """

    title: str
    build: Callable[..., qf.Model]
    default: tuple[str, float]
    finest: float
    runs: tuple[tuple[str, tuple[float, ...], tuple[float, ...]], ...]
    charted: bool = True
    followed: bool = False


def _tension(angle: float, displacement: float) -> Callable[..., qf.Model]:
    def build(size: float, symmetry: str = "auto", mesh: str = "fibre") -> qf.Model:
        return qf.off_axis_tension(angle, displacement=displacement, size=size, mesh=mesh)

    return build


def _forming(name: str, travel: float, orientation: float = 0.0) -> Callable[..., qf.Model]:
    def build(size: float, symmetry: str = "auto", mesh: str = "fibre") -> qf.Model:
        file = replace(scene_file.load(name), mesh=mesh)
        return qf.forming(file, orientation, size=size, travel=travel, symmetry=symmetry)

    return build


STRATEGIES: dict[str, tuple[str, dict[str, str], dict[str, str]]] = {
    # name: (title, how the scene is built, how it is solved)
    "full path": ("full path", {}, {}),
    "continuation": ("mesh continuation", {}, {}),
    "whole": ("whole sheet, full path", {"symmetry": "none"}, {}),
    "convex": ("always-convex Newton", {}, {"convex": "always"}),
    "free mesh": ("free mesh, full path", {"mesh": "free"}, {}),
    "relaxation": ("dynamic relaxation alone", {}, {"method": "relaxation"}),
    REFERENCE: ("reference", {}, {}),
}

_PLANE = (
    ("full path", (20.0, 10.0, 5.0, 2.5), (0.0,)),
    ("continuation", (10.0, 5.0, 2.5), (0.0,)),
    ("convex", (20.0, 10.0, 5.0), (0.0,)),
    ("free mesh", (20.0, 10.0, 5.0, 2.5), (0.0,)),
)


def _space(small: float, large: float) -> tuple[tuple[str, tuple[float, ...], tuple[float, ...]]]:
    return (
        ("full path", (20.0, 10.0, 5.0), (0.0,)),
        ("full path", (10.0, 5.0), (small, large)),
        ("continuation", (5.0, 2.5), (0.0,)),
        ("continuation", (5.0,), (large,)),
        ("convex", (10.0, 5.0), (0.0,)),
        ("whole", (10.0, 5.0), (0.0,)),
        ("free mesh", (10.0, 5.0), (0.0,)),
    )


_TURNED = (  # at 45°
    ("full path", (20.0, 10.0, 5.0), (0.0,)),
    ("continuation", (5.0,), (0.0,)),
    ("convex", (10.0,), (0.0,)),
)

PROBLEMS = {
    "oat-45": Problem(
        "off-axis tension 45°, 40 mm",
        _tension(45.0, 40.0),
        ("full path", 10.0),
        0.625,
        (
            *_PLANE,
            ("full path", (20.0, 10.0, 5.0), (1.0, 40.0)),
            ("relaxation", (20.0,), (0.0,)),
        ),
    ),
    "oat-30": Problem(
        "off-axis tension 30°, 15 mm",
        _tension(30.0, 15.0),
        ("full path", 10.0),
        1.25,
        (*_PLANE, ("full path", (20.0, 10.0, 5.0), (1.0, 15.0))),
        followed=True,  # refine at 1.25 mm does not end within minutes
    ),
    "hemisphere": Problem(
        "hemisphere 0°, 75 mm",
        _forming("hemisphere", 75.0),
        ("continuation", 5.0),
        1.25,
        _space(2.5, 15.0),
    ),
    "box": Problem(
        "box 0°, 20 mm", _forming("box", 20.0), ("continuation", 5.0), 1.25, _space(1.0, 10.0)
    ),
    "tetrahedron": Problem(
        "tetrahedron 0°, 40 mm",
        _forming("tetrahedron", 40.0),
        ("continuation", 5.0),
        1.25,
        _space(2.5, 20.0),
    ),
    "hemisphere-45": Problem(
        "hemisphere 45°, 75 mm",
        _forming("hemisphere", 75.0, 45.0),
        ("continuation", 5.0),
        2.5,
        _TURNED,
    ),
    "box-45": Problem(
        "box 45°, 20 mm",
        _forming("box", 20.0, 45.0),
        ("continuation", 5.0),
        2.5,
        _TURNED,
    ),
    "tetrahedron-45": Problem(
        "tetrahedron 45°, 40 mm",
        _forming("tetrahedron", 40.0, 45.0),
        ("continuation", 5.0),
        2.5,
        _TURNED,
    ),
    "hemisphere-5": Problem(
        "hemisphere 0°, 5 mm",
        _forming("hemisphere", 5.0),
        ("full path", 10.0),
        0.0,
        (("full path", (10.0,), (5.0,)), ("relaxation", (10.0,), (5.0,))),
        charted=False,
    ),
}


@dataclass(frozen=True)
class Plan:
    """A planned run."""

    scene: str
    strategy: str
    size: float
    increment: float


def plans(scenes: list[str], quick: bool = False) -> list[Plan]:
    """Runs of the scenes, coarse meshes first, so that the slow ones come last.

    With `quick` only those with automatic increments on meshes of at least 10 mm, the default, and
    a reference of half its size.
    """
    found = []
    for name in scenes:
        problem = PROBLEMS[name]
        for strategy, sizes, increments in problem.runs:
            found += [Plan(name, strategy, size, inc) for size in sizes for inc in increments]
        if quick:
            found = [
                plan
                for plan in found
                if plan.scene != name
                or (
                    not plan.increment
                    and plan.strategy != "relaxation"
                    and (plan.size >= 10 or (plan.strategy, plan.size) == problem.default)
                )
            ]
        if problem.finest:
            finest = problem.default[1] / 2 if quick else problem.finest
            found.append(Plan(name, REFERENCE, finest, 0.0))
    return sorted(found, key=lambda plan: -plan.size)


def run(plan: Plan) -> tuple[Row, FloatArray]:
    """Run a plan: its row, and shear angles (`POINTS`,) at fixed points of the flat sheet.

    The error estimate of a full path, which would need the same path on a coarser mesh, is not
    made; mesh continuation includes one.
    """
    problem = PROBLEMS[plan.scene]
    _, build, how = STRATEGIES[plan.strategy]
    increment = plan.increment or None
    wall, processor = time.perf_counter(), time.process_time()
    scene = problem.build(plan.size, **build)
    if plan.strategy == "continuation" or (plan.strategy == REFERENCE and not problem.followed):
        result = qf.refine(scene, increment=increment)
    else:
        result = qf.solve(scene, increment=increment, estimate=False, **how)
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    unit = unknowns(problem.build(problem.default[1]))
    row = Row(
        scene=plan.scene,
        strategy=plan.strategy,
        size=plan.size,
        increment=plan.increment,
        seconds=processor,
        wall=wall,
        dofs=unknowns(scene),
        solves=float(result.linear_solves),
        units=0.0 if plan.strategy == "relaxation" else work(result.factorisations, scene, unit),
        force=result.force,
        p99=result.quantities["shear_angle_deg"],
        certified="yes" if result.certified else "; ".join(result.certified.reasons),
        estimate=result.estimate["shear_angle_deg"],
        estimate_force=result.estimate["force_N"],
        version=sources(),
    )
    low, high = result.blank.nodes.min(0), result.blank.nodes.max(0)
    return row, result.shear_angle_at(np.random.default_rng(0).uniform(low, high, (POINTS, 2)))


def unknowns(scene: qf.Model) -> int:
    """Number of unknowns."""
    return int((~scene.fixed).sum())


def work(counts: dict[str, int], scene: qf.Model, unit: int) -> float:
    """Factorisations of all meshes of a run, in those of a mesh with `unit` unknowns."""
    sizes = {mesh: float(mesh.removesuffix(" mm")) for mesh in counts}
    return sum(
        count * (unknowns(scene.recipe.build(sizes[mesh], like=scene)) / unit) ** GROWTH
        for mesh, count in counts.items()
    )


def sources() -> str:
    """Version of the package with a digest of its sources."""
    folder = Path(qf.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.read_bytes())
    return f"{package_version()}+{digest.hexdigest()[:8]}"
