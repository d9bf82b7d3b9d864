"""Files read through a schema: pydantic checks them, and each refusal becomes one line.

Import this module where a file is read, not with the package: pydantic takes a while to load.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import ErrorDetails, PydanticCustomError

from .checks import InputError, check_keys, check_number, suggestion

M = TypeVar("M", bound="Table")
LARGEST = 1e6  # of a number, in its unit: a kilometre, a meganewton
STANDINGS = ("measured", "stated", "exact", "peer", "inferred", "assumed")
OPEN = Field(default_factory=NoneType)  # may be left out; no default is shown in the JSON schema
TABLES = ("model_type", "model_attributes_type", "dict_type", "union_tag_not_found")


class Table(BaseModel):
    """A table of a file; an unknown key is refused with a suggestion."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, table: Any) -> Any:
        if isinstance(table, Mapping):
            check_keys(table, [field.alias or key for key, field in cls.model_fields.items()])
        return table


def validated(model: type[M], table: Any, folder: Path | None = None) -> M:
    """Return the table of a file as its model; paths are relative to `folder`.

    InputError in one line that names table, key, value and what was expected.
    """
    try:
        return model.model_validate(table, context=folder)
    except ValidationError as error:
        raise InputError(_one_line(error.errors(include_url=False)[0], table)) from error


def dotted(path: Iterable[str | int]) -> str:
    """Name of a place in a file.

    >>> dotted(["blank", "holes", 0, "radius"])
    'blank.holes 1.radius'
    """
    words = ""
    for part in path:
        words += f" {part + 1}" if isinstance(part, int) else f".{part}" if words else part
    return words


def _one_line(error: ErrorDetails, table: Any) -> str:
    """What pydantic found wrong, as one line for the user."""
    kind, got, context = error["type"], error["input"], error.get("ctx", {})
    path, here = [], table
    for k, part in enumerate(error["loc"], 1):
        try:
            inner = here[part]
        except (KeyError, IndexError, TypeError):
            continue  # pydantic's name for the member of a union
        if k < len(error["loc"]) and not isinstance(inner, Mapping | list):
            continue  # such a name that is also a key
        here = inner
        path.append(part)
    if kind == "missing":
        path.append(error["loc"][-1])
    place = dotted(path)
    if kind in ("value_error", "table"):  # of a whole table
        words = str(context.get("error", error["msg"]))
        return f"[{place}] {words}" if place else words
    if kind == "part":  # of the table of a number
        return f"{place}: {error['msg']}"
    if kind in TABLES:
        return f"{place} = {got!r}: expected a table [{place}]"
    if kind.startswith(("list", "tuple")):
        return f"{place}: expected tables [[{place}]]"
    if kind == "union_tag_invalid":
        key = context["discriminator"].strip("'()").split("_")[-1]  # a function named after the key
        path, got = [*path, key], got.get(key)
    named = len(path) > 1 and isinstance(path[-1], str)
    name = f"[{dotted(path[:-1])}] {path[-1]}" if named else dotted(path)
    if kind in ("literal_error", "union_tag_invalid"):
        known = re.findall(r"'(.*?)'", context.get("expected") or context["expected_tags"])
        known = [word for word in known if word[0] != "("]  # chosen by another key
        if got is None:
            return f"{name} missing: expected one of {', '.join(known)}"
        return f"{name} = {got!r}: {suggestion(got if isinstance(got, str) else '', known)}"
    if kind.startswith("int"):
        kind = "int"
    words = {
        "missing": "missing",
        "int": f"must be a whole number, got {got!r}",
        "greater_than_equal": f"must be at least {context.get('ge')}, got {got!r}",
        "less_than_equal": f"must not exceed {context.get('le')}, got {got!r}",
        "bool_type": f"= {got!r}: expected true or false",
        "string_type": f"must be a text, got {got!r}",
        "float_type": f"must be a number, got {got!r}",
    }
    return f"{name} {words.get(kind, error['msg'])}"


# Types of keys


def _refusal(kind: str, words: str) -> PydanticCustomError:
    return PydanticCustomError(kind, "{words}", {"words": words})


def checked(check: Callable[[Any], Any], **schema: Any) -> Any:
    """Type of a key that `check` turns into its value; its InputError continues the key's name."""

    def wrapped(value: Any) -> Any:
        try:
            return check(value)
        except InputError as error:
            raise _refusal("wrong", str(error)) from error

    return Annotated[Any, PlainValidator(wrapped), WithJsonSchema(schema)]


