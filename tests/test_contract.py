"""What the run does for every term, a user's own included: state, unknowns, recipe."""

import json
import subprocess
import sys
from dataclasses import dataclass, replace
from functools import partial, wraps

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import quasiform as qf
from examples.softening import SofteningYarns, stitched
from quasiform.fingerprint import fingerprint
from quasiform.potential import Potential
from quasiform.scenes.scene_file import json_schema, load, scene_toml
from quasiform.solve import newton
from quasiform.solve import tangent as tangent_module
from quasiform.solve.equilibrium import Equilibrium
from quasiform.solve.proximal import Bed

MEMBRANE = replace(qf.Fabric(), in_plane_bending=0.0)


def strip(**given):
    given = {"law": MEMBRANE, "displacement": 20.0, "size": 20.0} | given
    return qf.off_axis_tension(**given)


class KilledError(Exception):
    pass


def killed_after(count):
    def callback(_):
        callback.left -= 1
        if not callback.left:
            raise KilledError

    callback.left = count
    return callback


# A term with memory, written by a user


@pytest.fixture(scope="module")
def softened():
    model = strip(displacement=40.0).including(stitched)
    return model, qf.solve(model)


def test_second_run_is_the_first(softened):
    model, first = softened
    second = qf.solve(model)
    assert_array_equal(second.states[-1].x, first.states[-1].x)
    assert second.factorisations == first.factorisations


def test_what_it_dissipates_closes_the_energy_balance(softened):
    _, result = softened
    assert result.energy_balance < 0.01
    forgetful = type("Forgetful", (SofteningYarns,), {"dissipated": lambda *_: 0.0})
    model = strip(displacement=40.0).including(stitched)
    yarns = model.terms[-1]
    yarns.__class__ = forgetful
    assert qf.solve(model, estimate=False).energy_balance > 0.01


def test_it_softens(softened):
    _, result = softened
    assert result.force > 1.05 * qf.solve(strip(displacement=40.0), estimate=False).force
    assert result.memory[-1].kappa.max() > 0.05


def test_killed_and_resumed_run_is_the_same(softened, tmp_path):
    model, straight = softened
    for count in (2, 5):
        folder = tmp_path / str(count)
        with pytest.raises(KilledError):
            qf.solve(model, killed_after(count), out=folder)
        resumed = qf.solve(model, out=folder, resume=True)
        assert_array_equal(resumed.states[-1].x, straight.states[-1].x)
        assert resumed.factorisations == straight.factorisations


def test_it_is_refined_with_an_estimate(softened):
    result = qf.refine(strip(displacement=40.0, size=10.0).including(stitched))
    assert result.path is not None
    assert result.estimate["force_N"] > 0
    assert all(
        any(t.name == "softening yarns" for t in r.model.terms) for r in (result, result.path)
    )
    # the memory has come along: without it the yarns would be new at the end of the travel
    kappa = result.memory[-1].kappa
    assert kappa.max() > 0.05


def test_rejected_increment_leaves_no_trace(softened):
    model, _ = softened
    run_of = qf.solve(model, increment=20.0, estimate=False)
    stopped = qf.solve(model, callback=lambda p: p.travel >= 20.0, increment=20.0, estimate=False)
    assert_array_equal(run_of.states[1].x, stopped.states[1].x)


# Stencils that change at a refresh


@dataclass(frozen=True)
class Pairs:
    """Pairs of nodes (m, 2)."""

    nodes: np.ndarray


