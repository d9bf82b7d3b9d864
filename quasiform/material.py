"""The fabric: shear and tension laws of a 0°/90° biaxial non-crimp fabric.

Strain energy W(C) = W4(I4) + W6(I6) + W8(I8) per reference volume (Schäfer et al., Eqs. 7-8) with

    I4 = a0·C·a0,  I6 = a0·C·b0,  I8 = b0·C·b0                       (Eqs. 1-3)

in the warp direction a0 and the weft direction b0. Each W_i follows the three-stage law of Eq. 9.
Two corrections to the printed equations: the shear angle needs the root, γ = arcsin(I6/√(I4 I8)),
and the derivative of Eq. 9 carries the sign of I - I0 (W is even, so dW/dI is odd).

Everything here works on plain arrays; no mesh is needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from .checks import InputError, check_keys, check_number, read_toml, suggestion

FloatArray = np.ndarray


def invariants(F: FloatArray, a0: FloatArray, b0: FloatArray) -> tuple[FloatArray, ...]:
    """Invariants I4, I6, I8 of the deformation gradient (Eqs. 1-3).

    Parameters
    ----------
    F : (..., m, 2) or (..., m, 3) array
        Deformation gradient, dimensionless.
    a0, b0 : (2,) or (3,) arrays
        Warp and weft unit vectors of the flat fabric.

    Returns
    -------
    I4, I6, I8 : (...) arrays, dimensionless

    Examples
    --------
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
        later = ("S_ini", "C_mid", "dS_mid", "C_lo", "I_lo")
        missing = [name for name in later if getattr(self, name) is None]
        if missing and len(missing) < len(later):
            raise InputError(
                f"a three-stage law needs all of {', '.join(later)}: {', '.join(missing)} missing"
            )
        for f in fields(self):
            value = getattr(self, f.name)
            if value is not None:
                check_number(f.name, value, zero_allowed=f.name in ("C_mid", "C_lo"))
        if not missing and self.I_lo <= self.S_ini / self.C_ini:
            raise InputError(
                f"I_lo must lie beyond S_ini/C_ini = {self.S_ini / self.C_ini:.4g}, got {self.I_lo}"
            )

    @property
    def linear(self) -> bool:
        """Whether the law has its first stage only."""
        return self.S_ini is None

    def energy(self, I: FloatArray, I0: float = 0.0) -> FloatArray:
        """W(I) in mJ/mm³ = MPa, zero at I0; same shape as `I`."""
        x = np.abs(I - I0)
        if self.linear:
            return 0.5 * self.C_ini * x**2
        It, c, y, z = self._stages(x)
        E = -np.expm1(-c * y)  # 1 - exp(-c y)
        plateau = self.S_ini * y + 0.5 * self.C_mid * y**2 + self.dS_mid * (y - E / c)
        # ∫ C_mid y exp(-c y) dy, subtracted
        plateau -= self.C_mid * (E / c**2 - y * (1.0 - E) / c)
        return 0.5 * self.C_ini * np.minimum(x, It) ** 2 + plateau + self.C_lo * z**3 / 3.0

    def stress(self, I: FloatArray, I0: float = 0.0) -> FloatArray:
        """dW/dI in MPa (Eq. 9, with the sign of I - I0); same shape as `I`."""
        x = np.abs(I - I0)
        if self.linear:
            return self.C_ini * (I - I0)
        It, c, y, z = self._stages(x)
        value = self.C_ini * np.minimum(x, It)
        value = value - (self.C_mid * y + self.dS_mid) * np.expm1(-c * y) + self.C_lo * z**2
        return np.sign(I - I0) * value

    def stiffness(self, I: FloatArray, I0: float = 0.0) -> FloatArray:
        """d²W/dI² in MPa, positive everywhere; same shape as `I`."""
        x = np.abs(I - I0)
        if self.linear:
            return np.full_like(x, self.C_ini)
        It, c, y, z = self._stages(x)
        E = np.exp(-c * y)
        later = (
            self.C_mid * (1.0 - E) + (self.C_mid * y + self.dS_mid) * c * E + 2.0 * self.C_lo * z
        )
        return np.where(x < It, self.C_ini, later)

    def _stages(self, x: FloatArray) -> tuple[float, float, FloatArray, FloatArray]:
        It = self.S_ini / self.C_ini
        return It, self.C_ini / self.dS_mid, np.maximum(x - It, 0.0), np.maximum(x - self.I_lo, 0.0)


_TENSION = ThreeStageLaw(C_ini=1000.0)
_MD600_SHEAR = {"C_ini": 0.334, "S_ini": 0.00386, "C_mid": 0.00196, "dS_mid": 0.0399}


