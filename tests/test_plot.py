"""The pictures exist, show something, and show it rightly, for every kind of result."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest
import shapely
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread

import quasiform as qf
from quasiform.draw import plot
from quasiform.draw.plot import save_pictures
from quasiform.net.blank import rotation
from quasiform.result.files import PICTURES
from quasiform.result.sheet import FormedSheet
from quasiform.scenes.scene_file import Region, load

SCENES = {
    "formed": lambda: qf.forming(size=30, travel=10),
    "formed, turned fibres": lambda: qf.forming(size=30, travel=5, orientation=45),
    "off-axis": lambda: qf.off_axis_tension(displacement=10, size=40),
    "picture frame": lambda: qf.picture_frame(size=25),
    "cantilever": lambda: qf.cantilever(100, 7e-6, width=20, size=10),
}
DISC = replace(
    load("hemisphere"),
    blank=Region.of(shapely.Point(0, 0).buffer(110.0, 64)),
    orientation=30.0,
    areas={},
)


@pytest.fixture(scope="module")
def results():
    return {name: qf.solve(scene(), estimate=False) for name, scene in SCENES.items()}


def pictures(result, folder):
    """All pictures, (height, width, 3), from 0 to 1."""
    save_pictures(result.record, folder)
    shown = [imread(folder / name)[..., :3] for name in PICTURES]
    for picture in shown:
        assert picture.shape[1] == pytest.approx(16 / 2.54 * 200, abs=1)
        assert picture.std() > 0.03
    return shown


def painted(result):
    """Faces of the sheet seen from above, from far to near: colours, and corners (n, 3, 2)."""
    axes = Figure().subplots()
    plot._draw_from_above(axes, result.record, plot.colour_scale([result.record]))
    sheet = axes.collections[0]
    corners = np.array([path.vertices[:3] for path in sheet.get_paths()])
    return sheet.get_facecolors()[:, :3], corners


def with_end(result, x):
    """Replace the end state's x."""
    return replace(result, states=[*result.states[:-1], replace(result.states[-1], x=x)])


@pytest.mark.parametrize("name", SCENES)
def test_pictures_are_written(results, name, tmp_path):
    pictures(results[name], tmp_path)


@pytest.mark.parametrize("name", ["formed", "off-axis"])
def test_pictures_of_the_start_alone(results, name, tmp_path):
    pictures(replace(results[name], states=results[name].states[:1]), tmp_path)


@pytest.mark.parametrize("name", ["formed, turned fibres", "picture frame", "cantilever"])
def test_pictures_of_a_bare_scene(results, name, tmp_path):
    result = results[name]
    scene = replace(result.model, parameters={}, measures={}, areas={}, edges={}, travel=0.0)
    states = [replace(state, travel=0.0, force=0.0, measures={}) for state in result.states]
    pictures(replace(result, model=scene, states=states), tmp_path)


def test_odd_parameters_are_left_alone(results, tmp_path):
    result = results["off-axis"]
    odd = {"size": "coarse", "length": None, "width": "160 mm", "angle": [45]}
    scene = replace(result.model, name="$5_{$", parameters=odd)
    pictures(replace(result, model=scene), tmp_path)
    assert plot.off_axis_theory(replace(result, model=scene).record) is None


def test_mesh_across_the_fibres(results, tmp_path):
    scene = qf.picture_frame(size=25)
    blank = replace(scene.sheet.blank, warp=rotation(17)[0], weft=rotation(17)[1])
    model = replace(scene, sheets=[replace(scene.sheet, blank=blank)])
    pictures(replace(results["picture frame"], model=model), tmp_path)


def test_settings_of_matplotlib_are_left_alone(results, tmp_path):
    with matplotlib.rc_context({"font.size": 11}):
        save_pictures(results["off-axis"].record, tmp_path)
        assert matplotlib.rcParams["font.size"] == 11


