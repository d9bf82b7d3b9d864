"""A recipe: all that a model is built from, so that the same one is built at any size, anywhere.

It is frozen, hashable, and can be written down and read back: the kind of scene, what was given
for it, and the changes that a user has made, each a function of the model.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import singledispatch
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

from .checks import InputError
from .fabric import Fabric
from .fingerprint import fingerprint
from .model import Model

Builder = Callable[..., Model]
Change = Callable[[Model], None]


@dataclass(frozen=True)
class Recipe:
    """What a model is built from.

    Parameters
    ----------
    builder : callable
        Takes `size`, `like` (a model of this recipe, with tools to use again) and what is given.
    given : tuple of (name, value)
        Numbers, text, None, and what `plain` can write.
    size : float
        That was asked for, mm.
    changes : tuple of callables
        Called one after the other with the model.
    """

    builder: Builder
    given: tuple[tuple[str, Any], ...]
    size: float
    changes: tuple[Change, ...] = ()

    def build(self, size: float | None = None, like: Model | None = None) -> Model:
        """Build the model at its size or another, mm; the tools of a model `like` it are used."""
        size = self.size if size is None else size
        model = self.builder(size=size, like=like, **dict(self.given))
        for change in self.changes:
            change(model)
        model.recipe = self
        model.built = fingerprint(model)
        return model

    def including(self, change: Change) -> Recipe:
        """Return the recipe with one more change."""
        return replace(self, changes=(*self.changes, change))

    def written(self) -> dict[str, Any]:
        """Return it in numbers and text; InputError if another process cannot find a change."""
        given = {name: plain(value) for name, value in self.given}
        changes = [reference(change) for change in self.changes]
        builder = reference(self.builder)
        return {"builder": builder, "given": given, "size": self.size, "changes": changes}

    @staticmethod
    def read(written: Mapping[str, Any]) -> Recipe:
        """Return the recipe that was written down; InputError if it is none or lacks a part."""
        try:
            given = tuple((name, _live(value)) for name, value in written["given"].items())
            changes = tuple(_found(name, ours=False) for name in written["changes"])
            return Recipe(_found(written["builder"]), given, float(written["size"]), changes)
        except InputError:
            raise
        except (KeyError, TypeError, AttributeError, ValueError, ImportError) as error:
            raise InputError(f"not a recipe of a model: {error}") from error

    def files(self) -> dict[str, str]:
        """SHA-256 of every file that it names, by path."""
        paths = []
        for _, value in self.given:
            paths += [value] if isinstance(value, Path) else getattr(value, "files", list)()
        return checksums(paths)

    @property
    def digest(self) -> str:
        """SHA-256 of all of it, with the contents of the files that it names."""
        content = json.dumps([self.written(), self.files()], sort_keys=True)
        return sha256(content.encode()).hexdigest()

    def __hash__(self) -> int:
        return hash((self.builder, repr(self.given), self.size, self.changes))


def checksums(paths: Iterable[str | Path]) -> dict[str, str]:
    """SHA-256 of files by their absolute paths; those that are not there are left out."""
    there = [path for path in map(Path.absolute, map(Path, paths)) if path.is_file()]
    return {str(path): sha256(path.read_bytes()).hexdigest() for path in there}


def built(builder: Builder, size: float, **given: Any) -> Model:
    """Build a model with its recipe."""
    return Recipe(builder, tuple(sorted(given.items())), size).build()


def reference(function: Callable[..., Any]) -> str:
    """Module and name of a function, by which another process finds it."""
    module = getattr(function, "__module__", None) or "__main__"
    name = getattr(function, "__qualname__", repr(function))
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    # a partial, a method or a wrapped function has no name by which it alone is found
    if module == "__main__" or found != function:
        raise InputError(
            f"'{name}' cannot be found from another process: define it in a module of its own"
        )
    return f"{module}:{name}"


def _found(reference: str, ours: bool = True) -> Callable[..., Any]:
    """Function of that name: one of this package, or a user's own that is imported already.

    So a record from a stranger calls nothing else.
    """
    module, _, name = reference.partition(":")
    package = module.partition(".")[0]
    if package != __package__ and (
        ours or package in sys.stdlib_module_names or module not in sys.modules
    ):
        raise InputError(f"'{reference}' is not called: import its module first, from Python")
    found: Any = import_module(module)
    for part in name.split("."):
        found = getattr(found, part)
    return found


@singledispatch
def plain(value: Any) -> Any:
    """Return a value as numbers and text, or {"read": reference of a function, "from": ...}."""
    return value


@plain.register
def _(value: Path) -> dict[str, Any]:
    return {"path": str(value.absolute())}


@plain.register
def _(value: Fabric) -> dict[str, Any]:
    return {"read": reference(Fabric.read), "from": value.written()}


def _live(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return Path(value["path"]) if "path" in value else _found(value["read"])(value["from"])
