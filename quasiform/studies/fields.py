"""The end states of all runs in one HDF5 file, and a manifest for machine learning.

`fields.h5` has a group for each run with `points` (n, 3), `flat` (n, 2), `triangles` (m, 3), and
the groups `point` and `cell` of its fields. `croissant.json` describes it and the table in the
Croissant format 1.0 (https://docs.mlcommons.org/croissant/docs/croissant-spec.html).
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from functools import partial
from hashlib import file_digest
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import optional
from ..result.summary import package_version

STORE, MANIFEST = "fields.h5", "croissant.json"
KINDS = {bool: "sc:Boolean", int: "sc:Integer", float: "sc:Float", str: "sc:Text"}
FORMATS = {".csv": "text/csv", ".h5": "application/x-hdf5"}
WORDS = "citeAs column conformsTo extract field fileProperty fileObject fileSet format includes "
WORDS += "isLiveDataset jsonPath key md5 parentField path recordSet references regex repeated "
WORDS += "replace separator source subField transform samplingRate"
CONTEXT: dict[str, Any] = {word: f"cr:{word}" for word in WORDS.split()} | {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
}


needed = partial(optional, "h5py", "study", "fields = true needs h5py")


def collect(folder: Path, runs: Sequence[str]) -> None:
    """Put the fields of runs that are in files of their own into the file of all.

    That file is replaced in one step, and only then the files of the runs are removed.
    """
    single = sorted((folder / "fields").glob("*.npz"))
    if not single:
        return
    h5py, new, old = needed(), folder / f".new-{STORE}", folder / STORE
    with h5py.File(new, "w") as file:
        if old.exists():
            with h5py.File(old) as before:
                for run in before:
                    before.copy(run, file)
        for path in single:
            if path.stem in file:
                del file[path.stem]
            with np.load(path) as arrays:
                for name, values in arrays.items():
                    file.create_dataset(f"{path.stem}/{name}", data=values, compression="gzip")
        file.attrs["runs"] = json.dumps([run for run in runs if run in file])
    os.replace(new, old)
    for path in single:
        path.unlink()
    (folder / "fields").rmdir()


def read(folder: Path, run: str) -> dict[str, np.ndarray]:
    """Points, flat points and triangles of a run, from its own file or that of all."""
    names = "points", "flat", "triangles"
    if (path := folder / "fields" / f"{run}.npz").exists():
        with np.load(path) as arrays:
            return {name: arrays[name] for name in names}
    with needed().File(folder / STORE) as file:
        return {name: file[f"{run}/{name}"][:] for name in names}


def manifest(
    paths: Sequence[Path], name: str, table: Mapping[str, Sequence[Any]], outputs: Sequence[str]
) -> str:
    """Return the manifest of a table and of the fields beside it, as JSON."""
    files = []
    for path in paths:
        with path.open("rb") as file:
            digest = file_digest(file, "sha256").hexdigest()
        about = {"@type": "cr:FileObject", "@id": path.name, "name": path.name, "sha256": digest}
        files.append(about | {"contentUrl": path.name, "encodingFormat": FORMATS[path.suffix]})
    columns = []
    for column, values in table.items():
        kinds = {type(value) for value in values if value is not None}
        kind = KINDS.get(kinds.pop() if len(kinds) == 1 else str, "sc:Text")
        source = {"fileObject": {"@id": "study.csv"}, "extract": {"column": column}}
        words = "output" if column in outputs else "of the run"
        about = {"@type": "cr:Field", "@id": f"runs/{column}", "name": column, "dataType": kind}
        columns.append(about | {"description": words, "source": source})
    runs = {"@type": "cr:RecordSet", "@id": "runs", "name": "runs", "field": columns}
    words = (
        f"Forming runs of quasiform {package_version()}: one row a run in study.csv, and in "
        f"{STORE} a group for each with points, flat points, triangles and fields of the end "
        "state. Lengths in mm, forces in N, angles in degrees."
    )
    about = {"@context": CONTEXT, "@type": "sc:Dataset", "name": name, "description": words}
    about |= {"conformsTo": "http://mlcommons.org/croissant/1.0", "version": "1.0.0"}
    return json.dumps(about | {"distribution": files, "recordSet": [runs]}, indent=2)
