"""What is drawn over a sheet: lines of equal values, and the tools."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..checks import InputError
from ..net.blank import rotation
from ..result.record import Record
from ..scenes.forming import forming

if TYPE_CHECKING:
    from ..energy.contact import Contact
    from ..tools.shapes import Tool

FloatArray = np.ndarray
CUT = 161  # points a side of the grid on which a tool is cut
FACE = 61  # points a side of the grid on which a tool's face is found
STEPS = 60  # of a search along z for the face of a tool
NEAR = 0.02  # mm: a face is found
BEYOND = 1.15  # times the blank's half length: how far a tool is shown


def level_lines(
    x: FloatArray, triangles: np.ndarray, values: FloatArray, levels: Sequence[float]
) -> FloatArray:
    """Segments (k, 2, d) on which a function, linear in each triangle, has one of some values.

    x (n, d) are the points and values (n,) those of the function there.

    Examples
    --------
    >>> x = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    >>> level_lines(x, np.array([[0, 1, 2]]), x[:, 0], [0.25]).tolist()
    [[[0.25, 0.75], [0.25, 0.0]]]
    """
    segments = [np.empty((0, 2, x.shape[1]))]
    for level in levels:
        above = values[triangles] > level
        # turned so that the first corner lies alone on its side of the line
        alone = (above.sum(1) == 1)[:, None] == above
        crossed = above.any(1) & ~above.all(1)
        first = alone[crossed].argmax(1)
        corners = np.take_along_axis(triangles[crossed], (first[:, None] + range(3)) % 3, axis=1)
        f = values[corners]
        share = ((level - f[:, :1]) / (f[:, 1:] - f[:, :1]))[:, :, None]
        segments.append((1 - share) * x[corners[:, :1]] + share * x[corners[:, 1:]])
    return np.concatenate(segments)


def tool_cuts(run: Record) -> tuple[dict[str, tuple[FloatArray, ...]], str]:
    """Cut the tools of a forming run at the height of the sheet's plane, or below it for a die.

    Cuts are x (n,), y (n,) and the signed distance from the tool (n, n), in the user's axes, mm;
    the text says why they are not known.
    """
    contacts, turn, why_not = _tools(run)
    x, y = _grid(run, CUT, 1.0)
    cuts = {}
    for contact in contacts:
        tool = contact.tool
        if tool.motion == "free":  # a holder lies over the sheet, as the die under it
            continue
        z = 0.0 if tool.motion == "driven" else -0.5 * run.travel
        d = _distance(contact, run.travel, turn, x, y, np.full((CUT, CUT), z))
        if d.min() < 0 < d.max():
            where = f"z = {z:.3g} mm" if z else "z = 0"
            cuts[f"{tool.name}, cut at {where}"] = x, y, d
    return cuts, why_not


def tool_faces(run: Record) -> Iterator[tuple[Tool, FloatArray, FloatArray, FloatArray]]:
    """Faces of the tools towards the sheet: tool, x (n,), y (n,) and z (n, n), mm.

    z is nan where a tool has no face. Steps as long as the distance lead along z to the face: up
    to a punch or a holder, down to a die. Tools that move are shown at the start of the travel.
    """
    contacts, turn, _ = _tools(run)
    x, y = _grid(run, FACE, BEYOND)
    reach = 2.0 * max(np.ptp(x), run.goal)
    for contact in {contact.tool.name: contact for contact in contacts}.values():
        down = contact.tool.motion == "fixed"
        z = np.full((FACE, FACE), reach if down else -reach)
        for _ in range(STEPS):
            d = _distance(contact, 0.0, turn, x, y, z)
            z += np.where(down, -d, d)
        z[(np.abs(d) > NEAR) | (np.abs(z) > reach)] = np.nan
        yield contact.tool, x, y, z


def _tools(run: Record) -> tuple[Sequence[Contact], float, str]:
    """Contacts of a run, the turn of its model, and why there are none.

    The scene of a folder is built again from its name or file.
    """
    if not run.has_tools:
        return (), 0.0, ""
    model, given = run.model, run.parameters
    if model is None:
        try:
            model = forming(run.scene, given["orientation"], size=given["size"])
        except (InputError, KeyError, TypeError) as error:
            why = f"its scene was not found or has changed: {' '.join(str(error).split())}"
            return (), 0.0, why
    return model.contacts, model.sheet.turn, ""


def _grid(run: Record, count: int, share: float) -> FloatArray:
    """(2, count) x and y over the flat blank, and beyond it by a share, mm."""
    low, high = run.sheet.flat.min(0), run.sheet.flat.max(0)
    half = 0.5 * share * (high - low)
    middle = 0.5 * (low + high)
    return np.linspace(middle - half, middle + half, count).T


def _distance(
    contact: Contact, travel: float, turn: float, x: FloatArray, y: FloatArray, z: FloatArray
) -> FloatArray:
    """(n, n) signed distance from a tool after a travel at x (n,), y (n,), z (n, n), mm."""
    tool = contact.tool
    plan = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) @ rotation(turn)
    return tool.gap(np.column_stack([plan, z.ravel()]), tool.moved(travel)).reshape(z.shape)
