"""Triangles of a rigid tool, where the sheet can be.

A tool from a file gives its own triangles, those of the file. A closed form d, or that of a file
with an offset, is sampled: marching cubes (libigl) on a grid of spacing h find d = 0, steps of
-d ∇d bring the vertices onto it, and slivers that turn over are collapsed. Only the chords of the
triangles, up to about √2 h long, are off: h²/(4 r) on a radius r.
"""

from __future__ import annotations

import numpy as np

from ..checks import InputError, optional
from ..model import Model
from ..net.blank import rotation
from ..tools.mending import normals_of
from ..tools.shapes import Shape, Tool

FloatArray = np.ndarray
MOST_NODES = 2_000_000
CHUNK = 50_000
ROUNDS = 10
SNAP = 0.05  # of h: vertices nearer to a node of the grid are one, or triangles would be slivers


def fine_enough(shape: Shape, off: float) -> float:
    """Return the spacing h = √(4 r off), mm, of triangles `off` mm from the smallest radius r."""
    sharpest = getattr(shape, "sharpest", 0.0)
    return 2.0 * float(np.sqrt(sharpest * off)) if sharpest > 0 else np.inf


def sampled(
    shape: Shape, low: FloatArray, high: FloatArray, spacing: float
) -> tuple[FloatArray, np.ndarray, float, float]:
    """Triangles of d = 0 between two corners of the shape's frame, normals pointing outwards.

    Returns vertices (n, 3) in mm, triangles (m, 3), the spacing h that was taken (larger than the
    one asked for where the grid would have more than two million nodes) and the largest |d| at the
    centres of the triangles, mm. A surface that is not in the box raises InputError.
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
    d = _distance(shape, nodes)[0]
    if not (d.min() < 0 < d.max()):
        raise InputError("the surface of the tool is not where the sheet can be")
    vertices, triangles, _ = igl.marching_cubes(d, nodes, *map(int, count), 0.0)
    place = (vertices - nodes[0]) / [axis[1] - axis[0] for axis in axes]
    cell = np.round(place).astype(int)
    near = np.linalg.norm(place - cell, axis=1) < SNAP
    number = np.where(near, np.ravel_multi_index(cell.T, count), len(nodes) + np.arange(len(near)))
    _, first, number = np.unique(number, return_index=True, return_inverse=True)
    vertices, triangles = vertices[first], _without_collapsed(number.ravel()[triangles])
    for _ in range(ROUNDS):
        d, n = _distance(shape, vertices)
        vertices = vertices - d[:, None] * n
    for _ in range(ROUNDS):
        corners = vertices[triangles]
        facing = (normals_of(corners) * _distance(shape, corners.mean(1))[1]).sum(1)
        over = triangles[facing <= 0]
        if not len(over):
            break
        sides = np.stack([over, np.roll(over, -1, axis=1)], axis=2)
        length = np.linalg.norm(np.diff(vertices[sides], axis=2)[:, :, 0], axis=2)
        removed, stays = sides[np.arange(len(over)), length.argmin(1)].T
        number = np.arange(len(vertices))
        number[removed] = stays
        triangles = _without_collapsed(number[triangles])
    off = np.abs(_distance(shape, vertices[triangles].mean(1))[0]).max()
    used, triangles = np.unique(triangles, return_inverse=True)
    return vertices[used], triangles.reshape(-1, 3), spacing, float(off)


def from_file(tool: Tool, model: Model) -> tuple[FloatArray, np.ndarray] | None:
    """Vertices and triangles of a tool that the model has read from a file, in its axes.

    None for another tool, and for one whose surface is moved by an offset: its triangles are not
    those of the file.
    """
    read = model.tools[1].get(tool.name) if model.tools else None
    if read is None or read.file.offset:
        return None
    turned = read.vertices[:, :2] @ rotation(model.sheet.turn)
    return np.column_stack([turned, read.vertices[:, 2]]), read.triangles


def _without_collapsed(triangles: np.ndarray) -> np.ndarray:
    return triangles[(triangles != np.roll(triangles, -1, axis=1)).all(1)]


def _distance(shape: Shape, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances (n,) and their gradients (n, 3), a part of the points at a time."""
    parts = [shape.distance(p)[:2] for p in np.array_split(points, len(points) // CHUNK + 1)]
    return tuple(map(np.concatenate, zip(*parts, strict=True)))
