"""Comparisons of fields whose difference is known, read back from files of every kind."""

import csv
import json
import sys
from types import ModuleType

import meshio
import numpy as np
import pytest
import shapely

import quasiform as qf
from quasiform.comparison import FILES, compare, picture
from quasiform.comparison.mapping import mapped
from quasiform.comparison.place import rim, unfolded
from quasiform.comparison.read import Reading, read_side
from quasiform.console.cli import main
from quasiform.net.blank import cut, rotation
from quasiform.result.sheet import FormedSheet
from quasiform.tables import read_table

HALF = 100.0  # mm


def flat_mesh(n, low=-HALF, high=HALF, width=0.8):
    """Triangles of a rectangle, high - low long and `width` times as wide."""
    x, y = np.meshgrid(np.linspace(low, high, n), width * np.linspace(low, high, n), indexing="ij")
    corner = (n * np.arange(n - 1)[:, None] + np.arange(n - 1)).ravel()
    quads = np.stack([corner, corner + n, corner + n + 1, corner + 1], axis=1)
    X = np.column_stack([x.ravel(), y.ravel()])
    return X, np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]), quads


def gamma_of(X):
    """Known field, degrees: positive, without a symmetry, curved."""
    x, y = X.T / HALF
    return 20.0 + 8.0 * x + 5.0 * y + 3.0 * x * y


def formed(X):
    """Formed positions of the same: drawn in, and a dome without a symmetry of its own."""
    x, y = 0.9 * X.T
    return np.column_stack([x, y, -30.0 * np.exp(-((x - 20) ** 2 + (y + 10) ** 2) / 50**2)])


def mesh_of(n, more=0.0, cells=False, displaced=True):
    X, triangles, _ = flat_mesh(n)
    x = formed(X)
    flat = np.pad(X, ((0, 0), (0, 1)))
    place = X[triangles].mean(1) if cells else X
    field = {"shear_angle": gamma_of(place) + more}
    return meshio.Mesh(
        x,
        [("triangle", triangles)],
        point_data=({"displacement": x - flat} if displaced else {}) | ({} if cells else field),
        cell_data={name: [values] for name, values in field.items()} if cells else {},
    )


def write_result(folder, mesh=None, travel=50.0, force=lambda s: 2.0 * s):
    """Write a folder as a run leaves it: one state at `travel` and half of it, and a history."""
    folder.mkdir()
    mesh = mesh or mesh_of(41)
    mesh.write(folder / "result.vtu")
    start = meshio.Mesh(
        mesh.points - 0.5 * mesh.point_data.get("displacement", 0.0),
        mesh.cells,
        {k: 0.5 * v for k, v in mesh.point_data.items()},
        {k: [0.5 * v[0]] for k, v in mesh.cell_data.items()},
    )
    start.write(folder / "half.vtu")
    (folder / "result.pvd").write_text(
        '<VTKFile type="Collection"><Collection>'
        f'<DataSet timestep="{travel / 2}" file="half.vtu"/>'
        f'<DataSet timestep="{travel}" file="result.vtu"/></Collection></VTKFile>'
    )
    rows = [f"{s},{force(s)}" for s in np.linspace(0.0, travel, 11)]
    (folder / "history.csv").write_text("\n".join(["travel_mm,force_N", *rows]))
    return folder


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return write_result(tmp_path_factory.mktemp("compare") / "result")


def write_points(path, head, columns):
    rows = [",".join(f"{v:.10g}" for v in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


MEAN, RMS, LARGEST = (
    f"difference of |γ|, {word}" for word in ("mean", "root mean square", "largest")
)
FAR = "distance of the outlines, largest"


# A known difference, between different meshes


@pytest.mark.parametrize("by", ["flat", "formed"])
@pytest.mark.parametrize("cells", [False, True])
def test_known_difference_between_two_meshes(result, tmp_path, by, cells):
    mesh_of(53, more=-1.5, cells=cells).write(tmp_path / "other.vtu")
    found = compare(result, tmp_path / "other.vtu", by=by, travel=50)
    # the mean of the triangles at a corner is that half a cell farther inside: 0.33 degrees
    least = 0.35 if cells else 0.02
    assert found[MEAN].difference == pytest.approx(1.5, abs=0.02)
    assert np.nanmax(np.abs(found.difference - 1.5)) < least
    assert found[FAR].difference < 1e-6
    assert np.isfinite(found.difference).all()


def test_a_result_beside_itself_differs_by_nothing(result):
    found = compare(result, result)
    assert found[LARGEST].difference == 0.0
    assert found["force at 50 mm"].result == 100.0
    assert found["force along the travel, root mean square of the largest"].difference == 0.0


def test_a_field_beside_itself_without_displacements_differs_by_nothing(tmp_path):
    """One sheet has flat areas, the other only formed ones: both means must go by the same."""
    mesh = mesh_of(21, cells=True)
    result = write_result(tmp_path / "result", mesh)
    field = {"GAMMA": mesh.cell_data["shear_angle"]}
    meshio.Mesh(mesh.points, mesh.cells, cell_data=field).write(tmp_path / "same.vtu")
    found = compare(result, tmp_path / "same.vtu", field="GAMMA")
    rows = [row for row in found.rows if row.unit == "deg"]
    assert len(rows) == 8
    assert [row.difference for row in rows] == [0.0] * 8
    assert any("by formed area" in note for note in found.notes)


def test_statistics_are_weighted_by_area():
    # a coarse and a fine half: the plain mean over the nodes would lean to the fine one
    X = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10], [11, 0], [11, 10]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])
    assert FormedSheet(flat=X, triangles=triangles).weights.sum() == pytest.approx(110.0)


