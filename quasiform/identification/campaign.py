"""A campaign of tests on one fabric: what a TOML file, or a CSV file with its specimen, says.

name = "my fabric"
method = "fit"                          # or inverse, table, as-printed
keep = { C_lo = 1000.0, I_lo = 0.819 }  # parameters that are not fitted

[fabric]                                # what the tests do not say (Fabric's own names)
thickness = 1.004
areal_weight = 600.0

[[tests]]
kind = "off-axis"                       # length, width, angle
files = ["a.csv", "b.csv"]              # repeats of one test
angle = 45.0

[[tests]]
kind = "picture-frame"                  # side, fabric_side
files = ["frame.csv"]
to = 45.0                               # shear angles that are used, degrees

[[tests]]
kind = "cantilever"                     # overhang and angle; or length and tip; or a profile
family = "warp"
overhang = [166.0, 163.0]
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from ..checks import InputError
from ..toml_file import read_toml
from .campaign_parts import ASSUMED, KINDS, METHODS, SIZES, VALUES, Campaign, ShearTest

__all__ = ["ASSUMED", "KINDS", "METHODS", "VALUES", "Campaign", "ShearTest", "load"]
OF_ONE_TEST = ("kind", "columns", "units", *(size for sizes in SIZES.values() for size in sizes))


def load(path: str | Path, **given: Any) -> Campaign:
    """Read a campaign from a TOML file, or from the CSV file of one test.

    Parameters
    ----------
    path : path
    **given
        Settings that replace those of the file: method, keep, algorithm, size, name; of a CSV file
        also kind, length, width, angle, side, fabric_side, thickness, columns, units.

    Raises
    ------
    InputError
        In one line that names file, key and what was expected.
    """
    from .campaign_schema import read_campaign  # pydantic

    path = Path(path)
    if path.suffix.lower() == ".toml":
        for key in given:
            if key in OF_ONE_TEST or key == "thickness":
                where = "[fabric]" if key == "thickness" else "[[tests]]"
                raise InputError(f"{path}: {key} belongs into the file, under {where}")
        return read_toml(path, lambda table: read_campaign(table | given, path))
    kind = given.get("kind", "off-axis")
    for key in given:
        if any(key in sizes for sizes in SIZES.values()) and key not in SIZES.get(kind, (key,)):
            raise InputError(f"{path}: {key} is not a size of the {kind} test")
    settings = {k: v for k, v in given.items() if k in ("method", "keep", "algorithm", "size")}
    test = {k: v for k, v in given.items() if k not in settings and k not in ("thickness", "name")}
    table: dict[str, Any] = {"name": given.get("name", path.stem), **settings}
    if "thickness" in given:
        table["fabric"] = {"thickness": given["thickness"]}
    table["tests"] = [{"kind": "off-axis", **test, "files": [str(path.absolute())]}]
    campaign = read_campaign(table, path)
    return replace(campaign, sources=(path,))