class NearestSpring(qf.Term):
    """A spring from each node of one line to the nearest node of another, found anew each time."""

    name = "nearest spring"

    def __init__(self, sheet, ones, others, stiffness):
        self.sheet, self.ones, self.others, self.stiffness = sheet, ones, others, stiffness

    def _pairs(self, x):
        X = self.sheet.positions(x)
        far = np.linalg.norm(X[self.ones][:, None] - X[self.others], axis=2)
        return Pairs(np.column_stack([self.ones, self.others[far.argmin(1)]]))

    def initial(self, x):
        return self._pairs(x)

    def refresh(self, x, state):
        found = self._pairs(x)
        return state if np.array_equal(found.nodes, state.nodes) else found

    def stencils(self, state):
        return self.sheet.dofs[state.nodes].reshape(len(state.nodes), -1)

    def _d(self, x, state):
        return np.diff(self.sheet.positions(x)[state.nodes], axis=1)[:, 0]

    def energy(self, x, state):
        return 0.5 * self.stiffness * (self._d(x, state) ** 2).sum(1)

    def gradient(self, x, state):
        d = self.stiffness * self._d(x, state)
        return np.hstack([-d, d])

    def hessian(self, x, state, convex):
        K = self.stiffness * np.eye(self.sheet.dim)
        return np.repeat(np.block([[K, -K], [-K, K]])[None], len(state.nodes), axis=0)


def test_stencils_may_change_at_a_refresh():
    model = strip()
    sheet = model.sheet
    y = sheet.blank.nodes[:, 1]
    lower, upper = np.flatnonzero(np.isclose(y, y.min())), np.flatnonzero(np.isclose(y, y.max()))
    spring = NearestSpring(sheet, lower, upper, 1e-4)
    model.terms.append(spring)
    equations = Equilibrium(model)
    before = equations.memory[-1].nodes.copy()
    pattern = equations.potential.pattern
    x = model.x0.copy()
    sheet.positions(x)  # a copy: the positions are moved by their numbers
    x[sheet.dofs[upper, 0]] += 37.0
    equations.refresh(x)
    after = equations.memory[-1].nodes
    assert (after != before).any()
    assert equations.potential.pattern is not pattern  # it did not cover the new pairs
    fresh = Potential(model.terms, ~model.fixed, equations.memory)
    assert_allclose(equations.gradient(x), fresh.gradient(x, equations.memory), atol=1e-12)
    mine, new = (
        np.asarray(p.hessian(x, equations.memory, False)[0]).sum()
        for p in (equations.potential, fresh)
    )
    assert_allclose(mine, new, rtol=1e-9)
    pattern = equations.potential.pattern
    equations.refresh(model.x0)  # back again: covered
    assert equations.potential.pattern is pattern
    assert qf.solve(model, estimate=False).certified


def test_stencils_may_change_while_a_term_is_added_for_the_time_being():
    model = strip()
    y = model.sheet.blank.nodes[:, 1]
    lower, upper = np.flatnonzero(np.isclose(y, y.min())), np.flatnonzero(np.isclose(y, y.max()))
    model.terms.append(NearestSpring(model.sheet, lower, upper, 1e-4))
    equations, x = Equilibrium(model), model.x0.copy()
    moved = x.copy()
    moved[model.sheet.dofs[upper, 0]] += 37.0
    equations.refresh(moved)  # the pattern grows, and keeps what it has
    equations.refresh(x)
    with equations.with_term(Bed(np.ones(len(x)))):
        equations.factor(x, True)
        equations.refresh(moved)
        equations.factor(x, True)
    g = equations.gradient(moved)[equations.free]
    equations.factor(moved, True)
    solved = equations.tangent.solve(g)
    fresh = Equilibrium(model)
    fresh.take(equations.memory)
    fresh.factor(moved, True)
    assert_allclose(solved, fresh.tangent.solve(g), rtol=1e-6, atol=1e-9 * np.abs(solved).max())


# The tangent


