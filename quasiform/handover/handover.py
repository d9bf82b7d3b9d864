"""One call from a result to the files of a structural code, and what they do not hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
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
from .layup import layup
from .placed import carry_placed, placed, three

if TYPE_CHECKING:
    from ..result.record import Record
    from ..result.run import Result

FORMATS: dict[str, str] = {
    "abaqus": "S3 in two layers, orientations and thickness by *DISTRIBUTION",
    "abaqus-pair": "the same with M3D3 on the same nodes",
    "calculix": "S3, one *ORIENTATION an element along --axis",
    "abaqus-layup": "composite shells, a layer a ply with its own orientation",
    "calculix-layup": "the same with S6 and S8R",
    "radioss": "/DRAPE tables of warp and weft plies",
    "optistruct": "DRAPE tables of warp and weft plies",
    "csv": "a row an element: thickness and THETA as in Nastran, areal weight, directions",
    "vtu": "all fields by cell",
    "pyacp": "columns of a look-up table: point, warp, thickness, transverse correction",
}
FloatArray = np.ndarray
LAYUPS = {"abaqus-layup": "abaqus", "calculix-layup": "calculix"}
NOTES = "handover.txt"
GENERAL = {*NOTICES["fibres"], *(words for words in NOTICES.values() if isinstance(words, str))}
OF_PLY = (*inp.FILES, "drape_0000.rad", "drape.fem", "fibres.csv", "fibres.vtu", "lookup.csv")
FILES = (*OF_PLY, *(f"ply_*_{name}" for name in OF_PLY), NOTES)


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
    plies : tuple of Fibres
        Directions, thickness and areal weight by element, of each ply from the punch down.
    general : tuple of str
        Those of the notices that are true of every hand-over in this format.
    """

    folder: Path
    files: tuple[str, ...]
    notices: tuple[str, ...]
    plies: tuple[Fibres, ...]
    general: tuple[str, ...] = ()

    @property
    def fibres(self) -> Fibres:
        """Those of the first ply, the only one but for stacks."""
        return self.plies[0]


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

    Of a stack each ply has its own files, `ply_1_part.inp`, ..., and a layup one layer.

    Parameters
    ----------
    source : Result, Record or path
        A run, or the folder of one.
    to : str
        One of `FORMATS`: abaqus, abaqus-pair, calculix, abaqus-layup, calculix-layup, radioss,
        optistruct, csv, vtu, pyacp.
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
        What local 1 is, for CalculiX and in layups.
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
    if align not in ALIGN:
        raise InputError(f"align must be one of {', '.join(ALIGN)}, got {align!r}")
    direction = _direction(reference)
    record = read_formed(source)
    plies = [read_formed(ply) for ply in record.plies]
    if mesh is not None:
        place = (three("origin", origin), three("rotate", rotate), align)
        there = placed(record, read_shells(mesh, scale), *place)
        carried = [carry_placed(ply, there, within) for ply in plies]
    elif to in LAYUPS:
        carried = _on_the_middle_one(plies, within)
    else:
        carried = [carry(ply, None, within) for ply in plies]
    writers: dict[str, Callable[[Fibres, Path], tuple[str, ...]]] = {
        "abaqus": inp.abaqus,
        "abaqus-pair": lambda *given: inp.abaqus(*given, pair=True),
        "calculix": lambda *given: inp.calculix(*given, axis),
        "radioss": lambda *given: drape.drape(*given, "drape_0000.rad", direction),
        "optistruct": lambda *given: drape.drape(*given, "drape.fem", direction),
        "csv": table.table,
        "vtu": table.grid,
        "pyacp": table.lookup,
    }
    with replaced(out, force=force, names=FILES) as folder:
        if to in LAYUPS:
            notices = [*_notices(carried), *layup(carried, folder, LAYUPS[to], axis)]
        else:
            each = [(*fibres.notices, *writers[to](fibres, folder)) for fibres in carried]
            notices = _notices([replace(f, notices=n) for f, n in zip(carried, each, strict=True)])
        title = f"Hand-over of {record.case} ({to}), quasiform {package_version()}"
        write_notices(folder / NOTES, title, notices)
        files = tuple(sorted(path.name for path in folder.iterdir()))
    general = tuple(notice for notice in notices if notice in GENERAL)
    return Handover(Path(out), files, tuple(notices), tuple(carried), general)


def _direction(reference: Sequence[float]) -> FloatArray:
    """(3,) unit vector; InputError if it has no direction."""
    with suppress(InputError):
        direction = three("reference", reference)
        if direction.any():
            return direction / np.linalg.norm(direction)
    raise InputError(f"reference must be a direction of three numbers, got {reference!r}")


def _on_the_middle_one(plies: Sequence[Record], within: float | None) -> list[Fibres]:
    """Fibres of all plies on the formed mesh of the middle one."""
    middle = (len(plies) - 1) // 2
    own = carry(plies[middle], None, within)
    if len(plies) > 1:
        own = replace(own, notices=(*own.notices, NOTICES["layers"]["middle"]))
    return [own if ply is plies[middle] else carry(ply, own.target, within) for ply in plies]


def _notices(carried: Sequence[Fibres]) -> list[str]:
    """Notices of all plies, each once; what is not true of all names its ply."""
    shared = set.intersection(*(set(fibres.notices) for fibres in carried))
    found = {
        notice if notice in shared | GENERAL else f"ply {fibres.ply}: {notice}": None
        for fibres in carried
        for notice in fibres.notices
    }
    return list(found)
