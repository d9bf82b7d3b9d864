"""Keyword files from templates, in plain ASCII."""

from __future__ import annotations

import textwrap
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

FloatArray = np.ndarray
TEMPLATES = Path(__file__).with_name("templates")
NOTICES: dict[str, Any] = tomllib.loads((TEMPLATES / "notices.toml").read_text("utf-8"))
PLAIN = str.maketrans({"°": " deg", "²": "^2", "³": "^3", "γ": "gamma", "×": "x"})


def numbers(values: Iterable[float], digits: int = 9) -> str:
    """Join numbers by commas."""
    return ", ".join(f"{value:.{digits}g}" for value in values)


def rows(labels: Iterable[int], values: Iterable[Any]) -> str:
    """Lines of a label and its numbers."""
    both = zip(labels, values, strict=True)
    return "\n".join(f"{label}, {numbers(np.atleast_1d(row))}" for label, row in both)


def elements(labels: Iterable[int], corners: Iterable[Iterable[int]]) -> str:
    """Lines of a label and the labels of its nodes."""
    both = zip(labels, corners, strict=True)
    return "\n".join(", ".join(map(str, [label, *nodes])) for label, nodes in both)


def in_lines(words: Iterable[object], most: int = 16) -> str:
    """Lines of at most `most` words each: labels of a set, constants of a material."""
    words = list(map(str, words))
    return "\n".join(", ".join(words[k : k + most]) for k in range(0, len(words), most))


def plain(text: str) -> str:
    """Return a text in ASCII."""
    return text.translate(PLAIN).encode("ascii", "replace").decode()


def comment(lines: Iterable[str]) -> str:
    """Comment lines of at most 80 characters."""
    wrapped = [part for line in lines for part in textwrap.wrap(plain(line), 76) or [""]]
    return "\n".join(f"** {part}" for part in wrapped)


def render(template: str, **values: Any) -> str:
    """Fill a template of the folder `templates`."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        filter.__name__: filter for filter in (numbers, rows, elements, in_lines, comment)
    }
    return environment.get_template(template).render(values)


def fill(template: str, path: Path, **values: Any) -> None:
    """Write a template in ASCII, without its empty lines."""
    lines = (plain(line) for line in render(template, **values).splitlines() if line.strip())
    path.write_text("\n".join([*lines, ""]), encoding="ascii")


def write_notices(path: Path, title: str, notices: Iterable[str]) -> None:
    """Write a title and a list of notices as text."""
    lines = [title, "", *(f"- {notice}" for notice in notices), ""]
    path.write_text("\n".join(lines), encoding="utf-8")
