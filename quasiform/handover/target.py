"""The user's structural mesh that directions are handed over to.

Element and node numbers of an .inp file are kept; elsewhere both count from 1.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..checks import InputError, check_file, check_number, naming
from ..comparison.shells import Shells, read_inp
from ..result.sheet import CORNERS
from ..tools.surface_file import read_mesh


def read_target(path: str | Path, scale: float = 1.0) -> Shells:
    """Read the shell elements of a structural mesh: .inp, or what meshio reads.

    `scale` is mm per unit of its lengths. Of elements of higher order only the corners count. A
    defect raises InputError with the name of the file.
    """
    path = Path(path)
    with naming(path):
        check_file(path)
        check_number("scale", scale)
        if path.suffix.lower() == ".inp":
            target = read_inp(path, ("INCLUDE", "INSTANCE"))
        else:
            target = _from_meshio(path)
        if not len(target.elements):
            raise InputError("no triangles or quadrilaterals")
        if not np.isfinite(target.points).all():
            raise InputError("not all points are finite numbers")
        target = Shells(scale * target.points, target.nodes, target.corners, target.elements)
        target.normals  # noqa: B018  (refuses an element without an area)
        return target


def _from_meshio(path: Path) -> Shells:
    mesh = read_mesh(path)
    rows = [np.empty((0, 4), dtype=int)]
    for block in mesh.cells:
        if corners := CORNERS.get(block.type):
            cells = np.asarray(block.data)[:, :corners]
            rows.append(np.pad(cells, ((0, 0), (0, 4 - corners)), constant_values=-1))
    return Shells.counted(mesh.points, np.concatenate(rows))