def test_means_are_weighted_by_area(tmp_path):
    X, triangles, _ = flat_mesh(61)
    X[:, 0] *= np.abs(X[:, 0]) / HALF  # fine in the middle, coarse at the ends
    flat = np.pad(X, ((0, 0), (0, 1)))
    for name, more in (("result", 0.0), ("other", (X[:, 0] / HALF) ** 2)):
        fields = {"displacement": 0.0 * flat, "shear_angle": 20.0 + more + 0.0 * X[:, 0]}
        write_result(tmp_path / name, meshio.Mesh(flat, [("triangle", triangles)], fields))
    found = compare(tmp_path / "result", tmp_path / "other")
    assert found[MEAN].difference == pytest.approx(-1 / 3, rel=0.01)  # of the nodes: -1/5
    assert found[RMS].difference == pytest.approx(1 / np.sqrt(5), rel=0.01)


def test_signs_count_only_when_asked_for(result, tmp_path):
    X, triangles, _ = flat_mesh(41)
    minus = meshio.Mesh(formed(X), [("triangle", triangles)], {"shear_angle": -gamma_of(X)})
    minus.write(tmp_path / "minus.vtu")
    assert compare(result, tmp_path / "minus.vtu")[LARGEST].difference < 1e-9
    signed = compare(result, tmp_path / "minus.vtu", signed=True)
    assert signed["difference of γ, mean"].difference == pytest.approx(40.0, rel=0.01)


def test_forces_over_the_common_travel(result, tmp_path):
    write_points(tmp_path / "f.csv", "Travel (mm),Force [kN]", [[0.0, 60.0], [0.0, 0.15]])
    mesh_of(21).write(tmp_path / "other.vtu")
    told = refusal(result, tmp_path / "other.vtu", history=tmp_path / "f.csv")
    assert "other: travels do not overlap: it is at 60 mm, asked for 50 mm" in told
    given = {"history": tmp_path / "f.csv", "reference_travel": 40}
    found = compare(result, tmp_path / "other.vtu", **given)
    assert found["force at 40 mm"].reference == pytest.approx(100.0)
    assert found["force at the end, relative"].difference == pytest.approx(-20.0)
    # (2 s - 2.5 s)² over 0 to 40, by the largest, 100 N
    along = found["force along the travel, root mean square of the largest"].difference
    assert along == pytest.approx(100 * 0.5 * 40 / np.sqrt(3) / 100, rel=0.01)
    quarter = compare(result, tmp_path / "other.vtu", **given, force_factor=4)
    assert quarter["force at 40 mm"].reference == pytest.approx(400.0)


def test_means_over_areas(result, tmp_path):
    mesh_of(31, more=2.0).write(tmp_path / "other.vtu")
    found = compare(result, tmp_path / "other.vtu", areas={"green": ((40.0, 30.0), 12.0)})
    row = found["mean |γ| in area green"]
    assert row.result == pytest.approx(gamma_of(np.array([[40.0, 30.0]]))[0], abs=0.05)
    assert row.difference == pytest.approx(-2.0, abs=0.02)


@pytest.fixture(scope="module")
def dome(tmp_path_factory):
    """A formed hemisphere and its folder."""
    run = qf.solve(qf.forming("hemisphere", size=12, travel=20), estimate=False)
    return run, run.save(tmp_path_factory.mktemp("dome") / "first", pictures=False)


def test_numbers_of_a_result_are_those_of_its_summary(dome):
    run, folder = dome
    summary = run.summary()
    for found in (compare(folder, folder), compare(run.record, folder), compare(run, folder)):
        for words, name in (("mean", "mean"), ("99th percentile", "p99"), ("maximum", "max")):
            row = found[f"{words} of |γ|"]
            for value in (row.result, row.reference):
                assert value == pytest.approx(summary["shear_angle_deg"][name], abs=1e-6)
        for name, value in summary["areas"].items():
            row = found[f"mean |γ| in area {name}"]
            assert row.result == pytest.approx(value, abs=1e-6)
            assert row.over.endswith("triangles")
        assert any("as in summary.json" in note for note in found.notes)
        assert found.locking == pytest.approx((np.degrees(np.arcsin(0.819)),) * 2)
    assert found.names == (run.model.name, "first")


def test_means_at_points_say_how_many_they_are_of(dome, tmp_path):
    _, folder = dome
    X = np.array([[50.0, 50.0], [50.0, 55.0], [110.0, 110.0], [0.0, 0.0]])
    path = write_points(tmp_path / "p.csv", "x0,y0,gamma", [*X.T, np.full(4, 3.0)])
    found = compare(folder, path)
    assert found["mean |γ| in area green"].over == "2 points"
    assert found["mean |γ| in area pink"].over == "1 point"
    assert "1 point" in found.table()
    notes = " ".join(found.notes)
    assert "not those of summary.json" in notes
    assert "means of few say little of an area: green (2 points), pink (1 point)" in notes
    assert "area blue: no point of both" in notes


