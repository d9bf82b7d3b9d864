"""The formed sheet of a result with its fibres, from a `Result` or the folder of one.

In a triangle with the flat legs dX and the formed ones dx, F = dx dX⁻¹ (3, 2); the area has changed
by J = |F e1 × F e2|.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import InputError, check_number
from ..comparison.mesh_file import read_fields
from ..comparison.read import scene_of
from ..comparison.sheet import Sheet
from ..result.run import Result

FloatArray = np.ndarray
FLAT = 1e-3  # of its size: how far the undeformed sheet may leave its plane


@dataclass(frozen=True, eq=False)
class Part:
    """One formed ply.

    Parameters
    ----------
    name : str
    flat : (n, 2) array
        Flat positions X, mm.
    points : (n, 3) array
        Formed positions x of the mid-surface, mm.
    triangles : (m, 3) int array
        Counter-clockwise seen from the upper side of the flat sheet, where the punch is.
    warp, weft : (m, 3) arrays
        Unit vectors of the formed fibres.
    fabric : dict
        Its parameters by name, as in summary.json: thickness (mm), areal_weight (g/m²), ...
    parameters : dict
        The run's.
    notices : tuple of str
        What is doubtful about it.
    folder : path, optional
        Where it was read from.
    """

    name: str
    flat: FloatArray
    points: FloatArray
    triangles: np.ndarray
    warp: FloatArray
    weft: FloatArray
    fabric: dict[str, Any]
    parameters: dict[str, Any]
    notices: tuple[str, ...] = ()
    folder: Path | None = None

    @property
    def scene(self) -> str:
        """Name or file of the run's scene, where it is now.

        Raises
        ------
        InputError
            If its file is not there any more.
        """
        if self.folder is None:
            return str(self.parameters.get("scene"))
        return scene_of(self.parameters, self.folder)

    @property
    def sheet(self) -> Sheet:
        """The formed mesh, for the mapping."""
        return Sheet(self.points, self.flat, self.triangles)

    @cached_property
    def F(self) -> FloatArray:
        """(m, 3, 2) deformation gradients."""
        legs = self.points[self.triangles[:, 1:]] - self.points[self.triangles[:, :1]]
        rest = self.flat[self.triangles[:, 1:]] - self.flat[self.triangles[:, :1]]
        return np.linalg.solve(rest, legs).transpose(0, 2, 1)

    @cached_property
    def area_ratio(self) -> FloatArray:
        """(m,) J, formed area over flat area."""
        return np.linalg.norm(np.cross(self.F[..., 0], self.F[..., 1]), axis=1)

    @cached_property
    def along(self) -> FloatArray:
        """(2, 2) flat unit vectors of warp and weft, one a row: F⁻¹ of the formed ones."""
        back = np.linalg.pinv(self.F)
        found = []
        for formed in (self.warp, self.weft):
            flat = np.einsum("mij,mj->mi", back, formed)
            mean = (flat / np.linalg.norm(flat, axis=1)[:, None]).mean(0)
            found.append(mean / np.linalg.norm(mean))
        return np.array(found)


def part_of(source: Result | str | Path) -> Part:
    """Formed sheet of a result or of the folder that it left (summary.json, result.vtu).

    Raises
    ------
    InputError
        Naming the file and what is missing in it.
    """
    if isinstance(source, Result):
        scene, blank = source.scene, source.blank
        fields = source.cell_fields()
        return _checked(
            Part(
                scene.name,
                blank.nodes,
                source.positions(),
                blank.triangles,
                fields["warp"],
                fields["weft"],
                {
                    name: getattr(scene.fabric, name)
                    for name in ("name", "thickness", "areal_weight")
                }
                | {"moduli": _moduli(vars(scene.fabric))},
                scene.parameters,
                _doubts(fields, source.status, source.certified),
            ),
            "the result",
        )
    folder = Path(source)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of a result")
    summary = _summary(folder / "summary.json")
    fields = read_fields(folder / "result.vtu")[-1]
    where = str(folder / "result.vtu")
    for kind, table, name in (
        ("point", fields.by_point, "displacement"),
        ("cell", fields.by_triangle, "warp"),
        ("cell", fields.by_triangle, "weft"),
    ):
        if name not in table or np.shape(table[name])[1:] != (3,):
            raise InputError(f"{where}: no {kind} field '{name}' of three components")
    rest = fields.points - fields.by_point["displacement"]
    if np.ptp(rest[:, 2]) > FLAT * np.ptp(rest, axis=0).max():
        raise InputError(f"{where}: its undeformed sheet is not flat")
    parameters = summary.get("parameters")
    fabric = parameters.get("fabric") if isinstance(parameters, dict) else None
    if not isinstance(fabric, dict):
        raise InputError(f"{folder / 'summary.json'}: no parameters.fabric")
    for name, zero in (("thickness", False), ("areal_weight", True)):
        given = f"{folder / 'summary.json'}: parameters.fabric.{name}"
        check_number(given, fabric.get(name), zero_allowed=zero)
    return _checked(
        Part(
            str(summary.get("case", folder.name)),
            rest[:, :2],
            fields.points,
            fields.triangles,
            np.asarray(fields.by_triangle["warp"], dtype=float),
            np.asarray(fields.by_triangle["weft"], dtype=float),
            fabric | {"moduli": _moduli(fabric)},
            parameters,
            _doubts(fields.by_triangle, summary.get("status"), summary.get("certified")),
            folder,
        ),
        where,
    )


def _summary(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise InputError(f"{path}: not readable: {error}") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: not a summary of a run")
    return content


def _checked(part: Part, where: str) -> Part:
    if not len(part.triangles) or not (part.area_ratio > 0).all():
        raise InputError(f"{where}: a triangle has no area")
    for name in ("warp", "weft"):
        length = np.linalg.norm(getattr(part, name), axis=1)
        if not (np.abs(length - 1) < 1e-3).all():
            raise InputError(f"{where}: the field '{name}' holds vectors that are no unit vectors")
    return part


def _moduli(fabric: dict[str, Any]) -> tuple[float, float, float] | None:
    """Stiffness of the flat, unloaded fabric along warp and weft and in shear, MPa.

    S = 2 dW/dI4 and E = (I4 - 1)/2, so that dS/dE = 4 d²W/dI4² = 4 C_ini; S12 = dW/dI6 and
    I6 = 2 E12, so that the shear modulus is C_ini. None where the laws are not known so far.
    """
    found = []
    for name, factor in (("warp", 4.0), ("weft", 4.0), ("shear", 1.0)):
        law = fabric.get(name)
        law = law if isinstance(law, dict) or law is None else vars(law)
        if law and "C_ini" in law:
            found.append(factor * float(law["C_ini"]))
        elif law and len(law.get("I6", ())) > 1:
            found.append(float(law["S12"][1]) / float(law["I6"][1]))
        else:
            return None
    return tuple(found)


def _doubts(fields: dict[str, FloatArray], status: object, certified: object) -> tuple[str, ...]:
    found = []
    if status == "stopped":
        found.append("the run stopped before its goal: the part is not fully formed")
    if certified is not True:
        found.append(f"the end state is not certified: {certified or 'unknown'}")
    if "doubt" in fields and (doubtful := np.asarray(fields["doubt"]) > 0).any():
        found.append(
            f"{doubtful.sum()} of {len(doubtful)} triangles of the result are marked doubtful "
            "(field 'doubt': beyond the tests of the fabric, unstable, collapsed, or rovings may "
            "slip); the mark is not carried into the hand-over"
        )
    return tuple(found)
