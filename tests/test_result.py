"""A formed sheet, the record of a run and its certificate: made, written, read, handed on."""

import json
import re
import shutil
import sys
from dataclasses import replace
from types import SimpleNamespace

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose

import quasiform as qf
from quasiform.console.terminal import in_short, number, report
from quasiform.draw import pictures, view
from quasiform.result.assumed import assumed
from quasiform.result.certificate import Certificate, trust
from quasiform.result.record import FORMAT, Record
from quasiform.result.sheet import FormedSheet, read_sheets

SQUARE = np.array([[0.0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.fixture(scope="module")
def strip():
    return qf.solve(qf.off_axis_tension(45, displacement=20, size=40))


@pytest.fixture
def folder(strip, tmp_path):
    return strip.save(tmp_path / "strip", pictures=False)


def test_deformation_of_an_even_stretch_and_shear():
    A = np.array([[1.1, 0.3], [0.0, 0.9], [0.2, 0.0]])
    sheet = FormedSheet(SQUARE[:, :2] @ A.T, HALVES, SQUARE[:, :2])
    assert_allclose(sheet.F, np.broadcast_to(A, (2, 3, 2)), atol=1e-12)
    area = np.linalg.norm(np.cross(A[:, 0], A[:, 1]))
    assert_allclose(sheet.area_ratio, area)
    assert_allclose(sheet.areas, area * sheet.flat_areas)
    assert_allclose(sheet.flat_areas, 1.0)
    assert_allclose(sheet.weights, [2 / 3, 1 / 3, 2 / 3, 1 / 3])
    a, b = A.T
    sine = a @ b / np.linalg.norm(a) / np.linalg.norm(b)
    assert_allclose(np.sin(np.radians(sheet.sheared(np.eye(2)))), sine)
    fields = dict(zip(("warp", "weft"), sheet.fibres(np.eye(2)), strict=True))
    assert_allclose(replace(sheet, cell_fields=fields).along, np.eye(2), atol=1e-12)


def test_what_is_not_known_is_said():
    sheet = FormedSheet(SQUARE, HALVES)
    with pytest.raises(qf.InputError, match="flat and formed positions"):
        _ = sheet.F
    with pytest.raises(qf.InputError, match="no cell field 'warp'"):
        _ = replace(sheet, flat=SQUARE[:, :2]).along
    with pytest.raises(qf.InputError, match="no point field 'displacement'"):
        sheet.with_flat()
    bent = replace(sheet, point_fields={"displacement": np.arange(4)[:, None] * [[0, 0, 1]]})
    with pytest.raises(qf.InputError, match="not flat"):
        bent.with_flat()


def test_outline_and_hole():
    n = np.arange(16).reshape(4, 4)
    corners = np.stack([n[:-1, :-1], n[:-1, 1:], n[1:, 1:], n[1:, :-1]], axis=-1).reshape(-1, 4)
    corners = np.delete(corners, 4, axis=0)
    triangles = np.vstack([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    points = np.stack(np.meshgrid(range(4), range(4)), axis=-1).reshape(-1, 2).astype(float)
    outer, hole = FormedSheet(None, triangles, points).outline
    assert (len(outer), len(hole)) == (13, 5)
    assert (outer[0] == outer[-1]).all()
    assert np.ptp(outer[:, 0]) == 3
    assert np.ptp(hole[:, 0]) == 1


def test_what_a_file_holds_besides_the_sheet_is_counted(tmp_path):
    points = np.vstack([SQUARE, np.add(SQUARE, [0, 0, 5]), [[9, 9, 9]]])
    cells = [("quad", [[0, 1, 2, 3]]), ("line", [[0, 8]]), ("hexahedron", [range(8)])]
    mesh = meshio.Mesh(points, cells, cell_data={"t": [[3.0], [1.0], [2.0]]})
    mesh.write(tmp_path / "part.vtu")
    (sheet,) = read_sheets(tmp_path / "part.vtu")
    assert sheet.triangles.tolist() == HALVES.tolist()
    assert sheet.cell_fields["t"].tolist() == [3.0, 3.0]
    assert sheet.left_out == {"line": 1, "hexahedron": 1, "nodes without an element": 5}


@pytest.mark.parametrize(
    ("name", "words"), [("gone.vtu", "No such file"), ("x.obj", "unknown kind of file '.obj'")]
)
def test_a_file_that_cannot_be_read_is_named(tmp_path, name, words):
    with pytest.raises(qf.InputError, match=name) as caught:
        read_sheets(tmp_path / name)
    assert words in str(caught.value)


def test_a_sheet_goes_through_meshio_and_back(strip, tmp_path):
    sheet = strip.sheet
    assert strip.sheets["sheet"].triangles is sheet.triangles
    sheet.write(tmp_path / "a.vtu")
    for back in (FormedSheet.from_meshio(sheet.to_meshio()), read_sheets(tmp_path / "a.vtu")[0]):
        back = back.with_flat()
        assert_allclose(back.flat, sheet.flat, atol=1e-12)
        assert set(back.cell_fields) == set(sheet.cell_fields)
        assert_allclose(back.shear_angle, strip.shear_angle)
        assert_allclose(back.sheared(back.along), strip.shear_angle, atol=1e-9)


def test_a_sheet_goes_to_pyvista(strip, monkeypatch):
    class PolyData:
        def __init__(self, points, faces):
            self.points, self.faces = points, faces
            self.point_data, self.cell_data = {}, {}

    monkeypatch.setitem(sys.modules, "pyvista", SimpleNamespace(PolyData=PolyData))
    sheet = strip.sheet
    surface = sheet.to_pyvista()
    assert surface.points is sheet.points
    assert (
        surface.faces.reshape(-1, 4)
        == np.pad(sheet.triangles, ((0, 0), (1, 0)), "constant", constant_values=3)
    ).all()
    assert set(surface.point_data) == {"displacement", "contact_pressure"}
    assert set(surface.cell_data) == set(sheet.cell_fields)
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(qf.InputError, match="pip install pyvista"):
        sheet.to_pyvista()


def test_history_and_table_go_into_pandas(strip):
    pandas = pytest.importorskip("pandas")
    history, table = pandas.DataFrame(strip.history), pandas.DataFrame(strip.table())
    assert len(history) == len(strip.states)
    assert history["force_N"].iloc[-1] == strip.force
    assert list(table.columns) == ["quantity", "value", "estimated_error", "unit"]
    row = table.set_index("quantity").loc["force_N"]
    assert (row["value"], row["unit"]) == (strip.force, "N")
    assert row["estimated_error"] == strip.estimate["force_N"]


def test_a_load_factor_does_work_and_has_no_force(tmp_path):
    result = qf.solve(qf.cantilever(100.0, 1e-5, size=10.0))
    x, weight = result.states[-1].x, result.model.terms[-1]
    work = float(weight.force @ result.model.sheet.positions(x)[:, 2])  # dE/dq = Σ w z
    assert result.history["load_work_mJ"][-1] == pytest.approx(work, rel=1e-6)
    assert result.estimate["load_work_mJ"] > 0
    table = result.table()
    assert table["unit"][table["quantity"].index("load_work_mJ")] == "mJ"
    assert "mJ" in repr(result)
    words = report(result, 1.0)
    assert "completed at 1 of 1\n" in words
    assert f"work of load    {number(work)} ± " in words
    result.save(tmp_path / "own")
    record = Record.read(tmp_path / "own")
    assert "force_N" not in record.history
    assert "force_N" not in record.summary
    assert "load_work_mJ" in record.summary["error_estimate"]
    old = {"force_N" if name == "load_work_mJ" else name: v for name, v in record.history.items()}
    for read in (record, replace(record, history=old)):  # that of version 0.1.0
        assert (read.force, read.force_unit) == (pytest.approx(work, rel=1e-6), "mJ")
        assert pictures.table([read])[0][5] == "load_work_mJ"
        assert "mJ" in view.words(read)
        assert pictures.save([read, read], tmp_path, ["force", "shear_angle"]) == []
    assert qf.compare(tmp_path / "own", tmp_path / "own").rows


def test_assumed_numbers_are_named(strip):
    # its size is the user's, its fabric the paper's but for the in-plane bending
    assert strip.summary()["assumed"] == ["fabric.in_plane_bending"]
    scene = qf.forming("hemisphere", size=30.0, travel=1.0)
    fabric = ["fabric.in_plane_bending", "fabric.compaction"]
    names = assumed(scene)
    assert names[-2:] == fabric
    assert {"tools.punch.radius", "tools.holder.mass", "blank.length"} <= set(names)
    assert "travel" not in names
    short = in_short(names)
    assert short.startswith("numbers of blank, punch, die, holder, areas; in_plane_bending")
    sheet = scene.sheet
    for changes, left in (
        ({"compaction": 60.0}, fabric[:1]),
        ({"provenance": {"compaction": "measured", "friction": "assumed: from Rome"}}, None),
    ):
        other = replace(sheet, fabric=replace(sheet.fabric, **changes))
        found = [name for name in assumed(replace(scene, sheets=[other])) if "fabric" in name]
        assert found == (left or ["fabric.in_plane_bending", "fabric.friction"])
    own = replace(sheet.fabric, shear=replace(sheet.fabric.shear, C_ini=0.5))
    names = assumed(replace(scene, sheets=[replace(sheet, fabric=own)]))
    assert "fabric.bending_warp" in names  # that of the paper's fabric, not of this one


def test_the_certificate_is_true_or_false(strip):
    found = strip.certified
    assert found
    assert isinstance(found, Certificate)
    assert (found.converged, found.reasons, str(found)) == (True, (), "certified")
    assert found.figures["residual_relative"] == strip.residual
    collapsed = replace(strip, collapse={"travel_mm": 12.0})
    assert not collapsed.certified
    assert collapsed.certified.converged
    assert str(collapsed.certified) == "collapsed from 12 mm on"
    for change in (
        {"residual": 2e-3},
        {"negative_pivots": 1},
        {"energy_balance": 0.02},
        {"negative_pivots": None},
        {"residual": np.nan},
    ):
        wrong = replace(strip, **change).certified
        assert not wrong
        assert not wrong.converged
        assert len(wrong.reasons) == 1


def test_trust_says_what_limits_the_numbers(strip):
    assert trust(strip) == []
    rough = replace(strip, estimate={"force_N": 0.3 * strip.force, "shear_angle_deg": 0.1})
    assert trust(rough) == ["the mesh error of the force is 3.8 at a value of 12.6 N"]
    fabric = replace(strip.model.sheet.fabric, shear_range=5.0)
    sheet = replace(strip.model.sheet, fabric=fabric)
    (words,) = trust(replace(strip, model=replace(strip.model, sheets=[sheet])))
    assert re.fullmatch(
        r"the largest shear angle is \d\d\.\d°, the law was tested to 5° \(\d+ % of the area is "
        r"beyond\)",
        words,
    )
    unknown = replace(strip, estimate={"force_N": None, "shear_angle_deg": None})
    assert trust(unknown) == ["the mesh error is not known"]
    assert trust(replace(strip, rescues={"saddle left": 1}, parted=0.05)) == []  # the same state
    (words,) = trust(replace(strip, rescues={"saddle left": 1}, parted=0.5))
    assert words == "one of many states: the sheet became unstable and buckled away once"


def test_the_error_of_the_mesh_is_put_into_another_result(strip):
    from quasiform.result.estimate import judged

    bare = replace(strip, estimate={"shear_angle_deg": None, "force_N": None})
    coarse = qf.solve(qf.off_axis_tension(45, displacement=20, size=80), estimate=False)
    better = judged(bare, [coarse])
    assert better.estimate["force_N"] == pytest.approx(1.25 * abs(strip.force - coarse.force))
    assert bare.estimate["force_N"] is None
    assert judged(bare, [replace(coarse, reason="stopped")]) is bare


def test_files_carry_their_format(strip, folder):
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["format"] == FORMAT == 2
    assert summary["certified"] is True
    assert summary["certificate"] == {"converged": True, "reasons": []}
    assert summary["trust"] == []
    assert summary["factorisations"] == strip.factorisations
    assert set(summary["factorisations"]) == {"40 mm", "56 mm", "20 mm"}
    run = Record.read(folder)
    assert run.summary == json.loads(json.dumps(strip.summary()))
    assert list(run.history) == list(strip.history)
    assert run.certified
    assert not run.upto(1).certified


def test_a_record_is_written_as_it_was_read(folder, tmp_path):
    (tmp_path / "again").mkdir()
    Record.read(folder).write(tmp_path / "again")
    for name in ("summary.json", "history.csv", "outline.csv", "result.pvd"):
        assert (tmp_path / "again" / name).read_text() == (folder / name).read_text()
    again = Record.read(tmp_path / "again")
    assert_allclose(again.sheet.points, Record.read(folder).sheet.points)


@pytest.mark.parametrize(
    ("given", "certified", "converged", "reasons"),
    [
        (True, True, True, []),
        ("stopped early", False, True, ["stopped early"]),
        ("stopped early; 2 negative pivots", False, False, ["stopped early", "2 negative pivots"]),
    ],
)
def test_a_folder_of_version_0_1_0_is_converted(folder, given, certified, converged, reasons):
    summary = json.loads((folder / "summary.json").read_text())
    for key in ("format", "certificate", "trust", "factorisations"):
        del summary[key]
    summary |= {"certified": given, "version": "0.1.0", "one_of_many": "the flange lifts by 1 mm"}
    (folder / "summary.json").write_text(json.dumps(summary))
    run = Record.read(folder)
    assert (run.certified, run.reasons) == (certified, reasons)
    assert run.summary["certified"] is certified
    assert run.summary["certificate"]["converged"] is converged
    assert run.summary["trust"] == ["one of many states: the flange lifts by 1 mm"]
    assert run.summary["format"] == 2


def test_a_newer_format_is_refused_in_one_line(folder):
    summary = json.loads((folder / "summary.json").read_text()) | {"format": 3}
    (folder / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(qf.InputError, match=r"summary\.json: of format 3; this version reads"):
        Record.read(folder)


def test_meshes_are_read_when_they_are_asked_for(folder):
    shutil.copy(folder / "result.vtu", folder / "keep")
    for path in folder.glob("increment_*.vtu"):
        path.write_text("no mesh")
    run = Record.read(folder)
    assert len(run.sheets) > 2
    with pytest.raises(qf.InputError, match=r"increment_0001\.vtu: not a readable"):
        _ = run.sheets[1]
