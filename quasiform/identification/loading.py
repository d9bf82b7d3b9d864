"""The loading part of a record: one cycle of it, its zero, its preload and its noise.

Rows are (k, n): what was moved (mm or rad), the force, and perhaps a shear angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from ..checks import InputError
from ..tables import UNITS

FloatArray = np.ndarray

FEWEST = 8  # rows of a curve
UNSTRAINED = 0.25  # of the force at the slope of the start: below, the displacement has an offset
BACK = 0.02  # of the range; going back further is no jitter
DROP = 0.2  # of the largest force; a specimen whose force drops by more is torn
SMALL = 0.02  # of the largest force: near zero, and where relative noise becomes absolute
OFFSET = 0.05  # of the largest force; a constant level above is friction, not a load cell's offset
TOE = 0.05  # of the range; the largest distance over which a toe is extrapolated
CONCAVE = 1.4  # a record without its first rows has a toe that is farther by less than this


@dataclass(frozen=True)
class Part:
    """Which part of a record is used, and where it begins; None: found from the record."""

    zero: float | None = None  # reading of the displacement at which the fabric is not strained, mm
    preload: float | None = None  # force on the fabric in the first row, N (or N/mm)
    cycle: str | int | None = None  # last, first, envelope, or its number from 1


WHOLE = Part()


def label(quantity: str) -> str:
    """Name of a quantity in a message."""
    return quantity.replace("_", " ")


def measured(quantity: str, value: float) -> str:
    """Value of a quantity with its unit."""
    unit = next(iter(UNITS[quantity]))
    return f"{np.degrees(value) if unit == 'deg' else value:.3g} {unit}"


def rows_of(n: int) -> str:
    """Return "1 row" or "2 rows"."""
    return "1 row" if n == 1 else f"{n} rows"


def were(n: int, where: str, what: str) -> str:
    """Sentence on what happened to n rows."""
    return f"{rows_of(n)} {where} {'was' if n == 1 else 'were'} {what}."


def loading(
    rows: FloatArray, along: str, force: str, lines: np.ndarray, part: Part, notices: list[str]
) -> tuple[FloatArray, float]:
    """Return the rows (k, m) of the loading, from their zero on, and the preload that was found.

    `lines` are those of the file.
    """
    used = _one_cycle(rows[0], along, part.cycle, notices)
    rows, lines = rows[:, used], lines[used]
    rows = _ahead(rows[:, : _end(rows, along, force, lines, notices)], along, lines, notices)
    if rows[1].max() <= 0:
        raise InputError("the force is nowhere positive while loading: is its sign reversed?")
    if along == "displacement":
        return _from_zero(rows, force, part, notices)
    if part.zero is not None or part.preload is not None:
        raise InputError("zero and preload are of a record with a displacement, not of an angle")
    return rows, 0.0


def _turns(x: FloatArray) -> list[tuple[int, int]]:
    """First and last row of each loading: between them it is unloaded in more than two rows."""
    back, found = BACK * np.ptp(x), []
    low = high = 0  # rows of the last valley, and of the peak after it
    rising = True
    for k in range(1, len(x)):
        if rising and x[k] > x[high]:
            high = k
        elif rising and x[k] < x[high] - back:
            found.append((low, high))
            low, rising = k, False
        elif not rising and x[k] < x[low]:
            low = k
        elif not rising and x[k] > x[low] + back:
            if low - found[-1][1] <= 2:  # a jump: `_ahead` refuses it
                low = found.pop()[0]
            high, rising = k, True
    turns = [*found, (low, high)] if rising else found
    return [(low, high) for low, high in turns if x[high] - x[low] > back]


def _one_cycle(
    x: FloatArray, along: str, cycle: str | int | None, notices: list[str]
) -> np.ndarray:
    """Rows of the cycle that is used; all rows of a record of a single loading."""
    turns = _turns(x)
    count = max(len(turns), 1)
    words = f"{count} cycles" if count > 1 else "1 cycle"
    if str(cycle).isdecimal() and not 1 <= int(cycle) <= count:
        raise InputError(f"cycle {cycle} is not in the record, which has {words}")
    if count < 2:
        return np.arange(len(x))
    if cycle in (None, "envelope"):
        reached, parts = -np.inf, []
        for low, high in turns:  # what comes back to about the largest so far is no progress
            rows = np.arange(low, high + 1)
            parts.append(rows[x[rows] > reached + (BACK * np.ptp(x) if parts else 0.0)])
            reached = max(reached, x[high])
        used, what = np.concatenate(parts), "their envelope is used, in the main the first loading"
    else:
        wide = [k for k, (low, high) in enumerate(turns) if x[high] - x[low] > 0.5 * np.ptp(x)]
        k = {"first": 0, "last": wide[-1] if wide else count - 1}.get(cycle, -1)
        k = int(cycle) - 1 if k < 0 else k
        used = np.arange(turns[k][0], turns[k][1] + 1)
        what = f"number {k + 1} is used, from {measured(along, x[used[0]])}"
    notices.append(f"The record has {words}: {what} (--cycle last|first|N|envelope).")
    return used


def _enough_rows(rows: FloatArray, why: str = "") -> FloatArray:
    """Refuse too few rows (k, n)."""
    if (n := rows.shape[-1]) < FEWEST:
        belong = "belongs" if n == 1 else "belong"
        words = f"only {rows_of(n)} {belong} to the loading, at least {FEWEST} are needed{why}"
        raise InputError(words)
    return rows


def _end(rows: FloatArray, along: str, force: str, lines: np.ndarray, notices: list[str]) -> int:
    """Number of rows before unloading and tearing."""
    x, f = rows[:2]
    end = int(x.argmax()) + 1
    _enough_rows(x[:end], f": the {label(along)} is largest at line {lines[end - 1]}")
    if n := len(x) - end:
        largest = f"{label(along)}, {measured(along, x[end - 1])}"
        notices.append(were(n, f"after the largest {largest},", "cut"))
    top = int(f[:end].argmax())
    if f[top] > 0 and f[top:end].min() < (1 - DROP) * f[top]:
        place = f"after {measured(force, f[top])} at {measured(along, x[top])}"
        rest = were(end - top, "from there on", "cut")
        notices.append(f"The force drops by more than {100 * DROP:g} % {place}: {rest}")
        end = top
    _enough_rows(x[:end])
    return end


def _ahead(rows: FloatArray, along: str, lines: np.ndarray, notices: list[str]) -> FloatArray:
    """Leave out rows that do not move ahead; refuse a record that goes back."""
    x = rows[0]
    reached = np.maximum.accumulate(x)
    back, worst = (reached - x).max(), int((reached - x).argmax())
    if back > BACK * np.ptp(x):
        words = f"{measured(along, back)} at line {lines[worst]}"
        raise InputError(f"{label(along)} is not monotone: goes back by {words}")
    ahead = np.r_[True, x[1:] > reached[:-1]]
    if not ahead.all():
        n = int((~ahead).sum())
        move = "does not move" if n == 1 else "do not move"
        notices.append(were(n, f"that {move} ahead", "left out"))
    return _enough_rows(rows[:, ahead])


def _from_zero(
    rows: FloatArray, force: str, part: Part, notices: list[str]
) -> tuple[FloatArray, float]:
    """Move the displacement, and a force by a given preload, to where the fabric is not strained.

    An angle stays as it was measured. In order: what is given; slack; the toe of a preloaded
    specimen, extrapolated; a first row that is not strained.
    """
    x, f = rows[:2]
    if part.preload is not None:
        start, f = f[0], f + (part.preload - f[0])
        words = f"from {measured(force, start)} in the first row to {measured(force, part.preload)}"
        notices.append(f"The force was shifted, {words}, the preload that was given.")
    elif part.zero is None and (slack := _slack(x, f)):
        start, level = slack
        cut = f"Slack up to {start:.4g} mm was cut, displacement counts from there"
        before = f"the constant {measured(force, level)} before it was subtracted from the force"
        notices.append(f"{cut}; {before}.")
        return _enough_rows(np.stack([x - start, f - level, *rows[2:]])[:, x > start]), 0.0
    zero, why, preload = (part.zero, "given", 0.0) if part.zero is not None else _zero(x, f, force)
    if zero is None:
        notices.append(why)
        zero = 0.0
    elif zero:
        notices.append(f"The displacement was shifted by {-zero:.4g} mm: {why}.")
    rows = _enough_rows(np.stack([x - zero, f, *rows[2:]])[:, x >= zero])
    return rows, 0.0 if part.preload is not None else preload


def _zero(x: FloatArray, f: FloatArray, force: str) -> tuple[float | None, str, float]:
    """Reading at which the fabric is not strained (None: unknown), why, and the preload.

    The tangent of the first rows meets zero force at the toe. A record whose first rows were left
    out has its toe before its own zero, but not far; one whose toe is elsewhere was preloaded.
    """
    distance, start, softens = _toe(x, f)
    toe, near, row = x[0] - distance, TOE * np.ptp(x), 0.5 * (x[1] - x[0])
    own = toe <= 0 and distance <= CONCAVE * x[0]  # its own zero is right
    if abs(toe) <= max(0.001 * np.ptp(x), row) or (own and distance <= near):
        return 0.0, "", 0.0
    if row < distance <= near and softens:
        words = f"a preload of {measured(force, start)} in the first row, at {x[0]:.4g} mm"
        return toe, f"{words}, extrapolated along the first rows to no force", start
    # a sheet that was strained by x[0] already would have taken about the slope of the start
    first = slice(0, max(FEWEST, np.searchsorted(x, x[0] + abs(x[0]))))
    slope = max(np.polyfit(x[first], f[first], 1)[0], 0.0)
    if x[0] < 0 or distance <= row or f[0] < UNSTRAINED * slope * x[0]:
        return float(x[0]), "it starts without a force", 0.0
    words = f"The curve begins at {x[0]:.4g} mm with {measured(force, f[0])}: not shifted"
    return None, f"{words} (--zero MM sets its zero).", 0.0


def _toe(x: FloatArray, f: FloatArray) -> tuple[float, float, bool]:
    """Distance from the first row to the toe, mm, the force there, and whether the curve softens.

    A parabola smooths rows over a length like that distance, at least six.
    """
    distance = TOE * np.ptp(x)
    for _ in range(4):
        n = max(6, np.searchsorted(x, x[0] + min(distance, TOE * np.ptp(x)), "right"))
        _, slope, start = np.polyfit(x[:n] - x[0], f[:n], 2)
        if slope <= 0:
            return np.inf, float(start), False
        distance = max(float(start / slope), 0.0)
    later = int(np.searchsorted(x, x[0] + 2 * TOE * np.ptp(x)))
    return distance, float(start), bool(f[later] - start < 1.1 * slope * (x[later] - x[0]))


def _slack(x: FloatArray, f: FloatArray) -> tuple[float, float] | None:
    """End of the slack, mm, and constant force before it, N; None if there is no slack.

    Rows from the first on are flat as long as their slope is not significant. The line through
    the first rise meets their level at the end of the slack, provided that this kinked line fits
    better than a parabola, as which a curve that just begins softly would pass.
    """
    top, n = f.max(), len(f)
    if np.ptp(f) == 0:
        return None
    step = np.diff(np.unique(f)).min() / np.sqrt(12)  # what rounding to a step scatters

    def scatter(k: int) -> float:
        return max(np.sqrt(np.mean(np.diff(f[:k], 2) ** 2) / 6), step, 1e-6 * top)

    k = 6
    while k < n:
        u = x[:k] - x[:k].mean()
        if abs(u @ f[:k]) > 4 * scatter(k) * np.sqrt(u @ u):
            break
        k = max(k + 1, int(1.05 * k))
    flat = int(0.8 * min(k, n))
    level, noise = float(np.median(f[:flat])), scatter(flat)
    if k >= n or flat < 5 or abs(level) > OFFSET * top:
        return None
    above = f > level + 5 * noise
    first = flat + int(np.argmax(above[flat:-1] & above[flat + 1 :]))
    last = max(first + 6, int(np.argmax(f > level + 20 * noise)) + 1)
    X, F = x[first:last], f[first:last]
    if len(X) < 4:
        return None
    i, j = np.triu_indices(len(X), 1)
    slope = np.median((F[j] - F[i]) / (X[j] - X[i]))  # Theil-Sen
    start = float(np.median(X - (F - level) / slope))
    X, F = x[:last], f[:last]
    kinked = level + slope * np.maximum(X - start, 0) - F
    u = (X - X[0]) / np.ptp(X)
    parabola = np.polyval(np.polyfit(u, F, 2), u) - F
    if slope <= 0 or kinked @ kinked > 0.7 * (parabola @ parabola):
        return None
    return start, level


def noise(x: FloatArray, f: FloatArray) -> FloatArray:
    """Standard deviation of the force: a share of it, of at least SMALL of the largest.

    The share is the median of what is left of a row by the cubic through its four neighbours,
    which a smooth curve's curvature does not enter, over the standard deviation of that by
    noise of one.
    """
    k = np.arange(2, len(x) - 2)
    near = k[:, None] + [-2, -1, 1, 2]  # (n - 4, 4)
    weight = np.ones(near.shape)  # of Lagrange
    for a, b in permutations(range(4), 2):
        weight[:, a] *= (x[k] - x[near[:, b]]) / (x[near[:, a]] - x[near[:, b]])
    left = (f[k] - (weight * f[near]).sum(axis=1)) / np.sqrt(1 + (weight**2).sum(axis=1))
    floor = SMALL * f.max()
    local = np.maximum((f[k - 1] + f[k] + f[k + 1]) / 3, floor)
    share = np.median(np.abs(left) / local) / 0.6745
    return max(share, 1e-6) * np.maximum(f, floor)
