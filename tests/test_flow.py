"""The structure of the package: rooms in one direction, no circles, small classes and functions."""

import ast
import re
from importlib.util import resolve_name
from pathlib import Path

import pytest

import quasiform

ROOT = Path(__file__).parents[1]
TABLE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| ((?:`\w+`(?:, )?)+) \|", TABLE.split("## The rooms")[1], re.MULTILINE)
ROOMS = {name: level for level, row in enumerate(ROWS) for name in re.findall(r"\w+", row)}
ALONE = "theory"  # closed forms, which know nothing of the package
LATER = {("result", "draw")}  # a result can be saved with its pictures
LARGEST_CLASS, LARGEST_FUNCTION, MOST_LARGE = 250, 60, 5  # lines, lines of code, functions


def modules():
    """Path of each module of the package by its dotted name; the package itself left out."""
    folder = Path(quasiform.__file__).parent
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(folder).with_suffix("").parts
        if parts not in (("__init__",), ("__main__",)):
            yield ".".join(["quasiform", *parts]).removesuffix(".__init__"), path


MODULES = dict(modules())
TREES = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in MODULES.items()}
every_module = pytest.mark.parametrize("module", MODULES)


def room(module):
    return module.split(".")[1]


def imports(module):
    """(module, name) of every import of the package, also in functions and for type checkers."""
    package = module if MODULES[module].name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = resolve_name("." * node.level + (node.module or ""), package)
            for alias in node.names:
                inner = f"{base}.{alias.name}"
                yield (inner, "") if inner in MODULES else (base, alias.name)


def imported(module):
    """Modules of the package that `module` ever imports."""
    names = {name for name, _ in imports(module) if name.split(".")[0] == "quasiform"}
    return names - {"quasiform"} if room(module) == "console" else names  # as a user would


@every_module
def test_module_has_a_place_in_the_table_of_rooms(module):
    assert room(module) in ROOMS


@every_module
def test_imports_come_from_earlier_rooms(module):
    for target in imported(module):
        assert target in MODULES, f"{module} imports {target}"
        here, there = room(module), room(target)
        if here != there and (here, there) not in LATER:
            assert ROOMS[there] <= ROOMS[here], f"{module} imports {target}"


def test_closed_forms_stand_alone():
    assert not imported(f"quasiform.{ALONE}")


def test_imports_run_in_no_circle():
    waiting = {module: imported(module) - {module} for module in MODULES}
    while waiting:
        ready = [module for module, needs in waiting.items() if not needs & waiting.keys()]
        assert ready, f"a circle among {', '.join(waiting)}"
        for module in ready:
            del waiting[module]


@every_module
def test_private_names_stay_in_their_room(module):
    used = {f"{base}.{name}" for base, name in imports(module) if name.startswith("_")}
    foreign = {name for name in used if room(name) != room(module)}
    assert not foreign


def lines_of_code(function):
    """Lines of a function without its docstring."""
    body = function.body[1:] if ast.get_docstring(function) is not None else function.body
    return body[-1].end_lineno - body[0].lineno + 1 if body else 0


def test_classes_and_functions_are_small():
    classes, functions = [], []
    for module, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                size = node.end_lineno - node.lineno + 1
                classes += [f"{module}.{node.name}: {size}"] * (size > LARGEST_CLASS)
            elif isinstance(node, ast.FunctionDef):
                size = lines_of_code(node)
                functions += [f"{module}.{node.name}: {size}"] * (size > LARGEST_FUNCTION)
    assert not classes
    assert len(functions) <= MOST_LARGE, functions


def test_walk_finds_every_form_of_import():
    assert "quasiform.scenes.scene_file" in imported("quasiform.scenes.forming")  # from . import
    assert "quasiform.energy.contact" in imported("quasiform.energy.friction")  # from .contact
    assert "quasiform.energy.term" in imported("quasiform.solve.proximal")  # from ..energy.term
    assert "quasiform.draw.plot" in imported("quasiform.result.run")  # in a function
    assert ("quasiform.tools.shapes", "Tool") in set(imports("quasiform.scenes.forming"))
