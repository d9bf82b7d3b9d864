"""A tool from a surface file, placed over the sheet.

What a file holds may be upside down, inside out, elsewhere, or in another unit. The model says
where it lies and, where that cannot be right, which line of the scene corrects it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..checks import InputError, naming
from . import grid as surface
from .mending import normals_of, position, rims_of
from .part import ToolPart
from .shapes import Tool
from .surface_file import SurfaceFile

if TYPE_CHECKING:
    import shapely

FloatArray = np.ndarray
SMALL = 0.2  # of an opening: the model warns of a narrower punch
BASE = 0.9  # of the area seen from above: a flat face as large is a base
SAMPLES = 60  # points a side of the grid on which an opening is looked for


@dataclass(frozen=True)
class ToolFile:
    """A tool's surface as it was read."""

    part: ToolPart  # its shape is a `SurfaceFile`
    thickness: float  # of the sheet, mm
    grid: surface.SurfaceGrid  # its distance, where the sheet can be
    vertices: FloatArray  # (n, 3), placed, repaired, in the tool's own z, mm
    triangles: np.ndarray  # (m, 3)
    repairs: list[str]
    warnings: list[str]  # what may be wrong, with the line that corrects it

    @property
    def file(self) -> SurfaceFile:
        return self.part.shape

    @property
    def name(self) -> str:
        return self.file.path.name

    @property
    def down(self) -> bool:
        """Whether its lowest point meets the sheet, as that of a punch, or its highest."""
        return self.part.role != "die"

    @property
    def box(self) -> FloatArray:
        """(2, 3) corners: x and y in space, z its own, mm."""
        box = np.stack([self.vertices.min(0), self.vertices.max(0)])
        box[:, :2] += self.part.place
        return box

    @property
    def corners(self) -> FloatArray:
        """(m, 3, 3) corners of its triangles, in the tool's own axes, mm."""
        return self.vertices[self.triangles]

    @property
    def rest(self) -> float:
        """The z at which it touches the flat sheet, mm."""
        low, high = self.box[:, 2]
        moved = self.thickness - low if self.down else -high
        return float(moved + self.file.offset * (-1 if self.down else 1))

    def description(
        self, tools: Sequence[Tool], outline: shapely.Polygon, travel: float
    ) -> list[tuple[str, str]]:
        """Lines of the model: what the file holds, where it lies, repairs, warnings."""
        part, box = self.part, self.box
        z = -self.vertices[:, 2] if self.down else self.vertices[:, 2]
        ends = self.vertices[z > z.max() - 1e-6 * np.ptp(self.vertices)]
        end = ends[np.linalg.norm(ends - ends.mean(0), axis=1).argmin()]
        gap = 0.0 if part.z is None else (part.z - self.rest) * (1 if self.down else -1)
        where = "on" if self.down else "under"
        if abs(gap) > 1e-9:
            side = "over" if (gap > 0) == self.down else "under"
            where = f"{abs(gap):.3g} mm {side} the {'upper' if self.down else 'lower'} face of"
        size = "{:.4g} x {:.4g} x {:.4g} mm".format(*np.ptp(box, axis=0))
        size += f", {len(self.triangles)} triangles, its middle at {position(box.mean(0)[:2])}"
        if self.file.offset:
            size += f", its surface moved by {self.file.offset:g} mm into the tool"
        tip = f"its {'lowest' if self.down else 'highest'} point at"
        tip = f"{tip} {position(end[:2] + part.place)}"
        lines = [(f"{part.name} from {self.name}", f"{size}, {tip}, {where} the sheet")]
        lines += [(f"{self.name} repaired", "; ".join(self.repairs))] * bool(self.repairs)
        warnings = [*self.warnings, *self._lost_in_opening(tools, outline, travel)]
        return lines + [(f"warning, {self.name}", warning) for warning in warnings]

    def _lost_in_opening(
        self, tools: Sequence[Tool], outline: shapely.Polygon, travel: float
    ) -> list[str]:
        """Warn of a punch that is small in the opening under it."""
        from scipy.ndimage import label

        if self.part.motion != "driven":
            return []
        box, warnings, scale = self.box, [], self.file.scale
        size, middle = np.ptp(box[:, :2], axis=0).max(), box.mean(0)
        x, y = np.linspace(*np.reshape(outline.bounds, (2, 2)), SAMPLES, axis=1)
        level = np.full((SAMPLES, SAMPLES), -travel / 2)
        points = np.stack([*np.meshgrid(x, y, indexing="ij"), level], axis=-1)
        for die in (tool for tool in tools if tool.motion == "fixed"):
            clear = die.gap(points.reshape(-1, 3)).reshape(SAMPLES, SAMPLES) > 0
            regions = label(clear)[0]
            under = regions[np.abs(x - middle[0]).argmin(), np.abs(y - middle[1]).argmin()]
            opening = regions == under
            rim = np.concatenate([opening[[0, -1]].ravel(), opening[:, [0, -1]].ravel()])
            if under == 0 or rim.any():
                continue
            width = np.ptp(points[opening][:, :2], axis=0).max()
            if size < SMALL * width:
                small = f"{size:.3g} mm wide (scale = {scale:g}) in an opening of about"
                unit = surface.likely_unit(size / scale, width)
                warnings.append(f"{small} {width:.2g} mm: {unit}")
        return warnings

    def why_inside(self) -> str:
        """What may have put it into the flat sheet, and what corrects it."""
        if self.warnings:
            return f"{self.name}: {self.warnings[0]}"
        where = f"{self.rest:.4g} puts it {'on' if self.down else 'under'} the sheet"
        place = "" if self.part.z is None else f"check its z, {where}, or "
        return f"{place}set flip = {str(not self.file.flip).lower()}"


