"""The folder of a result: claimed by one run, filled as it goes, or replaced as a whole."""

from __future__ import annotations

import os
import weakref
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from filelock import FileLock, Timeout

from ..checks import InputError

INCREMENTS = "increment_*.vtu"
OF_PLIES = ("ply_*.vtu", "shear_angle_ply_*.png", "diaphragm.vtu")
LOCK = ".lock"
RESUME = "resume.npz"
PICTURES = ("shear_angle.png", "history.png", "doubt.png")
SCENE = "scene.toml"
TABLES = ("summary.json", SCENE, "history.csv", "outline.csv")
SENSITIVITY = ("sensitivity.csv", "sensitivity.png")
FILES = (*TABLES, "result.vtu", "result.pvd", *PICTURES, "gaps.png", *SENSITIVITY, RESUME)


class Claim:
    """A folder for one run at a time, made if it is missing.

    The operating system frees the lock of a run that was killed. A folder into which nothing was
    put is removed at the end.

    Raises
    ------
    InputError
        If another run writes to the folder with a lock of that name, or it cannot be made.
    """

    def __init__(self, out: str | Path, *, new: bool = False, lock: str = LOCK) -> None:
        self.folder = folder = Path(out)
        missing = [path for path in (folder, *folder.parents) if not path.exists()]
        with writing_to(folder):
            if not folder.parent.exists():
                folder.parent.mkdir(parents=True, exist_ok=True)
            try:
                folder.mkdir(exist_ok=not new)
            except FileExistsError as error:
                if new:
                    raise FolderExistsError from error
                raise InputError(f"cannot write to {folder}: it is not a folder") from error
            held = FileLock(folder.resolve() / lock, is_singleton=True)  # one a process
            try:
                held.acquire(timeout=0)
            except Timeout as error:
                raise InputError(f"another run writes to {folder}: choose another one") from error
        self.release = weakref.finalize(self, _free, held, missing)


class FolderExistsError(Exception):
    """A folder that should be a new one."""


def claim_new(names: Iterable[Path]) -> Claim:
    """Claim the first of these folders that does not exist, whatever other runs do meanwhile."""
    for path in names:
        if not os.path.lexists(path):
            with suppress(FolderExistsError):
                return Claim(path, new=True)
    raise InputError("no name is left for a new folder")


def _free(lock: FileLock, missing: Sequence[Path]) -> None:
    lock.release()
    if lock.is_locked:  # by another run of this process
        return
    with suppress(OSError):
        Path(lock.lock_file).unlink(missing_ok=True)
    for path in missing:
        with suppress(OSError):  # not empty
            path.rmdir()


def check_folder(out: str | Path, *, force: bool = False, names: Sequence[str] = FILES) -> Path:
    """Check that a result can be written to a folder; nothing is made, nothing is touched.

    With `force` the folder may hold a result already: one of the files `names`.
    """
    folder = Path(out)
    with writing_to(folder):
        if folder.exists() and not folder.is_dir():
            raise InputError(f"cannot write to {folder}: it is not a folder")
        found = _existing(folder, names)
        if found and not force:
            raise InputError(
                f"{folder} holds a result already ({found[0].name}): "
                "choose another folder, or replace it with --force"
            )
        with _made(folder):
            TemporaryDirectory(prefix=".new-", dir=folder).cleanup()
    return folder


@contextmanager
def replaced(
    out: str | Path, *, force: bool = False, names: Sequence[str] = FILES
) -> Iterator[Path]:
    """Yield an empty folder whose files take the place of the result in `out` at the end.

    An old result stays complete until the new one is. Refuses what `check_folder` does.
    """
    folder = check_folder(out, force=force, names=names)
    with writing_to(folder), added(folder, instead=names) as staging:
        yield staging


@contextmanager
def added(folder: Path, *, instead: Sequence[str] = ()) -> Iterator[Path]:
    """Yield an empty folder whose files are put into `folder` at the end, each in one step.

    The files `instead` of an older result are removed; with such names the folder is made if it is
    missing. OSError if it was removed or cannot be written.
    """
    with (
        _made(folder) if instead else nullcontext(),
        TemporaryDirectory(prefix=".new-", dir=folder, ignore_cleanup_errors=True) as staging,
    ):
        yield Path(staging)
        new = {path.name for path in Path(staging).iterdir()}
        old = [path for path in _existing(folder, instead) if path.name not in new]
        for name in sorted(new):
            os.replace(Path(staging, name), folder / name)
        for path in old:
            path.unlink(missing_ok=True)


def _existing(folder: Path, names: Sequence[str]) -> list[Path]:
    """Files in a folder with one of the names, which may be patterns (`*`)."""
    more = (*names, INCREMENTS, *OF_PLIES) if names is FILES else names
    named = [folder / name for name in more if "*" not in name and (folder / name).exists()]
    patterns = [pattern for pattern in more if "*" in pattern]
    return named + [path for pattern in patterns for path in sorted(folder.glob(pattern))]


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Make a folder; remove it at the end if nothing has been put into it."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        for path in missing:
            with suppress(OSError):  # not empty
                path.rmdir()


@contextmanager
def writing_to(path: Path) -> Iterator[None]:
    """Report what fails while a file or folder is written as one line that names it."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write to {path}: {error.strerror or error}") from error