def test_the_convex_tangent_gives_steps_of_the_exact_one():
    """A compressed strip: the exact tangent is indefinite, the step goes down, and is counted."""
    model = strip()
    equations, x = Equilibrium(model), model.x0.copy()
    dofs = model.sheet.dofs
    x[dofs[:, 0]] *= 0.97
    x += 1e-3 * np.random.default_rng(1).normal(size=len(x)) * equations.free
    tangent, g = equations.tangent, equations.gradient(x)[equations.free]
    assert equations.factor(x, False)[0] > 0
    before = tangent.counts.copy()
    tangent.restart()
    with tangent.counted_as("balance"):
        d = tangent.step(x, equations.memory, g)
        assert g @ d < 0
        assert tangent.counts - before == {"balance": 1, "balance, convex": 1}
        again = tangent.step(x, equations.memory, g)  # the exact one is not tried again
    assert_allclose(again, d, rtol=1e-9)
    assert tangent.counts - before == {"balance": 1, "balance, convex": 2}
    equations.factor(x, True)
    slope = abs(g @ tangent.solve(g))
    assert g @ d <= -slope  # the convex tangent is stiffer: its own step goes down by less


def test_conjugate_gradients_solve_with_the_exact_tangent(monkeypatch):
    monkeypatch.setattr(tangent_module, "FORCING", 1e-10)
    model = strip()
    equations, x = Equilibrium(model), model.x0.copy()
    x += 1e-3 * np.random.default_rng(1).normal(size=len(x)) * equations.free
    tangent, g = equations.tangent, equations.gradient(x)[equations.free]
    assert equations.factor(x, False)[0] == 0
    expected = -tangent.solve(g)
    tangent._kept = 1  # as after an indefinite one
    d = tangent.step(x, equations.memory, g)
    assert_allclose(d, expected, atol=1e-6 * np.abs(expected).max())


def test_every_factorisation_has_a_purpose():
    result = qf.solve(qf.forming("hemisphere", size=10, travel=20), estimate=False)
    assert sum(result.purposes.values()) == result.linear_solves
    assert {"prediction", "balance", "friction", "check", "refused"} <= set(result.purposes)


def test_further_steps_of_one_factor_save_factorisations(monkeypatch):
    def solves():
        model = qf.forming("hemisphere", size=10, travel=40)
        return qf.solve(model, estimate=False).linear_solves

    few = solves()
    monkeypatch.setattr(newton, "FURTHER", 0)
    assert few < solves()


# The table of unknowns


class Coupled(qf.Term):
    """Positions and two scalars at the nodes of each triangle, coupled by a constant stiffness."""

    name = "coupled"
    quadratic = True

    def __init__(self, model, field):
        sheet = model.sheet
        nodes = sheet.blank.triangles
        both = np.concatenate([sheet.dofs, field.dofs], axis=1)
        self.dofs = both[nodes].reshape(len(nodes), -1)
        B = np.random.default_rng(0).normal(size=(4, self.dofs.shape[1]))
        self.K = 1e-6 * (B.T @ B + np.eye(B.shape[1]))
        self.x0 = model.x0[self.dofs]

    def energy(self, x, state):
        u = x[self.dofs] - self.x0
        return 0.5 * np.einsum("si,ij,sj->s", u, self.K, u)

    def gradient(self, x, state):
        return (x[self.dofs] - self.x0) @ self.K

    def hessian(self, x, state, convex):
        return np.repeat(self.K[None], len(self.dofs), axis=0)


def slipping(model):
    """Two scalars a node, as slip of warp and weft would be."""
    model.terms.append(Coupled(model, model.add("slip", 2, model.sheet)))


def nonzeros(model):
    equations = Equilibrium(model, "superlu")
    equations.factor(model.x0, True)
    return equations.tangent.solver._factor.nnz


def test_field_of_two_scalars_a_node_is_ordered_with_its_nodes():
    model = qf.forming("hemisphere", size=2.75)
    assert (~model.fixed).sum() > 9000
    plain, wider = nonzeros(model), nonzeros(model.including(slipping))
    assert wider <= 3.0 * plain