@dataclass(frozen=True)
class Fabric:
    """A dry biaxial fabric. Defaults are the MD600 of Schäfer et al. (Table 1 and text).

    Parameters
    ----------
    name : str
    shear : ThreeStageLaw
        W6 as a function of I6, MPa.
    warp, weft : ThreeStageLaw
        W4 and W8 as functions of I4 and I8, MPa. With C_ini = 1000 the fibre modulus is 4000 MPa.
    thickness : float
        t0, mm. All moduli are per reference volume and are multiplied by it.
    bending_warp, bending_weft : float
        B11 and B22, N mm (mJ mm/mm² of curvature squared, per width).
    friction : float
        Coulomb coefficient between fabric and tools (stated by the paper).
    areal_weight : float
        g/m²; 2 × about 300 for MD600.
    compaction : float
        Stiffness of the fabric against through-thickness compaction by a tool, N/mm³ (*assumed*).
    in_plane_bending : float
        Fraction of the bending stiffness that also resists in-plane curvature of the fibres
        (*assumed*). A bundle of round fibres that slide freely bends alike in every direction: 1.
        The paper's model has none; with little of it (0.01) the softening of the shear law gathers
        the shear at 45° in bands one element wide, and the peak depends on mesh and increments.
    shear_range : float
        Shear angle up to which the shear law follows the tests, degrees (MD600: about 57, stated).

    Raises
    ------
    InputError
        If a number is out of range; the message names it.
    """

    name: str = "MD600 locking"
    shear: ThreeStageLaw = field(
        default_factory=lambda: ThreeStageLaw(**_MD600_SHEAR, C_lo=1000.0, I_lo=0.819)
    )
    warp: ThreeStageLaw = _TENSION
    weft: ThreeStageLaw = _TENSION
    thickness: float = 1.004
    bending_warp: float = 3.403
    bending_weft: float = 3.863
    friction: float = 0.157
    areal_weight: float = 600.0
    compaction: float = 40.0
    in_plane_bending: float = 1.0
    shear_range: float = 57.0

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise InputError(f"Fabric(name=...) must be a text, got {self.name!r}")
        if (
            check_number("Fabric(in_plane_bending=...)", self.in_plane_bending, zero_allowed=True)
            > 1
        ):
            raise InputError(f"in_plane_bending must not exceed 1, got {self.in_plane_bending}")
        for name in ("thickness", "compaction", "shear_range"):
            check_number(f"Fabric({name}=...)", getattr(self, name))
        for name in (
            "bending_warp",
            "bending_weft",
            "friction",
            "areal_weight",
            "in_plane_bending",
        ):
            check_number(f"Fabric({name}=...)", getattr(self, name), zero_allowed=True)

    @staticmethod
    def preset(name: str) -> Fabric:
        """MD600 with the 'best-fit' or the 'locking' shear law of Table 1.

        Raises
        ------
        InputError
            For any other name.
        """
        if name == "locking":
            return Fabric()
        if name == "best-fit":
            shear = ThreeStageLaw(**_MD600_SHEAR, C_lo=0.911, I_lo=0.610)
            return Fabric(name="MD600 best-fit", shear=shear)
        raise InputError(f"unknown law '{name}': {suggestion(name, PRESETS)}, or a .toml file")

    @staticmethod
    def load(path: str | Path) -> Fabric:
        """Read a fabric from a TOML file as written by `save`.

        What is left out keeps its default, but the name, which is then that of the file.

        Raises
        ------
        InputError
            For unreadable files, unknown keys and bad values; one line naming file and key.
        """
        return read_toml(path, lambda table: _fabric({"name": Path(path).stem, **table}))

    def save(self, path: str | Path) -> None:
        """Write the fabric as TOML (MPa, mm, N mm, g/m²)."""
        lines, tables = [], []
        for key, value in asdict(self).items():
            if isinstance(value, dict):
                tables.append(f"\n[{key}]")
                tables += [f"{k} = {float(v)!r}" for k, v in value.items() if v is not None]
            elif isinstance(value, str):
                escaped = value.replace("\\", "\\\\").replace('"', '\\"')
                lines.append(f'{key} = "{escaped}"')
            else:
                lines.append(f"{key} = {float(value)!r}")
        Path(path).write_text("\n".join(lines + tables) + "\n", encoding="utf-8")


PRESETS = ("locking", "best-fit")


def fabric_of(law: str | Path | Fabric) -> Fabric:
    """Return a `Fabric`: itself, a preset by name, or read from a TOML file.

    Raises
    ------
    InputError
    """
    if isinstance(law, Fabric):
        return law
    if str(law).endswith(".toml"):
        return Fabric.load(law)
    return Fabric.preset(str(law))


def _fabric(table: Mapping[str, Any]) -> Fabric:
    arguments: dict[str, Any] = {}
    check_keys(table, [f.name for f in fields(Fabric)])
    for key, value in table.items():
        if key in ("shear", "warp", "weft"):
            if not isinstance(value, Mapping):
                raise InputError(f"{key} = {value!r}: expected a table [{key}]")
            check_keys(value, [f.name for f in fields(ThreeStageLaw)], key)
            if "C_ini" not in value:
                raise InputError(f"[{key}]: C_ini missing")
            try:
                arguments[key] = ThreeStageLaw(**value)
            except InputError as error:
                raise InputError(f"[{key}] {error}") from error
        else:
            arguments[key] = value
    return Fabric(**arguments)
