"""What a scene prescribes over the travel: driven tools, forces on free ones, a pressure."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from ..energy.contact import Contact
from ..energy.pressure import PRESSURE_FORCE, Pressure, PressureAtEdge
from ..energy.term import Term
from ..energy.weight import ToolForce
from ..model import DIAPHRAGM, Model
from ..tools.shapes import Tool
from .scene_file import SceneFile
from .stack import Layer, seen

FORCE, PRESSURE = "force on the ", "pressure"
FIRST = 1 / 16  # of the largest increment


def force_over_travel(model: Model, tool: Tool, dof: int) -> ToolForce:
    """Prescribe the force on a tool over the travel, and return its energy."""
    force = int(model.unknowns[FORCE + tool.name].dofs[0, 0])
    prescribe(model, force, tool.forces * [1.0, model.share])
    shown = over_travel(tool.forces, "N")
    model.description.append((f"{FORCE}{tool.name} over the travel", shown))
    return ToolForce(dof, force, tool.height, FORCE + tool.name)


def drive_tool(model: Model, tool: Tool, dof: int) -> None:
    """Prescribe the motion of a tool; its force counts where it goes farthest, down or up."""
    if tool.motion != "driven":
        return
    model.drive[dof] = -1.0
    if tool.stroke:
        down = np.array(tool.stroke)
        model.drive[dof] = -np.sign(down[np.abs(down[:, 1]).argmax(), 1]) or -1.0
        model.strokes[dof] = down * [1.0, -model.drive[dof]]
        model.description.append((f"stroke of the {tool.name}", over_travel(down, "mm")))


def prescribe(model: Model, dof: int, rows: np.ndarray) -> None:
    """Prescribe a load over the travel: rows (n, 2)."""
    model.loads[dof], model.fixed[dof], model.x0[dof] = rows, True, rows[0, 1]


def over_travel(rows: np.ndarray, unit: str) -> str:
    """Rows (n, 2) over the travel as a text."""
    return ", ".join(f"{value:g} {unit} at {travel:g} mm" for travel, value in rows)


def pressure_on_sheet(model: Model, file: SceneFile, layers: Sequence[Layer]) -> list[Term]:
    """Prescribe the pressure of a scene and return its energies; none without a pressure."""
    if file.pressure is None:
        return []
    outer = [sheet for sheet in model.sheets if sheet.name == DIAPHRAGM] or model.sheets
    sheet, dof = outer[0], int(model.unknowns[PRESSURE].dofs[0, 0])
    prescribe(model, dof, file.pressures)
    up = file.diaphragm is not None and file.diaphragm.side == "under"
    term = Pressure(sheet, dof, float(sheet.positions(model.x0)[:, 2].mean()), up)
    edge = PressureAtEdge(term)
    load = term.area * file.pressures[0, 1]
    model.resting += load
    shown = over_travel(file.pressures, "MPa")
    face = "lower" if up else "upper"
    model.description.append((f"pressure on the {face} face of the {sheet.name}", shown))
    (cover,) = (layer for layer in layers if layer.name == sheet.name)
    if bare := [layer.name for layer in layers if layer is not cover and seen(layer, [cover])]:
        entry = f"no pressure on what the {sheet.name} leaves uncovered"
        model.description.append((entry, ", ".join(bare)))
    model.measures["pressure_MPa"] = lambda x: float(x[dof])
    model.measures[PRESSURE_FORCE] = partial(along_z, model.share, term, edge)
    return [term] if model.fixed[edge.dofs].all() else [term, edge]


def sink(model: Model, file: SceneFile, contacts: Sequence[Contact]) -> None:
    """Start as deep in the fixed tools as the pressure of the first increment presses a sheet.

    Without a load that rests on the sheet it would start without any stiffness against it.
    """
    if file.pressure is None or model.resting:
        return
    x0, sheets = model.x0, model.sheets
    area, sunk = sum(sheet.blank.areas.sum() for sheet in sheets) / len(sheets), 0.0
    load = area * np.interp(FIRST * model.increment, *file.pressures.T)
    for contact in contacts:
        under = contact.penetration(x0) > -1e-6 * contact.sheet.fabric.thickness
        if contact.tool.motion == "fixed" and under.any():
            sunk = max(sunk, contact.depth_under(load, contact.area[under].sum()))
    for k, sheet in enumerate(sheets):
        x0[sheet.dofs[:, 2]] -= (len(sheets) - k) * sunk


def along_z(share: float, term: Pressure, edge: PressureAtEdge, x: np.ndarray) -> float:
    """Force of a pressure on the whole sheet along z, N: p times its area seen from above."""
    on_nodes = term.gradient(x)[:, 2:9:3].sum()
    on_nodes += edge.gradient(x, edge.initial(x))[:, 2:6:3].sum()
    return float(term.sign * on_nodes) / share
