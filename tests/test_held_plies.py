"""Supports and grippers of a stack: what they hold, and how plies share a gripper's pull."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import quasiform as qf
from quasiform.console.cli import main
from quasiform.energy.bending import Bending
from quasiform.energy.gripper import Grip
from quasiform.scenes import scene_file
from quasiform.scenes.stack import joined

PULL = {"side": "+x", "tension": 60.0, "stiffness": 5.0}
HOLD = {"side": "-x", "fix": "xy"}
SMOOTH = {"orientation": 0.0, "friction": 0.0}
DISC = {"blank": {"shape": "disc", "radius": 60.0}}
FLAT = """
travel = 2.0
law = "locking"
[fabric]
compaction = 100.0
[blank]
shape = "rectangle"
length = 160.0
width = 80.0
orientation = 20.0
size = 5.0
[tools.punch]
shape = "ball"
radius = 5.0
place = [0.0, 300.0]
friction = 0.0
[tools.die]
shape = "plane"
friction = 0.0
[tools.holder]
shape = "plane"
friction = 0.0
force = 200.0
tilt = false
[outputs]
pictures = false
"""


@pytest.fixture(autouse=True)
def flat_scene(tmp_path, monkeypatch):
    """A sheet between two smooth plates, with the punch beside it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flat.toml").write_text(FLAT, encoding="utf-8")


def held(plies=None, grippers=(PULL,), supports=(HOLD,), **more):
    edges = {"grippers": list(grippers), "supports": list(supports)}
    return qf.forming("flat.toml", plies=plies, overrides=edges | more)


@cache
def pulled(plies=0, times=1.0, picked=()):
    """The result of a stack without friction between its plies, some picked; 0: without plies."""
    pull = PULL | {key: times * PULL[key] for key in ("tension", "stiffness")}
    pull |= {"plies": list(picked)} if picked else {}
    stack = [0, *[SMOOTH] * (plies - 1)] if plies else None
    return qf.solve(held(stack, [pull]), estimate=False)


def motion(result, k=0):
    """(n, 2) of the nodes of sheet k in the plane, mm."""
    sheet, x = result.model.sheets[k], result.states[-1].x
    return (sheet.positions(x) - sheet.positions(result.model.x0))[:, :2]


def borne(result, k=0):
    """(2,) force of the supports on sheet k in the plane, N."""
    model, x = result.model, result.states[-1].x
    g = np.zeros(len(x))
    for term, state in zip(model.terms, result.memory, strict=True):
        term.add_gradient(g, x, state)
    sheet = model.sheets[k]
    return sheet.positions(g)[np.isclose(sheet.blank.nodes[:, 0], -80.0), :2].sum(0)


def pulls(model):
    """By name of a sheet, the tension and the stiffness of its gripper, N and N/mm."""
    terms = [term for term in model.terms if isinstance(term, Grip)]
    return {t.sheet.name: (t.tension.sum(), t.stiffness.sum()) for t in terms}


def on(model, k):
    """(n_nodes, 3) bool: what is fixed of sheet k."""
    return model.sheets[k].field.of(model.fixed)


# Mechanics


def test_one_ply_is_held_as_a_scene_without_plies():
    one, alone = pulled(1), pulled()
    assert np.abs(motion(alone)).max() > 0.01
    assert_array_equal(one.states[-1].x, alone.states[-1].x)
    assert_array_equal(one.history["force_N"], alone.history["force_N"])


def test_two_plies_move_under_twice_the_pull_as_one_does():
    """In the plane; the supports bear twice the force."""
    pair, alone = pulled(2, 2.0), pulled()
    assert (pair.status, alone.status) == ("completed", "completed")
    for k in (0, 1):
        assert_allclose(motion(pair, k), motion(alone), atol=1e-4)  # of 23 mm
        assert_allclose(borne(pair, k), borne(alone), atol=1e-4)
    u = motion(alone)[np.isclose(alone.blank.nodes[:, 0], 80.0), 0]
    assert -60.0 < borne(alone)[0] < -60.0 + 5.0 * u.max()


def test_a_gripper_of_one_ply_leaves_the_other_one():
    picked, alone = pulled(2, picked=(2,)), pulled()
    assert pulls(picked.model) == {"ply 2": pytest.approx((60.0, 5.0))}
    # where one has gone from under the other, both are uneven
    most = 5e-3 * np.abs(motion(alone)).max()
    assert_allclose(motion(picked, 1), motion(alone), atol=most)
    assert_allclose(motion(picked, 0), 0.0, atol=most)
    assert_allclose(borne(picked, 1), borne(alone), atol=0.1)
    assert_allclose(borne(picked, 0), 0.0, atol=0.1)


