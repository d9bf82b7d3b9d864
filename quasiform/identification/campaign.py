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

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import InputError, check_file, check_keys, check_number, suggestion
from ..fabric import Fabric, fabric_of
from ..toml_file import read_toml
from .cantilever import Stiffness, from_profile, from_repeats, from_tip
from .energy_method import Forces
from .fit import ALGORITHMS, check_kept
from .records import Curve, mean_of, read, rows_of
from .specimen import OffAxis, PictureFrame, Specimen

METHODS = {
    "fit": "six parameters by the power balance (Eq. 10, energy-consistent)",
    "inverse": "six parameters, finite-element tests in the loop",
    "table": "table by the power balance (Eq. 10, energy-consistent)",
    "as-printed": "six parameters by Eq. 10 as printed, which does not conserve energy",
}
KINDS = {"off-axis": OffAxis, "picture-frame": PictureFrame}
SIZES = {"off-axis": ("length", "width", "angle"), "picture-frame": ("side", "fabric_side")}
FABRIC = ("base", "thickness", "areal_weight", "bending_warp", "bending_weft", "friction")
VALUES = tuple(f.name for f in fields(Fabric) if f.name not in ("name", "provenance"))
OF_ONE_TEST = ("kind", "columns", "units", *(size for sizes in SIZES.values() for size in sizes))
ASSUMED = "assumed: that of "  # begins the origin of a value that no test and no user gave
LOWEST = 0.5  # degrees: below, a specimen settles in its grips


@dataclass(frozen=True)
class ShearTest:
    """Repeats of one test in shear, ready for identification.

    Parameters
    ----------
    name : str
    specimen : OffAxis or PictureFrame
    curve : Curve
        Their mean, within the shear angles that are used.
    low, high : float
        These, degrees.
    """

    name: str
    specimen: Specimen
    curve: Curve
    low: float = LOWEST
    high: float = 90.0

    def forces(self, thickness: float, as_printed: bool = False) -> Forces:
        """The test in the power balance.

        Raises
        ------
        InputError
            If fewer than 8 rows are left in the range of shear angles.
        """
        try:
            shares, angles = self.specimen.shares(self.curve, thickness, as_printed)
        except InputError as error:
            raise InputError(f"{self.name}: {error}") from error
        return Forces(self.curve.force, self.curve.sigma, shares, angles)

    def cut(self) -> ShearTest:
        """The same test with the rows outside its range of shear angles left out."""
        gamma = np.degrees(self.forces(1.0).angles[0])
        used = (gamma >= self.low) & (gamma > 0) & (gamma <= self.high) & (self.curve.force > 0)
        if used.sum() < 8:
            raise InputError(
                f"{self.name}: only {rows_of(int(used.sum()))} with a positive force between "
                f"{self.low:g} and {self.high:g} degrees of shear, expected at least 8"
            )

        def rows(values: np.ndarray | None) -> np.ndarray | None:
            return None if values is None else values[used]

        curve = replace(
            self.curve,
            force=rows(self.curve.force),
            sigma=rows(self.curve.sigma),
            displacement=rows(self.curve.displacement),
            shear_angle=rows(self.curve.shear_angle),
        )
        return replace(self, curve=curve)