def number(
    text: str,
    unit: str,
    *,
    zero: bool = False,
    signed: bool = False,
    most: float = LARGEST,
    over: str = "",
) -> Any:
    """Type of a key with a number in `unit`, or with `{ value, unit, standing }`.

    With `over`, the unit of a travel, also with a list of rows [travel, number].
    """

    def check(value: Any) -> float | tuple[tuple[float, float], ...]:
        if isinstance(value, Mapping):
            check_standing(value, unit, "value", "unit", "standing")
            value = value.get("value")
        if over and isinstance(value, list):
            rows = [row for row in value if isinstance(row, list) and len(row) == 2]
            travels = [row[0] for row in rows if type(row[0]) in (int, float) and row[0] >= 0]
            rising = all(a < b for a, b in pairwise([*travels, LARGEST]))
            if not (rising and len(travels) == len(value) > 1):
                expected = f"two rows or more, [travel in {over}, {unit}], of rising travel from 0"
                raise InputError(f"= {value!r}: expected {expected}")
            return tuple((float(s), check(y)) for s, y in value)
        if signed:
            if type(value) not in (int, float) or not abs(value) <= most:
                raise InputError(f"must be a number of up to {most:g}, got {value!r}")
        elif check_number("", value, zero_allowed=zero) > most:
            raise InputError(f"must not exceed {most:g} {unit}, got {value!r}")
        return float(value)

    limits = {"minimum": -most} if signed else {"minimum" if zero else "exclusiveMinimum": 0}
    plain = {"type": "number", **limits, "maximum": most}
    keys = {"value": plain, "unit": {"const": unit}, "standing": {"enum": list(STANDINGS)}}
    table = {"type": "object", "properties": keys, "additionalProperties": False}
    both = [plain, table | {"required": ["value", "standing"]}]
    if over:
        row = {"type": "array", "prefixItems": [{"type": "number", "minimum": 0}, plain]}
        both.append({"type": "array", "items": row, "minItems": 2})
    return checked(check, anyOf=both, description=text if unit == "1" else f"{text}; {unit}")


def check_standing(table: Mapping[str, Any], unit: str, *keys: str) -> None:
    """Refuse an unknown key, another unit, and no standing or an unknown one."""
    try:
        check_keys(table, keys)
    except InputError as error:
        raise _refusal("table", str(error)) from error
    if table.get("unit", unit) != unit:
        raise _refusal("part", f"unit must be {unit!r}, got {table['unit']!r}")
    if (standing := table.get("standing")) not in STANDINGS:
        known = ", ".join(STANDINGS)
        raise _refusal("part", f"standing must be one of {known}, got {standing!r}")


def vector(text: str, length: int, expected: str = "") -> Any:
    """Type of a key with a list of numbers."""

    def check(value: Any) -> tuple[float, ...]:
        numbers = isinstance(value, list | tuple) and all(
            type(c) in (int, float) and abs(c) <= LARGEST for c in value
        )
        if not numbers or len(value) != length:
            wanted = expected or f"{length} numbers"
            raise InputError(f"= {value!r}: expected {wanted} of up to {LARGEST:g}")
        return tuple(map(float, value))

    items = {"items": {"type": "number"}, "minItems": length, "maxItems": length}
    return checked(check, type="array", description=text, **items)


def path(text: str) -> Any:
    """Type of a key with the path of a file."""

    def check(value: Any, info: ValidationInfo) -> Path:
        if not isinstance(value, str) or not value or "\0" in value:
            raise _refusal("wrong", f"= {value!r}: expected the path of a file")
        return info.context / value

    schema = WithJsonSchema({"type": "string", "description": text})
    return Annotated[Any, PlainValidator(check), schema]


def standings(table: Any, path: tuple[str | int, ...] = ()) -> dict[str, str]:
    """Standings in the table of a file by the dotted names of what they are of."""
    if isinstance(table, Mapping) and "standing" in table:
        return {dotted(path): table["standing"]}
    items = enumerate(table) if isinstance(table, list) else ()
    found: dict[str, str] = {}
    for key, value in table.items() if isinstance(table, Mapping) else items:
        found |= standings(value, (*path, key))
    return found
