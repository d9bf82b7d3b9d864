"""Effect of each simplification: time saved and change of the result, with the error estimate.

Each run is the full path on the hemisphere at 0° and 10 mm with all simplifications except one; for
mesh continuation, at 5 mm. The plane problem is the off-axis tension test.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import quasiform as qf
from quasiform.energy.bending import Bending
from quasiform.energy.contact import Contact, at_edges
from quasiform.energy.friction import Friction
from quasiform.energy.membrane import Membrane
from quasiform.scenes import scene_file
from quasiform.unknowns import Unknowns

from ..tables import markdown_table

Solve = Callable[[], qf.Result]


def table() -> str:
    """A Markdown table, one row per simplification."""
    rows = []
    with TemporaryDirectory() as folder:
        for name, where, reduced, full in _pairs(Path(folder)):
            short, seconds = _timed(reduced)
            long, without = _timed(full)
            p99 = [r.quantities["shear_angle_deg"] for r in (short, long)]
            if short.estimate["shear_angle_deg"] is None:
                coarse = short.model.recipe.build(2 * short.model.size)
                short.judge([qf.solve(coarse, estimate=False)])
            rows.append(
                [
                    name,
                    where,
                    f"{seconds:.2f}",
                    f"{without:.2f}",
                    f"{without / seconds:.2f}",
                    f"{_dofs(short)} / {_dofs(long)}",
                    f"{short.linear_solves:.0f} / {long.linear_solves:.0f}",
                    f"{100 * (short.force / long.force - 1):+.3f}",
                    f"{p99[0] - p99[1]:+.4f}",
                    _shown(short.estimate["force_N"], 100 / short.force),
                    _shown(short.estimate["shear_angle_deg"], 1.0),
                    "yes"
                    if short.certified and long.certified
                    else f"{short.certified} / {long.certified}",
                ]
            )
            print("; ".join(map(str, rows[-1])), flush=True)
    head = ["simplification", "where", "s with", "s without", "ratio", "dofs", "solves"]
    head += ["force changed %", "p99 changed °", "estimate of force %", "estimate of p99 °"]
    return (
        "Processor times of the solve, with the simplification and without it; a ratio above 1 is "
        "time saved.\nThe estimates are those of the mesh, for comparison.\n\n"
        + markdown_table([*head, "certified"], rows)
    )


def _pairs(folder: Path) -> list[tuple[str, str, Solve, Solve]]:
    """(simplification, where, with it, without it)."""
    here, strip = "hemisphere, 10 mm", "off-axis tension 45°, 10 mm"

    def path(scene: Callable[[], qf.Model]) -> Solve:
        return lambda: qf.solve(scene(), estimate=False)

    plain = path(_hemisphere)
    ball = _stl(folder)
    return [
        ("plane problem", strip, path(_strip), path(_strip_in_space)),
        (
            "the same, without in-plane bending as well",
            strip,
            path(_strip),
            path(lambda: _strip_in_space(1.0)),
        ),
        (
            "two mirror planes (a quarter)",
            here,
            plain,
            path(lambda: _hemisphere(symmetry="none")),
        ),
        (
            "one mirror plane (a half)",
            here,
            path(lambda: _hemisphere(symmetry="half")),
            path(lambda: _hemisphere(symmetry="none")),
        ),
        (
            "no friction terms at zero friction",
            here,
            path(lambda: _hemisphere(friction=0.0)),
            path(lambda: _hemisphere(friction=1e-6)),
        ),
        ("no weight of the sheet", here, plain, path(_with_weight)),
        ("punch in closed form", here, plain, path(lambda: qf.forming(ball, size=10.0))),
        ("contact at nodes only", here, plain, path(_with_mid_edges)),
        (
            "mesh continuation",
            "hemisphere, 5 mm",
            lambda: qf.refine(_hemisphere(5.0)),
            path(lambda: _hemisphere(5.0)),
        ),
    ]


def _timed(solve: Solve) -> tuple[qf.Result, float]:
    clock = time.process_time()
    result = solve()
    return result, time.process_time() - clock


def _dofs(result: qf.Result) -> int:
    return int((~result.model.fixed).sum())


def _shown(value: float | None, factor: float) -> str:
    return "" if value is None else f"{value * factor:.3f}"


def _hemisphere(
    size: float = 10.0, symmetry: str = "auto", friction: float | None = None
) -> qf.Model:
    law = qf.Fabric() if friction is None else replace(qf.Fabric(), friction=friction)
    return qf.forming("hemisphere", law=law, size=size, symmetry=symmetry)


def _with_weight() -> qf.Model:
    return qf.forming(replace(scene_file.load("hemisphere"), gravity=True), size=10.0)


def _with_mid_edges() -> qf.Model:
    """Contact between the nodes too, although no tool is sharp enough to need it."""
    scene = _hemisphere()
    edges = at_edges(scene.sheet.blank)
    for contact in scene.contacts:
        between = Contact(scene.sheet, contact.tool, contact.tool_dofs, edges)
        scene.terms.append(between)
        if contact.tool.friction:
            scene.terms.append(Friction(between))
    return scene


def _stl(folder: Path) -> str:
    """Write the scene with its punch as a surface file; the path."""
    phi = np.linspace(0.0, 2.0 * np.pi, 241)[:-1]
    radius = 75.0
    lower = np.linspace(0.0, np.pi / 2, 61)[1:]
    rings = [(radius * np.sin(t), radius * (1.0 - np.cos(t))) for t in lower] + [(radius, 150.0)]
    vertices = [[0.0, 0.0, 0.0]]
    for r, z in rings:
        vertices += [[r * np.cos(p), r * np.sin(p), z] for p in phi]
    vertices.append([0.0, 0.0, 150.0])
    n, last = len(phi), len(vertices) - 1
    faces = []
    for j in range(n):
        k = (j + 1) % n
        faces.append([0, 1 + k, 1 + j])
        for i in range(len(rings) - 1):
            a, b, c, d = (1 + i * n + j, 1 + i * n + k, 1 + (i + 1) * n + j, 1 + (i + 1) * n + k)
            faces += [[a, b, d], [a, d, c]]
        faces.append([last, last - n + j, last - n + k])
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (folder / "ball.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    text = (scene_file.FOLDER / "hemisphere.toml").read_text(encoding="utf-8")
    head, rest = text.split("[tools.punch]\n")
    _, rest = rest.split("[tools.die]", 1)
    scene = folder / "hemisphere.toml"
    scene.write_text(
        f'{head}[tools.punch]\nfile = "ball.obj"\n\n[tools.die]{rest}', encoding="utf-8"
    )
    return str(scene)


def _strip() -> qf.Model:
    return qf.off_axis_tension(45.0, displacement=40.0)


def _strip_in_space(in_plane: float = 0.0) -> qf.Model:
    """Off-axis tension free to leave its plane, with bending of the fibre lines."""
    flat = _strip()
    blank, n = flat.sheet.blank, len(flat.sheet.blank.nodes)
    fabric = replace(flat.sheet.fabric, in_plane_bending=in_plane)

    def spatial(values: np.ndarray, out_of_plane: np.ndarray | float | bool) -> np.ndarray:
        found = np.empty((n, 3), dtype=values.dtype)
        found[:, :2], found[:, 2] = values.reshape(n, 2), out_of_plane
        return found.ravel()

    sheet = (unknowns := Unknowns()).sheet(blank, fabric, dim=3)
    return replace(
        flat,
        unknowns=unknowns,
        sheets=[sheet],
        terms=[Membrane(sheet), Bending(sheet)],
        x0=spatial(flat.x0, 0.0),
        fixed=spatial(flat.fixed, flat.fixed[::2]),
        drive=spatial(flat.drive, 0.0),
        measures={},
        recipe=None,
    )
