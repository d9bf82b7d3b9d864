"""The fabric: shear and tension laws of a 0°/90° biaxial non-crimp fabric.

Strain energy W(C) = W4(I4) + W6(I6) + W8(I8) per reference volume (Schäfer et al., Eqs. 7-8) with

    I4 = a0·C·a0,  I6 = a0·C·b0,  I8 = b0·C·b0                       (Eqs. 1-3)

in the warp direction a0 and the weft direction b0. Each W_i follows the three-stage law of Eq. 9;
W6 may come from a table instead.
Two corrections to the printed equations: the shear angle needs the root, γ = arcsin(I6/√(I4 I8)),
and the derivative of Eq. 9 carries the sign of I - I0 (W is even, so dW/dI is odd).

Everything here works on plain arrays; no mesh is needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from .checks import InputError, check_keys, check_number, suggestion
from .toml_file import read_toml, toml_text

FloatArray = np.ndarray
T = TypeVar("T")


def invariants(F: FloatArray, a0: FloatArray, b0: FloatArray) -> tuple[FloatArray, ...]:
    """Invariants I4, I6, I8 (Eqs. 1-3), (...) arrays, dimensionless.

    F is the deformation gradient, (..., m, 2) or (..., m, 3); a0 and b0 are the unit vectors of
    warp and weft in the flat fabric.

    >>> I4, I6, I8 = invariants(np.eye(2), np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    >>> float(I4), float(I6), float(I8)
    (1.0, 0.0, 1.0)
    """
    a, b = F @ a0, F @ b0
    return (a * a).sum(-1), (a * b).sum(-1), (b * b).sum(-1)


def shear_angle(I4: FloatArray, I6: FloatArray, I8: FloatArray) -> FloatArray:
    """Shear angle γ = arcsin(I6/√(I4 I8)) in radians (Eq. 6 with its root restored)."""
    return np.arcsin(np.clip(I6 / np.sqrt(I4 * I8), -1.0, 1.0))


@dataclass(frozen=True)
class ThreeStageLaw:
    """Three-stage law of Eq. 9: initial stiffness, plateau, locking.

    With x = |I - I0|, I^t = S_ini/C_ini, c = C_ini/dS_mid, y = max(x - I^t, 0) and
    z = max(x - I_lo, 0)::

        dW/dI = sgn(I - I0) [C_ini min(x, I^t) + (C_mid y + dS_mid)(1 - exp(-c y)) + C_lo z²]

    which is C¹ at both joins. With `C_ini` alone the law is linear for every argument.

    Parameters
    ----------
    C_ini : float
        Initial stiffness, MPa.
    S_ini, C_mid, dS_mid, C_lo : float or None
        Stress at the end of the first stage, slope and stress step of the plateau, and locking
        stiffness, MPa. All or none of the five optional numbers.
    I_lo : float or None
        Onset of locking, dimensionless.

    Raises
    ------
    InputError
        If a number is not finite and positive (`C_mid` and `C_lo` may be zero), or if only some
        of the optional numbers are given.
    """

    C_ini: float
    S_ini: float | None = None
    C_mid: float | None = None
    dS_mid: float | None = None
    C_lo: float | None = None
    I_lo: float | None = None

    def __post_init__(self) -> None:
        later = [f.name for f in fields(self)][1:]
        missing = [name for name in later if getattr(self, name) is None]
        if missing and len(missing) < len(later):
            words = f"a three-stage law needs all of {', '.join(later)}"
            raise InputError(f"{words}: {', '.join(missing)} missing")
        for name in ["C_ini", *later][: None if not missing else 1]:
            check_number(name, getattr(self, name), zero_allowed=name in ("C_mid", "C_lo"))
        if not missing and self.I_lo <= (It := self.S_ini / self.C_ini):
            raise InputError(f"I_lo must lie beyond S_ini/C_ini = {It:.4g}, got {self.I_lo}")

    @property
    def linear(self) -> bool:
        """Whether the law has its first stage only."""
        return self.S_ini is None

    def energy(self, I: FloatArray, I0: float = 0.0) -> FloatArray:
        """W(I) in mJ/mm³ = MPa, zero at I0; same shape as `I`."""
        if self.linear:
            return 0.5 * self.C_ini * (I - I0) ** 2
        x = np.abs(I - I0)
        It, c, y, z = self._stages(x)
        E = -np.expm1(-c * y)  # 1 - exp(-c y)
        plateau = self.S_ini * y + 0.5 * self.C_mid * y**2 + self.dS_mid * (y - E / c)
        # ∫ C_mid y exp(-c y) dy, subtracted
        plateau -= self.C_mid * (E / c**2 - y * (1.0 - E) / c)
        return 0.5 * self.C_ini * np.minimum(x, It) ** 2 + plateau + self.C_lo * z * z**2 / 3.0

    def stress(self, I: FloatArray, I0: float = 0.0) -> FloatArray:
        """dW/dI in MPa (Eq. 9, with the sign of I - I0); same shape as `I`."""
        if self.linear:
            return self.C_ini * (I - I0)
        x = np.abs(I - I0)
        It, c, y, z = self._stages(x)
        value = self.C_ini * np.minimum(x, It)
        value = value - (self.C_mid * y + self.dS_mid) * np.expm1(-c * y) + self.C_lo * z**2
        return np.sign(I - I0) * value

    def stiffness(self, I: FloatArray, I0: float = 0.0) -> FloatArray:
        """d²W/dI² in MPa, positive everywhere; same shape as `I`."""
        if self.linear:
            return np.full_like(I, self.C_ini, dtype=float)
        x = np.abs(I - I0)
        It, c, y, z = self._stages(x)
        E = np.exp(-c * y)
        plateau = self.C_mid * (1.0 - E) + (self.C_mid * y + self.dS_mid) * c * E
        return np.where(x < It, self.C_ini, plateau + 2.0 * self.C_lo * z)

    def _stages(self, x: FloatArray) -> tuple[float, float, FloatArray, FloatArray]:
        """I^t, c, y and z."""
        It = self.S_ini / self.C_ini
        return It, self.C_ini / self.dS_mid, np.maximum(x - It, 0.0), np.maximum(x - self.I_lo, 0.0)


@dataclass(frozen=True)
class TabulatedLaw:
    """Shear law through the points of a table, with a smooth and positive stiffness.

    With x = |I - I0| the stress is sgn(I - I0) S(x), S the quintic through values, slopes m and
    second derivatives s at the knots: C², so that the stiffness is C¹. On an interval of width h
    and secant D = ΔS/h the stiffness is the quartic of the Bernstein coefficients::

        m0,  m0 + s0 h/4,  5 D - 2 m0 - 2 m1 - (s0 - s1) h/4,  m1 - s1 h/4,  m1

    whose mean is D. None is negative, hence S' > 0, if at every knot

        m > 0,  m0 + m1 <= 5/2 D on both sides,
        -min(4 m/h_right, 2 q_left/h_left) <= s <= min(4 m/h_left, 2 q_right/h_right)

    with q = 5 D - 2 m0 - 2 m1 >= 0, half of which either end may take from the middle one. Both
    derivatives come from parabolas, of S for m and of m for s. A slope shrinks by the smaller of
    the factors 5/2 D/(m0 + m1) < 1 of its two intervals; s is clipped to its bounds. At zero and at
    the end s = 0; beyond it S is a straight line of 1/4 to 5/4 of the last secant.

    Parameters
    ----------
    I6 : (n,) sequence
        Invariant I6, dimensionless, strictly increasing from 0 to at most 1.5; n >= 4. The origin
        may be left out.
    S12 : (n,) sequence
        Stress dW/dI6, MPa, strictly increasing from 0.

    Raises
    ------
    InputError
        For a table that is too short or not increasing; the message names the entry.
    """

    I6: tuple[float, ...]
    S12: tuple[float, ...]

    def __post_init__(self) -> None:
        I6, S12 = _increasing("I6", self.I6), _increasing("S12", self.S12)
        lengths = f"{len(I6)} and {len(S12)}"
        at, origin = f"where I6[0] = {I6[0]:g}", (0.0,) if I6[0] > 0 else ()
        n, last, stress = len(I6) + len(origin), I6[-1], S12[0]
        for wrong, words in (
            (len(I6) != len(S12), f"I6 and S12 must be of one length, got {lengths} numbers"),
            (not origin and stress > 0, f"S12[0] must be 0, {at}, got {stress!r}"),
            (origin and stress == 0, f"S12[0], {at}, must be a positive number, got {stress!r}"),
            (last > 1.5, f"I6 = sin(shear angle) must not exceed 1.5, got {last!r}"),
            (n < 4, f"a tabulated law needs at least 4 points with the origin, got {n}"),
        ):
            if wrong:
                raise InputError(words)
        object.__setattr__(self, "I6", (*origin, *I6))
        object.__setattr__(self, "S12", (*origin, *S12))

    @property
    def linear(self) -> bool:
        """False: the stiffness follows the table."""
        return False

    def energy(self, I: FloatArray, I0: float = 0.0) -> FloatArray:
        """W(I) in mJ/mm³ = MPa, zero at I0; same shape as `I`."""
        inside, beyond = self._split(I - I0)
        stiffness, stress, energy = self._curves
        later = (stress(self.I6[-1]) + 0.5 * stiffness(self.I6[-1]) * beyond) * beyond
        return energy(inside) + later

    def stress(self, I: FloatArray, I0: float = 0.0) -> FloatArray:
        """dW/dI in MPa, with the sign of I - I0; same shape as `I`."""
        inside, beyond = self._split(I - I0)
        stiffness, stress, _ = self._curves
        return np.sign(I - I0) * (stress(inside) + stiffness(self.I6[-1]) * beyond)

    def stiffness(self, I: FloatArray, I0: float = 0.0) -> FloatArray:
        """d²W/dI² in MPa, positive everywhere; same shape as `I`."""
        inside, _ = self._split(I - I0)
        return self._curves[0](inside)[()]

    def _split(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """|x| up to the end of the table, and what lies beyond."""
        inside = np.minimum(np.abs(x), self.I6[-1])
        return inside, np.abs(x) - inside

    @cached_property
    def _curves(self) -> tuple[Any, Any, Any]:
        """Stiffness, stress and energy within the table: piecewise polynomials."""
        from scipy.interpolate import BPoly

        h, D = np.diff(self.I6), np.diff(self.S12) / np.diff(self.I6)
        end = D[-1] + (D[-1] - D[-2]) * h[-1] / (h[-1] + h[-2])
        m = np.concatenate([D[:1], _parabola(h, D), [np.clip(end, D[-1] / 4, 5 * D[-1] / 4)]])
        allowed = np.minimum(2.5 * D / (m[:-1] + m[1:]), 1.0)
        m *= np.minimum(np.append(allowed, 1.0), np.append(1.0, allowed))
        q = np.maximum(5 * D - 2 * m[:-1] - 2 * m[1:], 0.0)
        s = np.zeros_like(m)
        s[1:-1] = np.clip(
            _parabola(h, np.diff(m) / h),
            -np.minimum(4 * m[1:-1] / h[1:], 2 * q[:-1] / h[:-1]),
            np.minimum(4 * m[1:-1] / h[:-1], 2 * q[1:] / h[1:]),
        )
        left, right = s[:-1] * h / 4, s[1:] * h / 4
        middle = np.maximum(q - left + right, 0.0)  # round-off
        stiffness = BPoly([m[:-1], m[:-1] + left, middle, m[1:] - right, m[1:]], self.I6)
        stress = stiffness.antiderivative()
        return stiffness, stress, stress.antiderivative()


@dataclass(frozen=True)
class MomentCurve:
    """Moment over curvature of fibres that slide in a bent fabric, so that it softens.

    Odd, smooth and increasing, as `TabulatedLaw`; beyond its last point a straight line.

    Parameters
    ----------
    curvature : (n,) sequence
        1/mm, strictly increasing, n >= 3 beside the origin.
    moment : (n,) sequence
        Per width, N, strictly increasing.

    Raises
    ------
    InputError
        For a curve that is too short or not increasing; the message names the entry.
    """

    curvature: tuple[float, ...]
    moment: tuple[float, ...]

    def __post_init__(self) -> None:
        try:
            law = self.law
        except InputError as error:
            words = str(error).replace("I6", "curvature").replace("S12", "moment")
            raise InputError(words) from error
        object.__setattr__(self, "curvature", law.I6)
        object.__setattr__(self, "moment", law.S12)

    @cached_property
    def law(self) -> TabulatedLaw:
        """The same curve: its `stress` is the moment, N, its `stiffness` the slope, N mm."""
        return TabulatedLaw(self.curvature, self.moment)

    @property
    def initial(self) -> float:
        """Bending stiffness of the flat fabric, N mm."""
        return float(self.law.stiffness(0.0))


@dataclass(frozen=True)
class Slip:
    """How rovings slip over those of the other family (`energy.slip`).

    Parameters
    ----------
    resistance : float
        τ against sliding per area of fabric, MPa; `inf`: they slip elastically only.
    stiffness : float
        K of stitches and crossings before they slide, N/mm³.
    pitch : float
        w of the rovings, mm: neighbours are coupled by G = K w²/4.

    Raises
    ------
    InputError
        If a number is out of range; the message names it.
    """

    resistance: float
    stiffness: float
    pitch: float

    def __post_init__(self) -> None:
        if self.resistance != np.inf:
            check_number("resistance", self.resistance, zero_allowed=True)
        for name in ("stiffness", "pitch"):
            check_number(name, getattr(self, name))

    @property
    def coupling(self) -> float:
        """G, N/mm."""
        return self.stiffness * self.pitch**2 / 4


def _parabola(h: FloatArray, D: FloatArray) -> FloatArray:
    """(n - 1,) slopes at the inner knots of parabolas, from (n,) widths h and secants D."""
    return (h[1:] * D[:-1] + h[:-1] * D[1:]) / (h[1:] + h[:-1])


def _increasing(name: str, values: Any) -> tuple[float, ...]:
    """Return a sequence as a tuple of numbers, none negative, strictly increasing."""
    listed = not isinstance(values, str | Mapping) and np.iterable(values)
    if not listed or not len(numbers := list(values)):
        got = "none" if listed else repr(values)
        raise InputError(f"{name} must be a list of numbers, got {got}")
    for i, value in enumerate(numbers):
        numbers[i] = float(check_number(f"{name}[{i}]", value, zero_allowed=True))
        if i and numbers[i] <= numbers[i - 1]:
            before = f"{name}[{i - 1}] = {numbers[i - 1]!r}"
            raise InputError(f"{name}[{i}] must be greater than {before}, got {numbers[i]!r}")
    return tuple(numbers)


_TENSION = ThreeStageLaw(C_ini=1000.0)
_POSITIVE = ("thickness", "compaction", "shear_range")
_MAY_BE_ZERO = ("bending_warp", "bending_weft", "friction", "areal_weight", "in_plane_bending")
_MOMENTS = ("moment_warp", "moment_weft")
_MD600 = {"C_ini": 0.334, "S_ini": 0.00386, "C_mid": 0.00196, "dS_mid": 0.0399}
PRESETS = {
    "locking": {"C_lo": 1000.0, "I_lo": 0.819},
    "best-fit": {"C_lo": 0.911, "I_lo": 0.610},
}


@dataclass(frozen=True)
class Fabric:
    """A dry biaxial fabric. Defaults are the MD600 of Schäfer et al. (Table 1 and text).

    Parameters
    ----------
    name : str
        It appears in results and pictures.
    shear : ThreeStageLaw or TabulatedLaw
        W6 as a function of I6, MPa.
    warp, weft : ThreeStageLaw
        W4 and W8 as functions of I4 and I8, MPa. With C_ini = 1000 the fibre modulus is 4000 MPa.
    thickness : float
        t0, mm. All moduli are per reference volume and are multiplied by it.
    bending_warp, bending_weft : float
        B11 and B22, N mm (mJ mm/mm² of curvature squared, per width).
    moment_warp, moment_weft : MomentCurve or None
        Measured moment over curvature where the bending is not linear (`energy.softening`);
        `bending_warp` or `bending_weft` is then its slope at zero, of the flat fabric.
    friction : float
        Coulomb coefficient between fabric and tools (stated by the paper).
    areal_weight : float
        g/m²; 2 × about 300 for MD600.
    compaction : float
        Stiffness of the fabric against through-thickness compaction by a tool, N/mm³ (*assumed*).
    in_plane_bending : float
        r, the fraction of the bending stiffness that also resists in-plane curvature of the
        fibres (*assumed*). Rovings whose fibres slide freely have about 0.13 N mm, 0.03 to 0.04 of
        B11 and B22. More than 0.03 contradicts the off-axis tension tests behind the law.
    shear_range : float
        Shear angle up to which the shear law follows the tests, degrees (MD600: about 57, stated).
    slip : Slip or None
        How rovings slip; without it they do not.
    provenance : mapping of str to str, int, float or bool
        Where the numbers come from; it travels with them and has no effect. An entry named like a
        parameter ("slip.stiffness") is about that one, and `save` writes it beside it.

    Raises
    ------
    InputError
        If a number is out of range; the message names it.
    """

    name: str = "MD600 locking"
    shear: ThreeStageLaw | TabulatedLaw = ThreeStageLaw(**_MD600, **PRESETS["locking"])
    warp: ThreeStageLaw = _TENSION
    weft: ThreeStageLaw = _TENSION
    thickness: float = 1.004
    bending_warp: float = 3.403
    bending_weft: float = 3.863
    friction: float = 0.157
    areal_weight: float = 600.0
    compaction: float = 10.0
    in_plane_bending: float = 0.03
    shear_range: float = 57.0
    moment_warp: MomentCurve | None = None
    moment_weft: MomentCurve | None = None
    slip: Slip | None = None
    provenance: Mapping[str, str | float] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise InputError(f"Fabric(name=...) must be a text, got {self.name!r}")
        three = (ThreeStageLaw,)
        for name, kinds in (("shear", (*three, TabulatedLaw)), ("warp", three), ("weft", three)):
            if not isinstance(law := getattr(self, name), kinds):
                words = f"a {' or a '.join(kind.__name__ for kind in kinds)}"
                raise InputError(f"Fabric({name}=...) must be {words}, got {type(law).__name__}")
        for name in _MOMENTS:
            if not isinstance(curve := getattr(self, name), MomentCurve | None):
                words = f"must be a MomentCurve, got {type(curve).__name__}"
                raise InputError(f"Fabric({name}=...) {words}")
        if not isinstance(self.slip, Slip | None):
            raise InputError(f"Fabric(slip=...) must be a Slip, got {type(self.slip).__name__}")
        for name in (*_POSITIVE, *_MAY_BE_ZERO):
            zero_allowed = name in _MAY_BE_ZERO
            check_number(f"Fabric({name}=...)", getattr(self, name), zero_allowed=zero_allowed)
        if self.in_plane_bending > 1:
            raise InputError(f"in_plane_bending must not exceed 1, got {self.in_plane_bending}")
        object.__setattr__(self, "provenance", _provenance(self.provenance))

    @staticmethod
    def preset(name: str) -> Fabric:
        """MD600 with the 'best-fit' or the 'locking' shear law of Table 1, by this name."""
        if name not in PRESETS:
            raise InputError(f"unknown law '{name}': {suggestion(name, PRESETS)} (or a .toml file)")
        return Fabric(f"MD600 {name}", ThreeStageLaw(**_MD600, **PRESETS[name]))

    @staticmethod
    def load(path: str | Path) -> Fabric:
        """Read a fabric from a TOML file at `path` as written by `save`; a key may be left out."""
        return read_toml(path, lambda table: _fabric({"name": Path(path).stem, **table}))

    def save(self, path: str | Path) -> None:
        """Write the fabric as TOML (MPa, mm, N mm, g/m²), with what provenance says of a value."""
        table = self.written()
        if not self.provenance:
            del table["provenance"]
        origins = {key: value for key, value in self.provenance.items() if isinstance(value, str)}
        Path(path).write_text(toml_text(table, origins), encoding="utf-8")

    def written(self) -> dict[str, Any]:
        """Return the fabric as plain numbers and texts, for a recipe."""
        table = {key: value for key, value in asdict(self).items() if value is not None}
        for law in ("shear", "warp", "weft"):
            table[law] = {k: v for k, v in table[law].items() if v is not None}
        return table

    @staticmethod
    def read(written: Mapping[str, Any]) -> Fabric:
        """Return the fabric of a table that was `written`."""
        return _fabric(dict(written))


def fabric_of(law: str | Path | Fabric) -> Fabric:
    """Return a `Fabric`: itself, a preset by name, or read from a TOML file."""
    if isinstance(law, Fabric):
        return law
    if str(law).endswith(".toml"):
        return Fabric.load(law)
    return Fabric.preset(str(law))


def _fabric(table: dict[str, Any]) -> Fabric:
    stages, points = ([f.name for f in fields(law)] for law in (ThreeStageLaw, TabulatedLaw))
    for key in [key for key in table if key in ("shear", "warp", "weft")]:
        numbers, kind = table[key], ThreeStageLaw
        given = numbers if key == "shear" and isinstance(numbers, Mapping) else ()
        if point := next((name for name in given if name in points), None):
            kind = TabulatedLaw
            if mixed := [stage for stage in stages if stage in given]:
                words = f"{point} is of a table, {mixed[0]} of a three-stage law"
                raise InputError(f"[{key}] {words}: give one of the two")
        table[key] = _checked(kind, numbers, key)
    for key in set(_MOMENTS) & table.keys():
        table[key] = _checked(MomentCurve, table[key], key)
    if "slip" in table:
        table["slip"] = _checked(Slip, table["slip"], "slip")
    return _checked(Fabric, table)


def _checked(kind: type[T], table: Any, where: str = "") -> T:
    """Return the table of a file, called `where`, as a dataclass that checks its own values."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where} = {table!r}: expected a table [{where}]")
    known = {f.name: f.default is f.default_factory for f in fields(kind)}  # has it no default?
    try:
        check_keys(table, known)
        for name in known:
            if known[name] and name not in table:
                raise InputError(f"{name} missing")
        return kind(**table)
    except InputError as error:
        raise InputError(f"[{where}] {error}" if where else str(error)) from error


def _provenance(given: Any) -> dict[str, str | float]:
    """Return a copy of plain texts, numbers and truth values; refuse anything else."""
    if not isinstance(given, Mapping):
        raise InputError(f"provenance must be a table of texts and numbers, got {given!r}")
    kinds = ((str, str), (bool | np.bool_, bool), (Integral, int), (Real, float))
    plain: dict[str, str | float] = {}
    for key, value in given.items():
        if not isinstance(key, str):
            raise InputError(f"a key of provenance must be a text, got {key!r}")
        kind = next((kind for known, kind in kinds if isinstance(value, known)), None)
        if kind is None or (kind is float and not np.isfinite(value)):
            expected = "a text, a finite number or true or false"
            raise InputError(f"provenance '{key}' must be {expected}, got {value!r}")
        plain[key] = kind(value)
    return plain
