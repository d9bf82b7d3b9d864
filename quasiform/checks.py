"""What the user gives, checked: every refusal is one line that names what was expected."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable, Iterable
from numbers import Real
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")


class InputError(ValueError):
    """Wrong input; the message is one line for the user (exit status 2 on the command line)."""


def check_number(name: str, value: Any, *, zero_allowed: bool = False) -> float:
    """Return `value` if it is a finite positive number, else raise InputError naming it."""
    number = isinstance(value, Real) and not isinstance(value, bool)
    number = number and abs(value) < 1e100  # refuses nan and inf too
    if not number or value < 0 or (value == 0 and not zero_allowed):
        expected = "a number of at least zero" if zero_allowed else "a positive number"
        raise InputError(f"{name} must be {expected}, got {value!r}")
    return value


def check_keys(table: Iterable[str], known: Iterable[str], where: str = "") -> None:
    """Raise InputError, with a suggestion, for the first key of `table` that is not `known`."""
    known = list(known)
    for key in table:
        if key not in known:
            prefix = f"[{where}] " if where else ""
            raise InputError(f"{prefix}unknown key '{key}': {suggestion(key, known)}")


def read_toml(path: str | Path, build: Callable[[dict[str, Any]], T]) -> T:
    """Build something from the table in a TOML file; every refusal names the file."""
    try:
        with open(path, "rb") as file:
            return build(tomllib.load(file))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, InputError) as error:
        raise InputError(f"{path}: {error}") from error


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return the nearest of the known words as a question, or all of them."""
    near = difflib.get_close_matches(word, known, n=1)
    return f"did you mean '{near[0]}'?" if near else f"expected one of {', '.join(known)}"