@dataclass(frozen=True)
class Campaign:
    """Tests on one fabric, and how it shall be identified from them.

    Parameters
    ----------
    name : str
    fabric : Fabric
        What the tests do not say is taken from it; its provenance may say of each value, by its
        name, where that comes from.
    shear : tuple of ShearTest
    bending : dict of "warp" or "weft" to Stiffness
    method : str
        "fit": six parameters by the power balance; "inverse": the same with the finite-element
        test in the loop; "table": a tabulated law by the energy method; "as-printed": as "fit",
        with the coefficient that the paper prints in Eq. 10.
    keep : dict
        Parameters of the law that are not fitted.
    algorithm : "least-squares" or "nelder-mead"
    size : float
        Cell edge of the finite-element tests, mm.
    standing : str
        Of the data: "measured", or what else they are.
    sources : tuple of paths
        Files the campaign was read from.
    """

    name: str
    fabric: Fabric
    shear: tuple[ShearTest, ...] = ()
    bending: Mapping[str, Stiffness] = field(default_factory=dict)
    method: str = "fit"
    keep: Mapping[str, float] = field(default_factory=dict)
    algorithm: str = "least-squares"
    size: float = 14.0
    standing: str = "measured"
    sources: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        for name, value, known in (
            ("method", self.method, METHODS),
            ("algorithm", self.algorithm, ALGORITHMS),
        ):
            if not isinstance(value, str) or value not in known:
                raise InputError(f"unknown {name} {value!r}: {suggestion(str(value), known)}")
        check_number("size", self.size)
        check_kept(self.keep)
        if not self.shear and not self.bending:
            raise InputError("no tests: expected at least one [[tests]]")
        if self.method == "inverse" and self.algorithm != "least-squares":
            raise InputError("the inverse method knows no other algorithm than 'least-squares'")
        if self.method == "table" and self.keep:
            raise InputError("a table has no parameters to keep: choose method 'fit' or 'inverse'")


def load(path: str | Path, **given: Any) -> Campaign:
    """Read a campaign from a TOML file, or from the CSV file of one test.

    Parameters
    ----------
    path : path
    **given
        What stands over the file: method, keep, algorithm, size, name; of a CSV file also kind,
        length, width, angle, side, fabric_side, thickness, columns, units.

    Raises
    ------
    InputError
        In one line that names file, key and what was expected.
    """
    path = Path(path)
    if path.suffix.lower() == ".toml":
        for key in given:
            if key in OF_ONE_TEST or key == "thickness":
                where = "[fabric]" if key == "thickness" else "[[tests]]"
                raise InputError(f"{path}: {key} belongs into the file, under {where}")
        return read_toml(path, lambda table: _campaign(table | given, path))
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
    campaign = _campaign(table, path)
    return replace(campaign, sources=(path,))


def _campaign(table: Mapping[str, Any], path: Path) -> Campaign:
    settings = ["name", "method", "keep", "algorithm", "size", "standing"]
    check_keys(table, [*settings, "fabric", "tests"])
    keep = table.get("keep", {})
    if not isinstance(keep, Mapping):
        raise InputError(f"keep = {keep!r}: expected a table such as {{ I_lo = 0.819 }}")
    name, standing = table.get("name", path.stem), table.get("standing", "measured")
    for key, value in (("name", name), ("standing", standing)):
        if not isinstance(value, str):
            raise InputError(f"{key} must be a text, got {value!r}")
    fabric = _fabric(table.get("fabric", {}), path.parent)
    tests = table.get("tests", [])
    if not isinstance(tests, list) or not all(isinstance(test, Mapping) for test in tests):
        raise InputError("tests: expected tables [[tests]]")
    shear, bending, sources = [], {}, [path]
    for number, test in enumerate(tests, start=1):
        where = f"tests {number}"
        kind = test.get("kind")
        if kind == "cantilever":
            family, stiffness = _cantilever(test, where, path.parent, fabric, sources)
            if family in bending:
                raise InputError(f"[{where}] family {family!r} is there twice: give its repeats")
            bending[family] = stiffness
        elif isinstance(kind, str) and kind in KINDS:
            shear.append(_shear_test(kind, test, where, path.parent, sources))
        else:
            known = [*KINDS, "cantilever"]
            raise InputError(f"[{where}] kind = {kind!r}: {suggestion(str(kind), known)}")
    others = {key: table[key] for key in ("method", "algorithm", "size") if key in table}
    return Campaign(
        name,
        fabric,
        tuple(shear),
        bending,
        keep=dict(keep),
        standing=standing,
        sources=tuple(sources),
        **others,
    )


def _fabric(table: Any, folder: Path) -> Fabric:
    if not isinstance(table, Mapping):
        raise InputError(f"fabric = {table!r}: expected a table [fabric]")
    check_keys(table, FABRIC, "fabric")
    base = table.get("base", "locking")
    fabric = fabric_of(folder / base if str(base).endswith(".toml") else base)
    given = {key: value for key, value in table.items() if key != "base"}
    origins = {name: _inherited(fabric, name) for name in VALUES} | dict.fromkeys(given, "given")
    return replace(fabric, **given, provenance=origins)


