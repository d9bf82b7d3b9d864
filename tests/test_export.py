"""Hand-overs read back: directions, areas, decks and patterns of parts that are known."""

import csv
import json
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from typing import Any

import meshio
import numpy as np
import pytest

import quasiform as qf
from quasiform.checks import InputError
from quasiform.console.cli import main
from quasiform.draw.overlay import tool_cuts
from quasiform.draw.plot import sheet_figure
from quasiform.fabric import TabulatedLaw
from quasiform.handover import FORMATS, abaqus_deck, carry, export, flat_pattern, read_formed
from quasiform.handover.handover import FILES
from quasiform.handover.inp import moduli
from quasiform.handover.tool_surface import from_file, sampled
from quasiform.meshes.shells import read_shells
from quasiform.recipe import Recipe
from quasiform.result.files import FILES as RESULT_FILES
from quasiform.result.record import Record
from quasiform.scenes.scene_file import FOLDER, load
from quasiform.tools.shapes import ball, round_opening, turned

FABRIC = {
    "name": "test",
    "thickness": 1.2,
    "areal_weight": 500.0,
    "warp": {"C_ini": 1000.0},
    "weft": {"C_ini": 800.0},
    "shear": {"C_ini": 0.4},
}
HALF = 50.0  # mm
BOX = [[-20.0, -10.0], [20.0, -10.0], [20.0, 10.0], [-20.0, 10.0]]


def mesh_of(n, half=HALF):
    """Flat square of (n - 1)² · 2 triangles."""
    x, y = np.meshgrid(*[np.linspace(-half, half, n)] * 2, indexing="ij")
    corner = (n * np.arange(n - 1)[:, None] + np.arange(n - 1)).ravel()
    quads = np.stack([corner, corner + n, corner + n + 1, corner + 1], axis=1)
    triangles = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return np.column_stack([x.ravel(), y.ravel()]), triangles, quads


def fibres_at(orientation):
    c, s = np.cos(np.radians(orientation)), np.sin(np.radians(orientation))
    return np.array([c, s]), np.array([-s, c])


def write_result(folder, form, n=11, orientation=30.0, half=HALF, scene=None, **summary):
    """Write the folder of a run whose sheet is formed by a known map of the flat one."""
    folder.mkdir(exist_ok=True)
    X, triangles, _ = mesh_of(n, half)
    x = form(X)
    legs = x[triangles[:, 1:]] - x[triangles[:, :1]]
    rest = X[triangles[:, 1:]] - X[triangles[:, :1]]
    F = np.linalg.solve(rest, legs).transpose(0, 2, 1)
    unit = [F @ f / np.linalg.norm(F @ f, axis=1)[:, None] for f in fibres_at(orientation)]
    meshio.Mesh(
        x,
        [("triangle", triangles)],
        {"displacement": x - np.pad(X, ((0, 0), (0, 1)))},
        {
            "warp": [unit[0]],
            "weft": [unit[1]],
            "shear_angle": [np.degrees(np.arcsin((unit[0] * unit[1]).sum(1)))],
            "doubt": [np.zeros(len(triangles))],
        },
    ).write(folder / "result.vtu")
    content = {
        "case": "known part",
        "status": "completed",
        "reached_mm": 40.0,
        "error_estimate": {},
        "certified": True,
        "parameters": {"fabric": FABRIC, "scene": scene},
    } | summary
    (folder / "summary.json").write_text(json.dumps(content))
    return folder


def write_stack(folder, forms, orientations=(30.0, 75.0)):
    """Write the folder of a run of two plies or more, each formed by a known map."""
    parts = [
        meshio.read(write_result(folder, form, orientation=turn) / "result.vtu")
        for form, turn in zip(forms, orientations, strict=True)
    ]
    starts = np.cumsum([0, *(len(part.points) for part in parts)])
    cells = [part.cells[0].data + n for part, n in zip(parts, starts[:-1], strict=True)]
    moved = np.vstack([part.point_data["displacement"] for part in parts])
    names = parts[0].cell_data
    cell_data = {n: [np.concatenate([part.cell_data[n][0] for part in parts])] for n in names}
    numbers = [np.full(len(part), k) for k, part in enumerate(cells, 1)]
    cell_data["ply"] = [np.concatenate(numbers).astype(float)]
    x = np.vstack([part.points for part in parts])
    surface = [("triangle", np.vstack(cells))]
    meshio.Mesh(x, surface, {"displacement": moved}, cell_data).write(folder / "result.vtu")
    content = json.loads((folder / "summary.json").read_text())
    content["plies"] = [{}] * len(parts)
    layers = [
        {"plies": [k], "orientation": turn, "fabric": FABRIC | {"name": f"fabric {k}"}}
        for k, turn in enumerate(orientations, 1)
    ]
    content["parameters"]["plies"] = layers
    (folder / "summary.json").write_text(json.dumps(content))
    return folder


