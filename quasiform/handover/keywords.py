"""Lines of keyword files: labels, numbers, sets and comments in plain ASCII."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

FloatArray = np.ndarray
PLAIN = str.maketrans({"°": " deg", "²": "^2", "³": "^3", "γ": "gamma", "×": "x"})


def numbers(values: Iterable[float], digits: int = 9) -> str:
    """Join numbers by commas."""
    return ", ".join(f"{value:.{digits}g}" for value in values)


def rows(labels: Iterable[int], values: FloatArray) -> Iterator[str]:
    """Lines of a label and its numbers."""
    for label, row in zip(labels, values, strict=True):
        yield f"{label}, {numbers(np.atleast_1d(row))}"


def elements(labels: Iterable[int], corners: Iterable[Iterable[int]]) -> Iterator[str]:
    """Lines of a label and the labels of its nodes."""
    for label, nodes in zip(labels, corners, strict=True):
        yield ", ".join(map(str, [label, *nodes]))


def in_lines(words: Iterable[object], most: int = 16) -> Iterator[str]:
    """Lines of at most `most` words each: labels of a set, constants of a material."""
    words = list(map(str, words))
    for first in range(0, len(words), most):
        yield ", ".join(words[first : first + most])


def plain(line: str) -> str:
    """Return a line in ASCII."""
    return line.translate(PLAIN).encode("ascii", "replace").decode()


def comment(lines: Iterable[str]) -> list[str]:
    """Comment lines of at most 80 characters."""
    return [f"** {part}" for line in lines for part in textwrap.wrap(plain(line), 76) or [""]]


def write(path: Path, lines: Iterable[str]) -> None:
    """Write lines into a file, in ASCII."""
    path.write_text("\n".join([*map(plain, lines), ""]), encoding="ascii")


def write_notices(path: Path, title: str, notices: Iterable[str]) -> None:
    """Write a title and a list of notices as text."""
    lines = [title, "", *(f"- {notice}" for notice in notices), ""]
    path.write_text("\n".join(lines), encoding="utf-8")
