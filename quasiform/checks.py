"""What the user gives, checked: every refusal is one line that names what was expected."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from errno import EISDIR
from importlib import import_module
from numbers import Real
from os import strerror
from pathlib import Path
from stat import S_ISDIR, S_ISREG
from typing import Any, TypeVar

T = TypeVar("T")
LONGEST = 400  # characters of a message
BIGGEST = 10_000_000  # bytes of a TOML file
DEEPEST = 30  # tables and lists in each other


class InputError(ValueError):
    """Wrong input; the message is one line for the user (exit status 2 on the command line).

    What it cites from a file may be anything: it is shortened in the middle, and characters that
    would move the cursor or break the line are shown by their codes.
    """

    def __str__(self) -> str:
        message = " ".join(super().__str__().split())
        if len(message) > LONGEST:
            message = f"{message[: LONGEST // 2]} ... {message[-LONGEST // 2 :]}"
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in message)


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


def check_file(path: str | Path) -> None:
    """Refuse what is no regular file: a pipe or a device in its place may never end.

    Raises
    ------
    OSError
        If there is nothing, or a folder.
    InputError
    """
    try:
        mode = Path(path).stat().st_mode
        if S_ISDIR(mode):
            raise IsADirectoryError(EISDIR, strerror(EISDIR))
        if not S_ISREG(mode):
            raise InputError("not a regular file")
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"not the name of a file: {str(path)!r}") from error  # a null character


def read_toml(path: str | Path, build: Callable[[dict[str, Any]], T]) -> T:
    """Build something from the table in a TOML file; every refusal names the file."""
    with naming(path):
        return build(_toml(path))


def _toml(path: str | Path) -> dict[str, Any]:
    """Table of a TOML file that is not meant to hold up its reader."""
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
    level: list[Any] = [table]
    for _ in range(DEEPEST):
        level = [
            inner
            for outer in level
            for inner in (outer.values() if isinstance(outer, dict) else outer)
            if _holds_more(inner)
        ]
    if level:
        raise InputError(f"tables and lists nested deeper than {DEEPEST}")
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


def _holds_more(value: Any) -> bool:
    """Whether a value of TOML is a table or list; refuse numbers beyond its 64 bits."""
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise InputError("an integer that does not fit into 64 bits")
    return isinstance(value, dict | list)


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return the nearest of the known words as a question, or all of them."""
    near = difflib.get_close_matches(word, known, n=1)
    return f"did you mean '{near[0]}'?" if near else f"expected one of {', '.join(known)}"


def optional(module: str, extra: str, need: str) -> Any:
    """Import an optional package, or say how to install it."""
    try:
        return import_module(module)
    except (ImportError, OSError) as error:  # OSError: gmsh without the system's libraries
        raise InputError(f"{need}: pip install 'quasiform[{extra}]'") from error


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Name the file in every refusal."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
