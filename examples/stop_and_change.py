"""A callback that stops a run, and one that changes it on the way.

The callback is called with the `Progress` after each increment. It stops the run there by returning
True or the reason as a text; the result up to there is kept, with the status "stopped". What it
changes of the model's terms counts from the next increment on.
"""

import quasiform as qf
from quasiform.energy.weight import ToolWeight


def until_sheared(step):
    """Stop where the largest shear angle passes 20 degrees."""
    if step.measures["shear_angle_max_deg"] > 20:
        return "sheared by more than 20 degrees"
    return None


stopped = qf.solve(qf.off_axis_tension(displacement=50, size=20), until_sheared)
print(stopped.status, "-", stopped.reason)


# The holder is pressed harder once the punch has gone 10 mm: its weight is a term of the model.
model = qf.forming("hemisphere", size=20, travel=20)
weight = next(term for term in model.terms if isinstance(term, ToolWeight))
light = weight.force


def press(step):
    """Four times the weight from 10 mm on."""
    if step.travel >= 10:
        weight.force = 4 * light


pressed = qf.solve(model, press, estimate=False)
print("force of the holder:", pressed.history["holder_force_N"].round(1), "N")