def read(part: ToolPart, outline: shapely.Polygon, travel: float, thickness: float) -> ToolFile:
    """Read the surface of a tool, and its distance where the sheet can be.

    The outline is that of the flat blank; the largest travel and the thickness of the sheet are in
    mm. A file that cannot be read or repaired, that lies nowhere near the sheet, or whose size
    suggests another unit raises InputError.
    """
    file = part.shape
    reach = np.full(2, 1.1 * max(np.abs(outline.bounds)))
    across = float(np.ptp(np.reshape(outline.bounds, (2, 2)), axis=0).max())
    margin = surface.BESIDE * across
    spacing = file.spacing or min(surface.SPACING, surface.FINEST * across)
    vertices, triangles, repairs = file.placed()
    bottom, top = float(vertices[:, 2].min()), float(vertices[:, 2].max())
    # the sheet is between the punch's lowest point and the die's face
    deep = travel + 4 * thickness
    face = top if part.role == "die" else bottom
    below, above = (0.0, deep) if part.role == "punch" else (deep, 0.0)
    flat = face if part.z is None else -part.z  # where the flat sheet is, also in a tool
    low = np.append(-reach - part.place, min(face - below - margin, flat - 2 * thickness))
    high = np.append(reach - part.place, max(face + above + margin, flat + 2 * thickness))
    with naming(file.path):
        surface.check_size(np.ptp(vertices, axis=0).max(), across, file.scale)
        plan, sheet = vertices[:, :2] + part.place, np.reshape(outline.bounds, (2, 2))
        tool = np.stack([plan.min(0), plan.max(0)])
        beside = max(margin, surface.MARGIN * spacing)
        if (tool[0] - beside >= reach).any() or (tool[1] + beside <= -reach).any():
            words = "x {:.4g} to {:.4g}, y {:.4g} to {:.4g} mm"
            at, there = (words.format(*box.T.ravel()) for box in (tool, sheet))
            moved = file.moved_origin(*(tool - sheet).mean(0))
            raise InputError(
                f"the tool is nowhere near the sheet: it lies at {at}, the sheet at {there}; "
                f"{moved} puts it over the middle of the sheet"
            )
        grid = surface.surface_grid(
            vertices, triangles, low, high, spacing, across, file.scale, file.flip
        )
        grid = replace(grid, coefficients=grid.coefficients + file.offset)
    warnings = _orientation_warnings(vertices, triangles, part.role, file)
    notes = [*repairs, *grid.notes]
    return ToolFile(part, thickness, grid, vertices, triangles, notes, warnings)


