"""From a scene file to a scene: forming with punch, die and blank holder (Schäfer et al., Fig. 4).

The scene looks at itself first and leaves out what cannot matter, and says so: mirror planes that
blank, fibres and tools share, terms with a zero coefficient, contact between nodes where the mesh
resolves the tools.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from numbers import Real
from pathlib import Path

import numpy as np
import shapely

from ..checks import InputError, check_number
from ..energy import Term
from ..energy.bending import Bending
from ..energy.contact import Contact, at_edges, at_nodes
from ..energy.friction import Friction
from ..energy.gripper import Grip
from ..energy.paired_membrane import membrane_of
from ..energy.patch_bending import PatchBending
from ..energy.weight import GRAVITY, SheetWeight, ToolWeight
from ..fabric import Fabric, fabric_of
from ..model import Scene
from ..net import free_mesh
from ..net.blank import Blank, cut, rotation
from ..net.free_mesh import PAIRED
from ..result.measures import edge_points
from ..tools import tool_file
from ..tools.shapes import Tool, turned
from ..tools.tool_file import ToolFile
from . import scene_file
from .scene_file import SceneFile, SurfaceFile, ToolPart

FloatArray = np.ndarray
SIZE = 5.0  # mm, where nobody says


def forming(
    scene: str | Path | SceneFile = "hemisphere",
    orientation: float | None = None,
    law: str | Fabric | None = None,
    size: float | None = None,
    travel: float | None = None,
    symmetry: str | None = None,
    turn: float = 0.0,
) -> Scene:
    """Forming of a blank between rigid tools.

    What is not given is taken from the scene file.

    Parameters
    ----------
    scene : str or SceneFile
        Name of a built-in scene, or a TOML file.
    orientation : float, optional
        Angle of the warp to x, degrees; outline and tools stay.
    law : str or Fabric, optional
    size : float, optional
        Spacing of the fibre lines, mm (5 if nobody says).
    travel : float, optional
        Travel of the punch from first touch, mm; at most the file's own.
    symmetry : "auto", "half" or "none", optional
        Whether mirror planes of blank, fibres and tools are used: all, at most one, or none.
    turn : float
        Turns the blank with its fibres about the z axis, degrees.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        For bad input, and for a fabric without bending stiffness: a sheet without it has no
        wavelength for its wrinkles and no stiffness before it is stretched.
    """
    name = scene.name if isinstance(scene, SceneFile) else str(scene)
    file = scene if isinstance(scene, SceneFile) else scene_file.load(name)
    fabric = fabric_of(law or file.law)
    size = next(value for value in (size, file.size, SIZE) if value is not None)
    check_number("size", size)
    orientation = file.orientation if orientation is None else orientation
    for key, value in (("orientation", orientation), ("turn", turn)):
        if not isinstance(value, Real) or not np.isfinite(value):
            raise InputError(f"{key} must be a number of degrees, got {value!r}")
    symmetry = symmetry or file.symmetry
    if symmetry not in ("auto", "half", "none"):
        raise InputError(f"symmetry must be 'auto' or 'none', got {symmetry!r}")
    goal = file.travel if travel is None else float(check_number("travel", travel))
    if goal > file.travel:
        raise InputError(f"travel must not exceed {file.travel:g} mm in this scene, got {goal:g}")
    if fabric.bending_warp == 0 or fabric.bending_weft == 0:
        raise InputError(
            "forming in space needs a bending stiffness: bending_warp or _weft is zero"
        )
    return _Build(file, fabric, size, float(orientation), goal, symmetry, turn, name).scene()


class _Build:
    """One scene in the making, step by step."""

    def __init__(
        self,
        file: SceneFile,
        fabric: Fabric,
        size: float,
        orientation: float,
        goal: float,
        symmetry: str,
        turn: float,
        name: str,
    ) -> None:
        self.file, self.fabric, self.size, self.goal = file, fabric, size, goal
        self.orientation, self.symmetry, self.turn, self.given = orientation, symmetry, turn, name
        self.made: list[Tool] = []
        self.from_files: dict[str, ToolFile] = {}
        self.model: list[tuple[str, str]] = [
            ("bending of warp and weft lines", "the sheet leaves its plane")
        ]

    def scene(self) -> Scene:
        file = self.file
        own = self._own_mesh()
        self.outline = shapely.affinity.rotate(
            free_mesh.outline_of(own) if own else file.outline, self.turn, origin=(0, 0)
        )
        self._check_size()
        if not self.made:
            self.made = [self._tool(part) for part in file.tools]
        for read in self.from_files.values():
            self.model += read.told(self.made, self.outline, self.goal)
        self.tools = self.made
        self._check_clearance()
        mirror = self._mirror_planes()
        self.frame = self.orientation + self.turn if mirror else 0.0
        self.tools = [self._in_frame(tool) for tool in self.tools]
        blank = own.turned(self.turn) if own else self._mesh(mirror)
        self._assemble(blank)
        return self._finish(blank)

    # The parts

    def _own_mesh(self) -> Blank | None:
        """Return the user's own mesh, which brings its outline."""
        file = self.file
        if not isinstance(file.mesh, Path):
            return None
        return free_mesh.own_mesh(file.mesh, self.orientation, file.mesh_scale)

    def _check_size(self) -> None:
        low_x, low_y, high_x, high_y = self.outline.bounds
        least = min(high_x - low_x, high_y - low_y)
        if not isinstance(self.file.mesh, Path) and self.size > least / 8:
            raise InputError(
                f"size must not exceed an eighth of the blank, {least / 8:g}, got {self.size:g}"
            )

    def _tool(self, part: ToolPart) -> Tool:
        t0 = self.fabric.thickness
        shape, rest = part.shape, 0.0 if part.role == "die" else t0
        if isinstance(shape, SurfaceFile):
            read = tool_file.read(part, self.outline, self.file.travel, t0)
            self.from_files[part.name] = read
            shape, rest = read.grid, read.rest
        return Tool(
            part.name,
            shape,
            rest if part.z is None else part.z,
            part.motion,
            self.fabric.friction if part.friction is None else part.friction,
            part.mass,
            part.force,
            part.place,
            part.motion == "free" and part.tilt is not False,
        )

    def _why_inside(self, name: str) -> str:
        read = self.from_files.get(name)
        return read.why_inside() if read else "check its z"

    def _check_clearance(self) -> None:
        """Driven and fixed tools must leave room for the sheet between them at the end."""
        low_x, low_y, high_x, high_y = self.outline.bounds
        t0, z = self.fabric.thickness, np.linspace(-self.goal, 0.0, 30)
        grid = np.meshgrid(np.linspace(low_x, high_x, 60), np.linspace(low_y, high_y, 60), z)
        points = np.stack([c.ravel() for c in grid], axis=1)
        for driven in (tool for tool in self.tools if tool.motion == "driven"):
            for fixed in (tool for tool in self.tools if tool.motion != "driven"):
                d = driven.gap(points, -self.goal)
                gap = np.maximum(d + fixed.gap(points), 0.0)
                gap[np.abs(d) > 3.0] = np.inf
                at = gap.argmin()
                if gap[at] < t0 * (1 - 1e-9):
                    x, y, height = points[at]
                    why = tool_file.why_tight(driven, fixed, self.from_files, t0)
                    raise InputError(
                        f"{driven.name} and {fixed.name} leave {gap[at]:.2f} mm for a sheet of "
                        f"{t0:g} mm between them at the end of the travel, near "
                        f"({x:.0f}, {y:.0f}, {height:.0f}) mm{why}"
                    )

    def _mirror_planes(self) -> tuple[str, ...]:
        """Planes along the fibres that map blank and tools onto themselves, in the fibres' axes."""
        if self.symmetry == "none":
            self.model.append(("the whole blank", "symmetry is switched off"))
            return ()
        if self.file.mesh != "fibre":
            self.model.append(("the whole blank", "the mesh does not follow the fibres"))
            return ()
        if self.file.supports or self.file.grippers:
            self.model.append(("the whole blank", "mirror planes are not sought with supports"))
            return ()
        along = rotation(self.orientation + self.turn)
        outline = shapely.affinity.rotate(
            self.outline, -self.orientation - self.turn, origin=(0, 0)
        )
        bounds = np.array(outline.bounds).reshape(2, 2)
        rng = np.random.default_rng(0)
        flat = rng.uniform(*bounds, (20000, 2))
        z = rng.uniform(-self.goal, self.fabric.thickness, len(flat))
        planes = []
        for axis, name in enumerate("xy"):
            flip = np.ones(2)
            flip[axis] = -1.0
            mirrored = shapely.affinity.scale(outline, *flip, origin=(0, 0))
            same = outline.symmetric_difference(mirrored).area < 1e-6 * outline.area
            for tool in self.tools if same else ():
                same = same and abs(along[:, axis] @ tool.place) < 1e-9
                d = [
                    tool.gap(
                        np.column_stack([points @ along.T, z]),
                        -self.goal if tool.motion == "driven" else 0.0,
                    )
                    for points in (flat, flat * flip)
                ]
                near = np.minimum(*np.abs(d)) < 2 * self.fabric.thickness
                off = np.abs(d[0] - d[1])[near]
                same = same and not (off > 0.01 * self.fabric.thickness).any()
            if same and not (planes and self.symmetry == "half"):
                planes.append(name)
        where = {"x": "across the warp", "y": "along the warp"}
        if not planes:
            self.model.append(("the whole blank", "no plane along the fibres mirrors it"))
        else:
            part = "a quarter" if len(planes) == 2 else "a half"
            words = " and ".join(where[plane] for plane in planes)
            self.model.append(
                (
                    part,
                    f"blank, fibres and tools are mirrored at the plane{'s' * (len(planes) > 1)} "
                    f"{words}; wrinkles or bands that break this symmetry are not seen "
                    "(--symmetry none)",
                )
            )
        return tuple(planes)

    def _in_frame(self, tool: Tool) -> Tool:
        """Turn a tool into the model's axes."""
        if self.frame == 0:
            return tool
        place = tuple(np.array(tool.place) @ rotation(self.frame))
        return replace(tool, shape=turned(tool.shape, -self.frame), place=place)

    def _mesh(self, mirror: tuple[str, ...]) -> Blank:
        angle = self.orientation + self.turn - self.frame
        outline = shapely.affinity.rotate(self.outline, -self.frame, origin=(0, 0))
        if self.file.mesh == "free":
            return free_mesh.triangulate(outline, self.size, angle)
        return cut(outline, self.size, angle, through=((0.0, 0.0),), mirror=mirror)

    # Energies and supports

    def _assemble(self, blank: Blank) -> None:
        fabric, n = self.fabric, len(blank.nodes)
        self.share = 0.5 ** len(blank.mirror)
        t0 = fabric.thickness
        self.tools = [
            replace(tool, tilts=tool.tilts and len(blank.mirror) < 2) for tool in self.tools
        ]
        first = 3 * n + np.cumsum([0] + [3 if tool.tilts else 1 for tool in self.tools])
        self.tool_dof = first[:-1]
        n_dofs = int(first[-1]) + self.file.gravity
        x0, drive = np.zeros(n_dofs), np.zeros(n_dofs)
        fixed = np.zeros(n_dofs, dtype=bool)
        x0[: 3 * n].reshape(-1, 3)[:, :2] = blank.nodes
        points = at_nodes(blank)
        contacts = [
            Contact(blank, fabric, tool, dof, points)
            for tool, dof in zip(self.tools, self.tool_dof, strict=True)
        ]
        weights: list[Term] = []
        self.resting, sunk = 0.0, 0.0
        for tool, dof, contact in zip(self.tools, self.tool_dof, contacts, strict=True):
            x0[dof] = tool.height
            fixed[dof] = tool.motion != "free"
            drive[dof] = -1.0 if tool.motion == "driven" else 0.0
            if tool.motion != "free":
                continue
            for axis, plane in enumerate("xy"):
                if plane in blank.mirror and tool.tilts:  # only the turn in that plane is symmetric
                    fixed[dof + 2 - axis] = True
            x0[2 : 3 * n : 3] = tool.height - 0.5 * t0
            held = contact.penetration(x0) > -1e-6
            if not held.any():
                raise InputError(f"the blank does not reach under the {tool.name}")
            if tool.tilts and not contact.surrounds(x0, blank.mirror):
                raise InputError(f"the blank does not surround the weight of the {tool.name}")
            load = (1e3 * GRAVITY * tool.mass + tool.force) * self.share
            weights.append(ToolWeight(load, dof, f"weight of the {tool.name}"))
            self.resting += load
            sunk = max(sunk, contact.depth_under(load, blank.node_areas[held].sum()))
        # start at the equilibrium of the holder's weight: sheet and holder sunk in by as much
        x0[2 : 3 * n : 3] = 0.5 * t0 - sunk
        for tool, dof in zip(self.tools, self.tool_dof, strict=True):
            if tool.motion == "free":
                x0[dof] -= 2 * sunk
        for contact in contacts:
            if (contact.penetration(x0) > t0).any():
                raise InputError(
                    f"the flat blank starts inside the {contact.tool.name}: "
                    f"{self._why_inside(contact.tool.name)}"
                )
        for axis, plane in enumerate("xy"):
            if plane in blank.mirror:
                fixed[axis : 3 * n : 3] |= np.abs(blank.nodes[:, axis]) < 1e-9
        clamped = self._support(blank, fixed)
        sheet: list[Term] = [membrane_of(blank, fabric, dim=3)]
        if blank.pairs is None:
            sheet.append(Bending(blank, fabric, clamped))
        else:
            sheet.append(PatchBending(blank, fabric))
            self.model.append(PAIRED)
            if clamped is not None:
                raise InputError("clamp = true needs a mesh that follows the fibres")
        contacts += self._between_nodes(blank)
        frictions = [Friction(c, x0) for c in contacts if c.tool.friction]
        if not frictions:
            self.model.append(("friction left out", "its coefficient is zero"))
            self._hold(blank, fixed)
        if self.file.gravity:
            fixed[-1], x0[-1] = True, 1.0
            load = 1e-6 * GRAVITY * fabric.areal_weight
            weights.append(SheetWeight(blank, load, n_dofs - 1))
        else:
            total = 1e-6 * fabric.areal_weight * self.outline.area * GRAVITY
            beside = (
                f" beside the {self.resting / self.share:.3g} N that rest on it"
                if self.resting
                else ""
            )
            self.model.append(
                ("weight of the sheet left out", f"{total:.2g} N{beside} (gravity = false)")
            )
        self.terms = [*sheet, *contacts, *frictions, *weights, *self._grip(blank, x0)]
        self.x0, self.fixed, self.drive = x0, fixed, drive

    def _between_nodes(self, blank: Blank) -> list[Contact]:
        """Contact between nodes, for the tools whose edges are sharper than the mesh."""
        edges = at_edges(blank)
        sharp = [
            (tool, dof)
            for tool, dof in zip(self.tools, self.tool_dof, strict=True)
            if getattr(tool.shape, "sharpest", 0.0) < blank.size * (1 - 1e-9)
        ]
        words = "a tool bends more sharply than the elements"
        if not sharp:
            words = "no tool bends more sharply than the elements"
        self.model.append((f"contact at nodes{' and mid-edges' * bool(sharp)}", words))
        return [Contact(blank, self.fabric, tool, dof, edges) for tool, dof in sharp]

    def _support(self, blank: Blank, fixed: np.ndarray) -> np.ndarray | None:
        """Prescribe supported nodes; which of them are clamped."""
        clamped = np.zeros(len(blank.nodes), dtype=bool)
        for i, support in enumerate(self.file.supports, 1):
            nodes = support.where.nodes(blank.nodes, self.outline.bounds)
            if not nodes.any():
                raise InputError(f"[supports {i}] no node of the blank lies there")
            for axis, letter in enumerate("xyz"):
                if letter in support.fix:
                    fixed[axis : 3 * len(nodes) : 3] |= nodes
            clamped |= nodes & support.clamp
        return clamped if clamped.any() else None

    def _grip(self, blank: Blank, x0: FloatArray) -> list[Term]:
        grips: list[Term] = []
        positions = x0[: 3 * len(blank.nodes)].reshape(-1, 3)
        for i, gripper in enumerate(self.file.grippers, 1):
            at = np.flatnonzero(gripper.where.nodes(blank.nodes, self.outline.bounds))
            if not len(at):
                raise InputError(f"[grippers {i}] no node of the blank lies there")
            rim = blank.mesh.facets[:, blank.mesh.boundary_facets()].T
            rim = rim[np.isin(rim, at).all(1)] if gripper.where.side else rim[:0]
            length = np.linalg.norm(np.diff(blank.nodes[rim], axis=1)[:, 0], axis=1)
            part = (
                np.bincount(rim.ravel(), np.repeat(length, 2), minlength=len(blank.nodes))
                if len(rim)
                else blank.node_areas
            )
            shares = part[at] / part[at].sum()
            direction = np.array([*gripper.direction, 0.0])
            grips.append(
                Grip(at, shares, positions[at], direction, gripper.tension, gripper.stiffness)
            )
        return grips

    def _hold(self, blank: Blank, fixed: np.ndarray) -> None:
        """Without friction the middle of the sheet keeps its place in the plane."""
        if self.file.supports or self.file.grippers or len(blank.mirror) == 2:
            return
        middle = np.linalg.norm(blank.nodes, axis=1).argmin()
        for axis, plane in enumerate("xy"):
            if plane not in blank.mirror:
                fixed[3 * middle + axis] = True
        if not blank.mirror:
            far = np.linalg.norm(blank.nodes - blank.warp * 4 * self.size, axis=1).argmin()
            fixed[3 * far + int(abs(blank.warp[1]) < abs(blank.warp[0]))] = True
        self.model.append(("middle of the sheet held in the plane", "no friction holds it"))

    # The whole

    def _finish(self, blank: Blank) -> Scene:
        file, given = self.file, self.given
        scene = Scene(
            name=f"{file.name}-{self.orientation:g}",
            blank=blank,
            fabric=self.fabric,
            dim=3,
            terms=self.terms,
            x0=self.x0,
            fixed=self.fixed,
            drive=self.drive,
            travel=self.goal,
            increment=file.increment,
            rows=file.rows,
            travel_name="travel_mm",
            share=self.share,
            resting=self.resting
            + sum(g.tension for g in file.grippers)
            + file.gravity * 1e-6 * GRAVITY * self.fabric.areal_weight * blank.areas.sum(),
            model=self.model,
            parameters={
                "scene": given if isinstance(given, str) else file.name,
                **({"scene_file": file.source} if file.source else {}),
                "orientation": self.orientation,
                "law": self.fabric.name,
                "size": self.size,
                "travel": self.goal,
                "symmetry": self.symmetry,
                "turn": self.turn,
                "fabric": asdict(self.fabric),
                "standings": file.standings,
            },
            areas={
                name: (tuple(rotation(self.turn) @ centre), radius)
                for name, (centre, radius) in file.areas.items()
            },
            turn=self.frame,
            outputs=file.outputs,
            resized=None if isinstance(file.mesh, Path) else self._resized,
            coarsest=min(
                (getattr(tool.shape, "sharpest", 0.0) for tool in self.tools), default=0.0
            ),
        )
        scene.edges = edge_points(scene.whole[0], self.turn)
        membrane, share = scene.membrane, self.share
        resting = [c for c in scene.contacts if c.tool.motion == "free"]
        scene.measures = {
            "holder_force_N": lambda x: float(
                -sum(c.gradient(x)[:, c.height_column].sum() for c in resting) / share
            ),
            "shear_angle_max_deg": lambda x: float(
                np.degrees(np.abs(membrane.shear_angle(x)).max())
            ),
            "draw_in_mm": lambda x: float(
                np.mean([e.draw_in(scene.whole_positions(x)) for e in scene.edges.values()])
            ),
        }
        return scene

    def _resized(self, size: float) -> Scene:
        """Build the same scene at another size; its tools are those made already."""
        other = _Build(
            self.file,
            self.fabric,
            size,
            self.orientation,
            self.goal,
            self.symmetry,
            self.turn,
            self.given,
        )
        other.made, other.from_files = self.made, self.from_files
        return other.scene()
