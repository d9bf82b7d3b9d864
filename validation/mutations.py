"""Change single signs, comparisons and bounds of the code, and check that the tests notice.

    python -m validation.mutations --seed 0 --count 30 [--out mutations.csv] [--processes 2]

The changes ("mutants") are drawn from energies, net, tools, solver and model. Each is written
into a temporary copy of the checkout, where the tests run until the first failure: those of
`GUARDS` first, then the others. A mutant is killed if a test fails, or if the tests take too long.
Mutants that give the same results as the code are listed in `equivalent_mutants.csv`; others are
drawn instead.

Exit status: 0 at least 28 of 30 mutants were killed; 1 fewer; 2 the tests fail without a mutant.
"""

from __future__ import annotations

import argparse
import ast
import csv
import os
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import Queue
from tempfile import TemporaryDirectory

from pydantic.dataclasses import dataclass as checked
from rich.console import Console
from rich.table import Table

from .bands import Text
from .tables import read_table

ROOT = Path(__file__).resolve().parents[1]
PLACES = ("energy", "net", "tools", "solve", "model.py", "potential.py", "unknowns.py")
GUARDS = {  # tests that run first, by the beginning of a file's path
    "quasiform/energy/friction": ("energy", "oracle", "friction_scenes", "resume"),
    "quasiform/energy/contact": ("energy", "oracle", "forming", "friction_scenes"),
    "quasiform/energy/p": ("energy", "free_mesh", "oracle"),
    "quasiform/energy": ("energy", "oracle", "forming"),
    "quasiform/net/free_mesh": ("free_mesh", "outline"),
    "quasiform/net": ("blank", "outline", "free_mesh", "levels"),
    "quasiform/tools/shapes": ("tool", "energy", "forming"),
    "quasiform/tools": ("surface", "tool", "scene_file"),
    "quasiform/solve/linear": ("linear", "solve"),
    "quasiform/solve/levels": ("levels", "solve"),
    "quasiform/solve/proximal": ("stability", "solve"),
    "quasiform/solve/journal": ("resume", "solve"),
    "quasiform/solve": ("contract", "solve", "stability", "levels", "resume"),
    "quasiform/potential": ("energy", "linear", "contract"),
    "quasiform/unknowns": ("linear", "solve", "contract", "levels"),
    "quasiform/model": ("forming", "solve", "energy", "levels"),
}
OPERATORS = {  # text of an operator, and of the one that replaces it
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Lt: ("<", ">="),
    ast.LtE: ("<=", ">"),
    ast.Gt: (">", "<="),
    ast.GtE: (">=", "<"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
}
BOUNDS = ("minimum", "maximum", "clip")  # and the builtins min and max
LIMIT_S = 1800.0  # of the tests on one mutant
NEEDED = 28 / 30


@dataclass(frozen=True)
class Mutant:
    """One change: bytes `start` to `end` of a file become `new`."""

    file: str
    line: int
    start: int
    end: int
    new: str
    before: str
    after: str


@checked(frozen=True)
class Equivalent:
    """One row of `equivalent_mutants.csv`: a line before and after, and why both do the same."""

    file: Text
    before: Text
    after: Text
    reason: Text


def mutants(file: str, source: bytes) -> list[Mutant]:
    """Every sign, comparison and bound of a file that can be changed."""
    lines = source.splitlines(keepends=True)
    offsets = [sum(map(len, lines[:i])) for i in range(len(lines))]
    found = {}
    for node in _code(ast.parse(source)):
        for first, last, old, new in _changes(node):
            start = offsets[first[0] - 1] + first[1]
            end = offsets[last[0] - 1] + last[1]
            old = old or source[start:end].decode()
            start = source.find(old.encode(), start, end)
            number = source.count(b"\n", 0, start)
            before, column = lines[number].decode(), start - offsets[number]
            if start < 0 or "perf_counter" in before:
                continue
            at = len(lines[number][:column].decode())
            after = before[:at] + new + before[at + len(old) :]
            texts = before.strip(), after.strip()
            found[start] = Mutant(file, number + 1, start, start + len(old), new, *texts)
    return [found[start] for start in sorted(found)]


def _changes(node: ast.AST) -> Iterator[tuple[tuple[int, int], tuple[int, int], str, str]]:
    """Changes of a node: between which two places which text (all, if empty) becomes which."""
    pairs: list[tuple[ast.AST, ast.AST, ast.AST]] = []
    if isinstance(node, ast.BinOp) and not any(map(_is_sequence, (node.left, node.right))):
        pairs = [(node.op, node.left, node.right)]
    elif isinstance(node, ast.AugAssign) and not _is_sequence(node.value):
        pairs = [(node.op, node.target, node.value)]
    elif isinstance(node, ast.Compare):
        sides = [node.left, *node.comparators]
        pairs = [*zip(node.ops, sides, sides[1:], strict=False)]
    for operator, left, right in pairs:
        if swap := OPERATORS.get(type(operator)):
            yield (left.end_lineno, left.end_col_offset), (right.lineno, right.col_offset), *swap
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        if not isinstance(getattr(node.operand, "value", None), int):  # -1: an axis or an index
            end = node.operand.lineno, node.operand.col_offset
            yield (node.lineno, node.col_offset), end, "-", "+"
    for bound in _bounds(node):
        new = str(bound.value + 1 if isinstance(bound.value, int) else 10 * bound.value or 1.0)
        yield (bound.lineno, bound.col_offset), (bound.end_lineno, bound.end_col_offset), "", new


def _code(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes except messages, type annotations and indices."""
    yield tree
    for name, child in ast.iter_fields(tree):
        message = isinstance(tree, ast.Raise | ast.JoinedStr)
        if message or name in ("annotation", "returns", "slice"):
            continue
        for node in child if isinstance(child, list) else [child]:
            if isinstance(node, ast.AST):
                yield from _code(node)


def _bounds(node: ast.AST) -> list[ast.Constant]:
    """Numbers that bound something: compared, in min, max or clip, or a constant of a module."""
    candidates: list[ast.AST] = []
    if isinstance(node, ast.Compare):
        candidates = [node.left, *node.comparators]
    elif isinstance(node, ast.Call):
        name = getattr(node.func, "attr", "")
        builtin = getattr(node.func, "id", "") in ("min", "max")
        candidates = [*node.args] if builtin or name in BOUNDS else []
    elif isinstance(node, ast.Assign):
        upper = all(isinstance(t, ast.Name) and t.id.isupper() for t in node.targets)
        candidates = [node.value] if upper else []
    return [c for c in candidates if isinstance(c, ast.Constant) and type(c.value) in (int, float)]


def _is_sequence(node: ast.AST) -> bool:
    """Whether a sum with this joins texts or lists."""
    text = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return text or isinstance(node, ast.JoinedStr | ast.List | ast.Tuple | ast.ListComp)


def draw(seed: int, root: Path = ROOT) -> list[Mutant]:
    """All mutants in a random order, without those known to be equivalent."""
    found: list[Mutant] = []
    for place in PLACES:
        path = root / "quasiform" / place
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            found += mutants(file.relative_to(root).as_posix(), file.read_bytes())
    random.Random(seed).shuffle(found)
    listed = read_table(Path(__file__).with_name("equivalent_mutants.csv"), Equivalent, keyed=False)
    equivalent = {(row.file, row.before, row.after) for row in listed}
    return [m for m in found if (m.file, m.before, m.after) not in equivalent]


def copy(folder: Path) -> Path:
    """Copy the files of the checkout that are not ignored."""
    command = ["git", "ls-files", "-co", "--exclude-standard", "-z"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)
    return folder


def failing(folder: Path, tests: list[str]) -> str:
    """The first test that fails in a copy; empty if all pass."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    # without .pyc files: one of a mutant of the same second and size would be taken for the next
    alone = {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1", "OMP_NUM_THREADS": "1"}
    environment = os.environ | alone
    try:
        ended = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=LIMIT_S
        )
    except subprocess.TimeoutExpired:
        return f"not finished after {LIMIT_S:.0f} s"
    if ended.returncode == 0:
        return ""
    named = re.search(r"^(?:FAILED|ERROR) (\S+)", ended.stdout, re.MULTILINE)
    return named[1] if named else f"pytest ended with {ended.returncode}"


def judge(mutant: Mutant, folders: Queue[Path]) -> str:
    """The test that kills a mutant; empty if it survives."""
    folder = folders.get()
    path = folder / mutant.file
    source = path.read_bytes()
    first, rest = _tests(folder, mutant.file)
    try:
        path.write_bytes(source[: mutant.start] + mutant.new.encode() + source[mutant.end :])
        return (failing(folder, first) if first else "") or failing(folder, rest)
    finally:
        path.write_bytes(source)
        folders.put(folder)


def _tests(folder: Path, file: str) -> tuple[list[str], list[str]]:
    """Test files that guard a file, and the others with the doctests."""
    guards = next((names for start, names in GUARDS.items() if file.startswith(start)), ())
    every = sorted(path.relative_to(folder).as_posix() for path in folder.glob("tests/test_*.py"))
    first = [f"tests/test_{name}.py" for name in guards if f"tests/test_{name}.py" in every]
    return first, [*(test for test in every if test not in first), "quasiform"]


def main(argv: list[str] | None = None) -> int:
    """Draw mutants, test them and print a table; the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--processes", type=int, choices=(1, 2), default=2)
    parser.add_argument("--out", type=Path, default=Path("mutations.csv"), metavar="FILE.csv")
    parser.add_argument("--list", action="store_true", help="show what is drawn, and test nothing")
    parser.add_argument("--unchecked", action="store_true", help="skip the tests without a mutant")
    given = parser.parse_args(argv)
    every = draw(given.seed)
    drawn = every[: given.count]
    print(f"{len(drawn)} of {len(every)} possible mutants", flush=True)
    if given.list:
        for m in drawn:
            print(f"{m.file}:{m.line}\n  - {m.before}\n  + {m.after}")
        return 0
    with TemporaryDirectory() as name:
        folders: Queue[Path] = Queue()
        for i in range(given.processes):
            folders.put(copy(Path(name, f"copy_{i}")))
        if not given.unchecked and (test := failing(Path(name, "copy_0"), [])):
            print(f"without a mutant: {test}")
            return 2
        found = []
        with ThreadPoolExecutor(given.processes) as pool:
            for mutant, test in zip(
                drawn, pool.map(partial(judge, folders=folders), drawn), strict=True
            ):
                print(f"{mutant.file}:{mutant.line}: {test or 'SURVIVED'}", flush=True)
                found.append((mutant, test))
                write(found, given.out)
    print_table(found)
    killed = sum(bool(test) for _, test in found)
    print(f"{killed} of {len(found)} killed; written to {given.out}")
    return 0 if killed >= NEEDED * len(found) else 1


def write(found: list[tuple[Mutant, str]], path: Path) -> None:
    """Write one row per mutant to a CSV file."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("file", "line", "before", "after", "result", "test"))
        for m, test in found:
            result = "killed" if test else "survived"
            writer.writerow((m.file, m.line, m.before, m.after, result, test))


def print_table(found: list[tuple[Mutant, str]]) -> None:
    """Print one row per mutant."""
    table = Table("place", "before", "after", "result")
    for m, test in found:
        table.add_row(f"{m.file}:{m.line}", m.before, m.after, test or "[red]survived[/red]")
    Console(width=None if sys.stdout.isatty() else 170).print(table)


if __name__ == "__main__":
    sys.exit(main())
