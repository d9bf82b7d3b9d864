"""A fingerprint of numbers and objects, to see whether somebody has changed them since."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from functools import cached_property
from hashlib import blake2b
from itertools import chain
from typing import Any

import numpy as np

CACHES = ("_last", "built", "recipe", "tools")


def fingerprint(thing: Any) -> str:
    """Return a text that changes with any number in an object, its parts and their parts.

    Functions count by their identity: a fingerprint is good within one process.
    """
    digest, seen = blake2b(digest_size=16), {}

    def take(part: Any) -> None:
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype}{part.shape}".encode())
            digest.update(np.ascontiguousarray(part).data if part.dtype != object else b"")
        elif part is None or isinstance(part, str | bytes | int | float | complex | np.generic):
            digest.update(f"{part!r};".encode())  # 1, 23 is not 12, 3
        elif id(part) in seen:
            digest.update(f"{seen[id(part)]};".encode())
        else:
            seen[id(part)] = len(seen)
            digest.update(type(part).__qualname__.encode())
            for inner in _inside(part):
                take(inner)

    take(thing)
    return digest.hexdigest()


def _inside(part: Any) -> Iterable[Any]:
    """What an object consists of."""
    if isinstance(part, dict):
        return chain.from_iterable(part.items())
    if isinstance(part, list | tuple):
        return part
    if isinstance(part, set | frozenset):
        return sorted(map(repr, part))
    if is_dataclass(part) or (hasattr(part, "__dict__") and not callable(part)):
        names = [f.name for f in fields(part)] if is_dataclass(part) else vars(part)
        kind = {n: getattr(type(part), n, None) for n in names if n not in CACHES}
        own = [name for name, value in kind.items() if not isinstance(value, cached_property)]
        return chain.from_iterable((name, getattr(part, name)) for name in own)
    return (id(part),)
