"""Punches from surface files compared with the same punches in closed form."""

from pathlib import Path
from tempfile import TemporaryDirectory

import gmsh
import numpy as np

import quasiform as qf
from quasiform.result.measures import percentile
from quasiform.scenes import scene_file
from quasiform.tools import grid as surface
from quasiform.tools.shapes import Rounded

LOW, HIGH = np.array([-160.0, -160.0, -10.0]), np.array([160.0, 160.0, 90.0])


def values() -> dict[str, float]:
    """Differences in distance, normal and the formed result, at grid spacings of 2 and 1 mm."""
    found = {}
    with TemporaryDirectory() as folder:
        for name in ("hemisphere", "box", "tetrahedron"):
            path = Path(folder) / f"{name}.stl"
            exact = scene_file.load(name).tools[0].shape
            _write(name, exact, path)
            for spacing in (2.0, 1.0):
                grid = surface.from_file(path, LOW, HIGH, spacing)
                points = _near(exact)
                d, n, _ = exact.distance(points)
                d_file, n_file, _ = grid.distance(points)
                case = f"{name}, grid {spacing:g} mm"
                found[f"{case}: error of the distance, 95th percentile"] = np.percentile(
                    np.abs(d_file - d), 95
                )
                found[f"{case}: error of the distance, largest"] = np.abs(d_file - d).max()
                found[f"{case}: error of the normal, 95th percentile"] = np.percentile(
                    np.linalg.norm(n_file - n, axis=1), 95
                )
            # the box before it buckles, and with elements small enough for contact at nodes alone
            size, travel = (5, 20) if name == "box" else (10, 40)
            runs = [
                qf.solve(qf.forming(scene, 0, size=size, travel=travel), estimate=False)
                for scene in (name, _with_file(name, path))
            ]
            p99 = [percentile(np.abs(r.shear_angle), r.blank.areas, 0.99) for r in runs]
            found[f"{name} formed: difference of the 99th percentile"] = abs(p99[1] - p99[0])
            found[f"{name} formed: relative difference of the force"] = abs(
                runs[1].force / runs[0].force - 1
            )
    return found


def _near(shape: Rounded) -> np.ndarray:
    """Points within 2 mm of the surface, inside the region of the grid."""
    points = np.random.default_rng(0).uniform(LOW + 5, HIGH - 5, (200_000, 3))
    points = points[np.abs(shape.distance(points)[0]) < 2.0]
    return points[:20_000]


def _with_file(name: str, path: Path) -> str:
    """Write the scene with its punch from a file, next to that file; its path."""
    text = (scene_file.FOLDER / f"{name}.toml").read_text(encoding="utf-8")
    head, rest = text.split("[tools.punch]\n")
    _, rest = rest.split("[tools.die]", 1)
    scene = path.with_suffix(".toml")
    scene.write_text(
        f'{head}[tools.punch]\nfile = "{path.name}"\n\n[tools.die]{rest}', encoding="utf-8"
    )
    return str(scene)


def _write(name: str, shape: Rounded, path: Path) -> None:
    """Model the punch in OpenCASCADE, as a designer would, and write it as STL."""
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    occ, r = gmsh.model.occ, shape.radius
    core = shape.core.copy()
    core[:, 2] = np.minimum(core[:, 2], 150.0)
    if name == "hemisphere":
        ball = occ.addSphere(0, 0, r, r)
        shaft = occ.addCylinder(0, 0, r, 0, 0, 150.0 - r, r)
        occ.fuse([(3, ball)], [(3, shaft)])
    elif name == "box":
        low, high = core.min(0) - r, core.max(0) + np.array([r, r, 0.0])
        box = occ.addBox(*low, *(high - low))
        _fillet(box, r, top=high[2])
    else:
        # sharp corners: the faces, moved out again by the radius, meet there
        _fillet(_solid(_grown(core, r)), r, top=np.inf)
    occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 120)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 10.0)
    gmsh.model.mesh.generate(2)
    gmsh.write(str(path))
    gmsh.finalize()


def _grown(core: np.ndarray, r: float) -> np.ndarray:
    """Corners of a solid with the faces of `core` moved outwards by r."""
    from scipy.spatial import ConvexHull, HalfspaceIntersection

    faces = ConvexHull(core).equations - np.array([0.0, 0.0, 0.0, r])
    return HalfspaceIntersection(faces, core.mean(0)).intersections


def _solid(corners: np.ndarray) -> int:
    """Volume of a tetrahedron with these corners."""
    occ = gmsh.model.occ
    points = [occ.addPoint(*corner) for corner in corners]
    lines = {}
    for i in range(4):
        for j in range(i):
            lines[j, i] = occ.addLine(points[j], points[i])
    faces = [
        occ.addPlaneSurface([occ.addCurveLoop([lines[a, b], lines[b, c], lines[a, c]])])
        for a, b, c in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))
    ]
    return occ.addVolume([occ.addSurfaceLoop(faces)])


def _fillet(volume: int, r: float, top: float) -> None:
    """Fillet all edges of a volume except those of its top face."""
    occ = gmsh.model.occ
    occ.synchronize()
    edges = [tag for _, tag in occ.getEntities(1) if occ.getBoundingBox(1, tag)[2] < top - 1.0]
    occ.fillet([volume], edges, [r])