def test_a_misplaced_reference_is_warned_of(result, tmp_path, capsys):
    X, _, _ = flat_mesh(21)
    x = formed(X)
    path = write_points(tmp_path / "p.csv", "x,y,z,gamma", [*x.T, gamma_of(X)])
    assert not any("warning" in note for note in compare(result, path).notes)
    path = write_points(
        tmp_path / "off.csv", "x,y,z,gamma", [*np.add(x, [60, 0, 0]).T, gamma_of(X)]
    )
    found = compare(result, path, within=8.0)
    assert found.notes[0].startswith("warning: ")
    words = [str(result), str(path), "--within", "8", "--out", str(tmp_path / "out")]
    assert main(["compare", *words]) == 0
    said = capsys.readouterr().out
    assert said.index("warning: ") < said.index("mean of |γ|")
    assert said.count("warning") == 1
    assert "of the reference is off the result and left out: try --align shift" in found.notes[0]
    assert not any("warning" in note for note in compare(result, path, align="shift").notes)


def test_the_whole_of_a_disc_is_compared_with_a_coarser_one(tmp_path):
    """Whose nodes are denser at its rim, and at its hole, than elsewhere."""
    shape = shapely.Point(0.0, 0.0).buffer(150.0) - shapely.Point(60.0, 0.0).buffer(10.0)
    for size, turn in ((15.0, 30.0), (40.0, 75.0)):
        disc = cut(shape, size, turn, through=((0.0, 0.0),))
        flat = np.pad(disc.nodes, ((0, 0), (0, 1)))
        fields = {"shear_angle": gamma_of(disc.nodes), "displacement": 0.0 * flat}
        mesh = meshio.Mesh(flat, [("triangle", disc.triangles)], fields)
        write_result(tmp_path / f"{size:g}", mesh)
    found = compare(tmp_path / "15", tmp_path / "40")
    assert np.isfinite(found.difference).all()


def test_each_side_of_a_slit_is_compared_with_its_own(tmp_path):
    """The shear angle jumps at the slit x = 0; once on the same mesh, once on another one."""

    def slit(n):
        whole = mesh_of(n)
        triangles = whole.cells[0].data
        right = flat_mesh(n)[0][triangles].mean(1)[:, 0] > 0
        parted = np.where(right[:, None], triangles + n * n, triangles)
        used, triangles = np.unique(parted, return_inverse=True)
        fields = {name: v[used % (n * n)] for name, v in whole.point_data.items()}
        fields["shear_angle"] += 30.0 * (used >= n * n)
        points = whole.points[used % (n * n)]
        return meshio.Mesh(points, [("triangle", triangles.reshape(-1, 3))], fields)

    for n in (21, 27):
        write_result(tmp_path / f"{n}", slit(n))
        assert np.abs(compare(tmp_path / "21", tmp_path / f"{n}").difference).max() < 0.1


def test_blanks_that_differ_are_warned_of(result, tmp_path):
    mesh = mesh_of(31)
    small = meshio.Mesh(0.8 * mesh.points, mesh.cells, mesh.point_data)
    small.point_data["displacement"] = 0.8 * small.point_data["displacement"]
    write_result(tmp_path / "small", small)
    found = compare(tmp_path / "small", result)  # whose blank covers that of the result
    assert found.notes[0].startswith("warning: the flat blanks differ on 36 % of what they cover")
    assert "160 x 128 mm" in found.notes[0]
    mesh_of(29).write(tmp_path / "same.vtu")
    assert not any("warning" in note for note in compare(result, tmp_path / "same.vtu").notes)


def test_equal_folders_are_told_by_their_paths(result, tmp_path):
    (tmp_path / "a").mkdir()
    other = write_result(tmp_path / "a" / "result")
    assert compare(result, other).names == (str(result), str(other))


def test_each_sheet_is_drawn_on_its_own_shape(result, tmp_path):
    mesh = mesh_of(21)
    moved = meshio.Mesh(np.add(mesh.points, [7.0, 0, 0]), mesh.cells, mesh.point_data)
    moved.point_data["displacement"] = np.add(mesh.point_data["displacement"], [7.0, 0, 0])
    moved.write(tmp_path / "moved.vtu")
    found = compare(result, tmp_path / "moved.vtu", by="flat")
    mine, theirs, both = (
        picture.fields_of(found.sheets, found.field, found.gamma)[panel][0].places[:, 0].mean()
        for panel in ("result", "reference", "difference")
    )
    assert theirs - mine == pytest.approx(7.0)
    assert both == mine


def test_ratio_of_energies_of_an_explicit_reference(result, tmp_path):
    explicit = write_result(tmp_path / "explicit")
    s = np.linspace(0.0, 50.0, 6)
    write_points(
        explicit / "history.csv",
        "travel_mm,force_N,kinetic_energy_mJ,internal_energy_mJ",
        [s, 2 * s, [0.5, 2.0, 3.0, 4.0, 1.0, 0.5], [0.001, 20.0, 40.0, 60.0, 80.0, 100.0]],
    )
    found = compare(result, explicit)
    name = "kinetic by internal energy of the reference, "
    assert found[name + "at the end"].reference == pytest.approx(0.5)
    assert found[name + "at most"].reference == pytest.approx(10.0)  # not the start's 50000 %
    assert found[name + "at most"].result is None
    energies = tmp_path / "energies.csv"
    energies.write_text("time,ALLKE,ALLIE\n0,0,0\n0.1,4,80\n")
    assert compare(result, explicit, history=energies)[name + "at most"].reference == 5.0


