"""A model solved as its scene, a study or the command line asks for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ..checks import InputError
from ..model import Model
from ..result.run import Result
from .increments import Callback
from .journal import Journal
from .levels import refine, solve
from .scatter import AMPLITUDE, spread

DRAFT = 2.0  # times the size and the increments
OPTIONS = {"increment": None, "accuracy": None, "linear": "auto", "seeds": None, "estimate": True}


def asked(model: Model, run: Mapping[str, Any]) -> tuple[Model, dict[str, Any]]:
    """Return the model that is solved, and the options of `solved`.

    `run` has keys of the table [run] of a scene; a draft is solved on a coarser model.
    """
    options = OPTIONS | {"one_mesh": not model.contacts, "draft": False} | dict(run)
    if options["accuracy"] and not options["estimate"]:
        raise InputError("--accuracy needs the error estimate: drop --no-estimate")
    if options.pop("draft"):
        if options["accuracy"]:
            raise InputError("--draft answers on a coarse mesh: drop --accuracy")
        model = model.recipe.build(DRAFT * model.size, like=model)
        options |= {"one_mesh": True, "estimate": options["estimate"] and "coarse"}
        options["increment"] = options["increment"] or DRAFT * model.increment
    return model, options


def solved(
    model: Model,
    options: Mapping[str, Any],
    callback: Callback | None = None,
    out: Journal | None = None,
) -> Result:
    """Solve a model on one mesh or several, then perturbed starts where they are asked for.

    With an option `seed` it is itself solved with the noise of a perturbed start.
    """
    how = {name: options[name] for name in ("increment", "linear", "estimate")} | {"out": out}
    if seed := options.get("seed"):
        how |= {"perturbation": AMPLITUDE * model.sheets[0].fabric.thickness, "seed": seed}
    if out:
        out.more = bool(options["seeds"])
    if options["one_mesh"]:
        result = solve(model, callback, **how)
    else:
        result = refine(model, callback, options["accuracy"], **how)
    if result.status == "completed" and options["seeds"]:
        try:
            spread(result, range(1, options["seeds"] + 1), callback=callback)
        except KeyboardInterrupt:
            result = replace(result, reason="interrupted while perturbed starts were solved")
        if out:
            out.more = False
            out.close(result)
    return result
