"""Checks of what the user gives: every refusal is one line that names what was expected."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from errno import EISDIR
from importlib import import_module
from math import floor, log10
from numbers import Real
from os import strerror
from pathlib import Path
from stat import S_ISDIR, S_ISREG
from typing import Any

LONGEST = 400  # characters of a message

FORMAT = 2  # of every file that is written; those of version 0.1.0 carry none


def force_column(travel: str) -> str:
    """Column of the derivative of the energy by a travel in mm, or by a load factor.

    Examples
    --------
    >>> force_column("travel_mm"), force_column("load_factor")
    ('force_N', 'load_work_mJ')
    """
    return "force_N" if travel.endswith("_mm") else "load_work_mJ"


def round_length(length: float) -> float:
    """Return the 1, 2 or 5 times a power of ten that is nearest to a length, by their ratio.

    >>> [round_length(length) for length in (6.4, 0.64, 3.0, 8.0)]
    [5.0, 0.5, 2.0, 10.0]
    """
    power = floor(log10(length))
    known = [digit * 10.0**power for digit in (1, 2, 5, 10)]
    return min(known, key=lambda value: abs(log10(value / length)))


def number(value: float, digits: int = 4, zero: float = 0.0) -> str:
    """A number to some significant digits, without an exponent where people write none.

    What is smaller than `zero` is written as 0.

    Examples
    --------
    >>> number(112.3, 2), number(0.01234), number(123456.0), number(48.4346), number(-1e-5, 4, 1e-3)
    ('110', '0.01234', '123500', '48.43', '0')
    """
    return "0" if abs(value) < zero else f"{float(f'{value:.{digits}g}'):.15g}"


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
def interruptible() -> Iterator[None]:
    """Raise the Ctrl-C that arrived in compiled code, which reports it as a SystemError."""
    try:
        yield
    except SystemError as error:
        cause: BaseException | None = error
        while isinstance(cause, SystemError):  # one for each call of compiled code it came through
            cause = cause.__cause__
        if isinstance(cause, KeyboardInterrupt):
            raise cause from None
        raise


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Name the file, once, in every refusal."""
    try:
        yield
    except (OSError, UnicodeDecodeError, InputError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        if not reason.startswith(f"{path}: "):
            reason = f"{path}: {reason}"
        raise InputError(reason) from error
