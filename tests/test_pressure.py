"""Scenes with a pressure on the sheet: its load, mirror planes, records, and what is refused."""

from unittest.mock import Mock

import numpy as np
import pytest
import shapely
from numpy.testing import assert_array_equal

import quasiform as qf
from quasiform.draw.plot import words_of
from quasiform.energy.contact import Contact
from quasiform.energy.plies import PlyContact, folds_on_itself
from quasiform.energy.pressure import free_edges
from quasiform.handover.deck import abaqus_deck
from quasiform.result.assumed import assumed
from quasiform.result.sheet import read_sheets
from quasiform.scenes import scene_file
from quasiform.unknowns import Unknowns

MALE = """
travel = 10.0
pressure = 0.02
[blank]
shape = "disc"
radius = 40.0
[tools.die]
shape = "round punch"
radius = 75.0
"""
DRAWN = """
[blank]
shape = "rectangle"
length = 300.0
width = 300.0
[tools.die]
shape = "round opening"
radius = 80.0
fillet = 10.0
[tools.holder]
shape = "round opening"
radius = 80.0
fillet = 10.0
mass = 10.0
"""
FEMALE = (
    """
travel = 50.0
pressure = [[0.0, 0.001], [50.0, 0.003]]
"""
    + DRAWN
    + """tilt = false
"""
)


def scene(folder, text, **given):
    path = folder / "scene.toml"
    path.write_text(text + "[outputs]\npictures = false\nincrements = false\n")
    return qf.forming(str(path), **given)


def on_fixed_tools(result):
    """Downward force of the whole sheet on the fixed tools, with friction, N."""
    x, found = result.states[-1].x, 0.0
    for term, state in zip(result.model.terms, result.memory, strict=True):
        contact = getattr(term, "contact", None)
        if isinstance(contact, Contact) and contact.tool.motion == "fixed":
            found += term.gradient(x, state)[:, contact.height_column].sum()
    return found / result.model.share


@pytest.fixture(scope="module")
def male(tmp_path_factory):
    return qf.solve(scene(tmp_path_factory.mktemp("male"), MALE, size=10.0), estimate=False)


def test_a_male_tool_bears_the_pressure_on_the_projected_area(male):
    """Without any tool that is driven, at a full load that rises from zero."""
    assert male.status == "completed"
    assert male.certified.converged
    area = shapely.Polygon(male.positions()[male.blank.outline[0], :2]).area
    assert on_fixed_tools(male) == pytest.approx(0.02 * area, rel=0.01)
    assert male.history["pressure_force_N"][-1] == pytest.approx(0.02 * area, rel=1e-3)
    assert_array_equal(male.history["force_N"], male.history["pressure_force_N"])
    assert male.summary()["force_N"] == male.force == male.history["force_N"][-1]
    assert words_of(male.record) == ("travel", "force of the pressure", "N")
    assert male.history["pressure_MPa"] == pytest.approx(0.02 * male.history["travel_mm"] / 10.0)
    assert area < 0.97 * np.pi * 40.0**2  # the sheet lies on the hemisphere


def test_a_part_between_mirror_planes_bears_its_share(tmp_path):
    """A female tool with a holder; the load starts with the travel."""
    given = {"size": 25.0, "travel": 20.0}
    part, whole = (
        qf.solve(scene(tmp_path, FEMALE, symmetry=symmetry, **given), estimate=False)
        for symmetry in ("auto", "none")
    )
    assert (part.model.share, whole.model.share) == (0.25, 1.0)
    for result in (part, whole):
        assert result.status == "completed"
        force = result.history["pressure_force_N"][-1] + 98.1
        assert on_fixed_tools(result) == pytest.approx(force, rel=1e-3)
        assert result.history["holder_force_N"][-1] == pytest.approx(98.1, rel=1e-3)
    assert part.history["pressure_force_N"][-1] == pytest.approx(
        whole.history["pressure_force_N"][-1], rel=1e-3
    )
    assert part.shear_angle.max() == pytest.approx(whole.shear_angle.max(), rel=0.01)