def test_grippers_of_a_stack_over_a_punch():
    """Two plies without friction take twice the force of one, whose grippers pull half as much."""
    smooth = {f"tools.{tool}.friction": 0.0 for tool in ("punch", "die", "holder")}
    ends = []
    for times, plies in ((2.0, [0, SMOOTH]), (1.0, None)):
        sides = [{"side": s, "tension": 20.0 * times, "stiffness": times} for s in ("+x", "-x")]
        edges = {"grippers": sides, "supports": [{"centre": [0, 0], "radius": 6, "fix": "xy"}]}
        given = {"size": 31.0, "travel": 10.0, "plies": plies, "overrides": smooth | edges}
        ends.append(qf.solve(qf.forming("hemisphere", **given), estimate=False))
    assert ends[0].certified.converged
    assert ends[0].force == pytest.approx(2.0 * ends[1].force, rel=0.01)
    assert ends[0].draw_in == pytest.approx(ends[1].draw_in, abs=0.05)


# What is held, and what it bears


def test_plies_share_a_pull_by_the_length_of_their_gripped_edges():
    half = SMOOTH | {"blank": {"shape": "rectangle", "length": 160.0, "width": 40.0}}
    model = held([0, half])
    assert pulls(model) == {
        "ply 1": pytest.approx((40.0, 10.0 / 3.0), rel=1e-5),
        "ply 2": pytest.approx((20.0, 5.0 / 3.0), rel=1e-5),
    }
    turned = pulls(held([0, {"orientation": 25.0}]))  # other nodes on the same edge
    assert turned == {name: pytest.approx((30.0, 2.5)) for name in ("ply 1", "ply 2")}
    box = {"box": [40.0, -50.0, 90.0, 50.0], "tension": 9.0, "direction": [1.0, 0.0]}
    assert pulls(held([0, half], [box]))["ply 1"][0] == pytest.approx(6.0)
    assert model.resting == pytest.approx(260.0)  # with the force of the holder
    assert dict(model.description)["held by [grippers 1]"] == "ply 1 and ply 2"


def test_joined_plies_bear_as_many_shares():
    stack = [0, {"joined": True}, SMOOTH]
    assert pulls(held(stack)) == {
        "ply 1": pytest.approx((40.0, 10.0 / 3.0)),
        "ply 2": pytest.approx((20.0, 5.0 / 3.0)),
    }
    picked = held(stack, [PULL | {"plies": [1, 3]}], [HOLD | {"plies": [3]}])
    assert pulls(picked) == {name: pytest.approx((30.0, 2.5)) for name in ("ply 1", "ply 2")}
    assert not on(picked, 0).any()
    assert on(picked, 1)[:, :2].any()


def test_joined_plies_are_held_as_their_one_sheet():
    fabric = joined(qf.Fabric(compaction=100.0), 2)
    pair = held([0, {"joined": True}])
    alone = qf.forming("flat.toml", law=fabric, overrides={"grippers": [PULL], "supports": [HOLD]})
    assert pulls(pair) == {"sheet": pytest.approx((60.0, 5.0))}
    assert_array_equal(pair.fixed, alone.fixed)


def test_a_side_is_that_of_the_plies_among_which_it_is_sought():
    model = held([0, SMOOTH | DISC], supports=[HOLD, HOLD | {"plies": [1]}])
    assert set(pulls(model)) == {"ply 1"}  # the disc does not come to the side
    assert on(model, 1).sum() == 3  # its middle is kept, since nothing holds it
    moved = SMOOTH | {"offset": [10.0, 0.0]}
    assert set(pulls(held([0, moved], supports=[]))) == {"ply 2"}
    assert set(pulls(held([0, moved], [PULL | {"plies": [1]}], []))) == {"ply 1"}


def test_a_clamp_is_one_of_all_plies_that_lie_there():
    clamp = {"box": [-90.0, -50.0, -60.0, 50.0], "fix": "xyz", "clamp": True}
    model = held([0, 90], supports=[clamp])
    for k, bending in enumerate(t for t in model.terms if isinstance(t, Bending)):
        inside = model.sheets[k].blank.nodes[:, 0] < -60.0 + 1e-6
        assert_array_equal(on(model, k), np.repeat(inside[:, None], 3, axis=1))
        assert bending.constant.any()


