"""Whether a scene is mechanical: the driven tool meets the sheet, and something holds the sheet.

Both are asked of the flat sheet, moved as a whole: a sheet without a load stays flat until the
driven tool touches it.
"""

from __future__ import annotations

import numpy as np
import shapely

from ..checks import InputError
from ..energy.contact import Contact
from ..model import Model
from ..tools.mending import position
from .scene_file import SceneFile

HEIGHTS = 9  # along the travel at which the sheet is looked for
TOUCH = 1e-3  # of the thickness


def check_mechanics(model: Model, file: SceneFile, outline: shapely.Polygon) -> None:
    """Refuse a scene whose driven tools never meet the sheet, or in which nothing holds it."""
    if file.gravity or file.grippers:  # the sheet moves by itself
        return
    x0, y0, x1, y1 = outline.bounds
    sheet = f"the sheet lies at x {x0:.4g} to {x1:.4g}, y {y0:.4g} to {y1:.4g} mm"
    sheet += " and has a hole" * bool(outline.interiors)
    gaps = {c: _least_gap(model, c) for c in model.contacts if c.tool.motion == "driven"}
    if min(gaps.values()) > TOUCH * model.sheet.fabric.thickness:
        contact, gap = min(gaps.items(), key=lambda pair: pair[1])
        read = model.tools[1].get(contact.tool.name)
        part = next(tool for tool in file.tools if tool.name == contact.tool.name)
        at = position(read.box.mean(0)[:2] if read else np.array(part.place))
        words = f"within {model.travel:g} mm of travel it comes no nearer than {gap:.3g} mm"
        words = f"{words}; its middle is at {at}, {sheet}"
        raise InputError(f"the {contact.tool.name} never meets the sheet: {words}")
    if file.supports:
        return
    gaps = {c: _least_gap(model, c) for c in model.contacts if c.tool.motion == "fixed"}
    if min(gaps.values(), default=np.inf) > TOUCH * model.sheet.fabric.thickness:
        why = "it does not reach the die" if gaps else "there is no die and no support"
        raise InputError(f"nothing holds the sheet under the driven tool: {why}; {sheet}")


def _least_gap(model: Model, contact: Contact) -> float:
    """Least gap (mm) between a tool and the flat sheet while one of them moves down."""
    driven, least = contact.tool.motion == "driven", np.inf
    moved = contact.tool_dofs[:1] if driven else model.sheet.dofs[:, 2]
    for s in np.linspace(0.0, model.travel, HEIGHTS):
        x = model.x0.copy()
        x[moved] -= s
        least = min(least, -float(contact.penetration(x).max()))
        if least <= 0:
            break
    return least
