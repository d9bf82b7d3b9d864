"""What a user may call is described: public names, parameters with their units, returns.

The docstrings are numpydoc. A parameter counts as described by its own text, or by a type that says
it all (`Model`, `str or Fabric`, a choice in quotes).
"""

import inspect
import re
from functools import cached_property

import pytest

import quasiform as qf

ATTRIBUTE = property | cached_property
TYPED = re.compile(
    r"Model|Sheet|Recipe|Blank|Fabric|Result|Campaign|Journal|Progress|Comparison|Shape|path|\""
)
UNITS = re.compile(
    r"\b(mm²?|N|MPa|mJ|kg|s|degrees?|radians|g/m²|mm/|N/mm[²³]?|unit|coefficient|factor|share|"
    r"fraction|relative|dimensionless|times|count|percent)\b|°|%|1/mm"
)


def described(text):
    """Names under Parameters (or Attributes) of a docstring with their type and description."""
    section = re.search(r"^Parameters\n-+\n(.*?)(?=^\w[\w ]*\n-+\n|\Z)", text, re.S | re.M)
    found = {}
    for entry in re.split(r"\n(?=\S)", section[1].rstrip() if section else ""):
        head, _, body = entry.partition("\n")
        names, _, kind = head.partition(" : ")
        for name in names.split(","):
            found[name.strip().lstrip("*")] = (kind.strip(), " ".join(body.split()))
    return found


def public():
    """Public callables by name: the functions and classes of the package, and their methods."""
    for name in qf.__all__:
        thing = inspect.unwrap(getattr(qf, name))  # the package `solve` is called like its function
        yield name, thing
        if inspect.isclass(thing) and not issubclass(thing, Exception):
            for key, member in vars(thing).items():
                if not key.startswith("_") and (
                    inspect.isfunction(member) or isinstance(member, ATTRIBUTE)
                ):
                    yield f"{name}.{key}", member


CALLABLES = dict(public())
SIGNED = {
    name: thing
    for name, thing in CALLABLES.items()
    if not isinstance(thing, ATTRIBUTE) and not (inspect.isclass(thing) and name.endswith("Error"))
}


@pytest.mark.parametrize("name", CALLABLES)
def test_is_described(name):
    text = inspect.getdoc(CALLABLES[name])
    assert text, f"{name} has no docstring"
    assert text.split("\n")[0].endswith((".", ":", "::")), f"{name}: {text.splitlines()[0]!r}"


@pytest.mark.parametrize("name", SIGNED)
def test_parameters_are_described(name):
    thing = SIGNED[name]
    known = described(inspect.getdoc(thing))
    given = [
        parameter
        for parameter in inspect.signature(thing).parameters.values()
        if parameter.name != "self"
    ]
    one_liner = "\n" not in inspect.getdoc(thing)
    for parameter in given:
        where = f"{name}({parameter.name})"
        assert parameter.annotation is not inspect.Parameter.empty, f"{where}: no type hint"
        if one_liner and "." in name:  # a method in one line names what it takes there
            continue
        assert parameter.name in known, f"{where}: not among the parameters"
        kind, body = known[parameter.name]
        assert body or TYPED.search(kind), f"{where}: no description"
        hint = str(parameter.annotation)
        if "float" in hint and not re.search("Callable|dict|Mapping", hint):
            assert UNITS.search(f"{kind} {body}"), f"{where}: no unit"
    if given and not one_liner:
        extra = set(known) - {parameter.name for parameter in given}
        assert not extra, f"{name}: describes {extra}, which it does not take"


@pytest.mark.parametrize("name", [n for n in SIGNED if inspect.isfunction(SIGNED[n])])
def test_returns_are_told(name):
    thing = SIGNED[name]
    hint = inspect.signature(thing).return_annotation
    assert hint is not inspect.Signature.empty, f"{name}: no type hint of what it returns"
    text = inspect.getdoc(thing)
    if "." not in name and hint not in (None, "None"):
        assert "Returns\n-" in text, f"{name}: what it returns is not told"


def test_help_names_everything():
    """`help(qf)` begins with how to use it, and lists every public name."""
    import pydoc

    text = pydoc.plain(pydoc.render_doc(qf))
    assert "qf.solve(" in text[:1500]
    for name in qf.__all__:
        assert re.search(rf"\b{name}\b", text)
