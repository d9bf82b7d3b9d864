"""Triangles of a rigid tool, where the sheet can be.

A tool from a file gives its own triangles. A closed form d is sampled: marching cubes (libigl) on
a grid of spacing h find d = 0, bisection along its edges brings the vertices onto it, and slivers
that turn over are collapsed. Only the chords of the triangles, up to about √2 h long, are off:
h²/(4 r) on a radius r.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

from ..checks import InputError
from ..net.blank import rotation
from ..scenes import scene_file
from ..tools.shapes import Shape, Tool
from ..tools.surface_file import SurfaceFile, normals_of, optional

FloatArray = np.ndarray
MOST_NODES = 2_000_000
CHUNK = 50_000
HALVINGS = 25  # of an edge of the grid
ROUNDS = 10
SNAP = 0.05  # of h: vertices nearer to a node of the grid are one, or triangles would be slivers


def fine_enough(shape: Shape, off: float) -> float:
    """Return the spacing h = √(4 r off), mm, of triangles `off` mm from the smallest radius r."""
    sharpest = getattr(shape, "sharpest", 0.0)
    return 2.0 * float(np.sqrt(sharpest * off)) if sharpest > 0 else np.inf


def sampled(
    shape: Shape, low: FloatArray, high: FloatArray, spacing: float
) -> tuple[FloatArray, np.ndarray, float, float]:
    """Triangles of d = 0 in a box of the shape's frame, normals pointing outwards.

    Parameters
    ----------
    shape : Shape
    low, high : (3,) array
        mm.
    spacing : float
        h, mm; larger where the grid would have more than two million nodes.

    Returns
    -------
    vertices : (n, 3) array
        mm.
    triangles : (m, 3) int array
    spacing : float
        The one taken, mm.
    deviation : float
        Largest |d| at the triangles' centres, mm.

    Raises
    ------
    InputError
        If the surface is not in the box.
    """
    igl = optional("igl", "surface", "the triangles of a tool need libigl")
    span = high - low
    spacing = max(spacing, float((span.prod() / MOST_NODES) ** (1 / 3)))
    count = np.maximum(np.ceil(span / spacing).astype(int), 1) + 1
    # off round numbers, where faces are: a node on d = 0 makes slivers
    axes = [
        np.linspace(a, b, n) + 0.01 * spacing * np.sqrt(k)
        for k, a, b, n in zip((2, 3, 5), low, high, count, strict=True)
    ]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")  # x runs fastest
    nodes = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    d = _by_chunks(shape, nodes)[0]
    if not (d.min() < 0 < d.max()):
        raise InputError("the surface of the tool is not where the sheet can be")
    vertices, triangles, _ = igl.marching_cubes(d, nodes, *map(int, count), 0.0)
    step = np.array([axis[1] - axis[0] for axis in axes])
    place = (vertices - nodes[0]) / step
    # each is on an edge of the grid, between two nodes of different sign
    along = np.abs(place - np.round(place)).argmax(1)
    rows = np.arange(len(place))
    start = np.round(place).astype(int)
    start[rows, along] = np.floor(place[rows, along])
    inside = d[np.ravel_multi_index(start.T, count, order="F")] < 0
    low, high = np.zeros(len(place)), np.ones(len(place))
    for _ in range(HALVINGS):
        vertices = nodes[0] + step * start
        share = 0.5 * (low + high)
        vertices[rows, along] += share * step[along]
        same = (_by_chunks(shape, vertices)[0] < 0) == inside
        low, high = np.where(same, share, low), np.where(same, high, share)
    place = (vertices - nodes[0]) / step
    cell = np.round(place).astype(int)
    near = np.linalg.norm(place - cell, axis=1) < SNAP
    number = np.where(near, np.ravel_multi_index(cell.T, count), nodes.shape[0])
    number[~near] += np.arange((~near).sum())
    _, first, number = np.unique(number, return_index=True, return_inverse=True)
    vertices, triangles = vertices[first], _without_collapsed(number.ravel()[triangles])
    for _ in range(ROUNDS):
        over = triangles[_facing(shape, vertices, triangles) <= 0]
        if not len(over):
            break
        sides = np.stack([over, np.roll(over, -1, axis=1)], axis=2)
        length = np.linalg.norm(np.diff(vertices[sides], axis=2)[:, :, 0], axis=2)
        goes, stays = sides[np.arange(len(over)), length.argmin(1)].T
        number = np.arange(len(vertices))
        number[goes] = stays
        triangles = _without_collapsed(number[triangles])
    off, _ = _by_chunks(shape, vertices[triangles].mean(1))
    used, triangles = np.unique(triangles, return_inverse=True)
    return vertices[used], triangles.reshape(-1, 3), spacing, float(np.abs(off).max())


def from_scene_file(tool: Tool, parameters: dict[str, Any], turn: float) -> Any:
    """Vertices and triangles of a tool that the scene's file takes from a surface, or None.

    Parameters
    ----------
    tool : Tool
    parameters : dict
        The scene's.
    turn : float
        Angle of the model's x axis to the user's, degrees.
    """
    with suppress(InputError):
        for part in scene_file.load(str(parameters.get("scene"))).tools:
            given = part.shape
            if part.name == tool.name and isinstance(given, SurfaceFile):
                vertices, triangles, _ = given.placed()
                vertices[:, :2] = vertices[:, :2] @ rotation(turn)
                return vertices, triangles
    return None


def _facing(shape: Shape, vertices: FloatArray, triangles: np.ndarray) -> FloatArray:
    """(m,) normals times gradient of the distance, positive where they point outwards."""
    corners = vertices[triangles]
    return (normals_of(corners) * _by_chunks(shape, corners.mean(1))[1]).sum(1)


def _without_collapsed(triangles: np.ndarray) -> np.ndarray:
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)]


def _by_chunks(shape: Shape, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    d, n = np.empty(len(points)), np.empty((len(points), 3))
    for first in range(0, len(points), CHUNK):
        part = slice(first, first + CHUNK)
        d[part], n[part], _ = shape.distance(points[part])
    return d, n
