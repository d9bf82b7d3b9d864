"""Read a mesh by meshio, which prints, warns and exits: what it meets becomes an InputError.

Files are not trusted: nothing in them is executed, and reading writes nothing.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..checks import InputError

if TYPE_CHECKING:
    import meshio

MEMORY = 500_000_000  # bytes for reading a mesh, beside a hundred times its file


def read_mesh(path: Path, kind: str | None = None) -> meshio.Mesh:
    """Read a mesh, its points (n, 3), by meshio, in the format `kind` or that of the suffix."""
    reader = import_module(f"meshio.{kind}" if kind else "meshio")
    with reading(path):
        mesh = reader.read(str(path))
    if mesh.points.ndim != 2 or mesh.points.shape[1] not in (2, 3):
        raise InputError("the points have no two or three coordinates")
    mesh.points = np.pad(np.asarray(mesh.points, float), ((0, 0), (0, 3 - mesh.points.shape[1])))
    return mesh


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Silence a reader that prints and warns; what it raises or exits with is an InputError."""
    try:
        silent = redirect_stdout(StringIO()), redirect_stderr(StringIO())
        with silent[0], silent[1], warnings.catch_warnings(), _enough_memory(path.stat().st_size):
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", "string or file could not be read to its end")
            yield
    except (Exception, SystemExit) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        reason = "" if isinstance(error, SystemExit) else f": {reason}"
        raise InputError(f"not a readable {path.suffix.lower()} file{reason}") from error


@contextmanager
def _enough_memory(size: int) -> Iterator[None]:
    """Let a damaged count in a file of `size` bytes end in a MemoryError, where Linux can."""
    try:
        resource = import_module("resource")
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    except (ImportError, OSError):
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limits = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
    least = min([used + MEMORY + 100 * size, *limits])
    resource.setrlimit(resource.RLIMIT_AS, (least, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
