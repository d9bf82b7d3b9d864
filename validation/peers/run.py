"""Run the peers that are installed and print the table.

    python -m validation.peers.run [felupe] [calculix] [draping] [--repeats 3] [--json FILE]

Peers that are not installed are skipped with one line. The exit status is 1 if an answer disagrees
or a code failed.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from ..tables import markdown_table
from .contest import Row, rows

PEERS = {
    "felupe": "felupe_oat",
    "calculix": "calculix_hemisphere",
    "draping": "draping",
}


def compare(
    peers: Sequence[str] = tuple(PEERS), repeats: int = 3, report: Callable[[str], None] = print
) -> list[Row]:
    """Run peers and return all rows.

    Parameters
    ----------
    peers : sequence of str
        Names in `PEERS`.
    repeats : int
    report : callable
        Called with a line for each skipped peer and each run.
    """
    table: list[Row] = []
    report(f"load of the machine before: {os.getloadavg()[0]:.2f} on {os.cpu_count()} processors")
    for name in peers:
        peer = importlib.import_module(f"validation.peers.{PEERS[name]}")
        if reason := peer.missing():
            report(f"{name} skipped: {reason}")
            continue
        with tempfile.TemporaryDirectory() as folder:
            for problem in peer.problems(Path(folder)):
                report(problem.name)
                table += rows(problem, repeats, report)
    return table


def table_text(table: Sequence[Row]) -> str:
    """Rows as a Markdown table."""
    head = ["problem", "code", "increments", "solves", "value", "angle, °", "solve, s"]
    head += ["process, s", "processors, s", "ratio to quasiform", "each at its best"]
    lines = []
    for row in table:
        answer, first = row.answer, [row.problem, row.code, row.setting]
        if answer.failed:
            lines.append([*first, f"failed: {answer.failed}", *[""] * (len(head) - 4)])
            continue
        value = f"{answer.value:.5g} ({row.quantity})" + ("" if row.agrees else " DISAGREES")
        times = [f"{time:.3g}" for time in (row.solve_s, row.whole_s, row.processor_s)]
        ratios = ["" if r is None else f"{r:.2f}" for r in (row.ratio, row.best_ratio)]
        lines.append([*first, answer.iterations, value, f"{answer.angle:.2f}", *times, *ratios])
    return markdown_table(head, lines)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m validation.peers.run", description=__doc__)
    parser.add_argument("peers", nargs="*", metavar="peer", help=f"of {', '.join(PEERS)}")
    parser.add_argument("--repeats", type=int, default=3, help="runs of each contender")
    parser.add_argument("--json", type=Path, help="also write the rows to this file")
    given = parser.parse_args(arguments)
    if unknown := set(given.peers) - set(PEERS):
        parser.error(f"unknown peer {', '.join(sorted(unknown))}: expected {', '.join(PEERS)}")
    table = compare(given.peers or tuple(PEERS), max(given.repeats, 1))
    print(f"\n{table_text(table)}")
    if given.json:
        given.json.write_text(json.dumps([asdict(row) for row in table], indent=1), "utf-8")
    return 0 if all(row.agrees for row in table) else 1


if __name__ == "__main__":
    sys.exit(main())