def middle(tool: Tool, files: Mapping[str, ToolFile]) -> FloatArray:
    """(2,) middle of a tool seen along z, mm: of its box if it is from a file, else its place."""
    return files[tool.name].box.mean(0)[:2] if tool.name in files else np.array(tool.place)


def box_of(tool: Tool, files: Mapping[str, ToolFile]) -> FloatArray | None:
    """(2, 2) box of a tool seen along z, mm, where its file or its shape has one."""
    if tool.name in files:
        return files[tool.name].box[:, :2]
    own = getattr(tool.shape, "box", None)
    return None if own is None else np.asarray(own)[:, :2] + tool.place


def why_tight(driven: Tool, fixed: Tool, files: Mapping[str, ToolFile], thickness: float) -> str:
    """What is odd about tools from files that leave no room, and the line that corrects it."""
    named = [name for name in (driven.name, fixed.name) if name in files]
    for name in named:
        if files[name].warnings:
            return f"; {files[name].name}: {files[name].warnings[0]}"
    middles = [middle(tool, files) for tool in (driven, fixed)]
    off = middles[0] - middles[1]
    if not named or np.linalg.norm(off) < thickness:
        return ""
    origin = files[named[0]].file.moved_origin(*(off if named[0] == driven.name else -off))
    first, second = map(position, middles)
    where = f"the middle of the {driven.name} is at {first}, that of the {fixed.name} at {second}"
    return f"; {where}; for the {named[0]}, {origin} brings them together"


def _orientation_warnings(
    vertices: FloatArray, triangles: np.ndarray, role: str, file: SurfaceFile
) -> list[str]:
    """What makes a surface look upside down or inside out, and the line that corrects it."""
    rims = rims_of(vertices, triangles)
    # turned by another 180 degrees about x, which reverses the turns about y and z
    x, y, z = file.rotate
    over = np.array([180.0 - (-x % 360), -y, -z]) + 0.0
    upside_down = "rotate = [{:g}, {:g}, {:g}]".format(*over)
    height = vertices[:, 2] - vertices[:, 2].min()
    tall = height.max() > 1e-3 * np.ptp(vertices)
    if not rims:
        stands = role == "punch" and tall and _stands_on_its_base(vertices, triangles, height)
        words = (
            f"it has a flat base towards the sheet and narrows upwards: upside down? {upside_down}"
        )
        return [words] if stands else []
    matched = file.offset > 0  # a punch from the surface of its die may be open towards the sheet
    if role == "punch" and tall and not matched and height[rims[0]].mean() < 0.1 * height.max():
        return [f"the surface is open towards the sheet: upside down? {upside_down}"]
    up = normals_of(vertices[triangles])[:, 2].sum()
    flip = f"inside out? flip = {str(not file.flip).lower()}; or upside down? {upside_down}"
    away = up * (1 if role == "die" else -1) < 0
    return [f"its normals point away from the sheet: {flip}"] if away else []


def _stands_on_its_base(vertices: FloatArray, triangles: np.ndarray, height: FloatArray) -> bool:
    """Whether the lowest face of a closed body is as wide as the body, and no other level is."""
    level = 1e-3 * height.max()
    plan = 0.5 * normals_of(vertices[triangles])[:, 2]
    at = height[triangles]
    base = -plan[(at < level).all(1)].sum()
    top = plan[(at > height.max() - level).all(1)].sum()
    whole = plan[plan > 0].sum()
    return bool(base > BASE * whole > 0 and top < (1 - 2 * (1 - BASE)) * whole)