A = np.array([[1.2, 0.3], [-0.1, 0.9]])
TILT = np.array([[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])


def stretched(X):
    """Homogeneous deformation A in a plane that is tilted about y."""
    return np.pad(X @ A.T, ((0, 0), (0, 1))) @ TILT.T


def dome(X):
    """Drawn in, sheared, and a dome without a symmetry."""
    x, y = (0.95 * X[:, 0] + 0.1 * X[:, 1]), 0.9 * X[:, 1]
    return np.column_stack([x, y, 25.0 * np.exp(-((x - 5) ** 2 + (y + 8) ** 2) / 40**2)])


def exact(X, orientation=30.0, step=1e-4):
    """J, warp and weft of the dome at flat points, from its derivative."""
    g = [(dome(X + step * e) - dome(X - step * e)) / (2 * step) for e in np.eye(2)]
    F = np.stack(g, axis=2)
    unit = [F @ f / np.linalg.norm(F @ f, axis=1)[:, None] for f in fibres_at(orientation)]
    return np.linalg.norm(np.cross(*g), axis=1), *unit


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A small run, and its folder."""
    result = qf.solve(qf.forming("hemisphere", orientation=20, size=38, travel=15))
    folder = tmp_path_factory.mktemp("run") / "out"
    result.save(folder, pictures=False)
    return result, folder


def angle_between(a, b):
    return np.degrees(np.arccos(np.clip((a * b).sum(1), -1, 1)))


# Fibres


def test_area_change_of_a_stretch_is_exact(tmp_path):
    fibres = carry(read_formed(write_result(tmp_path / "r", stretched)))
    J = np.linalg.det(A)
    np.testing.assert_allclose(fibres.area_ratio, J, rtol=1e-12)
    np.testing.assert_allclose(fibres.thickness, 1.2 / J, rtol=1e-12)
    np.testing.assert_allclose(fibres.areal_weight, 500.0 / J, rtol=1e-12)
    warp, weft = (A @ f / np.linalg.norm(A @ f) for f in fibres_at(30.0))
    np.testing.assert_allclose(fibres.warp, np.tile(TILT @ [*warp, 0], (200, 1)), atol=1e-12)
    np.testing.assert_allclose(fibres.shear_angle, np.degrees(np.arcsin(warp @ weft)))


def test_fibres_of_flat_part_are_found(tmp_path):
    record = read_formed(write_result(tmp_path / "r", dome, orientation=-25.0))
    np.testing.assert_allclose(record.sheet.along, fibres_at(-25.0), atol=1e-12)


def test_directions_are_unit_and_tangent(tmp_path):
    part = read_formed(write_result(tmp_path / "r", dome))
    X, triangles, _ = mesh_of(17, 40.0)
    meshio.Mesh(dome(X), [("triangle", triangles)]).write(tmp_path / "fine.vtu")
    for target in (None, read_shells(tmp_path / "fine.vtu")):
        fibres = carry(part, target)
        for axis in ("warp", "weft", "bisector"):
            v = getattr(fibres, axis)
            np.testing.assert_allclose(np.linalg.norm(v, axis=1), 1.0, atol=1e-9)
            assert np.abs((v * fibres.target.normals).sum(1)).max() < 1e-7
        halves = [angle_between(fibres.bisector, f) for f in (fibres.warp, fibres.weft)]
        np.testing.assert_allclose(*halves, atol=1e-5)


def test_result_and_its_folder_hand_over_the_same(run):
    result, folder = run
    one, other = carry(read_formed(result)), carry(read_formed(folder))
    for name in ("warp", "weft", "area_ratio"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-9)
    for name in ("thickness", "areal_weight", "name"):
        assert one.fabric[name] == other.fabric[name]
    assert moduli(one) == moduli(other)
    one, other = read_formed(result.record).sheet, read_formed(folder).sheet
    for name in ("flat", "points", "triangles"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-9)
    np.testing.assert_allclose(one.along, fibres_at(20.0), atol=1e-9)


@pytest.mark.parametrize("kind", ["triangles", "quads"])
def test_mapping_onto_a_finer_mesh_converges_to_the_field(tmp_path, kind):
    X, triangles, quads = mesh_of(41, 35.0)  # clear of the rim, where a mean is one-sided
    cells = [("triangle", triangles)] if kind == "triangles" else [("quad", quads)]
    meshio.Mesh(dome(X), cells).write(tmp_path / "fine.vtk")
    target = read_shells(tmp_path / "fine.vtk")
    at = X[triangles if kind == "triangles" else quads].mean(1)
    J, *fibres = exact(at)
    n = target.normals  # a coarse target has planes of its own
    warp, weft = (f - (f * n).sum(1)[:, None] * n for f in fibres)
    warp, weft = (f / np.linalg.norm(f, axis=1)[:, None] for f in (warp, weft))
    errors = []
    for n in (11, 21):
        fibres = carry(read_formed(write_result(tmp_path / f"r{n}", dome, n)), target)
        assert fibres.known.all()
        errors.append(
            [
                np.abs(fibres.area_ratio / J - 1).max(),
                angle_between(fibres.warp, warp).max(),
                angle_between(fibres.weft, weft).max(),
            ]
        )
    coarse, fine = np.array(errors)
    assert (fine < [0.02, 1.0, 1.0]).all()
    assert (fine < 0.45 * coarse).all()


def test_elements_off_the_sheet_are_told_and_get_nothing(tmp_path):
    part = read_formed(write_result(tmp_path / "r", dome))
    X, triangles, _ = mesh_of(5, 45.0)
    x = np.vstack([dome(X), dome(X) + np.array([0, 0, 300])])
    both = np.vstack([triangles, triangles[:, ::-1] + len(X)])
    meshio.Mesh(x, [("triangle", both)]).write(tmp_path / "m.vtu")
    fibres = carry(part, read_shells(tmp_path / "m.vtu"))
    assert fibres.known.tolist() == [True] * 32 + [False] * 32
    assert np.isnan(fibres.warp[32:]).all()
    assert np.isnan(fibres.thickness[32:]).all()
    assert any("32 of 64 elements are farther" in notice for notice in fibres.notices)
    wide = carry(part, read_shells(tmp_path / "m.vtu"), within=400.0)
    assert wide.known.all()
    assert any("32 of 64 elements have their normal against" in notice for notice in wide.notices)
    meshio.Mesh(x * 1e-3, [("triangle", both)]).write(tmp_path / "metres.vtu")
    metres = read_shells(tmp_path / "metres.vtu", 1000.0)
    np.testing.assert_allclose(carry(part, metres).area_ratio[:32], fibres.area_ratio[:32])


def test_doubts_of_a_run_are_told(tmp_path):
    folder = write_result(tmp_path / "r", dome, status="stopped", certified="stopped early")
    mesh = meshio.read(folder / "result.vtu")
    mesh.cell_data["doubt"][0][:3] = 1.0
    mesh.write(folder / "result.vtu")
    notices = " ".join(carry(read_formed(folder)).notices)
    assert "3 of 200 triangles" in notices
    assert "stopped before its goal" in notices
    assert "not certified: stopped early" in notices


# Files


def blocks(*paths):
    """Blocks (keyword, parameters, data lines) of a keyword file, its includes followed."""
    found = []
    for path in paths:
        for line in path.read_text(encoding="ascii").splitlines():
            assert len(line) < 256
            if line.startswith("**"):
                continue
            assert line.strip()
            if line.startswith("*"):
                word, *rest = (w.strip() for w in line[1:].split(","))
                given = dict(
                    (w.upper(), "") if "=" not in w else (w.split("=")[0].upper(), w.split("=")[1])
                    for w in rest
                )
                if word == "INCLUDE":
                    found += blocks(path.parent / given["INPUT"])
                else:
                    found.append((word, given, []))
            else:
                found[-1][2].append([w.strip() for w in line.split(",")])
    return found


def numbers(data):
    return np.array([[float(w) for w in row if w] for row in data])


def named(found, word, **given):
    return [
        (g, data)
        for w, g, data in found
        if w == word and all(g.get(k) == v for k, v in given.items())
    ]


def distribution(found, name):
    data = named(found, "DISTRIBUTION", NAME=name)[0][1]
    assert data[0][0] == ""  # the default
    return {int(row[0]): [float(v) for v in row[1:]] for row in data[1:]}


@pytest.mark.parametrize("to", ["abaqus", "abaqus-pair"])
def test_abaqus_reads_back(tmp_path, to):
    handed = export(write_result(tmp_path / "r", dome), to, tmp_path / "out")
    assert set(handed.files) == {"mesh.inp", "fibres.inp", "part.inp", "handover.txt"}
    fibres, found = handed.fibres, blocks(tmp_path / "out" / "part.inp")
    pair = to == "abaqus-pair"
    if not pair:  # meshio knows no M3D3
        mesh = meshio.read(tmp_path / "out" / "mesh.inp")
        np.testing.assert_allclose(mesh.points, fibres.target.points, rtol=1e-8, atol=1e-8)
        assert (mesh.cells[0].data == fibres.target.corners[:, :3]).all()
    elements = {g["TYPE"]: numbers(data).astype(int) for g, data in named(found, "ELEMENT")}
    assert set(elements) == ({"S3", "M3D3"} if pair else {"S3"})
    labels = elements["S3"][:, 0]
    if pair:  # on the same nodes
        assert (elements["M3D3"][:, 1:] == elements["S3"][:, 1:]).all()
        assert not set(elements["M3D3"][:, 0]) & set(labels)
    every = np.concatenate([e[:, 0] for e in elements.values()])
    times = 1 + pair
    for axis in ("warp", "weft", "bisector"):
        points = distribution(found, f"{axis.upper()}_POINTS")
        assert list(points) == every.tolist()
        frame = np.array(list(points.values()))
        v = np.tile(getattr(fibres, axis), (times, 1))
        np.testing.assert_allclose(frame[:, :3], v, atol=1e-8)
        normal = np.cross(frame[:, :3], frame[:, 3:])
        np.testing.assert_allclose(normal, np.tile(fibres.target.normals, (times, 1)), atol=1e-7)
        orientation = named(found, "ORIENTATION", NAME=f"{axis.upper()}_AXES")[0]
        assert orientation[1] == [[f"{axis.upper()}_POINTS"], ["3", "0."]]
    thickness = distribution(found, "FORMED_THICKNESS")
    np.testing.assert_allclose(
        np.ravel(list(thickness.values())), np.tile(fibres.thickness, times), rtol=1e-8
    )
    tables = {g["NAME"] for g, _ in named(found, "DISTRIBUTION TABLE")}
    assert {g["TABLE"] for g, _ in named(found, "DISTRIBUTION")} == tables
    materials = {g["NAME"] for g, _ in named(found, "MATERIAL")}
    (section, layers), *_ = named(found, "SHELL SECTION")
    assert section["SHELL THICKNESS"] == "FORMED_THICKNESS"
    assert [(row[2], row[3]) for row in layers] == [
        ("WARP_LAYER", "WARP_AXES"),
        ("WEFT_LAYER", "WEFT_AXES"),
    ]
    assert materials == {"WARP_LAYER", "WEFT_LAYER"} | ({"MEMBRANE"} if pair else set())
    # the mass per area, with the density, is the areal weight
    density = float(named(found, "DENSITY")[0][1][0][0]) * times
    np.testing.assert_allclose(density * fibres.thickness * 1e12, fibres.areal_weight, rtol=1e-5)


def lopsided(X):
    """Form without a symmetry."""
    x, y = X.T * [[1.3], [0.9]]
    return np.column_stack([x, y, 12.0 * np.exp(-((x - 20) ** 2 + (y + 10) ** 2) / 30**2)])


@pytest.mark.parametrize("align", ["none", "rigid"])
def test_a_mesh_elsewhere_gets_the_fibres_of_the_part(tmp_path, align):
    """A mesh turned and moved away, placed back: its fibres are the part's, turned with it."""
    from scipy.spatial.transform import Rotation

    X, _, quads = mesh_of(8)
    there = write_result(tmp_path / "r", lopsided)
    turn, origin = Rotation.from_euler("xyz", [0, 0, 20], degrees=True), np.array([500.0, 10, 3])
    meshio.Mesh(lopsided(X), [("quad", quads)]).write(tmp_path / "here.vtu")
    away = turn.inv().apply(lopsided(X)) + origin
    meshio.Mesh(away, [("quad", quads)]).write(tmp_path / "away.vtu")
    place = {"origin": origin, "rotate": (0, 0, 20)} if align == "none" else {"align": align}
    here = export(there, "csv", tmp_path / "a", mesh=tmp_path / "here.vtu").fibres
    moved = export(there, "csv", tmp_path / "b", mesh=tmp_path / "away.vtu", **place).fibres
    np.testing.assert_allclose(moved.target.points, away)
    off = 1e-9 if align == "none" else 0.02
    np.testing.assert_allclose(turn.apply(moved.warp), here.warp, atol=off)
    np.testing.assert_allclose(moved.area_ratio, here.area_ratio, atol=off)


@pytest.mark.parametrize(
    ("to", "types"),
    [("abaqus", {6: "STRI65", 8: "S8R"}), ("calculix", {6: "S6", 8: "S8"})],
)
def test_elements_of_second_order_stay_so(tmp_path, to, types):
    X, triangles, quads = mesh_of(4, 30.0)
    x, lines = dome(X), ["*NODE"]
    cells = [("S8", quads[0]), ("S6", triangles[5]), ("S8", quads[3])]
    nodes, rows = list(x), []
    for kind, ring in cells:
        first = len(nodes)
        nodes += [*(0.5 * (x[ring] + x[np.roll(ring, -1)]))]
        rows.append((kind, [*ring, *range(first, len(nodes))]))
    lines += [f"{i + 1}, {p[0]}, {p[1]}, {p[2]}" for i, p in enumerate(nodes)]
    for label, (kind, ring) in enumerate(rows, 41):
        lines += [f"*ELEMENT, TYPE={kind}", ", ".join(str(k) for k in [label, *(np.add(ring, 1))])]
    (tmp_path / "mine.inp").write_text("\n".join(lines))
    there = write_result(tmp_path / "r", dome)
    handed = export(there, to, tmp_path / "out", mesh=tmp_path / "mine.inp")
    assert handed.fibres.target.elements.tolist() == [41, 42, 43]
    found = blocks(tmp_path / "out" / "part.inp")
    written = {g["TYPE"]: numbers(data).astype(int) for g, data in named(found, "ELEMENT")}
    assert set(written) == set(types.values())
    labelled = [[k, *np.add(ring, 1)] for k, (_, ring) in enumerate(rows, 41)]
    assert written[types[8]].tolist() == labelled[::2]
    assert written[types[6]].tolist() == labelled[1:2]


def test_labels_of_the_users_mesh_are_kept(tmp_path):
    X, triangles, quads = mesh_of(4, 30.0)
    x = dome(X)
    lines = ["*HEADING", "mine", "*Node"]
    lines += [f"{7 * i + 100}, {p[0]}, {p[1]}, {p[2]}" for i, p in enumerate(x)]
    lines += ["*Element, type=S4R, elset=skin"]
    lines += [
        f"{11 * i + 5000}, " + ", ".join(f"{7 * c + 100}" for c in q)
        for i, q in enumerate(quads[:5])
    ]
    lines += ["*ELEMENT, TYPE=C3D4", "1, 100, 107, 114, 121", "*ELEMENT, TYPE = S3"]
    lines += [
        f"{i + 90}, " + ", ".join(f"{7 * c + 100}" for c in t) for i, t in enumerate(triangles[5:9])
    ]
    (tmp_path / "mine.inp").write_text("\n".join(lines))
    handed = export(
        write_result(tmp_path / "r", dome), "abaqus", tmp_path / "out", mesh=tmp_path / "mine.inp"
    )
    target = handed.fibres.target
    assert target.elements.tolist() == [5000, 5011, 5022, 5033, 5044, 90, 91, 92, 93]
    np.testing.assert_allclose(target.centroids[0], x[quads[0]].mean(0))
    found = blocks(tmp_path / "out" / "part.inp")
    assert list(distribution(found, "WARP_POINTS")) == target.elements.tolist()
    written = {g["TYPE"]: numbers(data).astype(int) for g, data in named(found, "ELEMENT")}
    assert (written["S4R"][:, 1:] == 7 * quads[:5] + 100).all()
    assert (written["S3"][:, 1:] == 7 * triangles[5:9] + 100).all()
    assert any("mapped by the closest point" in notice for notice in handed.notices)


ccx = pytest.mark.skipif(
    not shutil.which("ccx"), reason="ccx (Debian package calculix-ccx) is not on the PATH"
)


def run_ccx(folder, strain):
    """Stress in local axes, mean over an element's points, of u = strain x at all nodes."""
    found = blocks(folder / "part.inp")
    nodes = numbers(named(found, "NODE")[0][1])
    lines = ["*STEP", "*STATIC", "*BOUNDARY"]
    for label, u in zip(nodes[:, 0].astype(int), nodes[:, 1:] @ strain.T, strict=True):
        lines += [f"{label}, {k}, {k}, {v:.12g}" for k, v in enumerate(u, 1)]
    lines += ["*EL PRINT, ELSET=FORMED, GLOBAL=NO", "S", "*END STEP", ""]
    (folder / "job.inp").write_text((folder / "part.inp").read_text() + "\n".join(lines))
    done = subprocess.run(["ccx", "job"], cwd=folder, capture_output=True, text=True, timeout=120)
    assert "Job finished" in done.stdout, done.stdout[-2000:]
    rows = [line.split()[:8] for line in (folder / "job.dat").read_text().splitlines()]
    rows = np.array([row for row in rows if len(row) == 8 and row[0].isdigit()], dtype=float)
    labels = np.unique(rows[:, 0])
    return labels, np.array([rows[rows[:, 0] == e, 2:].mean(0) for e in labels])


@ccx
@pytest.mark.parametrize("axis", ["warp", "weft", "bisector"])
def test_calculix_runs_an_exported_part_and_returns_its_orientation(tmp_path, axis):
    """Stretched along x, an element of E1, E2, G sees E1 (l·x)², E2 (m·x)², 2 G (l·x)(m·x)."""
    folder = write_result(tmp_path / "r", stretched, 5)
    handed = export(folder, "calculix", tmp_path / "out", axis=axis)
    fibres, strain = handed.fibres, np.diag([1e-3, 0.0, 0.0])
    labels, stress = run_ccx(tmp_path / "out", strain)
    assert labels.tolist() == fibres.target.elements.tolist()
    along = getattr(fibres, axis)
    across = np.cross(fibres.target.normals, along)
    E = {"warp": (4000, 3200), "weft": (3200, 4000), "bisector": (3600, 3600)}[axis]
    # u = strain x has no rotation of the mid-surface that a flat sheet would resist
    wanted = 1e-3 * np.stack(
        [E[0] * along[:, 0] ** 2, E[1] * across[:, 0] ** 2, 0.8 * along[:, 0] * across[:, 0]], 1
    )
    np.testing.assert_allclose(stress[:, [0, 1, 3]], wanted, rtol=1e-4, atol=1e-7)


def test_calculix_gets_thickness_at_nodes_and_the_mass(tmp_path):
    handed = export(write_result(tmp_path / "r", dome), "calculix", tmp_path / "out")
    found, fibres = blocks(tmp_path / "out" / "part.inp"), handed.fibres
    t = numbers(named(found, "NODAL THICKNESS")[0][1])
    assert t[:, 0].tolist() == fibres.target.nodes.tolist()
    x = fibres.target.points[fibres.target.corners[:, :3]]
    area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    volume = area @ t[:, 1][fibres.target.corners[:, :3]].mean(1)
    assert volume == pytest.approx(100.0**2 * 1.2, rel=1e-9)  # that of the flat sheet
    density = float(named(found, "DENSITY")[0][1][0][0])
    assert density * volume == pytest.approx(500e-12 * 100.0**2, rel=1e-5)
    sections = named(found, "SHELL SECTION")
    assert [g["ORIENTATION"] for g, _ in sections] == [f"O{e}" for e in fibres.target.elements]


@ccx
def test_calculix_returns_the_orientation_on_a_dome(tmp_path):
    handed = export(write_result(tmp_path / "r", dome, 13), "calculix", tmp_path / "out")
    _, stress = run_ccx(tmp_path / "out", np.diag([1e-3, 0.0, 0.0]))
    fibres = handed.fibres
    across = np.cross(fibres.target.normals, fibres.warp)
    # the angle of the stretched direction in the element's plane, from the stresses alone
    seen = np.degrees(np.arctan2(np.sqrt(stress[:, 1] / 3200), np.sqrt(stress[:, 0] / 4000)))
    true = np.degrees(np.arctan2(np.abs(across[:, 0]), np.abs(fibres.warp[:, 0])))
    assert np.abs(seen - true).max() < 0.5
    assert np.ptp(true) > 5  # there is something to tell apart


# Stacks


def lower_dome(X):
    """A ply under the dome, stretched otherwise."""
    return dome(X * [1.05, 0.98]) - [0.0, 0.0, 1.2]


@pytest.fixture
def stack(tmp_path):
    return write_stack(tmp_path / "r", [dome, lower_dome])


def upside_down(tmp_path):
    """Mesh of quadrilaterals and triangles on the dome, with some normals turned over."""
    X, triangles, quads = mesh_of(6, 35.0)
    cells = [("triangle", triangles[15:20, ::-1]), ("quad", quads[:9])]
    meshio.Mesh(dome(X) - [0, 0, 0.6], cells).write(tmp_path / "shell.vtk")
    return tmp_path / "shell.vtk"


@pytest.mark.parametrize("to", ["abaqus", "csv", "radioss", "pyacp"])
def test_each_ply_of_a_stack_has_files_of_its_own(stack, tmp_path, to):
    handed = export(stack, to, tmp_path / "out")
    for k, (form, turn) in enumerate([(dome, 30.0), (lower_dome, 75.0)], 1):
        alone = write_result(tmp_path / f"alone{k}", form, orientation=turn)
        one = export(alone, to, tmp_path / f"one{k}")
        assert {f"ply_{k}_{name}" for name in one.files if "handover" not in name} < {*handed.files}
        np.testing.assert_allclose(handed.plies[k - 1].warp, one.fibres.warp, atol=1e-9)
        np.testing.assert_allclose(handed.plies[k - 1].thickness, one.fibres.thickness)
    if to == "abaqus":
        frame = distribution(blocks(tmp_path / "out" / "ply_2_part.inp"), "WARP_POINTS")
        np.testing.assert_allclose(frame[1][:3], handed.plies[1].warp[0], atol=1e-8)
    told = (tmp_path / "out" / "handover.txt").read_text(encoding="utf-8")
    assert "each ply of the stack is handed over" in told
    assert "one ply is handed over" not in told
    with pytest.raises(InputError, match="holds a result already"):
        export(stack, to, tmp_path / "out")


def test_columns_of_pyacp_are_warp_thickness_and_transverse_correction(stack, tmp_path):
    handed = export(stack, "pyacp", tmp_path / "out")
    rows = np.genfromtxt(tmp_path / "out" / "ply_2_lookup.csv", delimiter=",", names=True)
    fibres = handed.plies[1]
    warp = np.column_stack([rows[f"warp_{c}"] for c in "xyz"])
    np.testing.assert_allclose(warp, fibres.warp, atol=1e-8)
    n, turn = fibres.target.normals, np.radians(90.0 + rows["draping_angle_2_deg"])[:, None]
    weft = np.cos(turn) * warp + np.sin(turn) * np.cross(n, warp)
    np.testing.assert_allclose(weft, fibres.weft, atol=1e-6)
    np.testing.assert_allclose(rows["thickness_mm"], fibres.thickness, rtol=1e-8)


def test_a_layup_for_abaqus_has_the_plies_in_order_in_every_element(stack, tmp_path):
    mesh = upside_down(tmp_path)
    handed = export(stack, "abaqus-layup", tmp_path / "out", mesh=mesh)
    found, plies = blocks(tmp_path / "out" / "part.inp"), handed.plies
    up = np.cross(plies[0].warp, plies[0].weft) * plies[0].target.normals
    up = up.sum(1) > 0
    assert 0 < up.sum() < len(up)
    sections = named(found, "SHELL SECTION")
    assert len(sections) == len(up)
    for row, (given, layers) in enumerate(sections):
        assert given["ELSET"] == f"F{plies[0].target.elements[row]}"
        order = [2, 1] if up[row] else [1, 2]
        assert [layer[2:] for layer in layers] == [[f"PLY_{k}", f"PLY_{k}_AXES"] for k in order]
        thickness = [plies[k - 1].thickness[row] for k in order]
        np.testing.assert_allclose([float(layer[0]) for layer in layers], thickness, rtol=1e-8)
    for k, ply in enumerate(plies, 1):
        frames = np.array([*distribution(found, f"PLY_{k}_POINTS").values()])
        np.testing.assert_allclose(frames[:, :3], ply.warp, atol=1e-8)
        across = np.cross(ply.target.normals, ply.warp)
        np.testing.assert_allclose(frames[:, 3:], across, atol=1e-7)


def test_joined_plies_are_layers_and_a_smaller_ply_ends(stack, tmp_path):
    """Two joined plies halve the thickness of their sheet; outside a ply its layer is missing."""
    content = json.loads((stack / "summary.json").read_text())
    content["parameters"]["plies"][0]["plies"] = [1, 2]
    (stack / "summary.json").write_text(json.dumps(content))
    X, _, quads = mesh_of(40, 60.0)
    meshio.Mesh(dome(X), [("quad", quads)]).write(tmp_path / "wide.vtk")
    handed = export(stack, "abaqus-layup", tmp_path / "out", mesh=tmp_path / "wide.vtk")
    sections = named(blocks(tmp_path / "out" / "part.inp"), "SHELL SECTION")
    layers = {int(given["ELSET"][1:]): data for given, data in sections}
    one, other = (ply.known for ply in handed.plies)
    wanted = {(True, True): [2, 1, 1], (True, False): [1, 1], (False, True): [2]}
    found = set()
    for row in np.flatnonzero(one | other):
        found.add(covered := (bool(one[row]), bool(other[row])))
        data = layers.pop(row + 1)
        assert [layer[2] for layer in data] == [f"PLY_{k}" for k in wanted[covered]]
        if one[row]:
            assert float(data[-1][0]) == pytest.approx(handed.fibres.thickness[row] / 2)
    assert found == set(wanted)
    assert not layers


def tables(path):
    """Rows of numbers of the tables in a file that CalculiX printed."""
    rows = path.read_text().split("for set")[1:]
    cells = [[line.split() for line in table.splitlines()] for table in rows]
    numbers = [[row[:8] for row in table if len(row) > 4 and row[0].isdigit()] for table in cells]
    return [np.array(table, dtype=float) for table in numbers]


@ccx
@pytest.mark.parametrize("mesh", ["formed", "own"])
def test_calculix_returns_the_orientation_of_every_ply_of_a_layup(stack, tmp_path, mesh):
    """Stresses along the local and along the global axes tell the frame R of every layer.

    Held and heated, a layer that expands along its local 1 alone has one large stress s11. If the
    frame that was written is off by small angles, stresses that it turns back have s12 and s13
    too large by these angles times s11 - s22.
    """
    handed = export(
        *(stack, "calculix-layup", tmp_path / "out"),
        mesh=upside_down(tmp_path) if mesh == "own" else None,
    )
    text = (tmp_path / "out" / "part.inp").read_text()
    expansion = "*EXPANSION, TYPE=ORTHO, ZERO=0.\n1e-3, 0., 0.\n"
    ends = re.compile(r"^(?=\*(MATERIAL, NAME=PLY_2|SHELL SECTION))", re.MULTILINE)
    text = ends.sub(expansion, text, count=2)
    lines = ["*INITIAL CONDITIONS, TYPE=TEMPERATURE", "FORMED_NODES, 0."]
    lines += ["*BOUNDARY", "FORMED_NODES, 1, 6", "*STEP", "*STATIC"]
    lines += ["*TEMPERATURE", "FORMED_NODES, 1.", "*EL PRINT, ELSET=FORMED, GLOBAL={}", "S, COORD"]
    for name in ("YES", "NO"):
        job = text + "\n".join([*lines, "*END STEP", ""]).format(name)
        (tmp_path / "out" / f"{name}.inp").write_text(job)
        given = {"cwd": tmp_path / "out", "capture_output": True, "text": True, "timeout": 120}
        done = subprocess.run(["ccx", name], **given)
        assert "Job finished" in done.stdout, done.stdout[-2000:]
    (seen, at), (own, _) = (tables(tmp_path / "out" / f"{name}.dat") for name in ("YES", "NO"))
    seen_s, own_s = (t[:, [2, 5, 6, 5, 3, 7, 6, 7, 4]].reshape(-1, 3, 3) for t in (seen, own))
    labels, worst = handed.fibres.target.elements, 0.0
    assert np.unique(seen[:, 0]).tolist() == labels.tolist()
    for row in range(len(labels)):
        n, mine = handed.fibres.target.normals[row], np.flatnonzero(seen[:, 0] == labels[row])
        upper = np.cross(handed.fibres.warp, handed.fibres.weft)[row] @ n
        rising = mine[np.argsort(at[mine, 2:] @ n * np.sign(upper))]
        half = len(mine) // 2
        for ply, points in ((1, rising[:half]), (0, rising[half:])):  # ply 1 is above
            warp = handed.plies[ply].warp[row]
            R = np.column_stack([warp, np.cross(n, warp), n])
            back = R.T @ seen_s[points] @ R - own_s[points]
            large = own_s[points, 0, 0] - own_s[points, 1, 1]
            assert (large < -1.0).all()
            off = np.linalg.norm(back[:, 0, 1:], axis=1) / np.abs(large)
            worst = max(worst, np.degrees(off.max()))
    print(f"largest angle {worst:.2g} degrees")
    assert worst < 0.01


@pytest.mark.parametrize("to", ["radioss", "optistruct"])
def test_drape_tables_read_back_by_columns(tmp_path, to):
    handed = export(
        write_result(tmp_path / "r", stretched), to, tmp_path / "out", reference=(1, 0, 0)
    )
    text = next((tmp_path / "out").glob("drape*")).read_text(encoding="ascii")
    tables, nodes, cells = {}, 0, 0
    for line in text.splitlines():
        if to == "radioss":
            if line.startswith("/DRAPE/"):
                tables[int(line[7:])] = rows = []
            elif line[:10] == "SH3N      ":
                rows.append((int(line[10:20]), float(line[20:40]), float(line[40:60])))
            nodes += bool(re.fullmatch(r" *\d+(?: +[-+.\deE]+){3}", line) and len(line) == 70)
            cells += bool(re.fullmatch(r" *\d+(?: +\d+){3}", line) and len(line) == 40)
        else:
            if line[:8] == "DRAPE   ":
                tables[int(line[8:16])] = rows = []
            elif line[:8] == "+       ":
                assert line[8:16] == "ELEM    "
                rows.append((int(line[16:24]), float(line[24:32]), float(line[32:40])))
            nodes += line[:8] == "GRID*   "
            cells += line[:8] == "CTRIA3  "
    assert (nodes, cells) == (121, 200)
    assert list(tables) == [1, 2]
    # in the tilted plane the projection of x is the plane's own first axis
    for number, fibre in enumerate(fibres_at(30.0), 1):
        x, y = A @ fibre
        found = np.array(tables[number])
        assert found[:, 0].tolist() == handed.fibres.target.elements.tolist()
        np.testing.assert_allclose(found[:, 1], 1 / np.linalg.det(A), atol=1e-5)
        np.testing.assert_allclose(found[:, 2], np.degrees(np.arctan2(y, x)), atol=0.01)


def test_elements_across_the_reference_are_told(tmp_path):
    def upright(X):
        return np.column_stack([np.zeros(len(X)), X])

    handed = export(write_result(tmp_path / "r", upright), "optistruct", tmp_path / "out")
    assert any("200 elements stand across" in notice for notice in handed.notices)
    assert "ELEM" not in (tmp_path / "out" / "drape.fem").read_text()


def test_table_reads_back(tmp_path):
    handed = export(write_result(tmp_path / "r", dome), "csv", tmp_path / "out")
    with (tmp_path / "out" / "fibres.csv").open() as file:
        table = list(csv.DictReader(file))
    fibres, x = handed.fibres, handed.fibres.target.points
    assert [int(row["element"]) for row in table] == fibres.target.elements.tolist()
    np.testing.assert_allclose(
        [float(row["thickness_mm"]) for row in table], fibres.thickness, rtol=1e-6
    )
    np.testing.assert_allclose(
        [float(row["areal_weight_g_per_m2"]) for row in table], fibres.areal_weight, rtol=1e-6
    )
    # the first side turned by theta about the normal is the fibre
    for axis in ("warp", "weft", "bisector"):
        for row in table[::17]:
            a, b = (x[int(row[name]) - 1] for name in ("n1", "n2"))
            n = fibres.target.normals[int(row["element"]) - 1]
            side = (b - a) / np.linalg.norm(b - a)
            theta = np.radians(float(row[f"theta_{axis}_deg"]))
            v = np.cos(theta) * side + np.sin(theta) * np.cross(n, side)
            np.testing.assert_allclose(v, [float(row[f"{axis}_{c}"]) for c in "xyz"], atol=1e-6)


def test_vtu_reads_back_with_both_kinds_of_cells(tmp_path):
    X, triangles, quads = mesh_of(4, 30.0)
    cells = [("triangle", triangles[5:9]), ("quad", quads[:5])]
    meshio.Mesh(dome(X), cells).write(tmp_path / "mine.vtu")
    handed = export(
        write_result(tmp_path / "r", dome), "vtu", tmp_path / "out", mesh=tmp_path / "mine.vtu"
    )
    mesh = meshio.read(tmp_path / "out" / "fibres.vtu")
    assert [(c.type, len(c.data)) for c in mesh.cells] == [("triangle", 4), ("quad", 5)]
    labels = np.concatenate(mesh.cell_data["element"])
    assert sorted(labels.tolist()) == list(range(1, 10))
    for name in ("warp", "weft", "bisector", "thickness", "areal_weight", "shear_angle"):
        found = np.concatenate(mesh.cell_data[name])
        np.testing.assert_allclose(found, getattr(handed.fibres, name)[labels - 1])


@pytest.mark.parametrize("to", FORMATS)
def test_every_format_tells_what_it_does_not_carry(run, tmp_path, to):
    _, folder = run
    handed = export(folder, to, tmp_path / "out")
    told = (tmp_path / "out" / "handover.txt").read_text(encoding="utf-8")
    assert set(handed.files) <= set(FILES)
    assert not set(FILES) & set(RESULT_FILES)  # into the folder of a run, nothing is replaced
    for notice in handed.notices:
        assert notice in told
    assert "several plies" in told
    assert "do not slip" in told
    with pytest.raises(InputError, match="holds a result already"):
        export(folder, to, tmp_path / "out")
    export(folder, to, tmp_path / "out", force=True)


# The deck of a scene

KNOWN = {
    *("HEADING", "NODE", "ELEMENT", "NSET", "ORIENTATION", "MEMBRANE SECTION", "SHELL SECTION"),
    *("MATERIAL", "DENSITY", "USER MATERIAL", "ELASTIC", "RIGID BODY", "MASS", "BOUNDARY"),
    *("SURFACE", "SURFACE INTERACTION", "FRICTION", "SURFACE BEHAVIOR", "AMPLITUDE", "STEP"),
    *("DYNAMIC", "CONTACT PAIR", "CLOAD", "DLOAD", "OUTPUT", "NODE OUTPUT", "ENERGY OUTPUT"),
    "END STEP",
}
IN_STEP = {"DYNAMIC", "CONTACT PAIR", "CLOAD", "DLOAD", "OUTPUT", "NODE OUTPUT", "ENERGY OUTPUT"}


def read_deck(path):
    """Blocks of a deck, with every label and name in it found consistent."""
    found = blocks(path)
    assert {word for word, _, _ in found} <= KNOWN
    inside = False
    for word, _, _ in found:
        if word in ("STEP", "END STEP"):
            assert inside == (word == "END STEP")
            inside = word == "STEP"
        elif word != "BOUNDARY":
            assert inside == (word in IN_STEP), word
    assert not inside
    nodes, nsets = {}, {}
    for given, data in named(found, "NODE"):
        rows = {int(row[0]): [float(v) for v in row[1:]] for row in data}
        assert not rows.keys() & nodes.keys()
        nodes |= rows
        nsets[given["NSET"]] = set(rows)
    for given, data in named(found, "NSET"):
        nsets[given["NSET"]] = {int(v) for row in data for v in row}
        assert nsets[given["NSET"]] <= nodes.keys()
    elements, elsets = {}, {}
    for given, data in named(found, "ELEMENT"):
        rows = {int(row[0]): [int(v) for v in row[1:]] for row in data}
        corners = {"M3D3": 3, "S3": 3, "R3D3": 3, "MASS": 1}[given["TYPE"]]
        assert all(len(row) == corners and set(row) <= nodes.keys() for row in rows.values())
        assert not rows.keys() & elements.keys()
        elements |= rows
        elsets[given["ELSET"]] = rows
    names = {
        word: {given["NAME"] for given, _ in named(found, word)}
        for word in ("MATERIAL", "ORIENTATION", "AMPLITUDE", "SURFACE", "SURFACE INTERACTION")
    }
    for word, given, data in found:
        if word in ("MEMBRANE SECTION", "SHELL SECTION", "RIGID BODY", "MASS"):
            assert given["ELSET"] in elsets
        if "SECTION" in word:
            assert given["MATERIAL"] in names["MATERIAL"]
            assert given["ORIENTATION"] in names["ORIENTATION"]
        if "AMPLITUDE" in given and word != "AMPLITUDE":
            assert given["AMPLITUDE"] in names["AMPLITUDE"]
        if word in ("BOUNDARY", "CLOAD"):
            assert all(row[0] in nsets or int(row[0]) in nodes for row in data)
        if word == "SURFACE":
            assert all(row[0] in elsets for row in data)
        if word == "CONTACT PAIR":
            assert given["INTERACTION"] in names["SURFACE INTERACTION"]
            assert all(set(row) <= names["SURFACE"] for row in data)
    return found, nodes, elsets, nsets


@pytest.mark.parametrize("symmetry", ["auto", "none"])
def test_deck_of_a_forming_scene(tmp_path, symmetry):
    scene = qf.forming("hemisphere", size=30, symmetry=symmetry)
    notices = abaqus_deck(scene, tmp_path / "new" / "scene.inp", spacing=12.0)
    found, nodes, elsets, nsets = read_deck(tmp_path / "new" / "scene.inp")
    blank, fabric = scene.sheet.blank, scene.sheet.fabric
    x = np.array([nodes[i + 1] for i in range(len(blank.nodes))])
    np.testing.assert_allclose(x, scene.sheet.positions(scene.x0), rtol=1e-8, atol=1e-8)
    for name in ("MEMBRANES", "SHELLS"):
        corners = np.array(list(elsets[name].values()))
        assert (corners == blank.triangles + 1).all()
    # mass of the sheet and of the holder, in tonnes
    density = sum(float(data[0][0]) for _, data in named(found, "DENSITY"))
    mass = density * fabric.thickness * blank.areas.sum()
    assert mass == pytest.approx(600e-12 * 310**2 * scene.share, rel=1e-4)
    assert float(named(found, "MASS")[0][1][0][0]) == pytest.approx(5e-3 * scene.share)
    assert named(found, "CLOAD")[0][1][0][:2] == ["T_BLANK_HOLDER_REF", "3"]
    assert float(named(found, "CLOAD")[0][1][0][2]) == pytest.approx(-5 * 9.81 * scene.share)
    # tools: on their distance, normals outwards, where the scene has them
    for contact in scene.contacts:
        name = "T_" + contact.tool.name.upper().replace(" ", "_")
        (reference,) = nsets[f"{name}_REF"]
        np.testing.assert_allclose(nodes[reference], contact.origin(scene.x0), atol=1e-8)
        corners = np.array([[nodes[c] for c in e] for e in elsets[name].values()])
        corners -= nodes[reference]
        d, n, _ = contact.tool.shape.distance(corners.reshape(-1, 3))
        assert np.abs(d).max() < 1e-5
        a, b, c = corners.transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        mean = n.reshape(-1, 3, 3).mean(1)
        assert ((normal * mean).sum(1) > 0).all()
        assert 100 < len(corners) < 5000
    # the travel: a smooth step to -75 mm at 1 m/s
    ((given, data),) = named(found, "AMPLITUDE", NAME="TRAVEL")
    assert given["DEFINITION"] == "SMOOTH STEP"
    assert [float(v) for v in data[0]] == [0.0, 0.0, 0.075, 1.0]
    ((_, data),) = named(found, "BOUNDARY", AMPLITUDE="TRAVEL")
    assert data == [["T_PUNCH_REF", "3", "3", "-75"]]
    friction = [float(data[0][0]) for _, data in named(found, "FRICTION")]
    assert friction == [fabric.friction] * 3
    assert len(named(found, "CONTACT PAIR")) == 3
    # the constants, in their order
    ((given, data),) = named(found, "USER MATERIAL")
    values = [float(v) for row in data for v in row if v]
    law = fabric.shear
    assert int(given["CONSTANTS"]) == len(values) == 19
    assert values == [
        *(1000.0, 0, 0, 0, 0, 0) * 2,
        *(0.0, law.C_ini, law.S_ini, law.C_mid, law.dS_mid, law.C_lo, law.I_lo),
    ]
    held = [row for given, data in named(found, "BOUNDARY") for row in data]
    mirrored = symmetry == "auto"
    assert not any(name.startswith("HELD") for name in nsets)  # symmetry says it already
    for plane, axis in (("X", 0), ("Y", 1)):
        assert ([f"MIRROR_{plane}", f"{plane}SYMM"] in held) == mirrored
        if mirrored:
            assert all(abs(nodes[i][axis]) < 1e-9 for i in nsets[f"MIRROR_{plane}"])
    text = (tmp_path / "new" / "scene.inp").read_text()
    assert "13     points of the table" in text
    assert any("not in the deck: in-plane bending" in notice for notice in notices)
    assert any("not run" in notice for notice in notices)
    assert any("multiply forces by 4" in notice for notice in notices) == mirrored


def test_deck_of_a_tension_test(tmp_path):
    shear = TabulatedLaw((0.0, 0.2, 0.5, 0.8, 1.0), (0.0, 0.1, 0.2, 0.4, 0.9))
    law = qf.Fabric(shear=shear)
    scene = qf.off_axis_tension(law=law, displacement=40, size=40)
    notices = abaqus_deck(scene, tmp_path / "oat.inp")
    found, nodes, elsets, _ = read_deck(tmp_path / "oat.inp")
    assert "SHELLS" not in elsets
    assert any("membranes alone" in notice for notice in notices)
    ((_, data),) = named(found, "BOUNDARY", AMPLITUDE="TRAVEL")
    right = [i for i, x in nodes.items() if x[0] > 160 - 1e-6]
    assert [[int(row[0]), int(row[1]), float(row[3])] for row in data] == [
        [i, 1, 40.0] for i in right
    ]
    ((given, data),) = named(found, "USER MATERIAL")
    values = [float(v) for row in data for v in row if v]
    assert int(given["CONSTANTS"]) == len(values) == 13 + 10
    assert values[12:] == [5.0, 0, 0, 0.2, 0.1, 0.5, 0.2, 0.8, 0.4, 1.0, 0.9]


def test_deck_takes_a_tool_from_a_file_as_it_is(tmp_path):
    vertices, triangles, *_ = sampled(ball(30.0), np.full(3, -35.0), np.full(3, 35.0), 8.0)
    vertices[:, 0] += 3.0  # off the axis, to see it turned
    meshio.Mesh(vertices, [("triangle", triangles)]).write(tmp_path / "ball.stl", binary=True)
    (tmp_path / "part.toml").write_text(
        "travel = 20\n[blank]\nshape = 'disc'\nradius = 80\n"
        "[tools.punch]\nfile = 'ball.stl'\nplace = [2.0, 1.0]\n"
        "[tools.die]\nshape = 'round opening'\nradius = 50\nfillet = 5\n"
    )
    scene = qf.forming(str(tmp_path / "part.toml"), orientation=90, size=20)
    notices = abaqus_deck(scene, tmp_path / "deck.inp", spacing=15.0)
    _, nodes, elsets, nsets = read_deck(tmp_path / "deck.inp")
    assert any("triangles of its file" in notice for notice in notices)
    assert len(elsets["T_PUNCH"]) == len(triangles)
    (reference,) = nsets["T_PUNCH_REF"]
    x = np.array([nodes[i] for i in sorted(nsets["T_PUNCH_NODES"])]) - nodes[reference]
    np.testing.assert_allclose(0.5 * (x.min(0) + x.max(0))[:2], [3.0, 0.0], atol=0.1)
    np.testing.assert_allclose(nodes[reference][:2], [2.0, 1.0])
    # in a model whose x axis is turned by 30° from the user's, the tool is turned back
    sheets = [replace(scene.sheet, turn=30.0)]
    turned_back, _ = from_file(scene.contacts[0].tool, replace(scene, sheets=sheets))
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    np.testing.assert_allclose(turned_back[:, 0], c * x[:, 0] + s * x[:, 1], atol=1e-6)
    np.testing.assert_allclose(turned_back[:, 1], c * x[:, 1] - s * x[:, 0], atol=1e-6)
    half = {"tools.punch.scale": 0.5}
    scene = qf.forming(str(tmp_path / "part.toml"), orientation=90, size=20, overrides=half)
    abaqus_deck(scene, tmp_path / "half.inp", spacing=15.0)
    _, nodes, _, nsets = read_deck(tmp_path / "half.inp")
    smaller = np.array([nodes[i] for i in sorted(nsets["T_PUNCH_NODES"])])
    np.testing.assert_allclose(np.ptp(smaller, axis=0), 0.5 * np.ptp(x, axis=0), atol=1e-3)
    # what is meant is what the model has read, and moved
    moved = qf.forming(str(tmp_path / "part.toml"), size=20, overrides={"tools.punch.offset": 3.0})
    (tmp_path / "ball.stl").unlink()
    abaqus_deck(scene, tmp_path / "again.inp", spacing=15.0)
    again, half = (read_deck(tmp_path / f"{name}.inp")[1] for name in ("again", "half"))
    assert again == half
    notices = abaqus_deck(moved, tmp_path / "moved.inp", spacing=4.0)
    assert any("the punch is" in notice and "sampled" in notice for notice in notices)
    _, nodes, _, nsets = read_deck(tmp_path / "moved.inp")
    (reference,) = nsets["T_PUNCH_REF"]
    inner = np.array([nodes[i] for i in sorted(nsets["T_PUNCH_NODES"])]) - nodes[reference]
    far = np.linalg.norm(inner - [3.0, 0.0, 0.0], axis=1)[inner[:, 2] < -1.0]
    assert len(far) > 50
    assert far.min() > 27.0 - 0.7  # facets 8 mm wide on 30 mm
    assert far.max() < 27.0 + 0.01


def test_what_a_deck_cannot_hold_is_told(tmp_path):
    class Spring:
        name = "a spring of mine"

    scene = qf.off_axis_tension(size=40)
    scene.terms.append(Spring())
    notices = abaqus_deck(scene, tmp_path / "a.inp")
    assert "not in the deck: a spring of mine" in notices
    text = (tmp_path / "a.inp").read_text()
    assert "a spring of mine" in text
    with pytest.raises(InputError, match="exists already"):
        abaqus_deck(scene, tmp_path / "a.inp")
    with pytest.raises(InputError, match="speed must be a positive number"):
        abaqus_deck(scene, tmp_path / "b.inp", speed=-1)


@pytest.mark.parametrize("shape", [ball(20.0), turned(round_opening(25.0, 8.0), 30.0)])
def test_triangles_of_a_tool_lie_on_it(shape):
    low, high = np.array([-40.0, -40, -25]), np.array([40.0, 40, 25])
    vertices, _, spacing, off = sampled(shape, low, high, 4.0)
    assert spacing == 4.0
    assert np.abs(shape.distance(vertices)[0]).max() < 1e-6
    assert off < 4.0**2 / (4 * 8.0)
    with pytest.raises(InputError, match="not where the sheet can be"):
        sampled(shape, low + np.array([0, 0, 200]), high + np.array([0, 0, 200]), 10.0)


# The flat pattern


def test_circle_mapped_forward_comes_back(tmp_path):
    """A circle of the flat sheet, lifted onto the formed triangles, is found again."""
    folder = write_result(tmp_path / "r", dome, 41)
    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    radius, centre = 30.0, np.array([4.0, -3.0])
    X = centre + radius * np.column_stack([np.cos(t), np.sin(t)])
    curve = dome(X)
    pattern = flat_pattern(folder, curve)
    (line,) = pattern.trim
    assert (line[0] == line[-1]).all()
    size = 2 * radius
    assert np.abs(np.linalg.norm(line - centre, axis=1) - radius).max() < 1e-3 * size
    assert pattern.area == pytest.approx(np.pi * radius**2, rel=1e-3)
    assert not any("leaves" in notice or "jumps" in notice for notice in pattern.notices)
    assert len(read_formed(folder).sheet.triangles) == 3200
    # from a CSV too, in metres
    rows = ["x,y,z", *(f"{p[0]:.9g},{p[1]:.9g},{p[2]:.9g}" for p in curve * 1e-3)]
    (tmp_path / "trim.csv").write_text("\n".join(rows))
    again = flat_pattern(folder, tmp_path / "trim.csv", scale=1000.0)
    np.testing.assert_allclose(again.trim[0], line, atol=1e-5)


def test_points_between_those_of_a_line_are_mapped_too(tmp_path):
    """The straight sides of a square in space are curves on the flat sheet."""

    def fanned(X):
        return np.column_stack([X[:, 0] * (1 + 0.003 * X[:, 1]), X[:, 1], 0 * X[:, 0]])

    folder = write_result(tmp_path / "r", fanned, 41)
    square = 30.0 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    (line,) = flat_pattern(folder, square).trim
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).max() < 1.0
    np.testing.assert_allclose(np.abs(fanned(line)).max(1), 30.0, atol=0.01)


