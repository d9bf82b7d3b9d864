"""A fingerprint of numbers and objects, to see whether somebody has changed them since."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from functools import cached_property
from hashlib import blake2b
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
            digest.update(repr(part).encode())
        elif id(part) in seen:
            digest.update(str(seen[id(part)]).encode())
        else:
            seen[id(part)] = len(seen)
            digest.update(type(part).__qualname__.encode())
            inside(part)

    def inside(part: Any) -> None:
        if isinstance(part, dict):
            for key, value in part.items():
                take(key)
                take(value)
        elif isinstance(part, list | tuple):
            for value in part:
                take(value)
        elif isinstance(part, set | frozenset):
            digest.update(repr(sorted(map(repr, part))).encode())
        elif is_dataclass(part) or (hasattr(part, "__dict__") and not callable(part)):
            names = [f.name for f in fields(part)] if is_dataclass(part) else vars(part)
            for name in names:
                if name in CACHES or isinstance(getattr(type(part), name, None), cached_property):
                    continue
                digest.update(name.encode())
                take(getattr(part, name))
        else:
            digest.update(str(id(part)).encode())

    take(thing)
    return digest.hexdigest()
