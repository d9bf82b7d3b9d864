"""One call from a result to the files of a structural code, and what they do not hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..checks import InputError, suggestion
from ..comparison.comparison import ALIGN
from ..meshes.shells import read_shells
from ..result.files import replaced
from ..result.summary import package_version
from . import drape, inp, table
from .fibres import Fibres, carry, read_formed
from .keywords import NOTICES, write_notices
from .placed import carry_placed, three

if TYPE_CHECKING:
    from ..result.record import Record
    from ..result.run import Result

FORMATS: dict[str, str] = {
    "abaqus": "S3 in two layers, orientations and thickness by *DISTRIBUTION",
    "abaqus-pair": "the same with M3D3 on the same nodes",
    "calculix": "S3, one *ORIENTATION an element along --axis",
    "radioss": "/DRAPE tables of warp and weft plies",
    "optistruct": "DRAPE tables of warp and weft plies",
    "csv": "a row an element: thickness and THETA as in Nastran, areal weight, directions",
    "vtu": "all fields by cell",
}
NOTES = "handover.txt"
GENERAL = {*NOTICES["fibres"], *(words for words in NOTICES.values() if isinstance(words, str))}
FILES = (*inp.FILES, "drape_0000.rad", "drape.fem", "fibres.csv", "fibres.vtu", NOTES)


@dataclass(frozen=True, eq=False)
class Handover:
    """What was written.

    Parameters
    ----------
    folder : path
    files : tuple of str
        Names in it.
    notices : tuple of str
        What they do not hold, and what was assumed.
    fibres : Fibres
        Directions, thickness and areal weight by element.
    general : tuple of str
        Those of the notices that are true of every hand-over in this format.
    """

    folder: Path
    files: tuple[str, ...]
    notices: tuple[str, ...]
    fibres: Fibres
    general: tuple[str, ...] = ()


def export(
    source: Result | Record | str | Path,
    to: str,
    out: str | Path,
    *,
    mesh: str | Path | None = None,
    scale: float = 1.0,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    rotate: Sequence[float] = (0.0, 0.0, 0.0),
    align: str = "none",
    within: float | None = None,
    axis: str = "warp",
    reference: Sequence[float] = (1.0, 0.0, 0.0),
    force: bool = False,
) -> Handover:
    """Write fibre directions, thickness and areal weight by element for another code.

    Parameters
    ----------
    source : Result, Record or path
        A run, or the folder of one.
    to : str
        One of `FORMATS`: abaqus, abaqus-pair, calculix, radioss, optistruct, csv, vtu.
    out : path
        Folder for the files; made if missing.
    mesh : path, optional
        Structural mesh in the place of the formed part, .inp or what meshio reads; the formed mesh
        itself if not given.
    scale : float
        mm per unit of that mesh.
    origin, rotate : (3,) floats
        Where that mesh lies: its point p is at R (scale p - origin) on the formed part, with the
        origin in mm and R by angles in degrees about x, y, z, as for a tool. What is written is in
        the mesh's own place.
    align : "none", "shift" or "rigid"
        Whether it is then shifted, or shifted and turned about z, to fit the formed part best.
    within : float, optional
        mm; elements farther than this from the sheet get no fibres. The spacing of the formed mesh
        if not given.
    axis : "warp", "weft" or "bisector"
        What CalculiX' local 1 is.
    reference : (3,) floats
        Direction from which the angles of DRAPE tables run, in any unit of length.
    force : bool
        Whether to replace files of an earlier hand-over.

    Returns
    -------
    Handover

    Raises
    ------
    InputError
        For an unknown format, files that cannot be read or written, a mesh away from the part.
    """
    if to not in FORMATS:
        raise InputError(f"unknown format '{to}': {suggestion(to, FORMATS)}")
    try:
        direction = np.array([*map(float, reference)])
    except (TypeError, ValueError):
        direction = np.zeros(0)
    if direction.shape != (3,) or not 0 < np.linalg.norm(direction) < np.inf:
        raise InputError(f"reference must be a direction of three numbers, got {reference!r}")
    direction /= np.linalg.norm(direction)
    record = read_formed(source)
    if align not in ALIGN:
        raise InputError(f"align must be one of {', '.join(ALIGN)}, got {align!r}")
    if mesh is None:
        fibres = carry(record, None, within)
    else:
        place = (three("origin", origin), three("rotate", rotate), align)
        fibres = carry_placed(record, read_shells(mesh, scale), place, within)
    writers: dict[str, Callable[[Path], tuple[str, ...]]] = {
        "abaqus": lambda folder: inp.abaqus(fibres, folder),
        "abaqus-pair": lambda folder: inp.abaqus(fibres, folder, pair=True),
        "calculix": lambda folder: inp.calculix(fibres, folder, axis),
        "radioss": lambda folder: drape.drape(fibres, folder, "drape_0000.rad", direction),
        "optistruct": lambda folder: drape.drape(fibres, folder, "drape.fem", direction),
        "csv": lambda folder: table.table(fibres, folder),
        "vtu": lambda folder: table.grid(fibres, folder),
    }
    with replaced(out, force=force, names=FILES) as folder:
        notices = (*fibres.notices, *writers[to](folder))
        title = f"Hand-over of {record.case} ({to}), quasiform {package_version()}"
        write_notices(folder / NOTES, title, notices)
        files = tuple(sorted(path.name for path in folder.iterdir()))
    general = tuple(notice for notice in notices if notice in GENERAL)
    return Handover(Path(out), files, notices, fibres, general)