def test_line_seen_along_z_comes_back(tmp_path):
    folder = write_result(tmp_path / "r", dome, 61)
    t = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    plan = 25.0 * np.column_stack([np.cos(t), np.sin(t)]) + [2.0, 1.0]
    (line,) = flat_pattern(folder, plan).trim
    assert np.abs(np.linalg.norm(dome(line)[:, :2] - [2.0, 1.0], axis=1) - 25.0).max() < 0.025
    whole = np.linalg.inv([[0.95, 0.1], [0.0, 0.9]])
    assert flat_pattern(folder, plan).area == pytest.approx(
        np.pi * 25.0**2 * np.linalg.det(whole), rel=1e-3
    )


def test_die_opening_and_edge(tmp_path):
    def drawn_in(X):
        return np.pad(0.9 * X, ((0, 0), (0, 1)))

    folder = write_result(tmp_path / "r", drawn_in, 61, half=155.0, scene="hemisphere")
    pattern = flat_pattern(folder, "die")
    (line,) = pattern.trim
    longest = np.linalg.norm(np.diff(line, axis=0), axis=1).max()
    assert any(f"triangles, up to {longest:.3g} mm long" in n for n in pattern.notices)
    assert load("hemisphere").tools[1].shape.hole.radius == 80.0
    assert np.abs(np.linalg.norm(line, axis=1) - 80.0 / 0.9).max() < 0.05
    edge = flat_pattern(folder, "edge")
    assert edge.area == pytest.approx(310.0**2)
    assert len(edge.trim) == len(edge.blank) == 1


