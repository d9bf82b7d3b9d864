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


def table_lines(table: Sequence[Row]) -> list[str]:
    """Format rows as a Markdown table."""
    lines = [
        "| problem | code | increments | solves | value | angle, ° | solve, s | process, s "
        "| processors, s | ratio to quasiform | each at its best |",
        "|-|-|-|-|-|-|-|-|-|-|-|",
    ]
    for row in table:
        answer = row.answer
        begin = f"| {row.problem} | {row.code} | {row.setting} |"
        if answer.failed:
            lines.append(f"{begin} | failed: {answer.failed} | | | | | | |")
            continue
        value = f"{answer.value:.5g} ({row.quantity})" + ("" if row.agrees else " DISAGREES")
        ratio, best = (
            "" if number is None else f"{number:.2f}" for number in (row.ratio, row.best_ratio)
        )
        lines.append(
            f"{begin} {answer.iterations} | {value} | {answer.angle:.2f} | {row.solve_s:.3g} "
            f"| {row.whole_s:.3g} | {row.processor_s:.3g} | {ratio} | {best} |"
        )
    return lines


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m validation.peers.run", description=__doc__)
    parser.add_argument("peers", nargs="*", metavar="peer", help=f"of {', '.join(PEERS)}")
    parser.add_argument("--repeats", type=int, default=3, help="runs of each contender")
    parser.add_argument("--json", type=Path, help="also write the rows to this file")
    given = parser.parse_args(arguments)
    if unknown := set(given.peers) - set(PEERS):
        parser.error(f"unknown peer {', '.join(sorted(unknown))}: expected {', '.join(PEERS)}")
    table = compare(given.peers or tuple(PEERS), max(given.repeats, 1))
    print("\n".join(["", *table_lines(table)]))
    if given.json:
        given.json.write_text(json.dumps([asdict(row) for row in table], indent=1), "utf-8")
    return 0 if all(row.agrees for row in table) else 1


if __name__ == "__main__":
    sys.exit(main())