def test_without_friction_only_a_ply_that_nothing_holds_keeps_its_middle():
    def kept(plies):
        edges = [PULL | {"plies": [1]}], [HOLD | {"plies": [1]}]
        words = [what for what, _ in held(plies, *edges).description if "middle" in what]
        return [word.removesuffix(" fixed in the plane") for word in words]

    assert kept([0, SMOOTH, SMOOTH]) == ["middle of the ply 2", "middle of the ply 3"]
    assert kept([0, 0, SMOOTH]) == ["middle of the ply 3"]  # ply 2 rubs on ply 1
    assert kept([0, 0, 0]) == []  # ply 3 rubs on ply 2
    assert kept([0, SMOOTH, 0]) == ["middle of the ply 2", "middle of the ply 3"]


def test_mirror_planes_are_sought_without_edges_that_are_held():
    free = {"size": 31.0, "plies": [0, 90]}
    assert qf.forming("hemisphere", **free).share == 0.25
    assert qf.forming("hemisphere", overrides={"supports": [HOLD]}, **free).share == 1.0


# Refusals, files, resume


@pytest.mark.parametrize(
    ("edge", "words"),
    [
        ({"side": "+x", "plies": [1, 2]}, "[grippers 1] no node of ply 2 lies there"),
        ({"box": [300.0, 0.0, 400.0, 9.0]}, "[grippers 1] no node of the blank lies there"),
        ({"box": [41.0, -9.0, 43.0, -8.0]}, "[grippers 1] no node of ply 1 lies there"),
        ({"centre": [0, 0], "radius": 9, "plies": [3]}, "plies = [3]: the scene has 2 [[plies]]"),
        ({"side": "+x", "plies": []}, "[grippers 1] plies = []: expected numbers of plies"),
        ({"side": "+x", "plies": [0]}, "[grippers 1] plies = [0]: expected numbers of plies"),
        ({"side": "+x", "plies": 1}, "[grippers 1] plies = 1: expected numbers of plies"),
        ({"side": "+x", "plies": [True]}, "plies = [True]: expected numbers of plies"),
    ],
)
def test_edges_that_are_refused(edge, words, capsys):
    with pytest.raises(qf.InputError, match=re.escape(words)):
        held([0, SMOOTH | DISC], [edge | {"tension": 5.0}])
    support = edge | {"fix": "z"}
    with pytest.raises(qf.InputError, match=re.escape(words.replace("grippers", "supports"))):
        held([0, SMOOTH | DISC], supports=[support])


def test_plies_are_picked_of_a_stack_only(capsys):
    words = "plies = [1]: the scene has no [[plies]]"
    with pytest.raises(qf.InputError, match=re.escape(words)):
        held(None, [PULL | {"plies": [1]}])
    edge = 'grippers=[{side = "+x", tension = 5.0, plies = [1]}]'
    assert main(["form", "flat.toml", "--set", edge, "--dry-run"]) == 2
    captured = capsys.readouterr()
    lines = [line for line in (captured.out + captured.err).splitlines() if words in line]
    assert len(lines) == 1


def test_picked_plies_are_written_and_read(tmp_path):
    edges = [PULL | {"plies": [2]}], [HOLD | {"plies": [1, 2]}, HOLD]
    model = held([0, SMOOTH], *edges)
    file = dict(model.recipe.given)["file"]
    (tmp_path / "again.toml").write_text(scene_file.scene_toml(file), encoding="utf-8")
    again = scene_file.load("again.toml")
    assert (again.grippers, again.supports) == (file.grippers, file.supports)
    assert [edge.plies for edge in (*again.grippers, *again.supports)] == [(2,), (1, 2), None]
    assert "plies = []" not in scene_file.scene_toml(replace(file, plies=()))
    built = model.recipe.build()
    assert_array_equal(built.fixed, model.fixed)
    assert pulls(built) == pulls(model)


def test_a_stopped_run_with_grippers_goes_on_as_it_was(tmp_path):
    model = pulled(2, picked=(2,)).model
    given = {"estimate": False, "out": tmp_path / "out"}
    assert qf.solve(model, callback=lambda p: p.travel > 0.5, **given).status == "stopped"
    end = qf.solve(model, resume=True, **given)
    assert_array_equal(end.states[-1].x, pulled(2, picked=(2,)).states[-1].x)