def test_line_that_leaves_the_sheet_is_told(tmp_path):
    folder = write_result(tmp_path / "r", dome)
    t = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    circle = np.column_stack([np.cos(t), np.sin(t)])

    def notices(curve):
        return " ".join(flat_pattern(folder, curve).notices)

    on = dome(30 * circle)

    def above(z):
        return on + np.column_stack([0 * t, 0 * t, 0 * t + z])

    assert "leaves the sheet" not in notices(on)
    assert "leaves the sheet" not in notices(above(0.6))  # on the tool, not in the middle
    assert "leaves the sheet" in notices(above(np.linspace(0, 5, 200)))
    assert "leaves the sheet" in notices(dome(30 * circle + [25.0, 0.0]))
    beyond = dome(30 * circle)
    beyond[:, 0] += 0.1 * np.maximum(beyond[:, 0] - 20, 0)
    assert "leaves the sheet" not in notices(beyond[:, :2])
    assert "leaves the sheet" in notices(60 * circle)  # seen along z
    flat = write_result(tmp_path / "flat", lambda X: np.pad(X, ((0, 0), (0, 1))))
    just = np.pad(np.array([[-40.0, -40], [50.5, -40], [50.5, 40], [-40, 40]]), ((0, 0), (0, 1)))
    told = " ".join(flat_pattern(flat, just).notices)
    assert "leaves the sheet" in told
    assert "by up to 0.5 mm" in told