def test_stopped_run_is_marked(results):
    result = results["off-axis"]
    stopped = replace(result, states=result.states[:2], reason="line search failed")
    end = stopped.states[-1].travel
    for shown, times in ((result, 0), (stopped, 1)):
        for axes in plot.history_figure(shown.record).axes:
            marks = [line for line in axes.get_lines() if line.get_marker() == "X"]
            assert [list(m.get_xdata()) for m in marks].count([end]) == times
    (axes, _) = plot.history_figure(stopped.record).axes
    assert f"stopped at {end:g} mm" in axes.get_legend_handles_labels()[1]
    assert axes.get_xlim()[1] > 10


def test_marks_of_a_coarser_mesh_are_hollow_and_the_step_to_the_end_is_dotted(results):
    run = results["off-axis"].record
    rows = len(run.history["displacement_mm"])
    history = dict(run.history) | {
        "size_mm": np.array([56.0] * (rows - 1) + [40.0]),
        "force_error_N": np.full(rows, 0.1),
    }
    (axes, _) = plot.history_figure(replace(run, history=history)).axes
    hollow = [line for line in axes.lines if line.get_markerfacecolor() == "white"]
    assert max(len(line.get_xdata()) for line in hollow) == rows - 1
    (step,) = (line for line in axes.lines if line.get_linestyle() == ":")
    assert step.get_xdata().tolist() == run.history["displacement_mm"][-2:].tolist()
    words = axes.get_legend_handles_labels()[1]
    assert {"path, 56 mm mesh", "end, 40 mm mesh", "mesh error"} <= set(words)


def test_form_draws_tools_and_the_locking_angle(results):
    run = results["formed"].record
    axes = Figure().subplots()
    handles = plot._draw_tools(axes, run)
    assert [handle.get_label() for handle in handles] == ["punch", "die"]
    fabric = dict(run.parameters["fabric"])
    fabric["shear"] = fabric["shear"] | {"I_lo": float(np.sin(np.radians(0.5)))}
    summary = run.summary | {"parameters": run.parameters | {"fabric": fabric}}
    plot.draw_locking(axes, replace(run, summary=summary, model=None))
    assert any(len(c.get_segments()) for c in axes.collections if hasattr(c, "get_segments"))
    bar = Figure().subplots()
    plot.mark_locking(bar, [run], 60.0)
    assert [text.get_text() for text in bar.texts] == ["locking 55°"]


def test_force_after_a_collapse_is_set_apart(results):
    result = replace(results["off-axis"], collapse={"travel_mm": 10.0})
    (axes, _) = plot.history_figure(result.record).axes
    sound, after = axes.get_lines()[:2]
    assert sound.get_xdata().max() == result.states[-2].travel
    assert (after.get_xdata().min(), after.get_xdata().max()) == (result.states[-2].travel, 10.0)
    assert "not meaningful" in after.get_label()


def test_collapsed_triangles_have_their_own_colour(results):
    result = results["off-axis"]
    x = result.states[-1].x.copy()
    middle = np.linalg.norm(result.model.sheet.blank.nodes, axis=1).argmin()
    x[2 * middle] += 60.0  # past its neighbours
    folded = with_end(result, x)
    assert 0 < plot.collapsed(folded.sheet).sum() <= 8
    for shown in (result, folded):
        colours, _ = painted(shown)
        count = np.isclose(colours, to_rgb(plot.COLLAPSED)).all(1).sum()
        assert count == plot.collapsed(shown.sheet).sum()


