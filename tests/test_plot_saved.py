"""Pictures, table and view of results from their files alone."""

import csv
import json
import shutil
import webbrowser
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

import quasiform as qf
from quasiform.console.cli import main
from quasiform.draw import overlay, pictures, view
from quasiform.result.record import Record


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Folders of a formed hemisphere and a pulled strip, and their results."""
    root = tmp_path_factory.mktemp("runs")
    hole = {"blank.holes": [{"shape": "disc", "radius": 30.0, "centre": [110.0, -20.0]}]}
    dome = qf.forming("hemisphere", 45, size=25, travel=40, overrides=hole)
    results = {
        "dome": qf.solve(dome, estimate=False),
        "strip": qf.solve(qf.off_axis_tension(30, displacement=20, size=40), estimate=False),
    }
    for name, result in results.items():
        result.save(root / name, pictures=False)
    return root, results


@pytest.fixture(params=["dome", "strip"])
def pair(request, folders):
    root, results = folders
    return Record.read(root / request.param), results[request.param]


def test_what_was_saved_is_read_back(pair):
    run, result = pair
    assert list(run.sheets.travels) == [s.travel for s in result.states]
    for k in (0, len(run.sheets) // 2, -1):
        sheet = run.sheets[k]
        assert_allclose(sheet.points, result.positions(k), atol=1e-9)
        assert_allclose(sheet.shear_angle, result.shear_angles(k), atol=1e-9)
        for reason, flag in result.sheet_at(k).doubts().items():
            assert (sheet.doubts()[reason] == flag).all()
        assert run.upto(k).force == pytest.approx(result.states[k].force, abs=1e-4)
    for family in ("warp", "weft"):
        blank = run.sheet.blank
        assert_allclose(getattr(blank, family), getattr(result.blank, family), atol=1e-9)
    assert_allclose(run.sheet.flat, result.blank.nodes, atol=1e-9)
    assert run.in_plane == (result.model.sheet.dim == 2)
    assert run.has_tools == bool(result.model.contacts)
    assert run.locking == pytest.approx(np.degrees(np.arcsin(0.819)))


def test_nearest_state(pair):
    run, result = pair
    assert run.near(11.0).travel == 10.0
    assert run.near(1e9).travel == result.model.travel


def test_level_lines_of_a_linear_function_are_straight_and_whole():
    blank = qf.off_axis_tension(30, size=20).sheet.blank
    x, along = blank.nodes, np.array([0.6, 0.8])
    lines = overlay.level_lines(x, blank.triangles, x @ along, [100.0])
    assert_allclose(lines @ along, 100.0)
    low = x.min(0)
    cut = [(100 - 0.8 * y) / 0.6 for y in (low[1], low[1] + 160)]
    inside = np.clip(cut, low[0], x.max(0)[0])
    expected = abs(np.diff(inside)[0]) / 0.8  # its direction is (0.8, -0.6)
    assert np.linalg.norm(np.diff(lines, axis=1), axis=2).sum() == pytest.approx(expected)


def test_level_lines_on_the_lines_of_a_mesh_are_drawn_once():
    x = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])
    lines = overlay.level_lines(x, triangles, x[:, 0], [1.0])
    assert np.linalg.norm(np.diff(lines, axis=1), axis=2).sum() == pytest.approx(1.0)


def test_pictures_of_two(folders, tmp_path):
    root, results = folders
    notes = pictures.save([Record.read(root / name) for name in results], tmp_path, animate="gif")
    assert notes == []
    assert {path.name for path in tmp_path.iterdir()} == {
        *(f"{name}.png" for name in pictures.PICTURES),
        "travel.gif",
    }
    for path in tmp_path.glob("*.png"):
        shades = np.asarray(Image.open(path).convert("L"))
        assert shades.min() < 60 < 250 < shades.max()
    with Image.open(tmp_path / "travel.gif") as gif:
        travels = {state.travel for result in results.values() for state in result.states}
        assert gif.n_frames == len(travels)


@pytest.mark.skipif(not shutil.which("ffmpeg"), reason="needs ffmpeg")
def test_the_travel_as_mp4(folders, tmp_path):
    root, _ = folders
    pictures.save([Record.read(root / "dome")], tmp_path, only=["force"], animate="mp4")
    assert b"ftyp" in (tmp_path / "travel.mp4").read_bytes()[:16]


def test_forces_of_a_coarser_mesh_are_hollow(folders):
    root, _ = folders
    run = Record.read(root / "dome")
    rows = len(run.history["force_N"])
    sizes = np.where(np.arange(rows) < rows - 1, 20.0, 10.0)
    mixed = replace(run, history=run.history | {"size_mm": sizes})

    def hollow(figure):
        marks = [m for m in figure.axes[0].lines if m.get_markerfacecolor() == "white"]
        return sum(len(m.get_xdata()) for m in marks)

    assert hollow(pictures.PICTURES["force"]([run], ["a"], 60, [])) == 0
    figure = pictures.PICTURES["force"]([mixed], ["a"], 60, [])
    assert hollow(figure) == rows - 1
    assert "coarser mesh" in figure.legends[0].get_texts()[-1].get_text()


def test_one_scale_for_all_that_reaches_the_locking_angle(folders):
    root, results = folders
    runs = [Record.read(root / name) for name in results]
    assert (
        pictures.scale_end(runs)
        == pictures.scale_end(runs[:1])
        == pictures.scale_end(runs[1:])
        == 60
    )
    figures = [
        pictures.PICTURES["shear_angle"](given, ["a", "b"][: len(given)], 60, [])
        for given in (runs, runs[:1])
    ]
    for figure in figures:
        bar = figure.axes[-1]
        assert [text.get_text() for text in bar.texts] == ["locking 55°"]
        assert bar.texts[0].xy[0] * 60 == pytest.approx(runs[0].locking, abs=0.01)
        assert bar.get_xlim() == (0, 60)


def test_tools_are_cut_where_they_are(folders):
    root, _ = folders
    cuts, why_not = overlay.tool_cuts(Record.read(root / "dome"))
    assert why_not == ""
    assert list(cuts) == ["punch, cut at z = 0", "die, cut at z = -20 mm"]
    for words, radius in (("punch", np.sqrt(75**2 - (75 - 40 + 1.004) ** 2)), ("die", 80.0)):
        x, y, d = next(cut for name, cut in cuts.items() if name.startswith(words))
        inside = (d < 0) if words == "punch" else (d > 0)
        area = inside.sum() * (x[1] - x[0]) * (y[1] - y[0])
        assert np.sqrt(area / np.pi) == pytest.approx(radius, rel=0.02)
    assert overlay.tool_cuts(Record.read(root / "strip")) == ({}, "")


def test_missing_scene_is_said(folders, tmp_path):
    root, _ = folders
    shutil.copytree(root / "dome", tmp_path / "dome")
    summary = json.loads((tmp_path / "dome" / "summary.json").read_text())
    (tmp_path / "dome" / "scene.toml").unlink()  # as in results of version 0.1.0
    summary["parameters"]["scene"] = "gone.toml"
    (tmp_path / "dome" / "summary.json").write_text(json.dumps(summary))
    (note,) = pictures.save([Record.read(tmp_path / "dome")], tmp_path, only=["outline"])
    assert note.startswith(
        "dome: no tools under the outline: its scene was not found or has changed"
    )
    assert (tmp_path / "outline.png").exists()


def test_one_flat_blank_for_equal_ones(folders):
    root, _ = folders
    run = Record.read(root / "dome")
    sheet = run.sheet
    order = np.roll(np.arange(len(sheet.flat)), 7)  # the same blank, numbered otherwise
    triangles = np.argsort(order)[sheet.triangles]
    moved = replace(sheet, points=sheet.points[order], flat=sheet.flat[order], triangles=triangles)
    other = replace(run, sheets=[moved])
    figure = pictures.PICTURES["outline"]([run, other], ["a", "b"], 60, [])
    dashed = [line for line in figure.axes[0].lines if line.get_linewidth() == 0.6]
    assert len(dashed) == len(sheet.loops)


def test_command(folders, tmp_path, monkeypatch, capsys):
    root, results = folders
    monkeypatch.chdir(tmp_path)
    assert main(["plot", str(root / "dome"), str(root / "strip"), "--only", "force"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("writing to pictures\n")
    assert out.endswith("files in pictures: force.png, table.csv\n")
    with open("pictures/table.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row, result in zip(rows, results.values(), strict=True):
        gamma = np.abs(result.shear_angle)
        assert float(row["shear_angle_max_deg"]) == pytest.approx(gamma.max(), abs=0.01)
        assert float(row["force_N"]) == pytest.approx(result.force, rel=1e-3)
        assert row["converged"] == ("yes" if result.certified.converged else "no")
        assert row["trust"] == "limited"  # at least by a mesh error that is not known
    assert main(["plot", str(root / "dome"), "--table", "--travel", "11"]) == 0
    table = dict(line.split(None, 1) for line in capsys.readouterr().out.splitlines())
    assert table["travel_mm"] == "10"
    assert "converged" not in table  # only the end is checked
    assert [path.name for path in tmp_path.iterdir()] == ["pictures"]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("", "DIR"),
        ("none", "none: no such folder"),
        (".", "no summary.json"),
        ("DOME --only fibre", "did you mean 'fibres'?"),
        ("DOME --animate avi", "unknown value 'avi'"),
        ("DOME --scale 0", "--scale"),
        ("DOME --animate mp4", "ffmpeg"),
        ("BROKEN", "not the summary of a run"),
        ("FOREIGN", "no field 'displacement'"),
    ],
)
def test_refusals(folders, tmp_path, monkeypatch, capsys, line, words):
    root, _ = folders
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(pictures.shutil, "which", lambda name: None)
    if "BROKEN" in line:
        (tmp_path / "BROKEN").mkdir()
        (tmp_path / "BROKEN" / "summary.json").write_text("[1, 2]")
    if "FOREIGN" in line:
        shutil.copytree(root / "dome", tmp_path / "FOREIGN")
        for path in (tmp_path / "FOREIGN").glob("*.vtu"):
            path.write_text(path.read_text().replace('"displacement"', '"moved"'))
    argv = ["plot", *line.replace("DOME", str(root / "dome")).split()]
    assert main(argv) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert words in err
    assert err.count("\n") == 1


def test_pictures_beside_a_result_leave_it_whole(folders, tmp_path, capsys):
    root, _ = folders
    shutil.copytree(root / "dome", tmp_path / "dome")
    before = {path.name: path.read_bytes() for path in (tmp_path / "dome").iterdir()}
    argv = ["plot", str(tmp_path / "dome"), "--only", "force", "--out", str(tmp_path / "dome")]
    assert [main(argv), main(argv), main([*argv, "--force"])] == [0, 2, 0]
    after = {path.name: path.read_bytes() for path in (tmp_path / "dome").iterdir()}
    assert {name: after[name] for name in before} == before
    assert set(after) - set(before) == {"force.png", "table.csv"}


def test_view_is_that_of_the_result(pair):
    pytest.importorskip("plotly")
    run, result = pair
    for state in (1, -1):
        (mine, *lines), (theirs, *their_lines) = (
            view.figure(source.upto(state)).data for source in (run, result.record)
        )
        for name in ("x", "y", "z", "intensity"):
            assert_allclose(mine[name], theirs[name], atol=1e-4)
        assert_allclose(mine.customdata, theirs.customdata, atol=1e-4)
        assert len(lines) == len(their_lines)
        for line, their_line in zip(lines, their_lines, strict=True):
            assert_allclose(line.z, their_line.z, atol=1e-4)
    assert view.figure(run).layout == view.figure(result.record).layout
    assert view.words(run).split(", ", 2)[2] == view.words(result.record).split(", ", 2)[2]
    assert view.words(run.near(10)).endswith("not the end of the run, which alone is checked")


def test_view_command(folders, tmp_path, monkeypatch, capsys):
    pytest.importorskip("plotly")
    root, _ = folders
    monkeypatch.chdir(tmp_path)
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda page: opened.append(page) or True)
    assert main(["view", str(root / "dome")]) == 0
    out = capsys.readouterr().out
    assert ", converged; trust limited: a fibre cuts" in out
    assert out.endswith("\nfile: dome.html\n")
    assert main(["view", str(root / "dome"), "--travel", "11", "--open"]) == 0
    assert "travel 10 mm" in capsys.readouterr().out
    assert opened == [(tmp_path / "dome-2.html").as_uri()]
    page = (tmp_path / "dome.html").read_text(encoding="utf-8")
    assert "Plotly.newPlot" in page
    assert "<script src" not in page
    assert main(["view", str(root / "dome"), "--out", "dome.html"]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["view", str(root / "dome"), "--out", "dome.html", "--force"]) == 0
    assert main(["view", "nowhere"]) == 2
    monkeypatch.setattr(view, "find_spec", lambda name: None)
    capsys.readouterr()
    assert main(["view", str(root / "dome")]) == 2
    assert "pip install 'quasiform[report]'" in capsys.readouterr().err
    assert len(list(tmp_path.iterdir())) == 2


def test_the_force_after_a_collapse_does_not_set_the_scale(folders):
    root, _ = folders
    run = Record.read(root / "dome")
    force = run.history["force_N"].copy()
    force[-1] = 1e6
    broken = replace(
        run,
        summary=run.summary | {"collapse": {"travel_mm": 35.0}},
        history=run.history | {"force_N": force},
    )
    axes = pictures.PICTURES["force"]([run, broken], ["a", "b"], 60, []).axes[0]
    low, high = axes.get_ylim()
    assert low < 0 < run.force < high < 2 * run.force
    assert [line.get_label() for line in axes.lines if line.get_linestyle() == ":"] == [
        "b: collapsed"
    ]