def test_travel_and_energies_in_a_file_of_fields(result, tmp_path):
    path = tmp_path / "other.vtu"
    mesh_of(11).write(path, binary=False)
    numbers = {"Travel [mm]": 25, "ALLKE": 3, "internal_energy_mJ": 60, "force_kN": 0.06}
    arrays = "".join(
        f'<DataArray type="Float64" Name="{name}" NumberOfTuples="1" format="ascii">{value}'
        "</DataArray>"
        for name, value in numbers.items()
    )
    text = path.read_text().replace("<Piece", f"<FieldData>{arrays}</FieldData><Piece", 1)
    path.write_text(text)
    found = compare(result, path)
    assert found.travel == 25
    assert found["kinetic by internal energy of the reference, at the end"].reference == 5.0
    assert found["force at 25 mm"].reference == 60.0


# Placement and symmetry


@pytest.mark.parametrize("kind", ["mesh", "contour", "points"])
def test_shift_and_turn_are_found(result, tmp_path, kind):
    X, triangles, _ = flat_mesh(31)
    turn, shift = rotation(37.0), np.array([280.0, -15.0, 12.0])
    x = formed(X)
    x[:, :2] = x[:, :2] @ turn.T
    x += shift
    if kind == "mesh":
        path = tmp_path / "turned.vtu"
        x[0, 2] += 2.0  # one point that is off does not lift the sheet
        meshio.Mesh(x, [("triangle", triangles)], {"shear_angle": gamma_of(X)}).write(path)
    elif kind == "points":
        path = write_points(tmp_path / "p.csv", "x,y,z,gamma", [*x.T, gamma_of(X)])
    else:
        ring = shapely.get_coordinates(shapely.box(-90, -72, 90, 72)) @ turn.T + shift[:2]
        path = write_points(tmp_path / "c.csv", "x,y", ring.T)
    found = compare(result, path, align="rigid")
    if kind != "points":
        assert found[FAR].difference < 0.05
    if kind == "mesh":
        np.testing.assert_allclose(found.sheets[1].points[1:], formed(X)[1:], atol=0.05)
    if kind != "contour":
        assert found[RMS].difference < 0.05
        with pytest.raises(qf.InputError, match="no point of the reference lies on the result"):
            compare(result, path)


def test_a_shift_leaves_the_turn_alone(result, tmp_path):
    ring = np.array([[-90.0, -72], [90, -72], [90, 72], [-90, 72], [-90, -72]])
    path = write_points(tmp_path / "c.csv", "x,y", (ring @ rotation(5).T + 30).T)
    assert compare(result, path, align="shift")[FAR].difference > 3.0
    found = compare(result, path, align="rigid")
    assert found[FAR].difference < 0.01
    assert "turned by -5° about z" in " ".join(found.notes)  # and not by 175


@pytest.mark.parametrize("signed", [False, True])
def test_a_quarter_is_unfolded(tmp_path, signed):
    def shear(X):
        return 30.0 * np.sin(X[:, 0] / HALF) * np.sin(X[:, 1] / HALF)

    sheets = []
    for low, n in ((-HALF, 41), (0.0, 21)):
        X, triangles, _ = flat_mesh(n, low)
        x = np.column_stack([X, -1e-3 * (X**2).sum(1)])
        flat = np.pad(X, ((0, 0), (0, 1)))
        # by triangle: at the mirror planes the mean over one side alone is not zero, but 0.5
        gamma = {"shear_angle": [shear(X[triangles].mean(1))]}
        cells = [("triangle", triangles)]
        sheets.append(meshio.Mesh(x, cells, {"displacement": x - flat}, gamma))
    whole = write_result(tmp_path / "whole", sheets[0])
    sheets[1].write(tmp_path / "quarter.vtu")
    word = "γ" if signed else "|γ|"
    for by in ("flat", "formed"):
        found = compare(whole, tmp_path / "quarter.vtu", mirror=("x", "y"), signed=signed, by=by)
        assert found[f"difference of {word}, root mean square"].difference < 0.1
        assert abs(found[f"mean of {word}"].difference) < 0.1  # by triangle
        on_plane = np.abs(found.field.flat).min(1) < 1e-9
        assert np.median(np.abs(found.difference[on_plane])) < (0.02 if signed else 0.3)
        assert found[FAR].difference < 1e-6
        assert np.isfinite(found.difference).all()
    alone = compare(whole, tmp_path / "quarter.vtu", signed=signed)
    assert alone[FAR].difference > 50.0
    with pytest.raises(qf.InputError, match="lies on both sides of x = 0"):
        compare(whole, whole, mirror=("x",))


