"""What a campaign of tests on one fabric consists of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from ..checks import InputError, check_number, suggestion
from ..fabric import Fabric
from .cantilever import Stiffness
from .energy_method import Forces
from .fit import ALGORITHMS, check_kept
from .records import Curve, rows_of
from .specimen import OffAxis, PictureFrame, Specimen

METHODS = {
    "fit": "six parameters by the power balance (Eq. 10, energy-consistent)",
    "inverse": "six parameters, finite-element tests in the loop",
    "table": "table by the power balance (Eq. 10, energy-consistent)",
    "as-printed": "six parameters by Eq. 10 as printed, which does not conserve energy",
}
KINDS = {"off-axis": OffAxis, "picture-frame": PictureFrame}
SIZES = {"off-axis": ("length", "width", "angle"), "picture-frame": ("side", "fabric_side")}
VALUES = tuple(f.name for f in fields(Fabric) if f.name not in ("name", "provenance"))
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
