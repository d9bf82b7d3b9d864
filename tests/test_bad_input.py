"""Files from strangers: a result with a certificate, or one clear line; never more than that.

Valid files are changed at random, in their values and in their bytes, and given to the command
line. Every case

- ends within its time with status 0 or 3 and a complete result, or with 2 and one line of error;
- writes finite numbers only, and writes, moves and deletes nothing outside its folder;
- starts no program and opens no connection.

A part of the cases runs by default, all with `--hypothesis-profile=thorough` (`conftest.py`).
"""

import csv
import faulthandler
import json
import os
import re
import signal
import sys
import tempfile
import tomllib
from collections import Counter
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from copy import deepcopy
from dataclasses import replace
from io import StringIO
from itertools import count
from pathlib import Path

import jsonschema
import matplotlib
import meshio
import numpy as np
import pytest
from hypothesis import Phase, currently_in_test_context, given, note, settings
from hypothesis import strategies as st

import quasiform as qf
from quasiform.checks import InputError
from quasiform.console.cli import main
from quasiform.fabric import Fabric
from quasiform.result.files import FILES
from quasiform.scenes.scene_file import FOLDER, json_schema, load, scene_toml
from quasiform.scenes.scene_parts import SYMMETRIES

SECONDS = 20.0  # of a case on the processor, and four times that on the clock
HARD = 200.0  # of a case that does not come back from compiled code
PROGRESS = ("travel ", "the end on a mesh of ", "its end was not found", "error of the mesh: ")


def cases(share=1.0):
    """Number of cases: a share of the profile's."""
    number = max(1, round(share * settings.default.max_examples))
    return settings(max_examples=number, phases=[Phase.explicit, Phase.generate])


# One run, watched


class TooLongError(BaseException):
    """A case that hangs; no `except Exception` takes it."""


matplotlib.get_configdir(), matplotlib.get_cachedir()  # are made before anything is watched


@contextmanager
def limited():
    """End what takes too long, even within a library; if need be with all threads shown."""

    def end(*_):
        raise TooLongError(f"more than {SECONDS:g} s")

    before = {number: signal.signal(number, end) for number in (signal.SIGPROF, signal.SIGALRM)}
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    signal.setitimer(signal.ITIMER_REAL, 4 * SECONDS)
    faulthandler.dump_traceback_later(HARD, exit=True, file=sys.__stderr__)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)


CHANGES = {"os.mkdir": 1, "os.remove": 1, "os.rmdir": 1, "os.rename": 2, "os.link": 2}
CHANGES |= {"os.symlink": 2, "os.truncate": 1, "os.chmod": 1, "shutil.rmtree": 1}
FOREIGN = ("subprocess.", "os.exec", "os.posix_spawn", "os.system", "os.fork", "socket.connect")
FOREIGN += ("pickle.find_class", "webbrowser.", "urllib.", "ftplib.")
WATCHED = ("open", *CHANGES, *FOREIGN)
seen: list[tuple[str, str]] | None = None  # what a watched run changes or starts


def _by_numba():
    """Whether numba compiles loops, or reads or fills its cache of them."""
    frame = sys._getframe(1)
    while frame and not frame.f_globals.get("__name__", "").startswith("numba."):
        frame = frame.f_back
    return frame is not None


def _audit(event, arguments):
    if seen is None or (event.startswith(WATCHED) and _by_numba()):
        return
    if event == "open" and not isinstance(arguments[0], int):
        path, mode, flags = arguments
        writes = set(mode or "") & set("wax+") if mode else flags & (os.O_WRONLY | os.O_RDWR)
        if writes:
            seen.append((event, os.fsdecode(path)))
    elif event in CHANGES:
        relative = any(isinstance(fd, int) and fd > 0 for fd in arguments[CHANGES[event] :])
        if not relative or event == "os.mkdir":  # else within a folder that was seen already
            seen.extend((event, os.fsdecode(p)) for p in arguments[: CHANGES[event]])
    elif event.startswith(FOREIGN):
        seen.append((event, repr(arguments)))


sys.addaudithook(_audit)
OUTCOMES: Counter[tuple[str, str]] = Counter()