def test_a_stopped_run_is_continued_as_it_was(male, tmp_path):
    given = {"estimate": False, "out": tmp_path / "out"}
    model = scene(tmp_path, MALE, size=10.0)
    stopped = qf.solve(model, callback=lambda p: p.travel > 4.0, **given)
    assert stopped.status == "stopped"
    end = qf.solve(model, resume=True, **given)
    assert_array_equal(end.states[-1].x, male.states[-1].x)
    assert end.energy_balance == male.energy_balance


def test_a_scene_with_a_pressure_is_written_back(tmp_path):
    for text in (MALE, FEMALE):
        scene(tmp_path, text)
        file = scene_file.load(str(tmp_path / "scene.toml"))
        (tmp_path / "again.toml").write_text(scene_file.scene_toml(file))
        again = scene_file.load(str(tmp_path / "again.toml"))
        assert again.pressure == file.pressure
        assert scene_file.scene_toml(again) == scene_file.scene_toml(file)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("pressure = 0.02", "", "no tool is driven"),
        ("pressure = 0.02", "pressure = -1", "pressure"),
        ("pressure = 0.02", "pressure = [[0.0, 0.1]]", "two rows or more, .travel in mm, MPa."),
        ("radius = 75.0", "radius = 75.0\nz = -50.0", "nothing holds the sheet under the pressure"),
        ("radius = 75.0", 'radius = 75.0\nmotion = "free"\nmass = 1.0', "nothing holds the sheet"),
    ],
)
def test_what_is_refused(tmp_path, old, new, words):
    with pytest.raises(qf.InputError, match=words):
        scene(tmp_path, MALE.replace(old, new), size=10.0)


# Stages, one after the other

STAGES = (
    """
travel = 60.0
pressure = [[0.0, 0.0], [20.0, 0.0], [30.0, 0.002], [40.0, 0.0]]
"""
    + DRAWN
    + """
[tools.punch]
shape = "round punch"
radius = 75.0
stroke = [[0.0, 0.0], [20.0, 20.0], [40.0, 20.0], [60.0, -1.0]]
"""
)


@pytest.fixture(scope="module")
def staged_by_increments(tmp_path_factory):
    model, seen = scene(tmp_path_factory.mktemp("staged"), STAGES, size=25.0), []
    result = qf.solve(model, lambda progress: seen.append(progress.travel), estimate=False)
    return result, np.array([0.0, *seen])


@pytest.fixture(scope="module")
def staged(staged_by_increments):
    return staged_by_increments[0]


def test_a_stage_begins_with_a_short_increment(staged_by_increments):
    result, travels = staged_by_increments
    steps = dict(zip(travels[:-1].tolist(), np.diff(travels), strict=True))
    for stage in (20.0, 30.0, 40.0):
        assert steps[stage] == pytest.approx(result.model.increment / 16)


def test_a_punch_closes_dwells_under_a_pressure_and_goes_back(staged):
    assert staged.status == "completed"
    assert staged.certified.converged
    s, force = staged.history["travel_mm"], staged.history["force_N"]
    punch = int(staged.model.unknowns["punch"].dofs[0, 0])
    z = [state.x[punch] - staged.model.x0[punch] for state in staged.states]
    assert z == pytest.approx(np.interp(s, [0, 20, 40, 60], [0, -20, -20, 1.0]), abs=1e-12)
    assert {20.0, 30.0, 40.0, 60.0} <= set(s)
    at = dict(zip(s, force, strict=True))
    assert at[20.0] > 1.0
    assert at[30.0] < 0.9 * at[20.0]  # the pressure takes the sheet off the punch
    assert abs(at[60.0]) < 1e-3 * at[20.0]
    pressed = staged.history["pressure_MPa"]
    assert pressed == pytest.approx(np.interp(s, [20, 30, 40], [0, 0.002, 0]), abs=1e-12)


def test_a_stage_is_the_scene_that_ends_there(staged, tmp_path):
    """Up to the end of its stroke the punch is one without `stroke`; force is by its motion."""
    alone = STAGES.replace("travel = 60.0", "travel = 20.0")
    alone = alone.replace("stroke", "# stroke").replace("pressure = ", "# pressure = ")
    end = qf.solve(scene(tmp_path, alone, size=25.0), estimate=False)
    row = list(staged.history["travel_mm"]).index(20.0)
    for name in ("force_N", "draw_in_mm"):
        assert staged.history[name][row] == pytest.approx(end.history[name][-1], rel=2e-3)