def test_field_without_places_is_eliminated_last_and_costs_far_more():
    model = qf.forming("hemisphere", size=6.0)
    last = model.including(slipping)
    last.unknowns.fields[-1] = replace(last.unknowns["slip"], places=None)
    assert nonzeros(last) > 4.0 * nonzeros(model)


def test_added_field_is_solved_transferred_and_part_of_the_residual():
    result = qf.refine(strip(size=10.0).including(slipping))
    slip = result.model.unknowns["slip"].of(result.states[-1].x)
    assert np.abs(slip).max() > 1e-3
    assert result.certified
    x = result.states[-1].x.copy()
    equations = Equilibrium(result.model)
    equations.travel = result.model.travel
    settled = equations.residual(equations.gradient(x))
    x[result.model.unknowns["slip"].dofs] += 10.0
    assert equations.residual(equations.gradient(x)) > 10 * settled


def test_names_of_fields_are_unique():
    model = strip()
    with pytest.raises(ValueError, match="there is a field 'sheet' already"):
        model.add("sheet", 1)


# The recipe


def thicker(model):
    model.membrane.volume *= 3.0


def test_model_changed_by_hand_is_solved_as_it_is_without_an_estimate():
    model = strip(size=10.0)
    assert not model.changed
    model.terms[0].volume *= 3.0
    assert model.changed
    plain, changed = qf.refine(strip(size=10.0)), qf.refine(model)
    assert changed.path is None
    assert changed.estimate["force_N"] is None
    assert any("not estimated" in entry for entry, _ in changed.description)
    assert_allclose(changed.force, 3.0 * plain.force, rtol=1e-3)
    assert_allclose(changed.states[1].force, 3.0 * plain.path.states[1].force, rtol=1e-2)


def test_change_in_the_recipe_is_there_on_every_mesh():
    result = qf.refine(strip(size=10.0).including(thicker))
    plain = qf.refine(strip(size=10.0))
    assert result.estimate["force_N"] == pytest.approx(3.0 * plain.estimate["force_N"], rel=1e-2)
    assert_allclose(result.path.states[-1].force, 3.0 * plain.path.states[-1].force, rtol=1e-3)


@pytest.mark.parametrize("change", ["x0", "fixed", "travel", "area", "measure", "term", "law"])
def test_any_change_by_hand_is_seen(change):
    model = qf.forming("hemisphere", size=20.0)
    if change == "x0":
        model.x0[5] += 1e-9
    elif change == "fixed":
        model.fixed[7] = True
    elif change == "travel":
        model.travel -= 1.0
    elif change == "area":
        model.areas["dome"] = ((0.0, 0.0), 5.0)
    elif change == "measure":
        model.measures["lift"] = lambda x: 0.0
    elif change == "term":
        model.terms.pop()
    else:
        model.membrane.fabric = replace(model.membrane.fabric, thickness=2.0)
    assert model.changed


def test_looking_at_a_model_does_not_change_it():
    model = qf.forming("hemisphere", size=20.0)
    repr(model), model.sheet.whole, model.sheet.blank.outline
    qf.solve(model, callback=lambda p: True, estimate=False)
    assert not model.changed


def test_recipe_can_be_written_read_and_hashed():
    for model in (
        strip(law="best-fit"),
        qf.forming("box", orientation=45.0, size=20.0).including(stitched),
        qf.cantilever(100.0, 1e-5),
        qf.picture_frame(),
    ):
        written = json.loads(json.dumps(model.recipe.written()))
        again = qf.Recipe.read(written)
        assert again.digest == model.recipe.digest
        assert hash(again) == hash(again)
        built = again.build()
        assert_array_equal(built.x0, model.x0)
        assert [t.name for t in built.terms] == [t.name for t in model.terms]
        assert [fingerprint(t.dofs) for t in built.terms] == [
            fingerprint(t.dofs) for t in model.terms
        ]