def test_pattern_reads_back_at_its_real_size(tmp_path):
    ezdxf = pytest.importorskip("ezdxf")
    folder = write_result(tmp_path / "r", dome, 21, orientation=30.0)
    t = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    curve = dome(np.column_stack([20 * np.cos(t), 30 * np.sin(t)]))
    pattern = flat_pattern(folder, curve)
    pattern.save(tmp_path / "out")
    drawing = ezdxf.readfile(tmp_path / "out" / "pattern.dxf")
    assert drawing.header["$INSUNITS"] == 4  # mm
    lines = {}
    for entity in drawing.modelspace().query("LWPOLYLINE"):
        points = np.array(entity.get_points("xy"))
        lines.setdefault(entity.dxf.layer, []).append((points, entity.closed))
    ((trim, closed),), ((blank, _),) = lines["TRIM"], lines["BLANK"]
    assert closed
    np.testing.assert_allclose(trim, pattern.trim[0][:-1])
    np.testing.assert_allclose(np.ptp(blank, axis=0), [100, 100])
    texts = [e.dxf.text for e in drawing.modelspace().query("TEXT")]
    assert "0° (warp)" in texts
    assert any("upper side" in text for text in texts)
    arrow = lines["MARKS"][0][0]
    along = (arrow[1] - arrow[0]) / np.linalg.norm(arrow[1] - arrow[0])
    np.testing.assert_allclose(along, fibres_at(30.0)[0], atol=1e-9)

    root = ET.parse(tmp_path / "out" / "pattern.svg").getroot()
    space = "{http://www.w3.org/2000/svg}"
    _, _, width, height = map(float, root.get("viewBox").split())
    assert (root.get("width"), root.get("height")) == (f"{width:.4f}mm", f"{height:.4f}mm")
    groups = {group.get("id"): group for group in root.iter(f"{space}g")}
    drawn = {
        name: np.array([p.split(",") for p in group[0].get("points").split()], dtype=float)
        for name, group in groups.items()
    }
    for name, wanted in (("TRIM", pattern.trim[0]), ("BLANK", pattern.blank[0])):
        shown = drawn[name] * [1, -1]  # y points down in a picture
        np.testing.assert_allclose(shown - shown[0], wanted - wanted[0], atol=2e-4)
        assert (drawn[name] > 0).all()
        assert (drawn[name] < [width, height]).all()
    assert "0° (warp)" in "".join(root.itertext())
    assert "several" not in pattern.notices[0]
    assert "plies of a stack" in (tmp_path / "out" / "pattern.txt").read_text(encoding="utf-8")
    with pytest.raises(InputError, match="holds a result already"):
        pattern.save(tmp_path / "out")