def test_a_killed_run_of_stages_goes_on_as_it_was(staged, tmp_path):
    given = {"estimate": False, "out": tmp_path / "out"}
    model = scene(tmp_path, STAGES, size=25.0)
    qf.solve(model, callback=lambda p: p.travel > 47.0, **given)
    end = qf.solve(model, resume=True, **given)
    assert_array_equal(end.states[-1].x, staged.states[-1].x)
    assert end.residual == staged.residual


def test_what_is_not_possible_with_stages(staged, tmp_path):
    with pytest.raises(qf.InputError, match="tools with a stroke and pressures are not followed"):
        staged.sensitivity(["fabric.friction"])
    with pytest.raises(qf.InputError, match="a deck of tools with a stroke is not possible"):
        abaqus_deck(staged.model, tmp_path / "deck.inp")


def test_the_force_of_a_tool_that_rises_is_positive(tmp_path):
    """A male tool from below, against a sheet that is clamped around it."""
    text = """
travel = 10.0
[blank]
shape = "rectangle"
length = 100.0
width = 100.0
[tools.die]
motion = "driven"
shape = "round punch"
radius = 40.0
stroke = -10.0
"""
    sides = "".join(f'[[supports]]\nside = "{side}"\nfix = "xyz"\n' for side in ("+x", "-x"))
    rising = qf.solve(scene(tmp_path, text + sides, size=12.5), estimate=False)
    text = text.replace("[tools.die]", "[tools.punch]").replace("-10.0", "10.0")
    falling = qf.solve(scene(tmp_path, text + sides, size=12.5), estimate=False)
    assert rising.status == "completed"
    assert rising.force == pytest.approx(falling.force, rel=1e-6)
    assert rising.positions()[:, 2].max() == pytest.approx(10.0, abs=1.0)


@pytest.mark.parametrize(
    ("tool", "words"),
    [
        ("stroke = [[0.0, 1.0], [20.0, 20.0]]", "stroke must start at 0 mm, got 1"),
        ("stroke = [[0.0, 0.0]]", "two rows or more"),
        ('stroke = 3.0\nmotion = "fixed"', "stroke belongs to a tool with motion = 'driven'"),
        ("stroke = [[0.0, 0.0], [20.0, 75.0], [60.0, 0.0]]\nradius = 90.0", "a travel of 20 mm"),
    ],
)
def test_strokes_that_are_refused(tmp_path, tool, words):
    head = STAGES[: STAGES.index("radius = 75.0")]  # the punch comes last
    radius = "" if "radius" in tool else "radius = 75.0\n"
    with pytest.raises(qf.InputError, match=words):
        scene(tmp_path, f"{head}{radius}{tool}\n", size=25.0)


# Plies

ON_A_PLATE = """
pressure = 0.02
[blank]
shape = "rectangle"
length = 100.0
width = 80.0
[tools.die]
shape = "plane"
"""
LYING = f"""
travel = 2.0
{ON_A_PLATE}[[plies]]
[[plies]]
orientation = 30.0
"""


def test_a_pressure_on_a_stack_acts_on_its_first_ply(tmp_path):
    """Each ply hands it on: to the next one, and to the die."""
    model = scene(tmp_path, LYING, size=10.0)
    result = qf.solve(model, estimate=False)
    assert result.certified.converged
    x, force = result.states[-1].x, 0.02 * 100.0 * 80.0
    between = 0.0
    for term, state in zip(model.terms, result.memory, strict=True):
        if isinstance(term, PlyContact):
            between -= term.side * term.gradient(x, state)[:, 2].sum()
    assert between == pytest.approx(force, rel=1e-3)
    assert on_fixed_tools(result) == pytest.approx(force, rel=1e-3)
    (pressure,) = model.pressures
    assert pressure.sheet.name == "ply 1"
    assert not any("no pressure" in what for what, _ in model.description)


