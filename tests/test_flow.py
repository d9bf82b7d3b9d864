"""The flow of the house is one-way: a room imports from earlier rooms only."""

import ast
from importlib.util import resolve_name
from pathlib import Path

import pytest

import quasiform

# Each line may import from the lines above it, and a folder from itself.
FLOW = """
    checks
    schema tables toml_file
    theory
    fabric net
    tools
    scenes.scene_file
    energy
    result.measures result.files
    model
    result.run
    solve
    scenes
    draw.plot
    comparison identification
    result.saved
    draw handover
    console
    __main__
"""
ROOMS = {room: level for level, line in enumerate(FLOW.split("\n")) for room in line.split()}
ALONE = "theory"  # closed forms, which know nothing of the package
DEFERRED = {("result", "plot")}  # pictures are asked for by `save`, not when loading


def modules():
    """Path of each module of the package by its dotted name; the package itself left out."""
    folder = Path(quasiform.__file__).parent
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(folder).with_suffix("").parts
        if parts != ("__init__",):
            yield ".".join(["quasiform", *parts]).removesuffix(".__init__"), path


MODULES = dict(modules())
every_module = pytest.mark.parametrize("module", MODULES)


def room(module):
    return module.split(".")[1]


def imported(module, *, deferred):
    """Modules of the package that `module` imports when loaded or, with `deferred`, ever."""
    path = MODULES[module]
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    nodes, names = [ast.parse(path.read_text(encoding="utf-8"))], set()
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = resolve_name("." * node.level + (node.module or ""), package)
            names.update(f"{base}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        elif deferred or not isinstance(node, ast.FunctionDef):
            nodes += ast.iter_child_nodes(node)
    names = {name if name in MODULES else name.rpartition(".")[0] for name in names}
    return {name for name in names if name.split(".")[0] == "quasiform"}


@every_module
def test_module_has_a_place_in_the_flow(module):
    assert room(module) in ROOMS


@every_module
def test_imports_come_from_earlier_rooms(module):
    for target in imported(module, deferred=True):
        assert target in MODULES, f"{module} imports {target}"
        here, there = room(module), room(target)
        if here != there and (here, there) not in DEFERRED:
            assert ROOMS[there] < ROOMS[here], f"{module} imports {target}"


def test_closed_forms_stand_alone():
    assert not imported(f"quasiform.{ALONE}", deferred=True)


def test_exceptions_are_needed_and_stay_out_of_loading():
    for here, there in DEFERRED:
        module, target = f"quasiform.{here}", f"quasiform.{there}"
        assert target in imported(module, deferred=True)
        assert target not in imported(module, deferred=False)


def test_imports_run_in_no_circle():
    waiting = {module: imported(module, deferred=False) for module in MODULES}
    while waiting:
        ready = [module for module, needs in waiting.items() if not needs & waiting.keys()]
        assert ready, f"a circle among {', '.join(waiting)}"
        for module in ready:
            del waiting[module]


def test_walk_finds_every_form_of_import():
    def found(module):
        return imported(f"quasiform.{module}", deferred=False)

    assert "quasiform.checks" in found("material")
    assert "quasiform.scene_file" in found("forming")  # from . import scene_file
    assert "quasiform.outline" in found("scene_file")  # from . import outline as outlines
    assert "quasiform.energy.contact" in found("energy.friction")  # from .contact import Contact
    assert "quasiform.energy" in found("solve.newton")  # from ..energy import Potential
    assert "quasiform.solve" in found("cli")
