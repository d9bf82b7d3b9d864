"""Shell elements of an Abaqus or CalculiX input file, with its parts and instances.

A part that is placed by one *INSTANCE is moved there; one that is placed twice would give two
elements one label and is refused. Every other element is counted by its type.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import InputError

FloatArray = np.ndarray
SHELL = re.compile(r"(?:S|DS|STRI|M3D|SFM3D|CPS|CPE|CPEG|R3D)([34689])")
NODES = re.compile(r"[A-Z]+\dD(\d+)|SC(\d)|B\d(\d)")  # of other elements, in their name
REMEDY = "write the model without parts and instances"
Label = tuple[str, int]  # part, or nothing, and label


def read_inp(path: Path) -> dict[str, Any]:
    """Read nodes and shell elements, rigid ones only if there are no others: parts of a `Shells`.

    Any defect raises InputError with the number of the line.
    """
    nodes: dict[Label, list[float]] = {}
    shells: dict[Label, tuple[str, list[int]]] = {}
    left_out: dict[str, int] = {}
    placed: dict[str, list[list[float]]] = {}
    part = ""
    text = path.read_text(encoding="utf-8", errors="replace")
    for line, keyword, options, lines in _blocks(text):
        if keyword in ("PART", "INSTANCE", "END PART", "END INSTANCE"):
            part = options.get("NAME", "")
        if keyword == "INSTANCE" and (source := options.get("PART", "")):
            if source in placed:
                raise InputError(f"line {line}: the part {source} is placed twice: {REMEDY}")
            placed[source] = [row for _, row in _numbers(lines, 1)]
        if keyword in ("INCLUDE", "NODE", "ELEMENT") and (
            keyword == "INCLUDE" or "INPUT" in options
        ):
            words = f"line {line}: *{keyword} of another file is not followed"
            raise InputError(f"{words}: put the mesh into one file")
        if keyword == "NODE":
            for number, row in _numbers(lines, 1):
                if len(row) < 2:
                    raise InputError(f"line {number}: too few numbers: {row}")
                _once(nodes, label := (part, int(row[0])), number)
                nodes[label] = [*row[1:4], 0.0, 0.0][:3]
        elif keyword == "ELEMENT":
            kind = options.get("TYPE", "elements without a type")
            many = _nodes_of(kind)
            for number, row in _numbers(lines, many and many + 1):
                if not SHELL.match(kind):
                    left_out[kind] = left_out.get(kind, 0) + 1
                    continue
                if len(row) != many + 1:
                    few = "few" if len(row) < many + 1 else "many"
                    raise InputError(f"line {number}: too {few} numbers for {kind}: {row}")
                _once(shells, label := (part, int(row[0])), number)
                shells[label] = kind, [int(v) for v in row[1 : many + 1]]
    if not nodes:
        raise InputError("no *NODE")
    return _assembled(nodes, shells, left_out, placed)


def _once(table: dict[Label, Any], label: Label, line: int) -> None:
    if label in table:
        raise InputError(f"line {line}: the label {label[1]} repeats: {REMEDY}")


def _assembled(
    nodes: dict[Label, list[float]],
    shells: dict[Label, tuple[str, list[int]]],
    left_out: dict[str, int],
    placed: dict[str, list[list[float]]],
) -> dict[str, Any]:
    """Put the parts with shells into one mesh."""
    rigid = {label for label, (kind, _) in shells.items() if kind.startswith("R3D")}
    if len(rigid) < len(shells):
        for label in rigid:
            kind = shells.pop(label)[0]
            left_out[kind] = left_out.get(kind, 0) + 1
    parts = {part for part, _ in shells}
    unused = [label for label in nodes if label[0] not in parts]
    if shells and unused:
        left_out["nodes of other parts"] = len(unused)
        nodes = {label: nodes[label] for label in nodes if label[0] in parts}
    for labels in (shells, nodes):
        seen = set()
        for _, label in labels:
            if label in seen:
                raise InputError(f"the label {label} repeats in another part: {REMEDY}")
            seen.add(label)
    place = {label: row for row, label in enumerate(nodes)}
    points = np.reshape([*nodes.values()], (-1, 3))
    for part, rows in placed.items():
        own = np.array([label[0] == part for label in nodes], dtype=bool)
        points[own] = _moved(points[own], rows)
    corners, middles = [], []
    for (part, label), (kind, row) in shells.items():
        if missing := [node for node in row if (part, node) not in place]:
            raise InputError(f"element {label} refers to node {missing[0]}, which is not there")
        rows = [place[part, node] for node in row]
        n = 3 if SHELL.match(kind)[1] in "36" else 4
        corners.append(rows[:n] + [-1] * (4 - n))
        middles.append(rows[n:] + [-1] * (5 - len(rows[n:])))
    return {
        "points": points,
        "nodes": np.array([label for _, label in nodes], dtype=int),
        "corners": np.reshape(corners, (-1, 4)).astype(int),
        "elements": np.array([label for _, label in shells], dtype=int),
        "middles": np.reshape(middles, (-1, 5)).astype(int),
        "left_out": left_out,
    }


def _moved(points: FloatArray, rows: list[list[float]]) -> FloatArray:
    """Place a part: shift by the first row, turn about two points by an angle in the second."""
    from scipy.spatial.transform import Rotation

    shift, turn = (*rows, [], [])[:2]
    if len(shift) not in (0, 3) or len(turn) not in (0, 7):
        raise InputError(f"*INSTANCE: expected 3 and 7 numbers, got {len(shift)} and {len(turn)}")
    points = points + (shift or 0.0)
    if turn:
        start, end = np.reshape(turn[:6], (2, 3))
        axis = (end - start) / max(float(np.linalg.norm(end - start)), 1e-300)
        spin = Rotation.from_rotvec(turn[6] * axis, degrees=True)
        points = spin.apply(points - start) + start
    return points


def _nodes_of(kind: str) -> int | None:
    """How many nodes an element of a type has, where its name says so."""
    if found := SHELL.match(kind):
        return int(found[1])
    found = NODES.match(kind)
    if not found:
        return None
    if found[3]:  # a beam: of the order 1, 2 or 3
        return 3 if found[3] == "2" else 2
    return int(found[1] or found[2])


def _blocks(text: str) -> Iterator[tuple[int, str, dict[str, str], list[tuple[int, str]]]]:
    """Keywords with the number of their line, their options, and the lines below them."""
    block: tuple[int, str, dict[str, str], list[tuple[int, str]]] = (0, "", {}, [])
    for number, line in enumerate(map(str.strip, text.splitlines()), 1):
        if line.startswith("**") or not line:
            continue
        if not line.startswith("*"):
            block[3].append((number, line))
            continue
        yield block
        keyword, *words = (word.strip().upper() for word in line[1:].split(","))
        pairs = (word.partition("=") for word in words)
        block = (number, keyword, {key.strip(): value.strip() for key, _, value in pairs}, [])
    yield block


def _numbers(lines: list[tuple[int, str]], most: int | None) -> Iterator[tuple[int, list[float]]]:
    """Rows of numbers; one of fewer than `most` that ends in a comma goes on in the next line."""
    row: list[float] = []
    for number, line in lines:
        try:
            row += [float(word) for word in line.split(",") if word.strip()]
        except ValueError:
            raise InputError(f"line {number}: not numbers: {line!r}") from None
        if not line.endswith(",") or (most and len(row) >= most):
            yield number, row
            row = []
    if row:
        yield lines[-1][0], row