def test_a_ply_that_the_first_one_leaves_uncovered_is_named(tmp_path):
    small = "[[plies]]\n[plies.blank]\nshape = 'disc'\nradius = 30.0\n[[plies]]"
    model = scene(tmp_path, LYING.replace("[[plies]]", small, 1), size=7.0)
    words = dict(model.description)["no pressure on what the ply 1 leaves uncovered"]
    assert words == "ply 2, ply 3"


# Diaphragms

PRESSED = f"""
travel = 10.0
{ON_A_PLATE}[diaphragm]
modulus = 1.0
thickness = 1.0
prestretch = 1.02
[diaphragm.blank]
shape = "rectangle"
length = 160.0
width = 140.0
[increments]
largest = 2.0
rows = 2.0
"""


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    return qf.solve(scene(tmp_path_factory.mktemp("flat"), PRESSED, size=10.0), estimate=False)


def test_a_diaphragm_bears_the_pressure_on_the_sheet_under_it(flat, tmp_path):
    """On a plane die: beyond the sheet the diaphragm comes down on the die itself."""
    result = flat
    assert (result.status, result.reason) == ("completed", "")
    assert result.certified.converged
    model, x = result.model, result.states[-1].x
    assert [sheet.name for sheet in model.sheets] == ["sheet", "diaphragm"]
    assert len(result.plies) == 1
    sheet, diaphragm = model.sheets
    force = on_fixed_tools(result)
    clamped = model.fixed[diaphragm.dofs[:, 2]]
    assert clamped.sum() == 16
    # half a row of elements at the clamp is borne by it
    assert 0.02 * 150.0 * 130.0 < force < 0.02 * 160.0 * 140.0
    (contact,) = (c for c in model.contacts if c.sheet is sheet)
    on_sheet = contact.area @ contact.pressure(x) / model.share
    assert 0.02 * 100.0 * 80.0 < on_sheet < 0.02 * 110.0 * 90.0  # with half a row beyond its edge
    assert result.certified.figures["penetration_mm"] < 0.03
    result.save(tmp_path / "out")
    (written,) = read_sheets(tmp_path / "out" / "diaphragm.vtu")
    volume = written.areas @ written.cell_fields["thickness"]
    assert volume == pytest.approx(160 * 140 / 1.02**2, rel=1e-6)  # it is incompressible
    assert result.history["pressure_force_N"][-1] == pytest.approx(0.02 * 160 * 140, rel=1e-3)


def test_a_clamped_diaphragm_needs_no_middle_that_is_kept(tmp_path):
    text = PRESSED.replace("[diaphragm]", "[diaphragm]\nfriction = 0.0")
    text = text.replace("[tools.die]", "[tools.die]\nfriction = 0.0")
    text = text.replace("prestretch = 1.02\n", "")
    for clamped in (True, False):
        words = f"[diaphragm]\nclamped = {str(clamped).lower()}"
        path = tmp_path / "scene.toml"
        path.write_text(text.replace("[diaphragm]", words), encoding="utf-8")
        model = qf.forming(path, orientation=30.0, size=10.0)
        sheet, diaphragm = model.sheets
        assert model.fixed[sheet.dofs].sum() == 3
        edge = free_edges(diaphragm.blank)
        kept = model.fixed[diaphragm.dofs].sum() - clamped * 3 * len(np.unique(edge))
        assert kept == (0 if clamped else 3)


def test_a_diaphragm_under_the_sheet_is_pressed_up(flat, tmp_path):
    """The same upside down: a plane over the sheet."""
    text = PRESSED.replace("[tools.die]", '[tools.holder]\nmotion = "fixed"')
    text = text.replace("[diaphragm]", '[diaphragm]\nside = "under"')
    ends = [flat, qf.solve(scene(tmp_path, text, size=10.0), estimate=False)]
    assert ends[1].status == "completed"
    forces = [on_fixed_tools(end) for end in ends]
    assert forces[0] == pytest.approx(-forces[1], rel=1e-4)  # the residual
    z = [end.model.sheets[1].positions(end.states[-1].x)[:, 2] for end in ends]
    assert 2.004 - z[1] == pytest.approx(z[0], abs=0.02)  # of a thickness of 1 mm