def test_doubts_are_painted_by_reason(results):
    """The sheet is taken to be known up to a small angle only; each share stands in the key."""
    result = results["formed"]
    fabric = replace(result.model.sheet.fabric, shear_range=0.5)
    sheet = replace(result.model.sheet, fabric=fabric)
    result = replace(result, model=replace(result.model, sheets=[sheet]))
    doubts = result.sheet.doubts()
    assert set(plot.DOUBTS) == set(doubts)
    figure = plot.doubt_figure(result.record)
    sheet, key = figure.axes
    colours = sheet.collections[0].get_facecolors()
    colours = colours[colours[:, 3] > 0, :3]
    trusted = ~np.any(list(doubts.values()), axis=0)
    for flag, colour in (
        (trusted, plot.TRUSTED),
        (doubts["beyond_identified_range"], plot.DOUBTS["beyond_identified_range"][0]),
    ):
        assert 0 < flag.sum() == np.isclose(colours, to_rgb(colour), atol=1e-6).all(1).sum()
    words = [text.get_text() for text in key.get_legend().get_texts()]
    share = 100 * result.blank.areas @ doubts["beyond_identified_range"] / 310.0**2
    assert f"beyond 0.5°: not tested: {share:.1f} %" in words
    assert "no limit was found" in words
    (advice,) = (text.get_text() for text in key.texts)
    assert "– beyond 0.5°: do not use these angles" in advice
    assert "collapsed" not in advice  # there is none
    assert len(words) == 1 + len(doubts)


def test_off_axis_closed_form(results):
    u, gamma, force = plot.off_axis_theory(results["off-axis"].record)
    assert (u[-1], gamma[-1]) == pytest.approx((10.0, 7.41), abs=5e-3)
    assert force[-1] == pytest.approx(8.07, abs=5e-3)  # reference: exact, 45°, 320 x 160
    assert plot.off_axis_theory(results["picture frame"].record) is None
    assert plot.off_axis_theory(results["cantilever"].record) is None


def test_closed_form_ends_at_its_limit():
    scene = qf.off_axis_tension(angle=30, displacement=5, size=40)
    result = replace(qf.solve(scene), model=replace(scene, travel=60.0))
    u, _, _ = plot.off_axis_theory(result.record)
    assert u[-1] == pytest.approx(21.96, abs=0.05)


def test_locking_force_gets_a_log_scale():
    axes = Figure().subplots()
    smooth = np.linspace(0.0, 20.0, 11)
    assert not plot.scale_force(axes, smooth, smooth)
    locking = np.append(smooth, [300.0, 4000.0])
    assert plot.scale_force(axes, locking, locking)
    assert axes.get_yscale() == "log"


