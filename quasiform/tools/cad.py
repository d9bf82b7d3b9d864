"""Triangles of a CAD file by gmsh: a program of its own, `python cad.py FILE KIND OUT`.

OpenCASCADE and gmsh can crash or never end on a damaged file; the calling program is not affected.
OUT gets the node tags (n,), their places (n, 3) and the tags of the triangles' corners (m, 3) as
arrays of a .npz file.
"""

import sys

import gmsh
import numpy as np

FACETS = 120  # on a full circle; a CAD surface's facets are 1/200 to 1/60 of its size
SEWN = 1e-3  # mm; gaps between the faces of an IGES file


def mesh(path: str, kind: str, out: str) -> None:
    """Mesh the faces of a shape, finer where they are curved; gmsh may raise any exception."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    if kind == "step":  # the others are in mm anyway; gmsh refuses the option as long as it has
        gmsh.option.setString("Geometry.OCCTargetUnit", "MM")  # not read or written a step file
    gmsh.model.occ.importShapes(path, format=kind)
    if kind == "iges":  # its faces do not know their neighbours
        gmsh.model.occ.healShapes(tolerance=SEWN)
    gmsh.model.occ.synchronize()
    box = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
    size = float(np.linalg.norm(box[1] - box[0]))
    sizes = {"FromCurvature": FACETS, "Min": size / 200, "Max": size / 60}
    sizes["ExtendFromBoundary"] = 0
    for option, value in sizes.items():
        gmsh.option.setNumber(f"Mesh.MeshSize{option}", value)
    gmsh.option.setNumber("Mesh.ElementOrder", 1)
    gmsh.option.setNumber("Mesh.RecombineAll", 0)
    gmsh.model.mesh.generate(2)
    tags, points, _ = gmsh.model.mesh.getNodes()
    corners = gmsh.model.mesh.getElementsByType(2)[1]
    np.savez(out, tags=tags, points=points.reshape(-1, 3), corners=corners.reshape(-1, 3))


if __name__ == "__main__":
    try:
        mesh(*sys.argv[1:])
    except Exception as error:  # all that gmsh raises, as one line
        sys.exit(" ".join(str(error).split()) or type(error).__name__)