def _inherited(base: Fabric, name: str) -> str:
    """Where a value comes from that is taken from another fabric."""
    known = base.provenance.get(name)
    if known is None:
        return f"{ASSUMED}{base.name}"
    known = str(known)
    return known if known.startswith((ASSUMED, "that of ")) else f"that of {base.name}: {known}"


def _shear_test(
    kind: str, test: Mapping[str, Any], where: str, folder: Path, sources: list[Path]
) -> ShearTest:
    check_keys(test, ["kind", "files", "columns", "units", "from", "to", *SIZES[kind]], where)
    files = test.get("files", [])
    files = [files] if isinstance(files, str) else files
    if not isinstance(files, list) or not files or not all(isinstance(f, str) for f in files):
        raise InputError(f"[{where}] files = {files!r}: expected a list of files")
    for key in ("columns", "units"):
        named = test.get(key, {})
        if not isinstance(named, Mapping) or not all(isinstance(v, str) for v in named.values()):
            raise InputError(
                f'[{where}] {key} = {named!r}: expected a table such as {{ force = "..." }}'
            )
    paths = [folder / file for file in files]
    low, high = test.get("from", LOWEST), test.get("to", 90.0)
    for key, value in (("from", low), ("to", high)):
        check_number(f"[{where}] {key}", value, zero_allowed=key == "from")
    try:
        specimen = KINDS[kind](**{key: test[key] for key in SIZES[kind] if key in test})
    except InputError as error:
        raise InputError(f"[{where}] {error}") from error
    curves = [read(path, test.get("columns"), test.get("units")) for path in paths]
    name = " + ".join(path.name for path in paths)
    curve = mean_of(curves)
    if words := specimen.described(curve):
        defaults = [key for key in SIZES[kind] if key not in test and getattr(specimen, key)]
        end = f"; not given, defaults: {', '.join(defaults)}." if defaults else "."
        curve = replace(curve, notices=(f"Taken as a {words}{end}", *curve.notices))
    if curve.per_length and kind == "off-axis":
        raise InputError(f"{name}: a force per length is that of a picture frame, not of a strip")
    sources += [path for path in paths if path not in sources]
    return ShearTest(name, specimen, curve, float(low), float(high)).cut()


def _cantilever(
    test: Mapping[str, Any], where: str, folder: Path, fabric: Fabric, sources: list[Path]
) -> tuple[str, Stiffness]:
    keys = ["kind", "family", "overhang", "angle", "length", "tip", "profile"]
    check_keys(test, keys, where)
    family = test.get("family")
    if family not in ("warp", "weft"):
        raise InputError(f"[{where}] family must be 'warp' or 'weft', got {family!r}")
    given = [key for key in ("overhang", "tip", "profile") if key in test]
    if len(given) != 1:
        raise InputError(f"[{where}] expected one of overhang, tip, profile, got {given or 'none'}")
    weight = fabric.areal_weight
    try:
        if "overhang" in test:
            return family, from_repeats(test["overhang"], test.get("angle", 41.5), weight)
        if "length" not in test:
            raise InputError("length missing: the free length of the strip")
        if "tip" in test:
            tips = np.atleast_2d(np.array(test["tip"], dtype=float))
            return family, from_tip(tips[:, 0], tips[:, 1], test["length"], weight)
        path = folder / test["profile"]
        check_file(path)
        sources.append(path)
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of an empty file
            points = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
        return family, from_profile(points[:, 0], points[:, 1], weight, test["length"])
    except OSError as error:
        raise InputError(f"[{where}] {test['profile']}: {error.strerror or error}") from error
    except InputError as error:
        raise InputError(f"[{where}] {error}") from error
    except (ValueError, TypeError, IndexError, UserWarning) as error:
        raise InputError(
            f"[{where}] {given[0]}: expected numbers in mm, two columns x, drop: {error}"
        ) from error
