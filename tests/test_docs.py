"""The site builds with warnings as errors, loads nothing, and shows what it promises."""

import inspect
import re
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

import quasiform as qf
from tests.chromium import opened, program

ROOT = Path(__file__).parent.parent
pytest.importorskip("mkdocs")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def pages(site):
    """Every page by its path."""
    return {str(p.relative_to(site)): p.read_text(encoding="utf-8") for p in site.rglob("*.html")}


def test_formulas_are_drawn_without_a_script(site):
    found = pages(site)
    assert found["theory/membrane.html"].count("<math") > 20
    for name, page in found.items():
        assert 'class="arithmatex"' not in page, name
        shown = re.sub(r"<(script|style|pre|code)\b.*?</\1>", "", page, flags=re.DOTALL)
        left = re.search(r"\\(frac|gamma|text|\(|\[)", shown)
        assert left is None, (name, left)


def test_nothing_is_loaded_from_elsewhere(site):
    for name, page in pages(site).items():
        sources = re.findall(r'<(?:script|img|iframe)[^>]*\ssrc="([^"]+)"', page)
        sources += re.findall(
            r'<link[^>]*rel="(?:stylesheet|preconnect|preload)"[^>]*href="([^"]+)"', page
        )
        away = [source for source in sources if re.match(r"(https?:)?//", source)]
        assert not away, (name, away)


def test_every_public_name_and_command_is_in_the_reference(site):
    reference = "".join(page for name, page in pages(site).items() if name.startswith("reference"))
    public = [inspect.unwrap(getattr(qf, name)) for name in qf.__all__]
    paths = [f"{thing.__module__}.{thing.__qualname__}" for thing in public]
    missing = [path for path in paths if f'id="{path}"' not in reference]
    assert not missing
    commands = pages(site)["reference/command-line.html"]
    plain = re.sub(r"<[^>]+>", "", commands)
    for command in ("oat", "form", "identify", "compare", "validate", "resume"):
        assert f'id="quasiform-{command}"' in commands
        assert re.search(rf"quasiform {command} (\[OPTIONS\]|FOLDER)", plain)


@pytest.mark.skipif(not program(), reason="needs a Chromium")
def test_names_stay_whole_and_code_is_not_cut_off(site, tmp_path):
    pytest.importorskip("websocket")
    cut = """[...document.querySelectorAll('pre > code')].filter(
        e => e.scrollWidth > e.clientWidth + 1).map(e => e.textContent.slice(0, 60))"""
    broken = """[...document.querySelectorAll('td:first-child code')].filter(
        e => e.getClientRects().length > 1).map(e => e.textContent)"""
    for page in ("tutorial", "reference/scene-files", "reference/files", "how-to/pictures"):
        folder = tmp_path / page.replace("/", "-")
        with opened(site / f"{page}.html", folder, 1300, 900) as tab:
            assert (page, tab.value(cut), tab.value(broken)) == (page, [], [])


def test_one_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    cited = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M)
    assert cited[1] == project["version"] == version("quasiform")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(r"^## (\S+?),", changes, re.M)[1] == project["version"]
