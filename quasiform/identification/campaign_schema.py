"""The schema of a campaign file, and what becomes of it; see `campaign` for an example.

Import it where a file is read: see `quasiform.schema`.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, StrictStr, Tag, create_model

from ..checks import InputError
from ..fabric import Fabric, fabric_of
from ..schema import OPEN, Table, checked, number, path, validated
from ..tables import read_numbers
from .campaign_parts import ASSUMED, KINDS, LOWEST, SIZES, VALUES, Campaign, ShearTest
from .cantilever import Stiffness, from_profile, from_repeats, from_tip
from .records import mean_of, read

OPEN_KEY = (Any, OPEN)  # specimens and fabrics check their numbers themselves


def _files(value: Any) -> list[str]:
    files = [value] if isinstance(value, str) else value
    if not isinstance(files, list) or not files or not all(isinstance(f, str) for f in files):
        raise InputError(f"= {files!r}: expected a list of files")
    return files


def _words(value: Any) -> dict[str, str]:
    if not isinstance(value, Mapping) or not all(isinstance(v, str) for v in value.values()):
        raise InputError(f'= {value!r}: expected a table such as {{ force = "..." }}')
    return dict(value)


WORDS = checked(_words, type="object", additionalProperties={"type": "string"})


class _Shear(Table):
    files: checked(_files, type="array", items={"type": "string"}, description="Repeats")
    columns: WORDS = OPEN
    units: WORDS = OPEN
    low: Annotated[number("Smallest shear angle", "deg", zero=True), Field(alias="from")] = LOWEST
    high: Annotated[number("Largest shear angle", "deg"), Field(alias="to")] = 90.0


class _Cantilever(Table):
    kind: Literal["cantilever"]
    family: Literal["warp", "weft"]
    overhang: Any = OPEN
    angle: Any = 41.5
    length: Any = OPEN
    tip: Any = OPEN
    profile: path("Table of x and drop, mm") = OPEN


def kind(table: Any) -> str | None:
    """Which model a test has."""
    return str(table.get("kind")) if isinstance(table, Mapping) else None


_STRIP, _FRAME = (
    create_model(
        name, __base__=_Shear, kind=(Literal[name], ...), **dict.fromkeys(SIZES[name], OPEN_KEY)
    )
    for name in KINDS
)
TEST = Annotated[
    Annotated[_STRIP, Tag("off-axis")]
    | Annotated[_FRAME, Tag("picture-frame")]
    | Annotated[_Cantilever, Tag("cantilever")],
    Discriminator(kind),
]
NAMES = ("thickness", "areal_weight", "bending_warp", "bending_weft", "friction")
_Fabric = create_model(
    "Fabric", __base__=Table, base=(Any, "locking"), **dict.fromkeys(NAMES, OPEN_KEY)
)


class _File(Table):
    name: StrictStr = OPEN
    method: Any = OPEN
    keep: dict[str, Any] = {}  # noqa: RUF012
    algorithm: Any = OPEN
    size: Any = OPEN
    standing: StrictStr = "measured"
    fabric: _Fabric = _Fabric()
    tests: list[TEST] = []  # noqa: RUF012


def read_campaign(table: Mapping[str, Any], file: Path) -> Campaign:
    """Return the campaign of a table; its paths are relative to `file`.

    Raises
    ------
    InputError
        In one line that names table, key, value and what was expected.
    """
    given = validated(_File, table, file.parent)
    fabric = _fabric(given.fabric, file.parent)
    shear, bending, sources = [], {}, [file]
    for i, test in enumerate(given.tests, start=1):
        where = f"[tests {i}]"
        if isinstance(test, _Cantilever):
            if test.family in bending:
                raise InputError(f"{where} family {test.family!r} is there twice: give its repeats")
            bending[test.family] = _stiffness(test, where, fabric)
            sources += [test.profile] if test.profile else []
        else:
            paths = [file.parent / name for name in test.files]
            shear.append(_shear_test(test, where, paths))
            sources += [path for path in paths if path not in sources]
    return Campaign(
        file.stem if given.name is None else given.name,
        fabric,
        tuple(shear),
        bending,
        sources=tuple(sources),
        **given.model_dump(
            include={"method", "keep", "algorithm", "size", "standing"}, exclude_defaults=True
        ),
    )


def _fabric(table: Table, folder: Path) -> Fabric:
    base = str(table.base)
    fabric = fabric_of(folder / base if base.endswith(".toml") else base)
    given = table.model_dump(exclude_unset=True, exclude={"base"})
    origins = {name: _inherited(fabric, name) for name in VALUES} | dict.fromkeys(given, "given")
    return replace(fabric, **given, provenance=origins)


def _inherited(base: Fabric, name: str) -> str:
    """Where a value comes from that is taken from another fabric."""
    known = base.provenance.get(name)
    if known is None:
        return f"{ASSUMED}{base.name}"
    known = str(known)
    return known if known.startswith((ASSUMED, "that of ")) else f"that of {base.name}: {known}"


def _shear_test(test: Table, where: str, paths: list[Path]) -> ShearTest:
    sizes = SIZES[test.kind]
    try:
        specimen = KINDS[test.kind](**test.model_dump(include=set(sizes), exclude_unset=True))
    except InputError as error:
        raise InputError(f"{where} {error}") from error
    name = " + ".join(path.name for path in paths)
    curve = mean_of([read(path, test.columns, test.units) for path in paths])
    if words := specimen.described(curve):
        unset = [k for k in sizes if k not in test.model_fields_set and getattr(specimen, k)]
        end = f"; not given, defaults: {', '.join(unset)}." if unset else "."
        curve = replace(curve, notices=(f"Taken as a {words}{end}", *curve.notices))
    if curve.per_length and test.kind == "off-axis":
        raise InputError(f"{name}: a force per length is that of a picture frame, not of a strip")
    return ShearTest(name, specimen, curve, test.low, test.high).cut()


def _stiffness(test: _Cantilever, where: str, fabric: Fabric) -> Stiffness:
    given = [key for key in ("overhang", "tip", "profile") if key in test.model_fields_set]
    weight = fabric.areal_weight
    try:
        if len(given) != 1:
            raise InputError(f"expected one of overhang, tip, profile, got {given or 'none'}")
        if given == ["overhang"]:
            return from_repeats(test.overhang, test.angle, weight)
        if "length" not in test.model_fields_set:
            raise InputError("length missing: the free length of the strip")
        if given == ["tip"]:
            x, drop = np.atleast_2d(np.array(test.tip, dtype=float)).T
            return from_tip(x, drop, test.length, weight)
        x, drop = read_numbers(test.profile, most=2)[2].T
        return from_profile(x, drop, weight, test.length)
    except InputError as error:
        raise InputError(f"{where} {error}") from error
    except (ValueError, TypeError) as error:
        raise InputError(
            f"{where} {given[0]}: expected numbers in mm, two columns x, drop: {error}"
        ) from error