def test_bowl_is_turned_over_not_mirrored(results):
    formed = results["formed"]
    turned = replace(formed.sheet, points=-formed.positions())
    assert plot.is_bowl(formed.record)
    assert not plot.is_bowl(replace(formed.record, sheets=[turned]))
    assert not plot.is_bowl(results["cantilever"].record)
    for turned_over, up in ((False, 1.0), (True, -1.0)):
        view = plot.view_from(turned_over)
        np.testing.assert_allclose(view @ view.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(view) == pytest.approx(1.0)
        assert np.sign(view[1, 2]) == up  # z on the picture
        assert np.sign(view[2, 2]) == up  # seen from slightly above that side


def test_colour_scale_is_round_and_covers_the_sheet(results):
    assert plot.colour_scale([results["formed"].record]).norm.vmax == 10
    assert plot.colour_scale([results["picture frame"].record]).norm.vmax == 60


def test_fibre_lines_are_whole_and_evenly_spaced():
    blank = qf.rectangle(300, 200, 5, orientation=30)
    segments = plot.fibre_lines(blank, 15.0)
    step = np.diff(blank.nodes[segments], axis=1)[:, 0]
    weft = np.abs(step @ blank.weft) > np.abs(step @ blank.warp)
    apart = np.diff(np.unique((blank.nodes[segments[weft]].mean(1) @ blank.warp).round(3)))
    assert apart.min() > 10
    assert apart.max() < 20
    # lines this far apart are as long, together, as the area over their distance
    length = np.linalg.norm(step[weft], axis=1).sum()
    assert length == pytest.approx(blank.areas.sum() / apart.mean(), rel=0.1)


def test_rings_move_with_the_sheet():
    blank = qf.rectangle(100, 80, 10, orientation=20)
    A = np.array([[1.1, 0.3], [0.2, 0.9]])
    points = np.array([[3.0, 4.0], [-21.3, 17.7], [60.0, 0.0]])  # the last one is off the blank
    formed = np.pad(blank.nodes @ A.T + [5.0, 6.0], ((0, 0), (0, 1)))
    carried = plot.formed_places(FormedSheet(formed, blank.triangles, blank.nodes), points)
    np.testing.assert_allclose(carried, points[:2] @ A.T + [5.0, 6.0], atol=1e-9)


def test_grips_lie_outside_the_specimen(results):
    result = results["off-axis"]
    grips = plot.draw_grips(Figure().subplots(), result.sheet, result.gripped)
    left, right = sorted(grips, key=lambda outline: outline[:, 0].min())
    assert left[:, 0].max() == pytest.approx(-160.0)
    assert right[:, 0].min() == pytest.approx(170.0)
    for grip in grips:
        assert np.ptp(grip[:, 1]) == pytest.approx(160.0)


@pytest.mark.parametrize("name", ["formed", "formed, turned fibres"])
def test_draw_in_stands_at_each_edge_of_a_mirrored_blank(results, name):
    axes = Figure().subplots()
    plot.draw_draw_in_arrows(axes, results[name].record)
    numbers = [text for text in axes.texts if text.get_text()]
    places = np.array([text.get_position() for text in numbers])
    assert len(numbers) == 4
    np.testing.assert_allclose(places.sum(0), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.abs(places).min(1), 0.0, atol=1e-9)  # on the user's axes
    assert (np.abs(places).max(1) > 155).all()


def test_far_side_is_hidden(results):
    """The nearer triangle is painted later."""
    result = results["formed"]
    P = result.positions()[result.blank.triangles]
    depth = {tuple(p[:, :2].mean(0).round(6)): p[:, 2].mean() for p in P}
    _, corners = painted(result)
    assert len(corners) == len(P)
    assert np.all(np.diff([depth[tuple(c.mean(0).round(6))] for c in corners]) >= -1e-9)


def test_lines_behind_the_sheet_are_hidden():
    """A sheet folded back over itself, seen from above: the lower layer is not seen."""
    P = np.array([[0.0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [0.5, 0, 1], [0.5, 1, 1]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])
    upper = 1.0 - (1.0 - 0.5) / 1.5
    points = np.array([[0.2, 0.5, 0.0], [1.0, 0.5, 0.0], [1.0, 0.5, upper], [2.0, 0.5, 0.0]])
    assert plot.hidden(P, triangles, points).tolist() == [False, True, False, False]
    axes = Figure().subplots()
    plot.draw_lines(axes, P, triangles, np.stack([points[:2], points[[2, 3]]]), "black", 1.0)
    (lines,) = axes.collections
    # the first has its middle at x = 0.6, below the fold
    np.testing.assert_allclose([path.vertices for path in lines.get_paths()], [points[2:, :2]])


def test_lines_are_joined_and_not_snapped(results):
    axes = Figure().subplots()
    result = results["formed"]
    plot.paint(axes, result.sheet, result.positions(), np.ones((len(result.shear_angle), 4)))
    rim = axes.collections[-1]
    assert len(rim.get_paths()) == 1
    assert len(rim.get_paths()[0].vertices) == len(plot.rim(result.sheet)) + 1
    with matplotlib.rc_context(plot.STYLE):
        assert rim.get_snap() is False


def test_largest_draw_in_of_a_disc(results):
    assert plot.largest_draw_in(results["formed"].sheet) == []
    scene = qf.forming(DISC, size=20, travel=20)
    result = qf.solve(scene, estimate=False)
    ((flat, inward, most, _),) = plot.largest_draw_in(result.sheet)
    np.testing.assert_allclose(inward, -flat / np.linalg.norm(flat), atol=0.05)
    assert np.linalg.norm(flat) == pytest.approx(110.0, rel=1e-3)
    turn = np.degrees(np.arctan2(flat[1], flat[0])) % 90.0
    assert turn == pytest.approx(30.0, abs=10.0)  # along the fibres
    assert most > 2.0 * max(result.draw_in.values())
