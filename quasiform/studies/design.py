"""Which values the runs of a study have: a grid, a list, a Latin hypercube or Sobol' points.

Points of the unit cube come from `scipy.stats.qmc`; each coordinate u becomes a value by the
inverse of the distribution function of its key. The same seed gives the same values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import ceil, exp, log, log2
from numbers import Real
from typing import Any

import numpy as np

from ..checks import InputError, check_keys

DESIGNS = ("grid", "list", "lhs", "sobol")
SAMPLED = ("lhs", "sobol")
MOST = 1_000_000  # runs
KEYS = ("from", "to", "steps", "log", "mean", "std")
INSIDE = 1e-12  # how near u may come to 0 and 1, where a normal distribution ends


@dataclass(frozen=True)
class Values:
    """Values of a key, one by one."""

    values: tuple[Any, ...]

    def all(self) -> Sequence[Any]:
        return self.values

    def at(self, u: float) -> Any:
        """Value for 0 <= u < 1, all of them equally likely."""
        return self.values[min(int(u * len(self.values)), len(self.values) - 1)]


@dataclass(frozen=True)
class Range:
    """Values between two ends, uniform in the value or its logarithm, or a normal distribution."""

    low: float
    high: float
    steps: int | None = None
    log: bool = False
    mean: float = 0.0
    std: float | None = None

    def all(self) -> Sequence[float]:
        """Values in equal steps, the ends included."""
        if self.steps is None:
            raise InputError("needs steps, such as { from = 2.0, to = 8.0, steps = 4 }, or a list")
        return [self.at(k / (self.steps - 1)) for k in range(self.steps)]

    def at(self, u: float) -> float:
        """Value whose distribution function is u."""
        if self.std is not None:
            from scipy.special import ndtr, ndtri

            low, high = (ndtr((end - self.mean) / self.std) for end in (self.low, self.high))
            u = min(max(low + u * (high - low), INSIDE), 1 - INSIDE)
            return float(self.mean + self.std * ndtri(u))
        if u in (0.0, 1.0):
            return self.high if u else self.low
        if self.log:
            return exp(log(self.low) + u * log(self.high / self.low))
        return self.low + u * (self.high - self.low)


def varied(entry: Any) -> Values | Range:
    """Return what [vary] has for a key; an InputError goes on where the name of the key ends."""
    if isinstance(entry, list | tuple):
        if not entry:
            raise InputError("is an empty list")
        return Values(tuple(entry))
    if not isinstance(entry, Mapping):
        raise InputError(f"= {entry!r}: expected a list, or a range such as {{ from = 2, to = 8 }}")
    if entry and all(isinstance(value, Mapping | list) for value in entry.values()):
        raise InputError('is a table: write the whole name in quotes, as "tools.holder.mass"')
    check_keys(entry, KEYS)
    normal = "std" in entry or "mean" in entry
    needed = ("mean", "std") if normal else ("from", "to")
    for key in needed:
        if key not in entry:
            raise InputError(f"{key} missing")
    for key in entry.keys() - {"log"}:
        value = entry[key]
        if not isinstance(value, Real) or isinstance(value, bool) or not abs(value) < 1e100:
            raise InputError(f"{key} must be a number, got {value!r}")
    steps, by_log = entry.get("steps"), entry.get("log", False)
    if steps is not None and (type(steps) is not int or not 2 <= steps <= MOST or normal):
        raise InputError(f"steps must be a whole number from 2 on, of a range, got {steps!r}")
    if not isinstance(by_log, bool) or (by_log and normal):
        raise InputError(f"log must be true or false, of a range, got {by_log!r}")
    low, high = float(entry.get("from", -np.inf)), float(entry.get("to", np.inf))
    if low >= high:
        raise InputError(f"from must be less than to, got from = {low:g}, to = {high:g}")
    if by_log and low <= 0:
        raise InputError(f"from must be positive with log = true, got {low:g}")
    if not normal:
        return Range(low, high, steps, by_log)
    mean, std = float(entry["mean"]), float(entry["std"])
    if std <= 0 or not low <= mean <= high:
        words = f"std must be positive and mean between from and to, got {mean:g} and {std:g}"
        raise InputError(words)
    return Range(low, high, mean=mean, std=std)


def rows(
    design: str, keys: Mapping[str, Values | Range], runs: int | None, seed: int
) -> list[dict[str, Any]]:
    """Return the values of the keys, by name, one dict a run in the order of the design."""
    if design in SAMPLED:
        if runs is None:
            raise InputError(f"runs missing: how many runs does design = '{design}' have?")
        points = _points(design, len(keys), runs, seed)
        return [
            {name: key.at(u) for (name, key), u in zip(keys.items(), point, strict=True)}
            for point in points.tolist()
        ]
    if runs is not None:
        words = f"runs = {runs} does not go with design = '{design}', whose values say how many"
        raise InputError(words)
    columns = []
    for name, key in keys.items():
        try:
            columns.append(key.all())
        except InputError as error:
            raise InputError(f"[vary] {name} {error}") from error
    if design == "list":
        if len({len(column) for column in columns}) > 1:
            counts = ", ".join(f"{name} {len(c)}" for name, c in zip(keys, columns, strict=True))
            raise InputError(f"design = 'list' needs lists of equal length, got {counts}")
        together = list(zip(*columns, strict=True))
    elif np.prod([float(len(column)) for column in columns]) > MOST:
        raise InputError(f"more than {MOST:g} runs")
    else:
        together = list(product(*columns))
    return [dict(zip(keys, values, strict=True)) for values in together]


def saltelli(keys: Mapping[str, Values | Range], points: int, seed: int) -> list[dict[str, Any]]:
    """Return the values of groups of runs: A, B, and A with one key from B after the other.

    More points start with the same groups.
    """
    d, found = len(keys), []
    for point in _points("sobol", 2 * d, points, seed).tolist():
        halves = point[:d], point[d:]
        A, B = ([k.at(u) for k, u in zip(keys.values(), half, strict=True)] for half in halves)
        mixed = [[*A[:i], B[i], *A[i + 1 :]] for i in range(d)]
        found += [dict(zip(keys, values, strict=True)) for values in (A, B, *mixed)]
    return found


def _points(design: str, dimensions: int, runs: int, seed: int) -> np.ndarray:
    """(runs, dimensions) points of the unit cube; more Sobol' points start with the same ones."""
    from scipy.stats import qmc

    if design == "lhs":
        return qmc.LatinHypercube(dimensions, rng=np.random.default_rng(seed)).random(runs)
    sobol = qmc.Sobol(dimensions, rng=np.random.default_rng(seed))
    return sobol.random_base2(ceil(log2(runs)))[:runs]
