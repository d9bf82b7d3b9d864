"""Slip of the rovings in a model: the field of the slip and its energies (`energy.slip`)."""

from __future__ import annotations

import numpy as np

from ..checks import InputError
from ..energy.bending import Bending
from ..energy.membrane import Membrane
from ..energy.slip import SlipBending, SlippingMembrane, SlipResistance, SlipWidth, Together
from ..model import Model


def let_slip(model: Model) -> None:
    """Let the rovings of a model slip, where its fabric has slip and a roving has a free end.

    A component of the slip is prescribed, zero, where that of the position is: at grips and clamps,
    and across mirror planes. InputError on a mesh that does not follow the fibres.
    """
    sheet, given = model.sheet, model.sheet.fabric.slip
    if given is None:
        return
    if sheet.blank.pairs is not None:
        raise InputError("[slip] needs a mesh that follows the fibres: choose mesh = 'fibre'")
    ends, held = sheet.blank.mesh.boundary_nodes(), model.fixed[sheet.dofs]
    planes = [np.abs(sheet.blank.nodes[:, "xy".index(p)]) < 1e-9 for p in sheet.blank.mirror]
    inside = np.logical_or.reduce(planes) if planes else np.zeros(len(held), dtype=bool)
    if held[ends[~inside[ends]]].all():
        model.description.append(("slip of the rovings left out", "no roving has a free end"))
        return
    slip = model.add("slip", sheet.dim, sheet)
    model.fixed[slip.dofs] = held
    place = next(i for i, term in enumerate(model.terms) if isinstance(term, Membrane))
    model.terms[place] = membrane = SlippingMembrane(sheet, slip)
    bends = [SlipBending(t, slip) for t in model.terms if isinstance(t, Bending) and t.in_plane]
    model.terms += [SlipResistance(sheet, slip), SlipWidth(sheet, slip), *bends]
    model.terms += [Together(membrane)] * (sheet.dim == 3)
    numbers = f"{given.resistance:g} MPa, {given.stiffness:g} N/mm³, pitch {given.pitch:g} mm"
    model.description.append(("slip of the rovings", f"[slip] of the fabric: {numbers}"))