@pytest.mark.parametrize("start", [0, 3])
def test_a_quarter_contour_is_unfolded(start):
    outline = shapely.Point(0, 0).buffer(50.0, 64)
    quarter = outline.intersection(shapely.box(0, 0, 99, 99)).exterior
    ring = np.roll(shapely.get_coordinates(quarter)[:-1], start, axis=0)
    arc = outline.exterior.intersection(shapely.box(0, 0, 99, 99))
    for line in (shapely.LineString(np.vstack([ring, ring[:1]])), shapely.line_merge(arc)):
        for planes in (("x", "y"), ("y", "x")):
            sheet = FormedSheet(contour=shapely.get_coordinates(line))
            whole = rim(unfolded(sheet, planes, False))
            assert whole.is_closed
            assert shapely.hausdorff_distance(whole, outline.exterior) < 0.1


# Every kind of file


@pytest.mark.parametrize("kind", ["vtu", "vtk", "xdmf"])
@pytest.mark.parametrize("cells", [False, True])
def test_mesh_files(result, tmp_path, monkeypatch, kind, cells):
    # meshio's writer asks for h5py even where it writes XML
    monkeypatch.setitem(sys.modules, "h5py", ModuleType("h5py"))
    path = tmp_path / f"other.{kind}"
    options = {"data_format": "XML"} if kind == "xdmf" else {}
    mesh_of(31, more=1.0, cells=cells).write(path, **options)
    found = compare(result, path)
    assert found[MEAN].difference == pytest.approx(-1.0, abs=0.02)
    assert any("flat coordinates" in note for note in found.notes)


def test_numbers_in_hdf5_name_what_they_need(result, tmp_path, monkeypatch):
    path = tmp_path / "other.xdmf"
    monkeypatch.setitem(sys.modules, "h5py", ModuleType("h5py"))
    mesh_of(5).write(path, data_format="XML")
    path.write_text(path.read_text().replace('Format="XML"', 'Format="HDF"'))
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert "needs h5py: pip install h5py" in refusal(result, path)


def test_quadrilaterals_and_undeformed_points(result, tmp_path):
    X, _, quads = flat_mesh(31)
    flat = np.pad(X, ((0, 0), (0, 1)))
    mesh = meshio.Mesh(
        flat,
        [("quad", quads), ("hexahedron", [[0, 1, 2, 3, 4, 5, 6, 7]])],
        {"U": formed(X) - flat},
        {"gamma": [np.radians(70.0 - gamma_of(X[quads].mean(1))), [0.0]]},
    )
    mesh.write(tmp_path / "quads.vtu")
    found = compare(result, tmp_path / "quads.vtu", angle="between", radians=True, by="formed")
    assert found[MEAN].difference == pytest.approx(-20.0, abs=0.05)
    assert found[LARGEST].difference < 20.6  # at a corner half a cell farther inside
    assert any("taken as the flat ones" in note for note in found.notes)
    metres = meshio.Mesh(1e-3 * flat, mesh.cells, {"U": 1e-3 * mesh.point_data["U"]})
    metres.write(tmp_path / "metres.vtu")
    assert compare(result, tmp_path / "metres.vtu", scale=1000.0)[FAR].difference < 1e-6


def test_angle_worked_out_from_displacements(tmp_path):
    X, triangles, _ = flat_mesh(11)
    flat = np.pad(X, ((0, 0), (0, 1)))
    x = flat.copy()
    x[:, 0] += np.tan(np.radians(10.0)) * X[:, 1]  # simple shear by 10 degrees
    path = tmp_path / "sheared.vtu"
    meshio.Mesh(x, [("triangle", triangles)], {"displacement": x - flat}).write(path)
    gamma = read_side(path, Reading(signed=True)).sheets[0].point_fields["shear_angle"]
    np.testing.assert_allclose(gamma, 10.0, atol=1e-9)
    # fibres at 90° to x: the warp now closes towards the other's negative direction
    turned = read_side(path, Reading(signed=True, orientation=90.0))
    gamma = turned.sheets[0].point_fields["shear_angle"]
    np.testing.assert_allclose(gamma, -10.0, atol=1e-9)


