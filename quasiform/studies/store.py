"""The folder of a study: rows that were finished, its table, kept results.

`rows.jsonl` has one line a run, appended as soon as it is finished. A line that a killed process
has not completed is ignored. Shares of a batch array write files of their own, read together.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..checks import InputError
from ..result.files import Claim, added, writing_to
from ..result.summary import error_column
from ..tables import write_rows
from ..toml_file import dotted_values
from .fields import MANIFEST, STORE, collect, manifest
from .plan import Job, Plan
from .run import FIELDS, PLACE, TEXTS

ROWS = "rows.jsonl"
TABLES = ("study.csv", "study.parquet")
ANSWER = "answer.txt"
ANSWERS = (ANSWER, "sobol.csv", "robust.csv", "branches.csv", "trim.csv", "blank.csv", "blank.toml")
PICTURES = [f"{n}.png" for n in "scatter force tornado sobol window optimise trim".split()]
FILES = (*TABLES, *ANSWERS, *PICTURES, STORE, MANIFEST, "runs", ROWS)
DPI = 200


class Store:
    """Rows by the name of the run, in a folder that one process writes to."""

    def __init__(self, folder: Path, share: tuple[int, int] | None = None) -> None:
        part = "-{}-of-{}".format(*share) if share else ""
        if (folder / "summary.json").exists():
            raise InputError(f"{folder} holds the result of one run: choose another folder")
        self.claim = Claim(folder, lock=f".lock{part}")
        self.folder, self.path = folder, folder / ROWS.replace(".", f"{part}.")
        self.rows = read_rows(folder)

    def add(
        self, row: dict[str, Any], files: Mapping[str, bytes], paths: Mapping[str, str]
    ) -> None:
        """Keep a row that was finished, and before it the files that it leaves."""
        row |= {"fields": FIELDS in files, "kept": bool(files.keys() - {FIELDS})}
        content = _with_paths(json.dumps(row).encode(), paths)
        with writing_to(self.folder):
            for name, left in files.items():
                fields, text = name == FIELDS, name.endswith(TEXTS)
                folder = self.folder / ("fields" if fields else f"runs/{row['run']}")
                folder.mkdir(parents=True, exist_ok=True)
                with added(folder) as staging:
                    path = staging / (f"{row['run']}.npz" if fields else name)
                    path.write_bytes(_with_paths(left, paths) if text else left)
            with self.path.open("ab+") as file:
                half = file.tell() and (file.seek(-1, os.SEEK_END), file.read())[1] != b"\n"
                file.write(b"\n" * bool(half) + content + b"\n")
                file.flush()
                os.fsync(file.fileno())
        self.rows[row["run"]] = json.loads(content)

    def write(self, files: Mapping[str, Any]) -> None:
        """Write files by their names in place of older answers: texts, columns, figures."""
        with writing_to(self.folder), added(self.folder, instead=(*ANSWERS, *PICTURES)) as staging:
            for name, content in files.items():
                path = staging / name
                if isinstance(content, str):
                    path.write_text(content, encoding="utf-8")
                elif isinstance(content, Mapping):
                    lines = [content, *zip(*content.values(), strict=True)]
                    write_rows(path, (map(_cell, row) for row in lines))
                else:
                    content.savefig(path, dpi=DPI)

    def write_table(self, plan: Plan) -> dict[str, list[Any]]:
        """Write the table of the runs that are finished, and return it by columns."""
        outputs = plan.study.columns
        rows = [
            _row(job.id, job.values, outputs, row)
            for job in plan.jobs
            if (row := {"error": job.error} if job.error else self.rows.get(job.id))
        ]
        names = list(_row("", dict.fromkeys(plan.keys), outputs, {}))
        table = {name: [row[name] for row in rows] for name in names}
        with writing_to(self.folder), added(self.folder) as staging:
            cells = [names, *(row.values() for row in rows)]
            write_rows(staging / TABLES[0], (map(_cell, row) for row in cells))
            _parquet(table, staging / TABLES[1])
            if plan.study.fields and self.path.name == ROWS:  # shares may end at the same time
                collect(self.folder, table["run"])
                paths = [staging / TABLES[0], self.folder / STORE]
                if paths[1].exists():
                    text = manifest(paths, plan.study.name, table, outputs)
                    (staging / MANIFEST).write_text(text, encoding="utf-8")
        return table


def read_rows(folder: Path) -> dict[str, dict[str, Any]]:
    """Rows in a folder by their runs; a line that is not complete is left out."""
    rows: dict[str, dict[str, Any]] = {}
    for path in sorted(folder.glob("rows*.jsonl")):
        for line in path.read_bytes().split(b"\n"):
            with suppress(ValueError, TypeError, KeyError):
                row = json.loads(line)
                if "error" not in row or "error" in rows.get(row["run"], row):
                    rows[row["run"]] = row
    return rows


def part(jobs: Sequence[Job], share: tuple[int, int] | None) -> Sequence[Job]:
    """Every n-th run from number i on; all without a share."""
    return jobs[share[0] - 1 :: share[1]] if share else jobs


def pending(
    plan: Plan,
    jobs: Sequence[Job],
    rows: Mapping[str, Mapping[str, Any]],
    resume: bool = False,
) -> list[Job]:
    """Runs that are still to do, each once; with `resume` those that failed too.

    So is a run whose result or fields were not kept, and shall be now.
    """
    keep, fields = plan.study.leaves
    wanted = ["kept"] * keep + ["fields"] * fields
    found: dict[str, Job] = {}
    for job in jobs:
        row = rows.get(job.id)
        todo = row is None or (resume if "error" in row else not all(row[w] for w in wanted))
        if todo and not job.error:
            found[job.id] = job
    return list(found.values())


def _with_paths(content: bytes, paths: Mapping[str, str]) -> bytes:
    """Return JSON or TOML in which files have the paths that they came from."""
    for name, path in paths.items():
        content = content.replace((PLACE + name).encode(), json.dumps(path)[1:-1].encode())
    return content


def _row(
    name: str, values: Mapping[str, Any], outputs: Sequence[str], row: Mapping[str, Any]
) -> dict[str, Any]:
    """One row of the table."""
    summary, failed = row.get("summary", {}), "error" in row
    known, trust = dotted_values(summary), summary.get("trust")
    found = {"run": name, **values} | {output: known.get(output) for output in outputs}
    for output in outputs:
        if column := error_column(output):
            found[column] = known.get(column)
    return found | {
        "status": "failed" if failed else summary.get("status"),
        "reason": row["error"] if failed else summary.get("reason"),
        "certified": summary.get("certified"),
        "converged": summary.get("certificate", {}).get("converged"),
        "trust": None if trust is None else "; ".join(trust),
        "one_of_many": summary.get("one_of_many"),
        "factorisations": sum(summary["factorisations"].values()) if summary else None,
        "cpu_s": row.get("cpu_s"),
    }


def _cell(value: Any) -> Any:
    """What a CSV file has for a value: nothing for None, true and false as in TOML."""
    if isinstance(value, bool | list | dict):
        return json.dumps(value)
    return "" if value is None else value


def _parquet(table: Mapping[str, list[Any]], path: Path) -> None:
    """Write the table as Parquet where pyarrow is installed."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        return
    columns = {}
    for name, values in table.items():
        try:
            columns[name] = pa.array(values)
        except pa.ArrowException:  # numbers and texts in one column
            columns[name] = pa.array([None if v is None else str(_cell(v)) for v in values])
    parquet.write_table(pa.table(columns), path)
