"""The interactive view holds the sheet as it is, and a browser shows it."""

import base64
import gzip
import json
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

import quasiform as qf
from quasiform.checks import number
from quasiform.draw import page as one_page
from quasiform.draw import view
from quasiform.draw.plot import SCALES
from tests.chromium import opened, program

pytest.importorskip("plotly")


@pytest.fixture(scope="module")
def formed():
    return qf.solve(qf.forming("hemisphere", 45, size=25, travel=40), estimate=False)


@pytest.fixture(scope="module")
def pulled():
    return qf.solve(qf.off_axis_tension(30, displacement=50, size=40), estimate=False)


@pytest.fixture(params=["formed", "pulled"])
def result(request):
    return request.getfixturevalue(request.param)


def test_mesh_is_the_sheet(result):
    sheet = view.figure(result.record).data[0]
    assert np.column_stack([sheet.x, sheet.y, sheet.z]) == pytest.approx(
        result.positions(), abs=1e-4
    )
    assert (np.column_stack([sheet.i, sheet.j, sheet.k]) == result.blank.triangles).all()
    assert sheet.intensitymode == "cell"
    assert sheet.intensity == pytest.approx(np.abs(result.shear_angle), abs=1e-4)
    assert sheet.customdata[:, 0] == pytest.approx(result.shear_angle, abs=1e-4)
    middle = result.blank.nodes[result.blank.triangles].mean(1)
    assert sheet.customdata[:, 1:3] == pytest.approx(middle, abs=1e-4)
    assert sheet.customdata[:, 3] == pytest.approx(result.sheet.cell_fields["E11"], abs=1e-6)
    assert sheet.cmin == 0
    assert sheet.cmax in SCALES


def test_an_earlier_state_is_another_sheet(formed):
    first, last = (view.figure(formed.record.upto(state)).data[0] for state in (0, -1))
    assert np.ptp(first.z) < 1e-6 < 30 < np.ptp(last.z)
    assert np.abs(first.intensity).max() < 1e-6


def test_collapsed_triangles_are_marked(pulled, formed):
    collapsed = pulled.sheet.doubts()["collapsed"]
    assert collapsed.any()
    traces = {trace.name: trace for trace in view.figure(pulled.record).data}
    assert len(traces["collapsed"].i) == collapsed.sum()
    assert "collapsed" not in [trace.name for trace in view.figure(formed.record).data]


def test_nothing_lies_outside_the_box(result):
    figure = view.figure(result.record)
    for axis in "xyz":
        low, high = figure.layout.scene[f"{axis}axis"].range
        for trace in figure.data:
            assert low < np.nanmin(trace[axis])
            assert np.nanmax(trace[axis]) < high
    ratio = figure.layout.scene.aspectratio
    widths = [np.ptp(figure.layout.scene[f"{axis}axis"].range) for axis in "xyz"]
    scales = np.array([ratio.x, ratio.y, ratio.z]) / widths
    assert scales == pytest.approx(scales[0])  # a circle stays a circle


def test_bowl_is_seen_as_a_dome(formed, pulled):
    camera = view.figure(formed.record).layout.scene.camera
    assert camera.eye.z < 0 > camera.up.z
    assert view.figure(pulled.record).layout.scene.camera.eye.z > 0


def test_lines_lie_near_the_sheet(formed):
    nodes = formed.positions()
    for trace in view.figure(formed.record).data[1:]:
        points = np.column_stack([trace.x, trace.y, trace.z])
        points = points[~np.isnan(points).any(1)]
        away = np.linalg.norm(points[:, None] - nodes, axis=2).min(1)
        assert 0 < away.max() < 2.0


def test_words(formed, pulled):
    words = view.words(formed.record)
    assert "hemisphere-45" in words
    assert f"{np.abs(formed.shear_angle).max():.1f}°" in words
    assert ", converged; trust limited: a fibre cuts" in words
    assert "converged; trust limited: collapsed" in view.words(pulled.record)


def test_one_page_summary(formed, tmp_path):
    """It leads with what limits the numbers, and has every key number with its error."""
    result = replace(formed, estimate={"force_N": 112.3, "shear_angle_deg": 0.5})
    html, pdf = one_page.save(result.record, tmp_path / "page.html")
    text = html.read_text(encoding="utf-8")
    assert pdf.read_bytes().startswith(b"%PDF")
    assert "<b>Converged</b>: it is a stable equilibrium" in text
    limits = [at for at in map(text.find, result.record.limits) if at > 0]
    assert len(limits) >= 2
    assert limits == sorted(limits)  # the worst first
    assert max(limits) < text.find("Key numbers")
    assert f"{number(result.force)} ± 110 N" in text
    assert f"{np.abs(result.shear_angle).max():.4g}" in text
    assert "tools.holder.mass" in text  # assumed
    assert text.count("data:image/png;base64,") == 3
    assert "http:" not in text
    assert "https:" not in text