def test_series_in_xdmf(result, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # meshio writes beside the working directory
    mesh = mesh_of(21)
    with meshio.xdmf.TimeSeriesWriter("series.xdmf", data_format="XML") as writer:
        writer.write_points_cells(mesh.points, mesh.cells)
        for time, share in ((0.0, 0.0), (1.0, 0.5), (2.0, 1.0)):
            writer.write_data(time, {"shear_angle": share * gamma_of(flat_mesh(21)[0])})
    path = tmp_path / "series.xdmf"
    assert compare(result, path, reference_travel=50.0)[RMS].difference < 0.05
    early = compare(result, path, reference_travel=50.0, travel=30)
    assert "reference: interpolated between 25 and 50 mm" in early.notes
    assert early["mean of |γ|"].reference == pytest.approx(12.0, abs=0.1)


@pytest.mark.parametrize("key", ["node", "Element Label"])
def test_abaqus_with_values_by_label(result, tmp_path, key):
    X, triangles, _ = flat_mesh(31)
    x = formed(X)
    text = ["*HEADING", "*NODE, NSET=TOOL", "5, 500., 0., 0.", "*NODE, NSET=SHEET"]
    text += [f"{i + 100}, {a}, {b}, {c}" for i, (a, b, c) in enumerate(x)]
    text += ["*ELEMENT, TYPE=R3D3, ELSET=TOOL", "1, 5, 100, 101", "** the sheet"]
    text += ["*ELEMENT, TYPE=S3R, ELSET=SHEET"]
    text += [f"{k + 7}, {a},\n {b}, {c}" for k, (a, b, c) in enumerate(triangles + 100)]
    (tmp_path / "sheet.inp").write_text("\n".join([*text, "*STEP", "1, 2, 3"]))
    place = X if key == "node" else X[triangles].mean(1)
    labels = np.arange(len(place)) + (100 if key == "node" else 7)
    order = np.random.default_rng(0).permutation(len(place))
    columns = [labels[order], gamma_of(place)[order]]
    write_points(tmp_path / "values.csv", f"{key},Fabric shear", columns)
    options = {"values": tmp_path / "values.csv", "field": "Fabric shear", "travel": 50}
    found = compare(result, tmp_path / "sheet.inp", **options)
    assert found[RMS].difference < (0.02 if key == "node" else 0.1)
    assert found[FAR].difference < 1e-6  # the rigid triangle is a tool
    again = [
        np.append(column, more) for column, more in zip(columns, (labels[0], 99.0), strict=True)
    ]
    write_points(options["values"], f"{key},Fabric shear", again)  # the first of a label counts
    assert compare(result, tmp_path / "sheet.inp", **options)[RMS] == found[RMS]
    kept = labels[order] != 500
    write_points(options["values"], f"{key},Fabric shear", [c[kept] for c in columns])
    some = compare(result, tmp_path / "sheet.inp", **options)
    # a node without a value leaves a gap, an element leaves its nodes to its neighbours
    assert np.isnan(some.difference).any() == (key == "node")
    with pytest.raises(qf.InputError, match=r"column 'Fabric sheer' not found: did you mean"):
        compare(result, tmp_path / "sheet.inp", **options | {"field": "Fabric sheer"})


def test_abaqus_written_by_meshio_with_displacements(result, tmp_path):
    X, triangles, _ = flat_mesh(21)
    flat = np.pad(X, ((0, 0), (0, 1)))
    meshio.Mesh(flat, [("triangle", triangles)]).write(tmp_path / "flat.inp")
    columns = [np.arange(len(X)) + 1, *(formed(X) - flat).T]
    write_points(tmp_path / "u.csv", "node,U1,U2,U3", columns)
    found = compare(result, tmp_path / "flat.inp", values=tmp_path / "u.csv")
    assert found[FAR].difference < 1e-6


@pytest.mark.parametrize(
    ("head", "options"),
    [
        ("x0,y0,angle", {}),
        ("X_flat [mm],Y_flat [mm],Shear angle [deg]", {}),
        ("# x_blank y_blank gamma_deg", {}),
        ("x;y;γ", {"coordinates": "flat"}),
        ("x\ty\tS12", {"coordinates": "flat", "field": "S12"}),
    ],
)
def test_points_in_flat_coordinates(result, tmp_path, head, options):
    X, _, _ = flat_mesh(9)
    mark = next((m for m in ";\t," if m in head), " ")
    rows = np.column_stack([0.9 * X, gamma_of(0.9 * X) - 1.0])
    lines = [mark.join(f"{v:.6f}" for v in row) for row in rows]
    if mark == ";":
        lines = [line.replace(".", ",") for line in lines]
    (tmp_path / "points.csv").write_text("\n".join([head, *lines]), encoding="utf-8-sig")
    found = compare(result, tmp_path / "points.csv", **options)
    assert found[MEAN].difference == pytest.approx(1.0, abs=0.01)
    assert len(found.difference) == 81
    assert "reference's points; 100.0 % of them" in " ".join(found.notes)


def test_points_in_formed_coordinates_and_far_ones(result, tmp_path):
    X, _, _ = flat_mesh(9)
    x = formed(X)
    x[0] += [0.0, 0.0, 50.0]  # an outlier of the measurement
    head = "x_mm,y_mm,z_mm,shear_angle_rad"
    path = write_points(tmp_path / "p.csv", head, [*x.T, np.radians(gamma_of(X))])
    areas = {"green": ((40.0, 30.0), 20.0), "none": ((400.0, 0.0), 5.0)}
    found = compare(result, path, areas=areas)
    assert found[RMS].difference < 0.1
    assert np.isnan(found.difference).sum() == 1
    row = found["mean |γ| in area green"]  # the flat place is the result's
    assert row.reference == pytest.approx(gamma_of(np.array([[40.0, 30.0]]))[0], abs=1.5)
    assert row.difference == pytest.approx(0.0, abs=0.1)
    assert "area none: no point of both lies in it" in found.notes
    assert compare(result, path, within=80.0)[LARGEST].difference < 6.0


@pytest.mark.parametrize("head", ["x,y", "x,y,z"])
def test_contours(result, tmp_path, head):
    ring = 0.9 * np.array([[-100.0, -80], [100, -80], [100, 80], [-100, 80]]) * 1.01
    ring = shapely.get_coordinates(shapely.segmentize(shapely.Polygon(ring), 5.0))[:-1]
    columns = [*ring.T, np.zeros(len(ring))][: head.count(",") + 1]
    found = compare(result, write_points(tmp_path / "c.csv", head, columns))
    # a hundredth longer and wider: 0.9 and 0.72 mm, at the corners both
    assert found[FAR].difference == pytest.approx(np.hypot(0.9, 0.72), abs=1e-6)
    assert 0.72 < found["distance of the outlines, mean"].difference < 0.9
    row = found["area within the outline"]
    assert row.difference == pytest.approx(row.result * (1 - 1.01**2))


def test_outlines_are_compared_both_ways(result, tmp_path):
    ring = np.array([[-90.0, -72], [90, -72], [90, 52], [70, 72], [-90, 72], [-90, -72]])
    found = compare(result, write_points(tmp_path / "c.csv", "x,y", ring.T))
    # the corner that is cut off lies farther from the cut than the cut from the edges
    assert found[FAR].difference == pytest.approx(20 / np.sqrt(2))


def test_a_part_of_a_contour_is_no_miss(result, tmp_path):
    x = np.linspace(-60.0, 60.0, 30)
    found = compare(result, write_points(tmp_path / "c.csv", "x,y", [x, np.full(30, 73.0)]))
    assert found[FAR].difference == pytest.approx(1.0, abs=1e-6)


def test_the_outline_is_the_outer_one():
    X, triangles, _ = flat_mesh(11)
    ring = triangles[np.linalg.norm(X[triangles].mean(1), axis=1) > 50.0]
    outline = rim(FormedSheet(np.pad(X, ((0, 0), (0, 1))), ring))
    assert outline.is_closed
    assert outline.bounds == (-100.0, -80.0, 100.0, 80.0)
    assert shapely.Polygon(outline).area == pytest.approx(200.0 * 160.0)


# Refusals


def refusal(result, path, **options):
    with pytest.raises(qf.InputError) as error:
        compare(result, path, **options)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_wrong_field_is_told_with_those_there_are(result, tmp_path):
    mesh = mesh_of(5, displaced=False)
    mesh.point_data = {"shear_engl": gamma_of(flat_mesh(5)[0]), "S": mesh.points}
    mesh.cell_data = {"thickness": [np.ones(32)]}
    mesh.write(tmp_path / "other.vtu")
    told = refusal(result, tmp_path / "other.vtu", field="shear_angle")
    assert "no field 'shear_angle': did you mean 'shear_engl'?" in told
    assert "cell fields: thickness; point fields: " in told
    told = refusal(result, tmp_path / "other.vtu")
    assert "choose one with field=" in told
    found = compare(result, tmp_path / "other.vtu", field="none")
    assert found.gamma is None
    assert found[FAR].difference < 1e-6


def test_travels_that_do_not_overlap(result, tmp_path):
    mesh_of(5).write(tmp_path / "other.vtu")
    told = refusal(result, tmp_path / "other.vtu", reference_travel=60.0, travel=60)
    assert "result: travels do not overlap: it ends at 50 mm" in told
    told = refusal(result, tmp_path / "other.vtu", reference_travel=60.0)
    assert "other: travels do not overlap: it is at 60 mm, asked for 50 mm" in told
    early = write_result(tmp_path / "early", travel=20.0)
    assert "asked for 20 mm" in refusal(result, early)


def test_bad_files(result, tmp_path):
    (tmp_path / "broken.vtu").write_text("<VTKFile")
    assert "not a readable .vtu file" in refusal(result, tmp_path / "broken.vtu")
    assert "No such file" in refusal(result, tmp_path / "nowhere.vtu")
    assert "no such file or folder" in refusal(result, tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    assert "no result" in refusal(result, tmp_path / "empty")
    (tmp_path / "a.stl").write_text("")
    assert "unknown kind of file '.stl'" in refusal(result, tmp_path / "a.stl")
    path = write_points(tmp_path / "p.csv", "x,y,angle", [[1.0, 2], [1.0, 2], [3.0, 4]])
    assert "flat or formed" in refusal(result, path)
    assert "need x, y and z" in refusal(result, path, coordinates="formed")
    (tmp_path / "words.csv").write_text("x,y\n1,2\n3,four\n")
    assert "line 3: column 2 is not a number: 'four'" in refusal(result, tmp_path / "words.csv")
    (tmp_path / "bare.csv").write_text("1,2,3\n4,5,6\n")
    assert "no line of headings" in refusal(result, tmp_path / "bare.csv")
    assert "align must be one of" in refusal(result, result, align="yes")
    assert "unknown key 'feild': did you mean 'field'?" in refusal(result, result, feild="a")
    assert "band for the force" in refusal(
        result, write_points(tmp_path / "c.csv", "x,y", [[0, 1, 1], [0, 0, 1]]), band_force=5
    )


def test_rows_without_a_place_are_left_out(result, tmp_path):
    text = "x0,y0,angle\n0,0,21\n,,\n10,,5\nnan,3,1\n20,0,\n10,0,20.8\n"
    (tmp_path / "p.csv").write_text(text)
    found = compare(result, tmp_path / "p.csv")
    assert np.isfinite(found.difference).sum() == 2
    assert found["mean of |γ|"].reference == pytest.approx(20.9)


def test_columns_by_any_usual_name(tmp_path):
    (tmp_path / "h.csv").write_text("Punch travel [mm];ALLKE;ALLIE;RF3\n0,5;1;2;3\n1,5;2;4;6\n")
    table = read_table(tmp_path / "h.csv")
    assert list(table) == ["travel", "kinetic", "internal", "RF3"]
    assert table["travel"].tolist() == [0.5, 1.5]


# Bands and files


def test_bands(result, tmp_path):
    write_result(tmp_path / "other", mesh_of(41, more=1.0), force=lambda s: 2.2 * s)
    bands = {"band_angle": 1.1, "band_outline": 0.1, "band_force": 10.0}
    held = compare(result, tmp_path / "other", **bands)
    assert held.held
    assert sum(row.held is not None for row in held.rows) == 4
    for name, value in (("band_angle", 0.9), ("band_force", 9.0)):
        missed = compare(result, tmp_path / "other", **bands | {name: value})
        assert not missed.held
        assert "OUTSIDE" in missed.table()
        assert "OUTSIDE" in missed.markdown()
        table = [line for line in missed.markdown().splitlines() if line.startswith("| ")]
        assert all(line.replace(r"\|", "").count("|") == 9 for line in table)


def test_files(result, tmp_path):
    write_result(tmp_path / "other", mesh_of(31, more=1.0))
    found = compare(result, tmp_path / "other", band_angle=0.5, standing="measured")
    found.save(tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(FILES)
    content = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert content["held"] is False
    assert content["travel_mm"] == 50
    with (tmp_path / "out" / "compare.csv").open(newline="") as file:
        rows = {row["quantity"]: row for row in csv.DictReader(file)}
    assert float(rows[MEAN]["difference"]) == pytest.approx(-1.0, abs=0.02)
    assert rows[MEAN]["standing"] == "measured"
    assert rows["difference of |γ|, 95th percentile"]["held"] == "OUTSIDE"
    field = meshio.read(tmp_path / "out" / "difference.vtu").point_data["shear_angle_difference"]
    np.testing.assert_allclose(field, -1.0, atol=0.05)
    assert (tmp_path / "out" / "difference.png").read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(qf.InputError, match="holds a result already"):
        found.save(tmp_path / "out")


# Command line


def test_command(result, tmp_path, capsys):
    write_result(tmp_path / "other", mesh_of(31, more=1.0))
    words = ["compare", str(result), str(tmp_path / "other")]
    assert main([*words, "--out", str(tmp_path / "free"), "--area", "a=0,0,30"]) == 0
    said = capsys.readouterr().out
    assert "mean |γ| in area a" in said
    assert "compare.md" in said
    for limit, status in (("1.2", 0), ("0.8", 1)):
        out = ["--out", str(tmp_path / limit), "--band-angle", limit]
        assert main([*words, *out]) == status
        assert json.loads((tmp_path / limit / "compare.json").read_text())["held"] is not status


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--mirror", "z"], "--mirror: unknown value 'z': expected one of x, y, x,y"),
        (["--area", "a=1,2"], "--area: expected NAME=X,Y,RADIUS in mm, got 'a=1,2'"),
        (["--align", "rigit"], "did you mean 'rigid'?"),
        (["--field", "S"], "no field 'S'"),
        (["--travel", "80"], "travels do not overlap"),
    ],
)
def test_command_refuses(result, tmp_path, capsys, words, told):
    out = tmp_path / "out"
    assert main(["compare", str(result), str(result), "--out", str(out), *words]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1
    assert not out.exists()


# Real runs


def test_two_runs_and_their_files(tmp_path):
    runs = [
        qf.solve(qf.off_axis_tension(45, displacement=20, size=size), estimate=False)
        for size in (20, 16)
    ]
    found = compare(*runs, travel=15.0)
    assert 0.0 < found[RMS].difference < 2.0
    assert abs(found["force at the end, relative"].difference) < 5.0
    runs[1].save(tmp_path / "fine", pictures=False)
    filed = compare(runs[0], tmp_path / "fine", travel=15.0)
    for row in found.rows:
        if row.difference is not None:
            assert filed[row.quantity].difference == pytest.approx(row.difference, abs=1e-4)


def test_points_beyond_a_sheet_are_not_compared():
    X, triangles, _ = flat_mesh(11)
    fields = {"shear_angle": gamma_of(X)}
    sheet = FormedSheet(flat=X, triangles=triangles, point_fields=fields)
    points = FormedSheet(flat=np.array([[0.0, 0.0], [103.0, 0.0], [160.0, 0.0]]))
    gamma = mapped(sheet, points, "flat")
    np.testing.assert_allclose(gamma[:2], [20.0, 28.0], atol=1e-9)
    assert np.isnan(gamma[2])


def test_cells_that_are_not_used_are_the_remedy_not_the_place(result, tmp_path):
    """A third of the reference is solid: no other place (--align) would bring it back."""
    mesh = mesh_of(31, cells=True, displaced=False)
    triangles, gamma = mesh.cells[0].data, mesh.cell_data["shear_angle"][0]
    kept = mesh.points[triangles].mean(1)[:, 0] < 30
    wedges = np.hstack([triangles[~kept], triangles[~kept]])
    cells = [("triangle", triangles[kept]), ("wedge", wedges)]
    data = {"shear_angle": [gamma[kept], gamma[~kept]]}
    meshio.Mesh(mesh.points, cells, cell_data=data).write(tmp_path / "solid.vtu")
    notes = compare(result, tmp_path / "solid.vtu", by="formed").notes
    many = f"{(~kept).sum()} wedge"
    assert any("of its file" in note and many in note for note in notes if "warning" in note)
    assert not any("--align" in note for note in notes)
    assert any(note.startswith(f"left out of the file: {many}") for note in notes)
