"""A recipe: all that a model is built from, so that the same one is built at any size, anywhere.

It is frozen, hashable, and can be written down and read back: the kind of scene, what was given
for it, and the changes that a user has made, each a function of the model.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
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
    """What a model is built from."""

    builder: Builder  # takes `size`, `like` (a model of this recipe with tools to use again), ...
    given: tuple[tuple[str, Any], ...]  # ... and what is given by name, which `plain` can write
    size: float  # that was asked for, mm
    changes: tuple[Change, ...] = ()  # called one after the other with the model

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
        return replace(self, changes=(*self.changes, change))

    def written(self) -> dict[str, Any]:
        """Return the recipe as plain numbers and text, for JSON.

        Raises InputError if a change cannot be found by its name in another process.
        """
        given = {name: plain(value) for name, value in self.given}
        changes = [reference(change) for change in self.changes]
        builder = reference(self.builder)
        return {"builder": builder, "given": given, "size": self.size, "changes": changes}

    @staticmethod
    def read(written: Mapping[str, Any]) -> Recipe:
        """Return the recipe that was written down.

        Raises InputError if it is not one, or a change is not there any more.
        """
        try:
            given = tuple((name, _live(value)) for name, value in written["given"].items())
            changes = tuple(_found(name) for name in written["changes"])
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
        return {str(path): sha256(Path(path).read_bytes()).hexdigest() for path in paths}

    @property
    def digest(self) -> str:
        """SHA-256 of all of it, with the contents of the files that it names."""
        content = json.dumps([self.written(), self.files()], sort_keys=True)
        return sha256(content.encode()).hexdigest()

    def __hash__(self) -> int:
        return hash((self.builder, repr(self.given), self.size, self.changes))


def built(builder: Builder, size: float, **given: Any) -> Model:
    """Build a model with its recipe."""
    return Recipe(builder, tuple(sorted(given.items())), size).build()


def reference(function: Callable[..., Any]) -> str:
    """Module and name of a function, by which another process finds it."""
    module, name = function.__module__, function.__qualname__
    if module == "__main__" or "<" in name:
        raise InputError(
            f"'{name}' cannot be found from another process: define it in a module of its own"
        )
    return f"{module}:{name}"


def _found(reference: str) -> Callable[..., Any]:
    module, _, name = reference.partition(":")
    found: Any = import_module(module)
    for part in name.split("."):
        found = getattr(found, part)
    if not callable(found):
        raise InputError(f"'{reference}' is not a function")
    return found


@singledispatch
def plain(value: Any) -> Any:
    """Return a value as numbers and text, or {"read": reference of a function, "from": ...}."""
    return value


@plain.register
def _(value: Path) -> dict[str, Any]:
    return {"read": reference(Path), "from": str(value)}


@plain.register
def _(value: Fabric) -> dict[str, Any]:
    return {"read": reference(Fabric.read), "from": value.written()}


def _live(value: Any) -> Any:
    return _found(value["read"])(value["from"]) if isinstance(value, dict) else value