def test_without_ezdxf_the_rest_is_written(tmp_path, monkeypatch, capsys):
    folder = write_result(tmp_path / "r", dome, 21)
    argv = ["export", str(folder), "--trim", "edge", "--out", str(tmp_path / "out")]
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    assert main(argv) == 0
    said = capsys.readouterr().out
    assert "note: pattern.dxf is left out" in said
    assert "pip install ezdxf" in said
    assert said.splitlines()[-1].endswith("pattern.svg, pattern.csv, pattern.txt")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"pattern.svg", "pattern.csv", "pattern.txt"}
    assert "pip install ezdxf" in (tmp_path / "out" / "pattern.txt").read_text(encoding="utf-8")


def test_points_of_a_pattern_as_csv(tmp_path):
    pattern = flat_pattern(write_result(tmp_path / "r", dome, 21), dome(np.array(BOX)))
    pattern.save(tmp_path / "out")
    with (tmp_path / "out" / "pattern.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    trim = [[float(r["x_mm"]), float(r["y_mm"])] for r in rows if r["layer"] == "TRIM"]
    np.testing.assert_allclose(trim, pattern.trim[0], atol=1e-3)


@pytest.mark.parametrize("to", FORMATS)
def test_the_command_prints_what_is_of_this_part_alone(tmp_path, capsys, to):
    folder = write_result(tmp_path / "r", dome, status="stopped")
    assert main(["export", str(folder), "--to", to, "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    told = (tmp_path / "out" / "handover.txt").read_text(encoding="utf-8")
    assert "the run stopped before its goal" in said
    assert "several plies" not in said
    assert "several plies" in told
    general = int(re.search(r"(\d+) notes that apply to every such", said)[1])
    assert said.count("  note: ") + general == told.count("\n- ")


def wide(size, like):
    """A scene that was made in Python, by a recipe of its own."""
    return qf.forming(size=size, travel=1.0, overrides={"tools.die.radius": 90.0})


@dataclass(frozen=True)
class Own:
    """A shape of the user's own, which no file can hold."""

    shape: Any

    def __getattr__(self, name):
        return getattr(object.__getattribute__(self, "shape"), name)


def own_punch(size):
    file = load("hemisphere", {"tools.die.radius": 90.0})
    punch, *others = file.tools
    punch = replace(punch, geometry=Own(punch.shape))
    return qf.forming(replace(file, tools=(punch, *others)), size=size, travel=1.0)


@pytest.mark.parametrize("made", ["overrides", "recipe", "own shape"])
def test_the_opening_of_the_die_is_that_of_the_run(tmp_path, made):
    scene = {
        "overrides": lambda: wide(31, None),
        "recipe": lambda: Recipe(wide, (), 31).build(),
        "own shape": lambda: own_punch(31),
    }[made]()
    result = qf.solve(scene, estimate=False)
    result.save(tmp_path / "out", pictures=False)
    assert result.record.areas.keys() == {"green", "blue", "pink"}
    sources = [result, tmp_path / "out"]
    if not (tmp_path / "out" / "scene.toml").exists():
        # the built-in scene of the same name is another one: 80 mm
        sources.remove(tmp_path / "out")
        with pytest.raises(InputError, match=r"no scene\.toml, so its scene is not known"):
            flat_pattern(tmp_path / "out", "die")
        saved = Record.read(tmp_path / "out")
        assert saved.areas == {}
        cuts, why = tool_cuts(saved)
        assert not cuts
        assert "its scene is not known" in why
        sheet_figure(saved)  # without the rings of the areas
    assert (len(sources) == 2) == (made == "overrides")
    for source in sources:
        (line,) = flat_pattern(source, "die").trim
        assert np.abs(np.linalg.norm(line, axis=1) - 90.0).max() < 0.5


@pytest.mark.parametrize("where", ["recorded", "beside", "moved away"])
def test_scene_of_a_result_is_found_from_any_folder(tmp_path, monkeypatch, where):
    def drawn_in(X):
        return np.pad(0.9 * X, ((0, 0), (0, 1)))

    (tmp_path / "runs").mkdir()
    folder = write_result(tmp_path / "runs" / "r", drawn_in, 61, half=155.0, scene="mine.toml")
    scene = tmp_path / ("elsewhere.toml" if where == "recorded" else "runs/mine.toml")
    text = (FOLDER / "hemisphere.toml").read_text(encoding="utf-8")
    if where != "moved away":
        scene.write_text(text.replace("radius = { value = 80.0", "radius = { value = 70.0"))
    if where == "recorded":
        content = json.loads((folder / "summary.json").read_text())
        content["parameters"]["scene_file"] = str(scene)
        (folder / "summary.json").write_text(json.dumps(content))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    if where == "moved away":
        with pytest.raises(InputError, match=r"its scene mine\.toml is in none of .*runs"):
            flat_pattern(folder, "die")
        return
    (line,) = flat_pattern(folder, "die").trim
    assert np.abs(np.linalg.norm(line, axis=1) - 70.0 / 0.9).max() < 0.05


def test_a_ply_book_has_a_page_a_ply_to_scale(stack, tmp_path):
    content = json.loads((stack / "summary.json").read_text())
    content["parameters"]["plies"][1]["plies"] = [2, 3]
    (stack / "summary.json").write_text(json.dumps(content))
    book = qf.ply_book(stack, tmp_path / "book")
    text = book.read_text(encoding="utf-8")
    titles = re.findall(r"<h1>(.*)</h1>", text)
    assert titles == ["Ply 1 of 3", "Ply 2 of 3", "Ply 3 of 3"]
    assert "Uppermost, over ply 2" in text
    assert "Joined to ply 2, lowest" in text
    own = re.findall(r'class="own"><td>(.*)</td>', text)
    name, angle, thickness, area, weight = own[0].split("</td><td>")[1:]
    assert (name, angle, thickness) == ("fabric 1", "30°", "1.2 mm")
    assert (area, weight) == ("100.0 cm²", "5.0 g")  # 500 g/m²
    assert own[1].split("</td><td>")[3] == "0.6 mm"
    size, view = re.search(r'<svg .*width="(.*?)mm".*viewBox="0 0 (.*?) ', text).groups()
    assert float(size) < 182
    assert float(view) == pytest.approx(float(size))  # 110 mm fit at 1:1
    wide = write_stack(tmp_path / "wide", [dome, lower_dome])
    mesh = meshio.read(wide / "result.vtu")
    mesh.points *= 4.0
    mesh.point_data["displacement"] *= 4.0
    mesh.write(wide / "result.vtu")
    text = qf.ply_book(wide, tmp_path / "wide-book").read_text(encoding="utf-8")
    size, view = re.search(r'<svg .*width="(.*?)mm".*viewBox="0 0 (.*?) ', text).groups()
    assert float(view) == pytest.approx(2.5 * float(size), rel=1e-4)
    assert "mm, 1:2.5<" in text
    assert ">100 mm</text>" in text
    arrow = re.findall(r'id="MARKS".*?points="(.*?)"', text, re.DOTALL)[1]
    (x, y), (a, b) = (map(float, p.split(",")) for p in arrow.split()[:2])
    assert np.degrees(np.arctan2(y - b, a - x)) == pytest.approx(75.0, abs=0.1)


def test_flat_patterns_of_a_stack_are_of_each_ply(stack, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["export", str(stack), "--trim", "edge", "--out", str(out)]) == 0
    names = {path.name for path in out.iterdir()}
    assert {"ply_1_pattern.csv", "ply_2_pattern.csv", "ply_2_pattern.svg"} < names
    assert (
        "known part, ply 2 of 2 at 75°: 1 line to cut, 10000 mm² inside" in capsys.readouterr().out
    )
    assert main(["export", str(stack), "--trim", "edge", "--out", str(out)]) == 2
    assert main(["export", str(stack), "--ply-book", "edge", "--out", str(out)]) == 0
    assert "ply_book.html" in capsys.readouterr().out


# Wrong input


def test_bad_input_ends_in_one_line(tmp_path):
    folder = write_result(tmp_path / "r", dome)
    out = tmp_path / "out"
    (tmp_path / "empty.inp").write_text("*NODE\n1, 0, 0, 0\n")
    (tmp_path / "broken.inp").write_text("*NODE\n1, 0, 0, 0\n*ELEMENT, TYPE=S3\n1, 1, 2, 3\n")
    (tmp_path / "twice.inp").write_text("*NODE\n1, 0, 0, 0\n1, 1, 0, 0\n")
    (tmp_path / "words.inp").write_text("*NODE\n1, a, 0, 0\n")
    (tmp_path / "far.vtu").write_text("nothing")
    X, triangles, _ = mesh_of(3)
    meshio.Mesh(dome(X) + 500.0, [("triangle", triangles)]).write(tmp_path / "away.vtu")
    for given, words in (
        ({"to": "nastran"}, "unknown format 'nastran'"),
        ({"source": tmp_path / "none"}, "no such folder"),
        ({"mesh": tmp_path / "none.inp"}, "none.inp: No such file"),
        ({"mesh": tmp_path / "empty.inp"}, "no triangles or quadrilaterals"),
        ({"mesh": tmp_path / "broken.inp"}, "refers to node 2"),
        ({"mesh": tmp_path / "twice.inp"}, "the label 1 repeats"),
        ({"mesh": tmp_path / "words.inp"}, "line 2: not numbers"),
        ({"mesh": tmp_path / "far.vtu"}, "not a readable .vtu"),
        ({"mesh": tmp_path / "away.vtu"}, "no element of the mesh is within"),
        ({"within": -1.0, "mesh": tmp_path / "away.vtu"}, "within must be a positive number"),
        ({"scale": 0, "mesh": tmp_path / "away.vtu"}, "scale must be a positive number"),
        ({"axis": "up"}, "axis must be one of warp, weft, bisector"),
        ({"reference": (0, 0, 0)}, "reference must be a direction"),
        ({"reference": "x"}, "reference must be a direction"),
    ):
        arguments = {"source": folder, "to": "calculix", "out": out} | given
        with pytest.raises(InputError, match=re.escape(words)):
            export(**arguments)
        assert not out.exists()


def test_folders_that_are_no_results_are_refused(tmp_path):
    def changed(name, change):
        folder = write_result(tmp_path / name, dome)
        content = json.loads((folder / "summary.json").read_text())
        change(content)
        (folder / "summary.json").write_text(json.dumps(content))
        return folder

    for folder, words in (
        (changed("z", lambda s: s.pop("parameters")), "expected reached_mm, parameters"),
        (changed("a", lambda s: s["parameters"].pop("fabric")), "no parameters.fabric"),
        (
            changed("b", lambda s: s["parameters"]["fabric"].pop("areal_weight")),
            "parameters.fabric.areal_weight must be",
        ),
        (
            changed("c", lambda s: s["parameters"]["fabric"].update(thickness=0)),
            "parameters.fabric.thickness must be",
        ),
        (changed("d", lambda s: None), ""),
    ):
        if words:
            with pytest.raises(InputError, match=words):
                read_formed(folder)
    (folder / "summary.json").write_text("{")
    with pytest.raises(InputError, match=r"summary\.json: not the summary of a run"):
        read_formed(folder)
    (folder / "summary.json").unlink()
    with pytest.raises(InputError, match=r"it has no summary\.json"):
        read_formed(folder)
    folder = write_result(tmp_path / "e", dome)
    mesh = meshio.read(folder / "result.vtu")
    del mesh.cell_data["weft"]
    mesh.write(folder / "result.vtu")
    with pytest.raises(InputError, match="no field 'weft'"):
        read_formed(folder)
    folder = changed("f", lambda s: s["parameters"]["fabric"].pop("shear"))
    with pytest.raises(InputError, match="the laws of the fabric are unknown"):
        export(folder, "abaqus", tmp_path / "out")


def test_bad_trim_lines_are_refused(tmp_path):
    folder = write_result(tmp_path / "r", dome)
    (tmp_path / "one.csv").write_text("x,z\n1,2\n")
    triangle = np.array([[0.0, 0, 0], [10, 0, 0], [0, 10, 0]])
    for trim, words in (
        (triangle[:2], "needs three points"),
        ([[0, 0], [1]], "must be points"),
        (triangle * np.nan, "must be points"),
        (triangle + 900, "nowhere within"),
        (triangle[:, :2] + 900, "does not cross the formed sheet"),
        ([[0, 0], [10, 10], [10, 0], [0, 10]], "not cross itself"),
        (tmp_path / "none.csv", "No such file"),
        (tmp_path / "one.csv", "expected columns x, y, z"),
        ("die", "no forming scene"),
    ):
        with pytest.raises(InputError, match=words):
            flat_pattern(folder, trim)
    with pytest.raises(InputError, match="within must be a positive number"):
        flat_pattern(folder, triangle, within=0)