def test_a_killed_run_with_a_diaphragm_goes_on_as_it_was(flat, tmp_path):
    given = {"estimate": False, "out": tmp_path / "out"}
    model = scene(tmp_path, PRESSED, size=10.0)
    qf.solve(model, callback=lambda p: p.travel > 3.0, **given)
    end = qf.solve(model, resume=True, **given)
    assert_array_equal(end.states[-1].x, flat.states[-1].x)


def folded(gap):
    """A strip that is folded over onto itself, with a gap between its halves, mm."""
    sheet = Unknowns().sheet(qf.rectangle(60.0, 20.0, 2.5), qf.Fabric(), 3)
    (x, y), r = sheet.blank.nodes.T, 0.5 * gap
    bend = np.clip(x / r, 0.0, np.pi)
    X = np.where(x < 0, x, r * np.sin(bend)) - np.maximum(x - np.pi * r, 0.0)
    return sheet, np.column_stack([X, y, r * (1.0 - np.cos(bend))]).ravel()


def test_a_fold_that_touches_itself_is_found():
    assert folds_on_itself(*folded(0.4))
    assert not folds_on_itself(*folded(4.0))
    sheet, x = folded(0.4)
    model = Mock(pressures=[None], sheets=[sheet], contacts=[])
    words = "the sheet folds on itself, and self-contact is not modelled"
    assert qf.Model.lost(model, x) == words
    model.pressures = []
    assert qf.Model.lost(model, x) == ""


def test_a_scene_with_a_diaphragm_is_written_back(tmp_path):
    model = scene(tmp_path, PRESSED, size=10.0)
    file = scene_file.load(str(tmp_path / "scene.toml"))
    (tmp_path / "again.toml").write_text(scene_file.scene_toml(file))
    again = scene_file.load(str(tmp_path / "again.toml"))
    assert again.diaphragm == file.diaphragm
    assert {"diaphragm.poisson", "diaphragm.friction"} <= set(assumed(model))
    assert qf.forming(again, size=10.0).description == model.description


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("modulus = 1.0", "", r"\[diaphragm\] modulus missing"),
        ("modulus = 1.0", "modulus = -1.0", "modulus"),
        ("modulus = 1.0", "modulus = 1.0\npoisson = 0.6", "poisson must not exceed 0.5"),
        ("prestretch = 1.02", "prestretch = 0.9", "prestretch must be at least 1"),
        ("modulus = 1.0", 'modulus = 1.0\nside = "over"', "side = 'over'"),
        ("modulus = 1.0", "modulus = 1.0\nclamped = false", "prestretch needs"),
        (
            "[diaphragm]",
            '[[supports]]\nside = "+x"\nfix = "z"\n[diaphragm]',
            "not possible together",
        ),
        ("width = 140.0", "width = 140.0\ncentre = [500.0, 0.0]", "does not lie over the blank"),
    ],
)
def test_diaphragms_that_are_refused(tmp_path, old, new, words):
    with pytest.raises(qf.InputError, match=words):
        scene(tmp_path, PRESSED.replace(old, new, 1), size=10.0)


def test_plies_under_a_diaphragm_have_fields_between_them(tmp_path):
    """The diaphragm is no ply: it adds nothing to the stack, and has no files."""
    plies = "[[plies]]\n[[plies]]\norientation = 90.0\n"
    model = scene(tmp_path, PRESSED.replace("travel = 10.0", "travel = 2.0") + plies, size=10.0)
    result = qf.solve(model, estimate=False)
    fields = result.stack_at().point_fields
    thickness = sum(ply.fabric.thickness for ply in model.sheets[:2])
    assert fields["stack_thickness"] == pytest.approx(thickness, rel=1e-3)
    assert {name for name in fields if name.startswith("slip")} == {"slip_1_2"}
    assert list(result.sheets) == ["ply 1", "ply 2"]
    handed = qf.export(result, "abaqus-layup", tmp_path / "layup")
    assert len(handed.plies) == 2
