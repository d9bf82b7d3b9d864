"""The report of a validation run: what is in it; it can be read and turned in a browser."""

import csv
import json
import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

import validation
from tests.chromium import opened, program
from validation.agreement import headline
from validation.bands import Case, Reference, Row
from validation.report import about, difference, markdown, reference
from validation.report import page as report_page
from validation.report_text import verdict

SUITE = Path(validation.__file__).parent
HEADER = "name,value,tolerance,unit,standing,source,limitation,only\n"
FORMED = '''
"""A sheet pressed a little."""
import numpy as np
from matplotlib.figure import Figure
import quasiform as qf
from validation.run import Outcome

def run(quick: bool) -> Outcome:
    result = qf.solve(qf.forming("hemisphere", 45, size=25, travel=40), estimate=False)
    figure = Figure(figsize=(4, 2.5))
    figure.subplots().plot([0, 1], [0, 1])
    values = {"good": 10.05, "bad": 3.0, "off, and known": 12.0, "shown": float(quick)}
    return Outcome(
        values | {"not a number": np.nan},
        {"A line <b>": figure},
        {"Hemisphere </script>": result},
        ["It took *one* step."],
    )
'''
FORMED_ROWS = """good,10,1%,N,exact,a closed form
bad,1,0.5,deg,measured,a <b>paper</b>
"off, and known",10,3,N,measured,a test,"rovings slip | here"
not returned,1,max,N,own,nothing
to be measured,,10%,deg,measured,nobody yet
shown,0,report,1,own,no reference
not a number,1,max,1,own,nothing
slow,1,max,1,own,nothing,,full
"""
CASES = {
    "formed": (FORMED, FORMED_ROWS),
    "plain": ("def values():\n    return {'x': 2.0}\n", "x,2,0,1,exact,two\n"),
    "raises": ("def values():\n    raise ValueError('too <odd>')\n", "x,2,0,1,exact,two\n"),
    "dies": ("import os\ndef values():\n    os._exit(7)\n", "x,2,0,1,exact,two\n"),
    "unasked": ("def values():\n    return {'x': 2, 'y': 3}\n", "x,2,0,1,exact,two\n"),
    "no_case": (None, "x,2,0,1,exact,two\n"),
    "no_reference": ("def values():\n    return {'x': 2.0}\n", None),
}


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    """A suite of small cases, laid out as the real one, away from it."""
    folder = tmp_path_factory.mktemp("suite") / "validation"
    folder.mkdir()
    for path in SUITE.iterdir():
        if path.is_file() and path.name != "cases.csv":
            shutil.copy(path, folder)
    listed = ["case,seconds,quick_seconds"]
    listed += [f"{name},1,{'1' if name in ('formed', 'plain') else ''}" for name in CASES]
    (folder / "cases.csv").write_text("\n".join([*listed, "absent,1,", ""]))
    for name, (case, rows) in CASES.items():
        (folder / name).mkdir()
        (folder / name / "README.md").write_text(f"# Title of {name}\n\nText with `code`.\n")
        if case is not None:
            (folder / name / "case.py").write_text(case)
        if rows is not None:
            lines = [row + [""] * (8 - len(row)) for row in csv.reader(rows.splitlines())]
            with (folder / name / "reference.csv").open("w", newline="") as file:
                file.write(HEADER)
                csv.writer(file).writerows(lines)
    return folder


def run(suite, *arguments):
    """Run the command of the suite; the ended process."""
    return subprocess.run(
        [sys.executable, "-P", "-m", "validation.run", *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(suite.parent), str(SUITE.parent)])},
        cwd=suite.parent,
        capture_output=True,
        text=True,
    )


@pytest.fixture(scope="module")
def report(suite):
    """Folder of the report on all cases, and what was said."""
    folder = suite.parent / "report"
    return folder, run(suite, "--out", folder)