def test_recipe_builds_the_same_model_in_another_process():
    model = qf.forming("hemisphere", orientation=45.0, size=20.0)
    script = (
        "import json, sys, numpy as np, quasiform as qf\n"
        "model = qf.Recipe.read(json.load(sys.stdin)).build(25.0)\n"
        "print(model.recipe.digest, repr(model.x0.sum()), model.unknowns.size)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        input=json.dumps(model.recipe.written()),
        capture_output=True,
        text=True,
        check=True,
    )
    here = model.recipe.build(25.0)
    assert done.stdout.split() == [
        model.recipe.digest,
        *repr(here.x0.sum()).split(),
        str(here.unknowns.size),
    ]


def test_change_that_no_other_process_finds_is_refused_when_written():
    model = strip().including(lambda model: None)
    with pytest.raises(qf.InputError, match="define it in a module"):
        model.recipe.written()


@pytest.mark.parametrize("name", ["os:abort", "subprocess:run", "not_imported:change"])
def test_recipe_from_a_stranger_calls_nothing_else(name):
    written = strip().recipe.written()
    for bad in (
        written | {"builder": name},
        written | {"changes": [name]},
        written | {"given": written["given"] | {"fabric": {"read": name, "from": "x"}}},
    ):
        with pytest.raises(qf.InputError, match="is not called: import its module first"):
            qf.Recipe.read(bad)


def test_hand_built_model_has_no_recipe():
    model = strip()
    model.recipe = None
    assert model.changed
    with pytest.raises(ValueError, match="no recipe"):
        model.including(stitched)


# Work


def test_identical_runs_count_identical_work():
    counts = [
        qf.refine(qf.forming("hemisphere", size=10.0, travel=20.0)).factorisations for _ in range(2)
    ]
    assert counts[0] == counts[1]
    assert set(counts[0]) == {"10 mm", "14 mm", "5 mm"}
    assert all(isinstance(n, int) for n in counts[0].values())


def test_checkpoint_of_an_older_version_is_refused_with_one_line(tmp_path):
    head = json.dumps({"recipe": {"command": "form"}, "parameters": {}, "settings": {}})
    np.savez(tmp_path / "resume.npz", head=np.array(head), x=np.zeros(3))
    with pytest.raises(qf.InputError, match=r"a record of format 1, this version continues 2"):
        qf.Journal(tmp_path, resume=True)


def test_files_that_are_written_carry_their_format(tmp_path):
    qf.Fabric().save(tmp_path / "fabric.toml")
    assert (tmp_path / "fabric.toml").read_text().startswith("format = 2\n")
    assert qf.Fabric.load(tmp_path / "fabric.toml").shear == qf.Fabric().shear
    newer = (tmp_path / "fabric.toml").read_text().replace("format = 2", "format = 3")
    (tmp_path / "newer.toml").write_text(newer)
    with pytest.raises(qf.InputError, match=r"newer\.toml: format must be 1 or 2, got 3"):
        qf.Fabric.load(tmp_path / "newer.toml")
    assert scene_toml(load("hemisphere")).startswith("format = 2\n")
    assert "format" in json_schema()["properties"]


# What a user may get wrong is said in one line


