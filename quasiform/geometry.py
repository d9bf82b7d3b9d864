"""Dimensions of the forming tests, read from `geometries/*.toml`, each number with its standing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .checks import InputError, check_keys, check_number, read_toml, suggestion
from .tool import Flipped, RoundOpening, RoundPunch, Shape

STANDINGS = ("measured", "stated", "exact", "peer", "inferred", "assumed")
_PACKAGED = Path(__file__).parent / "geometries"
FOLDER = _PACKAGED if _PACKAGED.is_dir() else Path(__file__).parent.parent / "geometries"
_TABLES = {
    "blank": ["length", "width"],
    "punch": ["shape", "radius", "travel"],
    "die": ["shape", "radius", "fillet"],
    "holder": ["shape", "radius", "fillet", "mass"],
}


@dataclass(frozen=True)
class Geometry:
    """A forming test.

    Parameters
    ----------
    name : str
    length, width : float
        Blank, mm, along x and y.
    punch, die, holder : Shape
        The holder's shape is already upside down.
    travel : float
        Travel of the punch from first touch, mm.
    mass : float
        Mass of the blank holder, kg.
    areas : dict of name to (centre (2,), radius)
        Discs in blank coordinates, mm.
    standings : dict of "table.key" to standing
    """

    name: str
    length: float
    width: float
    punch: Shape
    die: Shape
    holder: Shape
    travel: float
    mass: float
    areas: dict[str, tuple[tuple[float, float], float]]
    standings: dict[str, str]


def built_in() -> list[str]:
    """Names of the geometries that come with the package."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def load(name: str) -> Geometry:
    """Read a built-in geometry by name, or a TOML file of the same form.

    Raises
    ------
    InputError
        For an unknown name, an unreadable file, unknown keys and bad values: one line that names
        file, table and key.
    """
    if name in built_in():
        path = FOLDER / f"{name}.toml"
    elif name.endswith(".toml"):
        path = Path(name)
    else:
        raise InputError(f"unknown scene '{name}': {suggestion(name, built_in())}, or a .toml file")
    return read_toml(path, lambda table: _geometry(table, path.stem))


def _geometry(table: dict[str, Any], name: str) -> Geometry:
    check_keys(table, ["name", "areas", *_TABLES])
    numbers: dict[str, float] = {}
    standings: dict[str, str] = {}
    for part, keys in _TABLES.items():
        if not isinstance(table.get(part), dict):
            raise InputError(f"table [{part}] missing")
        check_keys(table[part], keys, part)
        for key in keys:
            if key not in table[part]:
                raise InputError(f"[{part}] {key} missing")
            if key != "shape":
                where = f"{part}.{key}"
                numbers[where], standings[where] = _number(table[part][key], where)
    areas = {}
    if not isinstance(table.get("areas", {}), dict):
        raise InputError("areas: expected a table [areas]")
    for key, area in table.get("areas", {}).items():
        where = f"areas.{key}"
        if not isinstance(area, dict):
            raise InputError(f"{where} = {area!r}: expected {{ centre, radius, unit, standing }}")
        check_keys(area, ["centre", "radius", "unit", "standing"], where)
        radius = check_number(f"{where}.radius", area.get("radius"))
        standings[where] = _standing(area, where)
        centre = area.get("centre")
        if not (
            isinstance(centre, list) and [type(c) in (int, float) for c in centre] == [True] * 2
        ):
            raise InputError(f"{where}: centre must be two numbers, got {centre!r}")
        areas[key] = ((float(centre[0]), float(centre[1])), radius)
    _shape(table, "punch", "round punch")
    _shape(table, "die", "round opening")
    _shape(table, "holder", "round opening")
    return Geometry(
        name=str(table.get("name", name)),
        length=numbers["blank.length"],
        width=numbers["blank.width"],
        punch=RoundPunch(numbers["punch.radius"]),
        die=RoundOpening(numbers["die.radius"], numbers["die.fillet"]),
        holder=Flipped(RoundOpening(numbers["holder.radius"], numbers["holder.fillet"])),
        travel=numbers["punch.travel"],
        mass=numbers["holder.mass"],
        areas=areas,
        standings=standings,
    )


def _number(entry: Any, where: str) -> tuple[float, str]:
    if not isinstance(entry, dict):
        raise InputError(f"{where} = {entry!r}: expected {{ value, unit, standing }}")
    check_keys(entry, ["value", "unit", "standing"], where)
    value = check_number(where, entry.get("value"))
    unit = "kg" if where.endswith(".mass") else "mm"
    if entry.get("unit", unit) != unit:
        raise InputError(f"{where}: unit must be {unit!r}, got {entry['unit']!r}")
    return float(value), _standing(entry, where)


def _standing(entry: dict[str, Any], where: str) -> str:
    standing = entry.get("standing")
    if standing not in STANDINGS:
        raise InputError(
            f"{where}: standing must be one of {', '.join(STANDINGS)}, got {standing!r}"
        )
    return standing


def _shape(table: dict[str, Any], part: str, known: str) -> None:
    if table[part]["shape"] != known:
        raise InputError(f"[{part}] shape = {table[part]['shape']!r}: expected {known!r}")