@pytest.fixture(scope="module")
def page(report):
    return (report[0] / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def found(report):
    """The cases of report.json by name."""
    content = json.loads((report[0] / "report.json").read_text(encoding="utf-8"))
    return {case["name"]: case for case in content["cases"]} | {"": content}


def test_failures_make_the_exit_status(report):
    ended = report[1]
    assert ended.returncode == 1, ended.stderr
    assert "2 rows failed, 5 values missing, 6 cases with errors" in ended.stdout


def test_rows_by_state(found):
    states = {row["name"]: row["state"] for row in found["formed"]["rows"]}
    assert states == {
        "good": "passed",
        "bad": "failed",
        "off, and known": "known limitation",
        "not returned": "missing",
        "to be measured": "no reference yet",
        "shown": "for information",
        "not a number": "failed",
        "slow": "missing",
    }


def test_no_case_is_lost_by_another(found):
    assert [*found][:-1] == [*CASES, "absent"]
    assert found["plain"]["passed"]
    assert "crashed: ValueError: too <odd>" in found["raises"]["problem"]
    assert "ended with 7" in found["dies"]["problem"]
    assert found["unasked"]["problem"] == "no reference for y"
    assert found["no_case"]["problem"] == "missing: case.py"
    assert found["no_reference"]["problem"] == "missing: reference.csv"
    assert found["absent"]["problem"] == "missing: case.py and reference.csv"
    assert found["dies"]["rows"][0]["state"] == "missing"


def test_report_says_where_and_when(found, page):
    for name in ("quasiform", "Python", "numpy", "scipy", "scikit-fem"):
        assert found[""]["versions"][name] in page
    assert found[""]["machine"]["linear solver"] in page
    assert found[""]["machine"]["processor"] in page
    assert all(case["date"] and case["seconds"] >= 0 for case in found[""]["cases"])


def test_page_stands_alone(page):
    own = page.split("<script>", 1)[0]
    assert "http:" not in own
    assert "https:" not in own  # a colon is in no base64
    assert "src=" not in own.replace('src="data:', "")
    assert 'src="data:image/png;base64,' in own


def test_page_escapes_what_comes_from_outside(page):
    assert "a &lt;b&gt;paper&lt;/b&gt;" in page
    assert "too &lt;odd&gt;" in page
    assert "A line &lt;b&gt;" in page
    assert "A line <b>" not in page
    assert "Hemisphere &lt;/script&gt;" in page
    assert "Hemisphere </script>" not in page


def test_page_shows_readme_notes_and_limitation(page):
    assert "Title of formed" in page
    assert "<code>code</code>" in page
    assert "It took <em>one</em> step." in page
    assert '<span class="reason">rovings slip | here</span>' in page
    assert "python -m validation.stability" in page  # not made yet, and how


def test_sheet_without_plotly_is_a_picture(report):
    picture = report[0] / "report_files" / "formed" / "sheet_1.png"
    case = Case("formed", sheets=(("A sheet", "text", None, picture),))
    text = report_page(about(quick=True, not_run=[]), [case], [])
    assert 'class="formed flat"' in text
    assert "quasiform[report]" in text
    assert "Plotly.newPlot" not in text


def test_skipped_rows_are_counted_and_folded_away():
    known = Reference("slow", 1.0, "max", "N", "own", "none", only="full")
    case = Case("formed", rows=(Row(known, None, quick=True),))
    text = report_page(about(quick=True, not_run=[]), [case], [])
    assert "Rows that only the full suite computes: 1" in text
    assert '<th class="n">skipped</th>' in text
    assert case.passed


@pytest.mark.parametrize(("skipped", "mostly"), [(1, False), (2, False), (3, True)])
@pytest.mark.parametrize("quick", [True, False])
def test_a_case_that_is_mostly_skipped_has_no_tick(skipped, mostly, quick):
    only = "full" if quick else "quick"
    known = Reference("fast", 1.0, "max", "N", "own", "none")
    slow = Reference("slow", 1.0, "max", "N", "own", "none", only=only)
    rows = 2 * (Row(known, 0.5, quick=quick),) + skipped * (Row(slow, None, quick=quick),)
    case, this = Case("formed", rows=rows), about(quick=quick, not_run=[])
    assert case.passed
    words = f"mostly skipped by the {'quick' if quick else 'full'} suite"
    page, text = report_page(this, [case], []), markdown(this, [case], [])
    assert (words in page) == (f"`formed` ({words}) |" in text) == mostly
    assert ('<span class="state">✓</span>' in page) != mostly
    assert ('<span class="mark state">✓</span>' in page) != mostly
    told = (
        f"Every row passed in 1 case; 1 case {words}." if mostly else "Every row passed in 1 case."
    )
    assert verdict([case], []) == told


def test_markdown_and_junit(report):
    text = (report[0] / "report.md").read_text(encoding="utf-8")
    assert "`formed` | bad |" in text
    assert "rovings slip \\| here" in text
    suites = ET.parse(report[0] / "junit.xml").getroot()
    formed = next(s for s in suites if s.get("name") == "formed")
    assert {k: formed.get(k) for k in ("tests", "failures", "errors", "skipped")} == {
        "tests": "8",
        "failures": "4",
        "errors": "0",
        "skipped": "1",
    }
    failed = {test.get("name") for test in formed if test.find("failure") is not None}
    assert failed == {"bad", "not returned", "not a number", "slow"}


def test_quick_suite_and_an_existing_report(suite):
    folder = suite.parent / "quick"
    ended = run(suite, "--quick", "--out", folder, "plain")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "Every row passed in 1 case." in ended.stdout
    assert "formed" in json.loads((folder / "report.json").read_text())["not_run"]
    again = run(suite, "--quick", "--out", folder, "plain")
    assert again.returncode == 2
    assert "holds a result already" in again.stderr


def test_unknown_case_is_wrong_input(suite):
    ended = run(suite, "plane")
    assert ended.returncode == 2
    assert "unknown case 'plane': did you mean 'plain'?" in ended.stderr


def measured(value, reference, tolerance="report", standing="measured", limitation=""):
    known = Reference("force u=10", reference, tolerance, "N", standing, "a test", limitation)
    return Row(known, value)


def test_the_report_leads_with_agreement_with_measurement():
    """Good and bad, in numbers; what the model was given and bounds on errors do not count."""
    rows = [measured(9.5, 10.0), measured(57.0, 10.0), measured(None, 10.0), measured(3.0, None)]
    rows += [measured(10.0, 10.0, standing="input"), measured(0.5, 1.0, "max")]
    rows.append(measured(10.3, 10.0))
    case = Case("formed", rows=tuple(rows))
    assert headline([case]).replace("\u00a0", " ") == (
        "3 numbers were compared with measurements, in 1 case: 2 of them differ by at most 10 %, "
        "half of them by at most 5 %, the worst by a factor of 5.7. "
        "1 more are not published yet."
    )
    later = Case("study_forming", rows=(measured(3.0, None), measured(2.0, None)))
    words = "3 more are not published yet: all those of study_forming."
    assert headline([case, later]).endswith(words)
    text = report_page(about(quick=True, not_run=[]), [case], [])
    first, _ = text.split('<section id="verdict">')
    assert "<b>5.7 ×</b>" in first
    assert "force at 10 mm" in first
    assert "every row passed" not in first.lower()
    assert headline([]) == "No computed number could be compared with a measurement."


def test_reference_and_difference_are_never_empty():
    rows = [measured(9.5, 10.0), measured(9.5, 10.0, "max"), measured(9.5, None), measured(1, 0)]
    rows += [measured(None, 10.0), measured(-1, 10.0), measured(0, 10.0, "min"), measured(10, 10.0)]
    for row in rows:
        assert reference(row)
        assert difference(row)
    assert [difference(row) for row in rows[:3]] == ["−5 %", "−5 %", "no reference"]
    assert difference(measured(31.0, 10.0)) == "3.1 ×"
    assert reference(rows[1]) == "at most 10 N"


def test_a_case_that_needs_a_limitation_has_no_tick():
    good = measured(10.0, 10.0, "1%")
    known = measured(12.0, 10.0, "50%", limitation="rovings slip")
    assert Case("formed", rows=(good,)).state == "passed"
    assert Case("formed", rows=(good, known)).state == "known limitation"
    assert Case("formed", rows=(good, known)).passed


def test_the_report_is_written_again_from_its_numbers(suite):
    folder = suite.parent / "again"
    assert run(suite, "--quick", "--out", folder, "plain").returncode == 0
    before = json.loads((folder / "report.json").read_text())
    (folder / "report.html").unlink()
    ended = run(suite, "--draw", folder)
    assert ended.returncode == 0, ended.stderr
    assert (folder / "report.html").exists()
    assert json.loads((folder / "report.json").read_text()) == before
    assert run(suite, "--draw", suite).returncode == 2


@pytest.mark.skipif(program() is None, reason="no Chromium on this machine")
@pytest.mark.parametrize("width", [1400, 420])
def test_the_report_does_not_scroll_sideways(report, tmp_path, width):
    pytest.importorskip("websocket")
    with opened(report[0] / "report.html", tmp_path, width, 900) as page:
        assert page.value("document.documentElement.scrollWidth") <= width
        assert not page.value(
            "[...document.querySelectorAll('main *')].filter(e => "
            "e.getBoundingClientRect().right > innerWidth + 1).length"
        )


@pytest.mark.skipif(program() is None, reason="no Chromium on this machine")
def test_sheet_turns_and_tells_its_shear_angle(report, tmp_path):
    pytest.importorskip("websocket")
    pytest.importorskip("plotly")
    with opened(report[0] / "report.html", tmp_path) as page:
        assert page.value("document.querySelectorAll('.sheet canvas').length") == 0  # far below
        page.value(
            "document.querySelector('.sheet')"
            ".scrollIntoView({block: 'center', behavior: 'instant'})"
        )
        page.wait("document.querySelector('.sheet canvas')")
        assert page.value("!!document.querySelector('.sheet canvas').getContext('webgl')")
        left, top, width, height = page.box(".sheet")
        middle = (left + 0.47 * width, top + 0.5 * height)
        page.probe(*middle, "document.querySelector('.probe').textContent.startsWith('γ = ')")
        told = page.value("document.querySelector('.probe').textContent")
        gamma = page.value(
            "Array.from(document.querySelector('.sheet')._fullData[0].customdata, row => row[0])"
        )
        assert len(gamma) == 324
        assert any(f"γ = {angle:.1f}°" in told for angle in gamma)
        eye = "JSON.stringify(document.querySelector('.sheet').layout.scene.camera.eye)"
        before = page.value(eye)
        page.drag(middle, (middle[0] + 120, middle[1] + 40))
        page.wait(f"{eye} != {json.dumps(before)}")
        page.value("window.scrollTo({top: 0, behavior: 'instant'})")
        page.wait("!document.querySelector('.sheet canvas')")  # gives its context back
        assert not page.errors
        assert all(url.startswith(("file:", "data:", "blob:")) for url in page.requests)
