"""TOML files: read within limits, and written."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Mapping
from numbers import Integral
from pathlib import Path
from typing import Any, TypeVar

from .checks import FORMAT, InputError, check_file, naming

T = TypeVar("T")
BIGGEST = 10_000_000  # bytes of a file
DEEPEST = 30  # tables and lists in each other


def read_toml(path: str | Path, build: Callable[[dict[str, Any]], T]) -> T:
    """Build something from the table in a TOML file; every refusal names the file."""
    with naming(path):
        return build(without_format(_toml(path)))


def without_format(table: dict[str, Any]) -> dict[str, Any]:
    """Return a table without the number of its format, if that is one that is known."""
    given = table.pop("format", FORMAT)
    if given not in (1, FORMAT):
        raise InputError(f"format must be 1 or {FORMAT}, got {given!r}")
    return table


def _toml(path: str | Path) -> dict[str, Any]:
    """Table of a TOML file; refuse one that would take very long to read."""
    check_file(path)
    if Path(path).stat().st_size > BIGGEST:
        raise InputError(f"larger than {BIGGEST / 1e6:g} MB")
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")
        # the time that tomllib takes for a dotted key grows with the square of its parts
        for word in text.replace(" ", "").replace("\t", "").split("\n"):
            if word.count(".") > 20 * DEEPEST and _parts(word) > 10 * DEEPEST:
                raise InputError(f"a key of more than {10 * DEEPEST} parts")
        table = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"tables and lists nested deeper than {DEEPEST}") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{error}{_decimal_comma(text, str(error))}") from error
    except ValueError as error:  # of the encoding, of TOML, or of a number with too many digits
        raise InputError(str(error)) from error
    _check(table)
    return table


def _decimal_comma(text: str, error: str) -> str:
    """Point to a comma in a number, where it is what TOML stumbles over."""
    at = re.search(r"at line (\d+)", error)
    line = text.split("\n")[int(at[1]) - 1] if at else ""
    comma = re.search(r"=\s*([+-]?\d+),(\d+)\s*(?:[#,}]|$)", line)
    return f": with a decimal point, {comma[1]}.{comma[2]}" if comma else ""


def _parts(line: str) -> int:
    """Largest number of parts that dots join, blanks left out."""
    words = line.translate(str.maketrans(",[]{}=#", " " * 7)).split()
    return max(sum(map(bool, word.split("."))) for word in words)


def _check(value: Any, depth: int = 0) -> None:
    """Refuse what is nested too deep, and numbers beyond the 64 bits of TOML."""
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise InputError("an integer that does not fit into 64 bits")
    if isinstance(value, dict | list):
        if depth == DEEPEST:
            raise InputError(f"tables and lists nested deeper than {DEEPEST}")
        for inner in value.values() if isinstance(value, dict) else value:
            _check(inner, depth + 1)


def dotted_values(value: Any, name: str = "") -> dict[str, Any]:
    """Values in a table by their dotted names, entries of lists of tables counted from 1.

    >>> dotted_values({"blank": {"holes": [{"radius": 3.0}]}})
    {'blank.holes.1.radius': 3.0}
    """
    if isinstance(value, list) and any(isinstance(entry, Mapping) for entry in value):
        value = {str(i): entry for i, entry in enumerate(value, 1)}
    if not isinstance(value, Mapping):
        return {name: value}
    found: dict[str, Any] = {}
    for key, inner in value.items():
        found |= dotted_values(inner, f"{name}.{key}" if name else key)
    return found


def toml_text(table: Mapping[str, Any], comments: Mapping[str, str] | None = None) -> str:
    """Return a table as the text of a TOML file; lists of tables and tables come last.

    The number of the format comes first; a comment stands behind its key on one line.
    """
    lines = _lines({"format": FORMAT, **table}, (), comments or {})
    return "\n".join(lines).lstrip("\n") + "\n"


def _lines(table: Mapping[str, Any], at: tuple[str, ...], comments: Mapping[str, str]) -> list[str]:
    values, tables = [], []
    for key, value in table.items():
        path, comment = (*at, key), comments.get(key, "")
        comment = comment and f"  # {''.join(c if c.isprintable() else ' ' for c in comment)}"
        name = ".".join(map(_key, path))
        nested = isinstance(value, Mapping) and len(path) < 3
        if nested and not {"value", "standing"} <= value.keys():
            start = f"{key}."
            within = {k[len(start) :]: v for k, v in comments.items() if k.startswith(start)}
            inner = _lines(value, path, within)
            header = [] if inner and inner[0].startswith("\n[") else [f"\n[{name}]{comment}"]
            tables += header + inner
        elif value and isinstance(value, list) and all(isinstance(v, Mapping) for v in value):
            for entry in value:
                tables += [f"\n[[{name}]]", *_lines(entry, path, {})]
        else:
            values.append(f"{_key(key)} = {_value(value)}{comment}")
    return values + tables


def _key(name: str) -> str:
    return name if re.fullmatch("[A-Za-z0-9_-]+", name) else _value(name)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, str):  # the escapes of JSON are TOML's, which has one more to make
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return str(value).lower()
    return repr(int(value) if isinstance(value, Integral) else float(value))