class Wrong(SofteningYarns):
    wrong = ""

    def initial(self, x):
        state = super().initial(x)
        return {"array": state.kappa, "forgets": None}.get(self.wrong, state)

    def _secant(self, e, state):
        return super()._secant(e, state or self.start)

    def energy(self, x, state):
        energy = super().energy(x, state or self.start)
        return energy.sum() if self.wrong == "energy" else energy

    def commit(self, x, state):
        return super().commit(x, state or self.start)

    def gradient(self, x, state):
        gradient = super().gradient(x, state)
        return gradient[:, :2] if self.wrong == "gradient" else gradient

    def hessian(self, x, state, convex):
        state = state or self.start
        return super().hessian(x, state, convex)[:, : 2 if self.wrong == "hessian" else None]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("energy", r"its energy must be of shape \(\d+,\), got \(\)"),
        ("gradient", r"its gradient must be of shape \(\d+, 4\), got \(\d+, 2\)"),
        ("hessian", r"its hessian must be of shape \(\d+, 4, 4\), got \(\d+, 2, 4\)"),
        ("array", "its state must be a frozen dataclass of arrays or None, got ndarray"),
        ("forgets", "its state was NoneType and became Stretched"),
        ("far", "dofs must lie between 0 and"),
        ("float", "dofs must be whole numbers"),
    ],
)
def test_wrong_term_is_refused_with_one_line(wrong, message):
    model = strip().including(stitched)
    yarns = model.terms[-1]
    yarns.__class__, yarns.wrong, yarns.start = Wrong, wrong, yarns.initial(model.x0)
    if wrong == "far":
        yarns.dofs = yarns.dofs + 1000000
    if wrong == "float":
        yarns.dofs = yarns.dofs.astype(float)
    with pytest.raises(qf.InputError, match="term 'softening yarns': " + message):
        qf.solve(model)


def test_what_is_no_term_is_refused_with_one_line():
    model = strip()
    model.terms.append(lambda x: 0.0)
    with pytest.raises(qf.InputError, match="must be a Term, got function"):
        qf.solve(model)


class Stitching:
    def __call__(self, model):
        stitched(model)

    def method(self, model):
        stitched(model)


@pytest.mark.parametrize(
    "change",
    [partial(stitched), Stitching(), Stitching().method, wraps(thicker)(lambda m: stitched(m))],
)
def test_change_without_a_name_of_its_own_is_recorded_as_unfindable(change, tmp_path):
    model = strip().including(change)
    with pytest.raises(qf.InputError, match="cannot be found from another process"):
        model.recipe.written()
    straight = qf.solve(model, estimate=False)
    qf.solve(model, lambda p: p.travel > 8, out=tmp_path)
    resumed = qf.solve(model, out=tmp_path, resume=True, estimate=False)
    assert resumed.force == straight.force


def test_refine_without_a_folder_cannot_resume():
    with pytest.raises(qf.InputError, match="resume needs the folder of a run"):
        qf.refine(strip(), resume=True)


def test_unknown_field_is_named():
    with pytest.raises(KeyError, match="no field 'slip': there are sheet"):
        strip().unknowns["slip"]


def test_places_and_areas_of_a_field_fit():
    with pytest.raises(ValueError, match=r"places of 'slip' must be \(n, 2\), got \(3, 3\)"):
        strip().add("slip", 2, places=np.zeros((3, 3)))
    with pytest.raises(ValueError, match="areas of 'slip' must be one a place"):
        strip().add("slip", 2, places=np.zeros((3, 2)), areas=np.ones(2))


def one_by_node_without_places(model):
    slip = model.add("slip", len(model.sheet.blank.nodes))
    model.fixed[slip.dofs] = True


def test_field_without_places_that_grows_with_the_mesh_is_refused_by_refine():
    with pytest.raises(qf.InputError, match=r"'slip' has .* give it places"):
        qf.refine(strip(size=10.0).including(one_by_node_without_places))


def test_fingerprint_keeps_numbers_apart():
    assert fingerprint([1, 23]) != fingerprint([12, 3])


def test_recipe_with_a_mesh_is_read_from_another_folder(tmp_path, monkeypatch):
    blank = strip().sheet.blank
    points = np.pad(blank.nodes, ((0, 0), (0, 1)))
    meshio.Mesh(points, [("triangle", blank.triangles)]).write(tmp_path / "own.vtu")
    monkeypatch.chdir(tmp_path)
    recipe = strip(mesh="own.vtu").recipe
    written, digest = recipe.written(), recipe.digest
    monkeypatch.chdir("/")
    again = qf.Recipe.read(written)
    assert again.digest == digest
    assert_array_equal(again.build().sheet.blank.triangles, blank.triangles)