@pytest.fixture(scope="module", autouse=True)
def told():
    """Report the outcomes at the end (pytest -s); loops are compiled before time is limited."""
    for file in ("hemisphere", replace(load("hemisphere"), mesh="free")):
        qf.solve(qf.forming(file, size=30, travel=1), estimate=False)
    qf.solve(qf.off_axis_tension(size=80, displacement=1), estimate=False)
    yield
    for (test, outcome), number in sorted(OUTCOMES.items()):
        print(f"{test:36}{outcome:44}{number:6}")


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return a function that makes a fresh working directory, alone in a folder, and enters it."""
    number = count(1)

    def fresh():
        folder = tmp_path / f"case{next(number)}" / "here"
        folder.mkdir(parents=True)
        monkeypatch.chdir(folder)
        return folder

    return fresh


def listing(root):
    """What lies in a folder, with times of change, links not followed."""
    return {
        str(path.relative_to(root)): (path.lstat().st_mtime_ns, path.lstat().st_size)
        for path in root.rglob("*")
        if not path.is_dir() or path.is_symlink()
    }


def run(test, folder, *words, out="out"):
    """Run the command line in a folder and check what every run owes; its exit status.

    `out` is the folder of the result; None for the one that the program names itself.
    """
    global seen
    words = [str(word) for word in words] + ([] if out is None else ["--out", out])
    if currently_in_test_context():
        note(f"quasiform {' '.join(words)}")
    root = folder.parent
    before, here = listing(root), set(os.listdir(folder))
    said, told = StringIO(), StringIO()
    seen = []
    try:
        with limited(), redirect_stdout(said), redirect_stderr(told):
            status = main(words)
    finally:
        events, seen = seen, None
    lines = told.getvalue().splitlines()
    if out is None:
        new = sorted(set(os.listdir(folder)) - here)
        assert len(new) <= 1
        target = folder / new[0] if new else folder / "nothing"
        assert not target.is_symlink()
    else:
        target = folder / out
    for event, what in events:
        assert event in ("open", *CHANGES), (event, what)
        assert allowed(folder, target, what), (event, what)
    after = listing(root)
    within = str(target.relative_to(root)) + os.sep
    outside = {p for p in before | after if before.get(p) != after.get(p)} - {
        p for p in after if p.startswith(within)
    }
    assert not outside
    if status == 2:
        assert not target.exists()
        assert re.fullmatch(r"quasiform: \S.*", lines[-1]), lines
        assert all(line.startswith(PROGRESS) for line in lines[:-1]), lines
        assert lines[-1].isprintable()
        assert len(lines[-1]) < 1000
        reason = re.sub(r"\S*[/\\]\S+|'.*?'|\S*\d\S*", "*", lines[-1][11:])
        OUTCOMES[test, f"2 {' '.join(reason.split()[:6])}"] += 1
    else:
        assert status in (0, 3)
        assert all(line.startswith(PROGRESS) for line in lines), lines
        certified = checked(target) if target.exists() else "(nothing written)"
        OUTCOMES[test, f"{status} {certified}"[:44]] += 1
    return status


def allowed(folder, target, what):
    """Whether a run may change this: its folder, and what `tempfile` makes."""
    path = Path(os.path.normpath(folder / what))
    temporary = Path(tempfile.gettempdir())
    mine = path == target or target in path.parents or str(path) == os.devnull
    parts = path.relative_to(temporary).parts if temporary in path.parents else ("",)
    return mine or bool(re.fullmatch(r"tmp\w{8}", parts[0]))


def checked(folder):
    """Check the files of a result; its certificate in a word."""
    names = {path.name for path in folder.iterdir()}
    assert not [name for name in names if name.startswith(".")]
    summary = json.loads((folder / "summary.json").read_text("utf-8"), parse_constant=pytest.fail)
    for path in folder.glob("*.csv"):
        for row in csv.reader(path.read_text("utf-8").splitlines()):
            for cell in row:
                assert not re.fullmatch(r"[+-]?(nan|inf(inity)?)", cell.lower()), (path.name, row)
    if "material.toml" in names:
        Fabric.load(folder / "material.toml")
        return "identified"
    for path in folder.glob("*.vtu"):
        mesh = meshio.read(path)
        for values in (
            mesh.points,
            *mesh.point_data.values(),
            *(part for parts in mesh.cell_data.values() for part in parts),
        ):
            assert np.isfinite(values).all(), path.name
    assert {"summary.json", "history.csv", "outline.csv", "result.vtu", "result.pvd"} <= names
    assert summary["status"] in ("completed", "stopped")
    assert (summary["status"] == "stopped") == bool(summary["reason"])
    certified = summary["certified"]
    assert isinstance(certified, bool)
    assert certified or summary["certificate"]["reasons"]
    return "certified" if certified else "not certified"


# TOML as text


def toml(table, head=()):
    """A table as TOML."""
    lines, tables = [], []
    for key, value in table.items():
        if isinstance(value, dict) and value and not head:
            tables += [f"[{text(key)}]", toml(value, (key,))]
        else:
            lines.append(f"{text(key)} = {literal(value)}")
    return "\n".join([*lines, *tables])


def literal(value):
    if isinstance(value, dict):
        return "{" + ", ".join(f"{text(k)} = {literal(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(literal, value)) + "]"
    if isinstance(value, str):
        return text(value)
    return str(value).lower() if isinstance(value, bool) else str(value)


def text(value):
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


# Changes

HOSTILE = (
    *("../../x", "/etc/passwd", "..", ".", "", "~", "a\0b", "x\ny", "\x1b[2J", "$(touch x)"),
    *("`touch x`", "__import__('os').system('touch x')", "%n%s", "é ü 漢", "a" * 400, "CON"),
    *("\u202e\u2028", "../../../tmp/x.stl", "file:///etc/passwd", "http://localhost/x.toml"),
    *("-rf", "--force", ".toml", "\\\\host\\x", "{0.__class__}", "/dev/zero", "/dev/stdin"),
)
NUMBERS = (
    *(0, 1, -1, 2, 3.7, 1e-300, 1e-30, 1e-9, 1e-3, 0.1, 15.0, 90.0, 1e3, 1e6, 1e9, 1e30, 1e99),
    *(1e200, 1.7e308, -0.0, -5.0, -1e9, float("nan"), float("inf"), -float("inf"), 10**25, 2**63),
)
LETTERS = st.characters(exclude_categories=("Cs",))
values = st.recursive(
    st.one_of(
        st.sampled_from(NUMBERS),
        st.floats(),
        st.integers(),
        st.booleans(),
        st.sampled_from(HOSTILE),
        st.text(LETTERS, max_size=8),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.sampled_from(["value", "unit", "x", "é.", ""]), inner, max_size=3),
    ),
    max_leaves=6,
)


def places(table, at=()):
    """All ways into a tree of tables and lists, with what is there."""
    found = [(at, table)] if at else []
    if isinstance(table, dict | list):
        keys = table if isinstance(table, dict) else range(len(table))
        for key in keys:
            found += places(table[key], (*at, key))
    return found


@st.composite
def changed(draw, bases, most=3):
    """One of the tables, with one to three changes."""
    table = deepcopy(draw(st.sampled_from(bases)))
    for _ in range(draw(st.integers(1, most))):
        act = draw(st.sampled_from(["near", "near", "replace", "replace", "drop", "more", "wrap"]))
        numbers = [way for way, value in places(table) if type(value) in (int, float)]
        ways = (act == "near" and numbers) or [way for way, _ in places(table)]
        if not ways:
            break
        *way, key = draw(st.sampled_from(ways))
        parent = table
        for step in way:
            parent = parent[step]
        if act == "near" and numbers:
            parent[key] *= draw(st.floats(0.2, 5.0))
        elif act in ("near", "replace"):
            parent[key] = draw(values)
        elif act == "drop":
            del parent[key]
        elif act == "wrap":
            parent[key] = draw(st.sampled_from([[parent[key]], {"value": parent[key]}]))
        elif isinstance(parent, list):
            parent.insert(key, draw(values))
        else:
            name = draw(st.sampled_from([*HOSTILE, "friction", "file", "radius", "nmae"]))
            parent[name] = draw(values)
    return table


@st.composite
def mangled(draw, content):
    """Bytes with damage as files take it, or none."""
    act = draw(
        st.sampled_from(
            [
                *("none", "bom", "crlf", "cr", "utf-16", "latin-1", "empty", "cut", "cut out"),
                *("insert", "flip", "twice", "comma", "semicolons", "nul", "tabs", "quotes"),
            ]
        )
    )
    n = len(content)
    i, j = sorted(draw(st.tuples(st.integers(0, n), st.integers(0, n))))
    plain = content.decode("utf-8", "replace")
    if act in ("bom", "utf-16", "latin-1"):
        return plain.encode({"bom": "utf-8-sig"}.get(act, act), "replace")
    swaps = {
        "crlf": (b"\n", b"\r\n"),
        "cr": (b"\n", b"\r"),
        "semicolons": (b",", b";"),
        "nul": (b" ", b"\0"),
        "tabs": (b",", b"\t"),
        "quotes": (b",", b'","'),
    }
    if act in swaps:
        return content.replace(*swaps[act])
    if act == "comma":
        return re.sub(rb"(\d)\.(\d)", rb"\1,\2", content.replace(b",", b";"))
    if act == "flip" and n:
        k = min(i, n - 1)
        return content[:k] + bytes([content[k] ^ draw(st.integers(1, 255))]) + content[k + 1 :]
    if act == "insert":
        return content[:i] + draw(st.binary(max_size=12)) + content[i:]
    if act == "twice":
        return content[:j] + content[i:]
    ends = {"empty": b"", "cut": content[:i], "cut out": content[:i] + content[j:]}
    return ends.get(act, content)


# Scenes

ROUND = """
travel = 10.0
[blank]
shape = "rectangle"
length = 160.0
width = 160.0
[tools.punch]
shape = "round punch"
radius = 30.0
[tools.die]
shape = "round opening"
radius = 40.0
fillet = 10.0
[tools.holder]
shape = "round opening"
radius = 40.0
fillet = 10.0
mass = 2.0
[outputs]
pictures = false
increments = false
"""
RICH = """
name = "all there is"
travel = { value = 8.0, unit = "mm", standing = "assumed" }
symmetry = "none"
gravity = true
law = "best-fit"
[increments]
largest = 4.0
rows = 2.0
[blank]
shape = "polygon"
points = [[-90, -80], [90, -80], [90, 80], [0, 90], [-90, 80]]
centre = [0, 0]
orientation = 30.0
size = 15.0
mesh = "fibre"
holes = [{ shape = "disc", radius = 12.0, centre = [55, 50] }]
[tools.punch]
shape = "tetrahedron punch"
base_edge = 90.0
height = 60.0
edge_radius = 10.0
azimuth = 90.0
friction = 0.2
[tools.die]
shape = "triangle opening"
edge = 120.0
azimuth = 90.0
corner_radius = 12.0
fillet = 8.0
place = [0.0, 0.0]
[tools.holder]
shape = "triangle opening"
edge = 120.0
azimuth = 90.0
corner_radius = 12.0
fillet = 8.0
force = 20.0
tilt = false
[areas]
green = { centre = [30, 30], radius = 20 }
[outputs]
pictures = false
increments = true
"""
BASES = [tomllib.loads(scene) for scene in (ROUND, RICH)]
BUILT_IN = [tomllib.loads(path.read_text("utf-8")) for path in sorted(FOLDER.glob("*.toml"))]
HELD = {"supports": [{"side": "-x", "fix": "xyz"}], "outputs": {"pictures": False}}
HELD["grippers"] = [{"side": "+x", "tension": 5.0, "stiffness": 0.1}]
HELD_PLIES = HELD | {"grippers": [HELD["grippers"][0] | {"plies": [2]}], "plies": [{}, {}]}
NOTCH = {"shape": "disc", "radius": 12.0, "centre": [80.0, 0.0]}
NOTCHED = {"blank": BASES[0]["blank"] | {"holes": [NOTCH]}, "outputs": {"pictures": False}}
NOTCHED["grippers"] = [{"box": [60.0, -80.0, 80.0, 80.0], "tension": 5.0}]
ROWS = {"force": [[0.0, 10.0], [5.0, 50.0], [8.0, 5.0]]}
NOTCHED["tools"] = BASES[0]["tools"] | {"holder": BASES[0]["tools"]["holder"] | ROWS}
PRESSED = {"pressure": [[0.0, 0.001], [5.0, 0.002]], "outputs": {"pictures": False}}
PRESSED["tools"] = {name: BASES[0]["tools"][name] for name in ("die", "holder")}
PRESSED["tools"]["lid"] = {
    "role": "punch",
    "shape": "ball",
    "radius": 10.0,
    "z": 20.0,
    "stroke": [[0, 0]],
}
PRESSED["tools"]["lid"]["stroke"] += [[9.0, 5.0], [10.0, 0.0]]
ABOVE = {"modulus": 1.0, "thickness": 0.8, "poisson": 0.45, "prestretch": 1.1, "friction": 0.4}
PRESSED["diaphragm"] = ABOVE | {"blank": {"shape": "disc", "radius": 110.0}}
CUT = {"darts": {"points": [[40.0, 0.0], [90.0, -9.0], [90.0, 9.0]]}, "slits": []}
CUT["slits"] = [{"points": [[0.0, 40.0], [9.0, 85.0]], "centre": [0.0, 0.0]}]
SLIT = {"blank": BASES[0]["blank"] | CUT, "plies": [{}, {"blank": BASES[0]["blank"] | CUT}]}
SCENES = [*BASES, *BUILT_IN]
SCENES += [BASES[0] | more for more in (HELD, HELD_PLIES, NOTCHED, PRESSED, SLIT)]
JSON_SCHEMA = jsonschema.Draft202012Validator(json_schema())


@cases(2.0)
@given(scene=changed(SCENES))
def test_scenes_with_changed_values_are_built_or_refused(place, scene):
    folder = place()
    (folder / "scene.toml").write_text(toml(scene), "utf-8")
    run("scene values", folder, "form", "scene.toml", "--size", "20", "--dry-run")


PLIES = """
law = "locking"
[[plies]]
orientation = 0.0
[[plies]]
orientation = 45.0
friction = { value = 0.25, standing = "measured" }
fabric = { thickness = 1.2 }
[[plies]]
law = "best-fit"
blank = { shape = "disc", radius = 70.0, holes = [{ shape = "disc", radius = 9.0 }] }
offset = [5.0, -3.0]
[[plies]]
law = "best-fit"
blank = { shape = "disc", radius = 70.0, holes = [{ shape = "disc", radius = 9.0 }] }
offset = [5.0, -3.0]
joined = true
"""
STACKS = [BASES[0] | tomllib.loads(PLIES), BASES[0] | {"plies": [{}, {"joined": True}]}]
STACKS.append(BASES[0] | HELD_PLIES)


@st.composite
def changed_plies(draw):
    """A scene with plies, with one to three changes in them; at times one more of them."""
    scene = deepcopy(draw(st.sampled_from(STACKS)))
    plies = draw(changed([{"plies": scene.pop("plies")}]))
    if isinstance(plies.get("plies"), list) and draw(st.booleans()):
        plies["plies"] += plies["plies"][-1:] * draw(st.sampled_from([1, 1, 2, 12]))
    return scene | plies


@cases(0.25)
@given(scene=changed_plies())
def test_plies_with_changed_values_are_built_or_refused(place, scene):
    folder = place()
    (folder / "scene.toml").write_text(toml(scene), "utf-8")
    run("plies", folder, "form", "scene.toml", "--size", "16", "--dry-run")


@cases(1.0)
@given(content=st.sampled_from(SCENES).flatmap(lambda scene: mangled(toml(scene).encode())))
def test_scenes_with_damaged_bytes_are_built_or_refused(place, content):
    folder = place()
    (folder / "scene.toml").write_bytes(content)
    run("scene bytes", folder, "form", "scene.toml", "--size", "20", "--dry-run")


@cases(1.0)
@given(scene=changed(SCENES))
def test_scenes_that_are_read_are_written_back(place, scene):
    place()
    fits = JSON_SCHEMA.is_valid(tomllib.loads(toml(scene)))
    Path("scene.toml").write_text(toml(scene), "utf-8")
    try:
        file = load("scene.toml")
    except InputError:
        return
    assert fits  # an editor marks nothing that is read
    Path("again.toml").write_text(scene_toml(file), "utf-8")
    assert scene_toml(load("again.toml")) == scene_toml(file)


def extreme(low, high):
    """Numbers spread evenly over the orders of magnitude."""
    return st.floats(np.log10(low), np.log10(high)).map(lambda e: float(f"{10**e:.4g}"))


@cases(0.15)
@given(
    travel=extreme(0.01, 3.0),
    mass=extreme(1e-3, 1e4),
    fillet=extreme(0.5, 20.0),
    friction=extreme(1e-6, 10.0) | st.just(0.0),
    orientation=st.sampled_from([0.0, 30.0, 45.0, -1e-9, 1e6]),
    symmetry=st.sampled_from(SYMMETRIES),
    gravity=st.booleans(),
    rows=extreme(0.1, 100.0),
    law=st.sampled_from(["locking", "best-fit"]),
)
def test_extreme_scenes_end_in_a_result(place, travel, mass, fillet, friction, rows, **more):
    scene = deepcopy(BASES[0])
    scene["blank"]["orientation"] = more.pop("orientation")
    scene |= {"travel": travel, "increments": {"rows": rows}, **more}
    for tool in scene["tools"].values():
        tool["friction"] = friction
    scene["tools"]["holder"]["mass"] = mass
    scene["tools"]["die"]["fillet"] = scene["tools"]["holder"]["fillet"] = fillet
    folder = place()
    (folder / "scene.toml").write_text(toml(scene), "utf-8")
    run("extreme scenes", folder, "form", "scene.toml", "--size", "20")


# Materials

with tempfile.TemporaryDirectory() as kept:
    Fabric.preset("locking").save(f"{kept}/law.toml")
    LOCKING = tomllib.loads(Path(kept, "law.toml").read_text("utf-8"))
TABLE = {"shear": {"I6": [0.0, 0.05, 0.2, 0.5, 0.9], "S12": [0.0, 0.004, 0.01, 0.03, 0.3]}}
LAWS = [LOCKING, LOCKING | TABLE, LOCKING | {"provenance": {"by": "x", "n": 3}}]
STRIP = ("--length", "40", "--width", "16", "--size", "8", "--displacement")


@cases(2.0)
@given(
    law=changed(LAWS).map(toml).map(str.encode)
    | changed(LAWS).flatmap(lambda law: mangled(toml(law).encode()))
)
def test_materials_are_read_or_refused(place, law):
    folder = place()
    (folder / "law.toml").write_bytes(law)
    run("materials", folder, "oat", "--law", "law.toml", *STRIP, "1", "--dry-run")


@cases(0.3)
@given(
    shear=st.fixed_dictionaries(
        {
            "C_ini": extreme(1e-6, 1e6),
            "S_ini": extreme(1e-9, 1e3),
            "C_mid": extreme(1e-6, 1e3) | st.just(0.0),
            "dS_mid": extreme(1e-9, 1e3),
            "C_lo": extreme(1e-6, 1e8) | st.just(0.0),
            "I_lo": extreme(1e-3, 2.0),
        }
    ),
    fibres=extreme(1e-3, 1e8),
    thickness=extreme(1e-4, 1e3),
    displacement=extreme(0.01, 30.0),
)
def test_extreme_materials_end_in_a_result(place, monkeypatch, shear, fibres, **more):
    monkeypatch.setattr("quasiform.draw.plot.save_pictures", lambda *_: None)
    law = LOCKING | {"shear": shear, "warp": {"C_ini": fibres}, "weft": {"C_ini": fibres}}
    law["thickness"] = more["thickness"]
    folder = place()
    (folder / "law.toml").write_text(toml(law), "utf-8")
    run("extreme materials", folder, "oat", "--law", "law.toml", *STRIP, more["displacement"])


# Test data


def record(separator=",", decimal=".", rows=30, force=1.0, stretch=1.0, noise=0.0):
    """An off-axis tension test as a table."""
    u = np.linspace(0.0, 60.0, rows)
    F = force * (5 * (1 - np.exp(-u / 3)) + 0.1 * u + 5e-4 * u**3)
    F *= 1 + noise * np.sin(37.0 * np.arange(rows))
    lines = [f"displacement [mm]{separator}force [N]"]
    lines += [
        f"{a:.4f}{separator}{b:.6g}".replace(".", decimal)
        for a, b in zip(stretch * u, F, strict=True)
    ]
    return "\n".join(lines).encode()


RECORDS = [record(), record(";", ","), record("\t"), record(" ", rows=9), record(noise=0.1)]
CELLS = ("nan", "inf", "1e400", "-", "", "0x10", "1_000", "1,5", "١٢", "9" * 400, "=cmd|' /C'!A0")


@st.composite
def tables(draw):
    """A record with a few cells replaced."""
    lines = draw(st.sampled_from(RECORDS)).decode().split("\n")
    for _ in range(draw(st.integers(1, 4))):
        k = draw(st.integers(0, len(lines) - 1))
        cells = re.split(r"([,;\t ])", lines[k])
        at = draw(st.integers(0, len(cells) - 1))
        cells[at] = draw(st.sampled_from(CELLS) | values.map(str))
        lines[k] = "".join(cells)
    return "\n".join(lines).encode("utf-8", "replace")


KINDS = st.sampled_from([(), ("--kind", "picture-frame"), ("--angle", "30", "--width", "80")])


@cases(2.5)
@given(
    content=st.sampled_from(RECORDS).flatmap(mangled) | tables() | st.binary(max_size=200),
    kind=KINDS,
)
def test_records_are_read_or_refused(place, content, kind):
    folder = place()
    (folder / "test.csv").write_bytes(content)
    run("records", folder, "identify", "test.csv", *kind, "--dry-run")


@cases(0.2)
@given(
    content=st.builds(
        record,
        rows=st.integers(8, 60),
        force=extreme(1e-6, 1e12),
        stretch=extreme(0.05, 2.0),
        noise=st.sampled_from([0.0, 0.01, 0.5, 2.0]),
    ),
    method=st.sampled_from(["fit", "table", "as-printed"]),
    keep=st.sampled_from([(), ("--keep", "C_lo=1000,I_lo=0.819"), ("--keep", "C_mid=0")]),
    thickness=extreme(1e-3, 1e3),
)
def test_extreme_records_end_in_a_material(place, content, method, keep, thickness):
    folder = place()
    (folder / "test.csv").write_bytes(content)
    words = ("--method", method, *keep, "--thickness", thickness)
    run("extreme records", folder, "identify", "test.csv", *words)


CAMPAIGN = """
name = "a fabric"
method = "fit"
keep = { C_lo = 1000.0, I_lo = 0.819 }
standing = "measured"
[fabric]
thickness = 1.0
areal_weight = 600.0
[[tests]]
kind = "off-axis"
files = ["a.csv", "a.csv"]
angle = 45.0
from = 1.0
units = { force = "N" }
[[tests]]
kind = "cantilever"
family = "warp"
overhang = [166.0, 163.0]
angle = 41.5
[[tests]]
kind = "cantilever"
family = "weft"
length = 150.0
tip = [[120.0, 70.0], [121.0, 69.0]]
"""
PROFILE = {"tests": [{"kind": "cantilever", "family": "warp", "profile": "p.csv", "length": 150.0}]}
CAMPAIGNS = [tomllib.loads(CAMPAIGN), PROFILE]


@cases(1.5)
@given(
    table=changed(CAMPAIGNS).map(toml).map(str.encode)
    | changed(CAMPAIGNS).flatmap(lambda table: mangled(toml(table).encode()))
)
def test_campaigns_are_read_or_refused(place, table):
    folder = place()
    (folder / "a.csv").write_bytes(RECORDS[0])
    (folder / "p.csv").write_text("x,drop\n30,3\n60,12\n90,28\n110,46\n")
    (folder / "tests.toml").write_bytes(table)
    run("campaigns", folder, "identify", "tests.toml", "--dry-run")


# Surfaces and outlines


def ball(radius=30.0, n=6, m=10):
    """Vertices and triangles of a ball that stands on the origin."""
    theta, phi = np.linspace(0.0, np.pi, n + 1)[1:-1, None], 2 * np.pi * np.arange(m) / m
    ring = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], -1
    )
    points = radius * np.vstack([[0, 0, 1], ring.reshape(-1, 3), [0, 0, -1]])
    points[:, 2] += radius
    j, k = np.arange(m), (np.arange(m) + 1) % m
    faces = [np.c_[0 * j, 1 + j, 1 + k]]
    for a in range(1, 1 + (n - 2) * m, m):
        faces += [np.c_[a + j, a + m + j, a + k], np.c_[a + k, a + m + j, a + m + k]]
    a = 1 + (n - 2) * m
    return points, np.vstack([*faces, np.c_[0 * j + a + m, a + k, a + j]])


def written(points, triangles, kinds):
    """The bytes of a mesh in several forms of file, by suffix."""
    with tempfile.TemporaryDirectory() as folder:
        found = []
        for suffix, more in kinds:
            path = Path(folder, f"x.{suffix}")
            meshio.write(path, meshio.Mesh(points, [("triangle", triangles)]), **more)
            found.append((suffix, path.read_bytes()))
    return found


FORMS = [(s, {"binary": b}) for s in ("stl", "ply", "vtk", "vtu", "msh") for b in (True, False)]
FORMS = [(s, m if s != "msh" else {**m, "file_format": "gmsh"}) for s, m in FORMS]
BALLS = written(*ball(), [*FORMS, ("obj", {})])
SQUARE = np.array([[x, y, 0.0] for y in (-80, -25, 25, 80) for x in (-80, -25, 25, 80)])
CORNERS = np.array([[0, 1, 5], [0, 5, 4]])
QUILT = np.vstack([CORNERS + i + 4 * j for j in range(3) for i in range(3)])
SHEETS = written(SQUARE, QUILT, [*FORMS, ("obj", {})])
SHEETS += [("csv", b"x,y\n-80,-80\n80,-80\n80,80\n-80,80\n"), ("xy", b"-80 -80\n80 -80\n0 80")]
DXF = "0 SECTION 2 ENTITIES 0 LWPOLYLINE 8 0 90 4 70 1 10 -80 20 -80 10 80 20 -80 10 80 20 80 10"
DXF += " -80 20 80 0 CIRCLE 8 0 10 50 20 50 40 10 0 ENDSEC 0 EOF"
SHEETS += [("dxf", "\n".join(DXF.split()).encode())]


def damaged(files):
    """(suffix, bytes) of a file, its bytes damaged; at times with another suffix."""
    return st.sampled_from(files).flatmap(
        lambda file: st.tuples(
            st.sampled_from([file[0]] * 9 + ["stl", "obj", "xyz"]), mangled(file[1])
        )
    )


@cases(1.4)
@given(file=damaged(BALLS), scale=st.sampled_from([1.0] * 6 + [1e-3, 1e6, 1e-300]))
def test_surfaces_of_tools_are_read_or_refused(place, file, scale):
    suffix, content = file
    folder = place()
    (folder / f"tool.{suffix}").write_bytes(content)
    scene = deepcopy(BASES[0])
    scene["tools"]["punch"] = {"file": f"tool.{suffix}", "spacing": 8.0, "scale": scale}
    (folder / "scene.toml").write_text(toml(scene), "utf-8")
    run("surfaces", folder, "form", "scene.toml", "--size", "20", "--dry-run")


@cases(1.4)
@given(
    file=damaged(SHEETS),
    scale=st.sampled_from([1.0] * 6 + [1e-3, 1e6, 1e-300]),
    own=st.booleans(),
)
def test_outlines_and_meshes_of_blanks_are_read_or_refused(place, file, scale, own):
    suffix, content = file
    folder = place()
    (folder / f"blank.{suffix}").write_bytes(content)
    scene = deepcopy(BASES[0])
    scene["blank"] = {"shape": "file", "file": f"blank.{suffix}", "scale": scale}
    if own:
        scene["blank"] = {"mesh": f"blank.{suffix}", "mesh_scale": scale}
    (folder / "scene.toml").write_text(toml(scene), "utf-8")
    run("blanks", folder, "form", "scene.toml", "--size", "20", "--dry-run")


# Names, links and files that are none


@cases(0.2)
@given(name=st.sampled_from(HOSTILE))
def test_a_name_makes_one_folder_here(place, name):
    folder = place()
    areas = {name: {"centre": [0, 0], "radius": 9}}
    scene = BASES[0] | {"name": name, "travel": 0.5, "areas": areas}
    (folder / "scene.toml").write_text(toml(scene), "utf-8")
    run("names of scenes", folder, "form", "scene.toml", "--size", "20", out=None)
    assert run("names of scenes", folder, "form", "scene.toml", "--size", "20") == 0


@cases(0.2)
@given(name=st.sampled_from(HOSTILE))
def test_the_name_of_a_fabric_stays_within_its_file(place, name):
    folder = place()
    (folder / "a.csv").write_bytes(RECORDS[0])
    campaign = CAMPAIGNS[0] | {"name": name, "standing": name, "method": "table"}
    del campaign["keep"]
    (folder / "tests.toml").write_text(toml(campaign), "utf-8")
    assert run("names of fabrics", folder, "identify", "tests.toml", out=None) == 0
    law = next(folder.glob("*/material.toml"))
    assert Fabric.load(law).name == name


def test_links_in_the_folder_of_a_result_lead_nowhere(place):
    folder = place()
    out, stolen = folder / "out", folder / "stolen"
    for directory in (out, stolen):
        directory.mkdir()
    for name in (*FILES, *(f"increment_{i:04d}.vtu" for i in range(9))):
        (out / name).symlink_to(stolen / name)
    main(["oat", *STRIP, "1", "--out", "out", "--force"])
    assert not list(stolen.iterdir())


def linked(path):
    path.symlink_to(path.name)


NO_FILES = {
    "pipe": os.mkfifo,
    "folder": Path.mkdir,
    "link to itself": linked,
    "endless": lambda path: path.symlink_to("/dev/zero"),
    "missing": lambda path: None,
}


@pytest.mark.parametrize("make", NO_FILES.values(), ids=NO_FILES)
def test_what_is_no_file_is_refused(place, make):
    folder = place()
    punch = {"tools": BASES[0]["tools"] | {"punch": {"file": "x.stl"}}}
    scenes = [punch, {"law": "x.toml"}]
    scenes += [{"blank": {"shape": "file", "file": f"x.{kind}"}} for kind in ("csv", "dxf", "vtu")]
    scenes += [{"blank": {"mesh": f"x.{kind}"}} for kind in ("msh", "vtk", "nas", "npz")]
    tests = [{"kind": "off-axis", "files": ["x.csv"]}]
    tests += [PROFILE["tests"][0] | {"profile": "x.csv"}]
    for suffix in ("stl", "toml", "csv", "dxf", "vtu", "msh", "vtk", "nas", "npz"):
        make(folder / f"x.{suffix}")
    for number, scene in enumerate(scenes):
        (folder / f"{number}.toml").write_text(toml(BASES[0] | scene), "utf-8")
        assert run("no files", folder, "form", f"{number}.toml", "--size", "20", "--dry-run") == 2
    for number, test in enumerate(tests):
        (folder / f"t{number}.toml").write_text(toml({"tests": [test]}), "utf-8")
        assert run("no files", folder, "identify", f"t{number}.toml", "--dry-run") == 2
    for words in (["form", "x.toml"], ["identify", "x.csv"], ["oat", "--law", "x.toml"]):
        assert run("no files", folder, *words, "--dry-run") == 2


SLOW = {
    "deep list": "name = " + "[" * 20000,
    "deep table": "a." * 250 + "b = 1",
    "deeper table": "a . " * 20000 + "b = 1",
    "deep header": "[" + "a." * 20000 + "b]",
    "many digits": "travel = " + "9" * 10000,
    "many hexadecimal digits": "travel = 0x" + "f" * 10000,
    "long text": 'name = ["' + "x" * 200_000 + '"]',
    "long key": "x" * 200_000 + " = 1",
    "small steps": ROUND + "[increments]\nlargest = 1e-9",
    "many rows": ROUND + "[increments]\nrows = 1e-9",
    "large blank": ROUND.replace("160.0", "1e6"),
    "large disc": ROUND.replace("rectangle", "disc").replace("length = 160.0", "radius = 1e6"),
    "large punch": ROUND.replace("30.0", "1e4"),
    "small fillet": ROUND.replace("fillet = 10.0", "fillet = 1e-9"),
    "flat tools": ROUND.replace("40.0", "1e-6"),
}


@pytest.mark.parametrize("content", SLOW.values(), ids=SLOW)
def test_what_is_meant_to_take_long_is_refused(place, content):
    folder = place()
    (folder / "scene.toml").write_text(content, "utf-8")
    run("meant to take long", folder, "form", "scene.toml", "--size", "20", "--dry-run")
    if content not in (SLOW["small fillet"], SLOW["large blank"]):  # the size follows the blank
        assert run("meant to take long", folder, "form", "scene.toml", "--dry-run") == 2


@pytest.mark.parametrize(
    "line", ["a[" + " " * 4000, "x " * 4000, " " * 200_000 + "(", '"' * 9999, "," * 9999]
)
def test_a_long_heading_is_no_table(place, line):
    folder = place()
    content = (line + "x\n").encode() + RECORDS[0]
    (folder / "test.csv").write_bytes(content)
    run("long headings", folder, "identify", "test.csv", "--dry-run")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="no limit of memory elsewhere")
def test_a_damaged_count_does_not_take_the_memory(place):
    folder = place()
    content = next(c for suffix, c in BALLS if suffix == "msh" and b"4.1 0" in c)
    # the tag of the last node is the size of an array that meshio makes
    content = content.replace(b"\n52\n", b"\n9000000000\n", 1)
    (folder / "tool.msh").write_bytes(content)
    scene = deepcopy(BASES[0])
    scene["tools"]["punch"] = {"file": "tool.msh", "spacing": 8.0}
    (folder / "scene.toml").write_text(toml(scene), "utf-8")
    assert run("damaged counts", folder, "form", "scene.toml", "--size", "20", "--dry-run") == 2
