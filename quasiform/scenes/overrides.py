"""Other values for keys of a scene file, by their dotted names.

`tools.holder.mass`, `fabric.friction`, `blank.holes.1.radius` (entries of a list are counted from
1); `orientation`, `size` and `mesh` are those of the blank.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

from ..checks import InputError, suggestion

OF_THE_BLANK = ("orientation", "size", "mesh")
MADE = ("fabric", "increments", "outputs", "run", "areas")  # tables that a file may leave out


def overridden(table: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of a scene file with other values.

    The last part of a name may be a new key, which the schema of the scene then checks.

    Raises
    ------
    InputError
        If there is no such table, with the nearest name.

    Examples
    --------
    >>> overridden({"tools": {"holder": {"mass": 5.0}}}, {"tools.holder.mass": 8.0})
    {'tools': {'holder': {'mass': 8.0}}}
    """
    table = deepcopy(dict(table))
    for name, value in sorted(overrides.items(), key=lambda pair: pair[0] != "law"):
        if name == "law":
            table.pop("fabric", None)
        elif name.startswith("fabric.") and "fabric" not in table:
            table.setdefault("law", "locking")
        parts = ["blank", name] if name in OF_THE_BLANK else name.split(".")
        here: Any = table
        for i, part in enumerate(parts[:-1]):
            if (i == 0 and part in MADE) or parts[0] == "fabric":  # which checks its own keys
                here.setdefault(part, {})
            here = _inner(here, part, name)
        here[_key(here, parts[-1], name)] = value
    return table


def merged(table: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table with the keys of another one over its own, in tables of it likewise."""
    found = dict(table)
    for key, value in over.items():
        inner = found.get(key)
        both = isinstance(inner, Mapping) and isinstance(value, Mapping)
        found[key] = merged(inner, value) if both else value
    return found


def _inner(table: Any, part: str, name: str) -> Any:
    inner = table[_key(table, part, name, there=True)]
    if not isinstance(inner, dict | list):
        raise InputError(f"{name}: '{part}' is a value, not a table")
    return inner


def _key(table: Any, part: str, name: str, there: bool = False) -> Any:
    """Key or index of a part of a name; with `there` it has to exist."""
    if isinstance(table, list):
        if not part.isdecimal() or not 1 <= int(part) <= len(table):
            raise InputError(f"{name}: expected a number from 1 to {len(table)}, got '{part}'")
        return int(part) - 1
    if there and part not in table:
        tables = [k for k, v in table.items() if isinstance(v, dict | list) and "value" not in v]
        remedy = f": {suggestion(part, tables)}" if tables else ""
        raise InputError(f"{name}: there is no '{part}' in the scene{remedy}")
    return part