@pytest.mark.skipif(program() is None, reason="no Chromium on this machine")
def test_one_page_summary_does_not_scroll_sideways(formed, tmp_path):
    pytest.importorskip("websocket")
    html, _ = one_page.save(formed.record, tmp_path / "page.html")
    with opened(html, tmp_path / "profile", 420, 900) as page:
        assert page.value("document.documentElement.scrollWidth") <= 420
        assert not page.errors


def test_refusals(formed, monkeypatch, tmp_path):
    with pytest.raises(qf.InputError, match="cannot write to"):
        view.save(formed.record, tmp_path / "none" / "view.html")
    monkeypatch.setattr(view, "find_spec", lambda name: None)
    with pytest.raises(qf.InputError, match=r"quasiform\[report\]"):
        view.figure(formed.record)


@pytest.mark.skipif(program() is None, reason="no Chromium on this machine")
def test_browser_tells_the_shear_angle_under_the_pointer(formed, tmp_path):
    pytest.importorskip("websocket")
    file = view.save(formed.record, tmp_path / "view.html")
    with opened(file, tmp_path / "profile", 800, 600) as page:
        page.wait("document.body.dataset.ready")
        page.value(
            "window.seen = []; document.querySelector('#sheet').on('plotly_hover', e => "
            "window.seen.push([e.points[0].pointNumber, e.points[0].customdata[0]]))"
        )
        left, top, width, height = page.box("#sheet")
        page.probe(left + 0.47 * width, top + 0.5 * height, "window.seen.length")
        triangle, gamma = json.loads(page.value("JSON.stringify(window.seen[0])"))
        assert gamma == pytest.approx(formed.shear_angle[triangle], abs=0.01)
        assert not page.errors
        assert page.requests == [file.resolve().as_uri()]


SLIP = {"slip_warp", "slip_weft", "E22_warp_layer", "E11_weft_layer"}  # of a fabric with slip
FOUND = set(view.FIELDS) - SLIP - {"error", "stack_thickness"}


def test_page_holds_every_field_state_and_tool(formed, tmp_path):
    numbers = view._Numbers()
    content = view._content(formed.record, numbers)
    block = gzip.decompress(base64.b64decode(numbers.packed()))

    def read(entry):
        levels = np.frombuffer(block, "<u2", entry["n"], entry["at"])
        return np.where(levels == 65535, np.nan, entry["low"] + entry["step"] * levels)

    assert len(content["states"]) == len(formed.record.sheets)
    last = content["states"][-1]
    assert read(last["x"]).reshape(-1, 3) == pytest.approx(formed.positions(), abs=0.01)
    assert read(last["fields"]["shear"]) == pytest.approx(formed.shear_angle, abs=0.01)
    weight = read(last["fields"]["weight"])
    assert weight @ formed.sheet.areas == pytest.approx(600.0 * formed.blank.areas.sum(), rel=1e-3)
    assert read(last["fields"]["pressure"]).max() > 0
    assert {name for name, *_ in content["fields"]} == FOUND  # the error was not estimated
    punch, die, holder = content["tools"]
    moved = [tool["moved"][-1] for tool in (punch, die, holder)]
    assert moved == [-content["states"][-1]["travel"], 0.0, 0.0]
    assert np.nanmin(read(punch["z"])) == pytest.approx(1.004, abs=0.05)  # on the sheet
    assert np.isnan(read(die["z"])).any()  # its opening
    assert view.save(formed.record, tmp_path / "view.html").stat().st_size < 3e6


@pytest.mark.skipif(program() is None, reason="no Chromium on this machine")
@pytest.mark.parametrize("width", [1400, 420])
def test_browser_shows_every_field_at_every_width(formed, tmp_path, width):
    pytest.importorskip("websocket")
    file = view.save(formed.record, tmp_path / "view.html")
    with opened(file, tmp_path / "profile", width, 900) as page:
        page.wait("document.body.dataset.ready")
        left, top, _, high = (round(x) for x in page.box("#sheet"))
        page.picture(tmp_path / "seen.png")
        seen = imread(tmp_path / "seen.png")[top : top + high, left : left + 6, :3]
        assert seen.min() > 0.8  # no title of an axis is cut
        for name in FOUND:
            page.value(f"field.value = '{name}'; travel.value = 1; show()")
            assert page.value("sheet._fullData[0].intensity.every(v => v !== null)")
        page.value("document.querySelectorAll('.tool').forEach(box => box.checked = true); show()")
        shown = "sheet._fullData.filter(t => t.type === 'surface' && t.visible).length"
        assert page.value(shown) == 3
        assert page.value("document.documentElement.scrollWidth") <= width
        left, _, wide, high = page.box("#sheet")
        assert left >= 0
        assert left + wide <= width
        assert high > 300
        assert not page.errors
