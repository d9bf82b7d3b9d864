"""Specimens: the shear angles that a test has at the same time, and their shares in the force.

With inextensible fibres the power balance of a test reads

    force = Σ_k share_k S12(sin γ_k),    share_k = t0 A_k cos γ_k dγ_k/du

over its zones k, linear in the unknown S12. At 45° a full zone has γ and half ones γ/2: solved for
S12(γ), this is Eq. 10 of Schäfer et al. with the coefficient of S12(γ/2) that conserves energy
(`theory.OffAxisTension`); the printed one is half of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..checks import InputError, check_number
from ..theory import OffAxisTension
from .records import Curve

FloatArray = np.ndarray
Shares = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class OffAxis:
    """Off-axis tension test of a strip (bias extension at 45°).

    InputError if a size is not positive or a fibre joins both grips.
    """

    length: float = 320.0  # l0 between the grips, mm
    width: float = 160.0  # w0, mm
    angle: float = 45.0  # Θ0 between load and warp, degrees

    def __post_init__(self) -> None:
        for name in ("length", "width", "angle"):
            check_number(name, getattr(self, name))
        try:
            _ = self.net
        except ValueError as error:
            raise InputError(str(error)) from error

    @cached_property
    def net(self) -> OffAxisTension:
        """The strip with inextensible fibres."""
        return OffAxisTension(self.length, self.width, np.radians(self.angle))

    def described(self, curve: Curve) -> str:
        """The specimen as text; empty where its sizes are not needed."""
        return f"strip of {self.length:g} x {self.width:g} mm at {self.angle:g} degrees"

    def angle_of(self, curve: Curve) -> FloatArray:
        """(n,) kinematic shear angle of the rows, radians, 90 degrees where the net has collapsed.

        Without a displacement the angle of the file.
        """
        if curve.displacement is None:
            return _angle(curve)
        u, (D, _) = curve.displacement, self.net.chord
        I6 = u * (2 * D + u) / (2 * self.net.alpha * self.net.beta)
        return np.arcsin(np.minimum(I6, 1.0))

    def displacement(self, curve: Curve) -> FloatArray:
        """(n,) grip displacement of the rows, mm: the measured one, or that of a measured angle."""
        if curve.displacement is None:
            I6, (D, _) = np.sin(_angle(curve)), self.net.chord
            return np.sqrt(D**2 + 2 * self.net.alpha * self.net.beta * I6) - D
        if curve.shear_angle is not None:
            _angle(curve)  # a check, but no impossible one
        end = "at {:.4g} mm the net of inextensible fibres has collapsed: cut the record (--to), "
        return _within(curve, self.net.displacement_limit, end + "or check length and width")

    def shares(self, curve: Curve, thickness: float, as_printed: bool = False) -> Shares:
        """Shares of the zones in the force, (3, n) in mm², and their angles, (3, n) in radians.

        The angles follow the displacement. One that was measured at the centre is no mean of its
        zone, and its rate is not that of the fibres: it is a check only (`campaign`). With
        `as_printed` the half zones count for half, as in the paper's Eq. 10.
        """
        u = self.displacement(curve)
        angles, rates = self.net.angles(u), self.net.angle_rates(u)
        areas = self.net.zone_areas[:3] * ([1.0, 0.5, 0.5] if as_printed else 1.0)
        return thickness * areas[:, None] * np.cos(angles) * rates, angles


@dataclass(frozen=True)
class PictureFrame:
    """Picture frame, pulled along its diagonal."""

    side: float = 100.0  # L of the frame between its hinges, mm
    fabric_side: float | None = None  # of the sheared fabric, mm, where it is smaller
    amplification: float | None = None  # displacement of the corner over that of the machine

    def __post_init__(self) -> None:
        check_number("side", self.side)
        if self.amplification is not None:
            check_number("amplification", self.amplification)
        if self.fabric_side is not None:
            check_number("fabric_side", self.fabric_side)
            if self.fabric_side > self.side:
                words = f"fabric_side must not exceed the side of the frame, {self.side:g} mm"
                raise InputError(f"{words}, got {self.fabric_side:g}")

    def described(self, curve: Curve) -> str:
        """The specimen as text; empty where its sizes are not needed."""
        if curve.per_length and curve.shear_angle is not None:
            return ""
        linkage = f", linkage of factor {self.amplification:g}" if self.amplification else ""
        if self.fabric_side:
            return f"frame of {self.side:g} mm sides, fabric of {self.fabric_side:g} mm{linkage}"
        assumed = "filled by the fabric (if not, S12 is (side/fabric_side)² times: --fabric-side)"
        return f"frame of {self.side:g} mm sides{linkage}, {assumed}"

    def angle_of(self, curve: Curve) -> FloatArray:
        """(n,) shear angle of the rows, radians: measured, or that of the hinged frame."""
        return self._hinged(curve) if curve.shear_angle is None else _angle(curve)

    def _hinged(self, curve: Curve) -> FloatArray:
        """(n,) shear angle of the frame, radians, 90 degrees where it is closed."""
        u = (self.amplification or 1.0) * curve.displacement
        return np.pi / 2 - 2.0 * np.arccos(np.minimum(np.sqrt(0.5) + u / (2.0 * self.side), 1.0))

    def shares(self, curve: Curve, thickness: float, as_printed: bool = False) -> Shares:
        """Share of the only zone in the force, (1, n) in mm², and its angle, (1, n) in radians.

        A force per length of fabric is F_sh = t0 S12 itself. Else the power balance has the rate of
        the angle that is used: a measured one turns as fast as the frame times dγ/dγ_frame, from a
        cubic of the one over the other.
        """
        gamma, fabric, factor = self.angle_of(curve), self.fabric_side or self.side, 1.0
        if curve.per_length:
            return np.full((1, len(gamma)), thickness), gamma[None]
        if curve.displacement is not None:
            end = "the frame closes at {:.4g} mm: check its side, or cut the record (--to)"
            factor = self.amplification or 1.0
            _within(curve, (2 - np.sqrt(2.0)) * self.side / factor, end)
            frame, powers = self._hinged(curve), np.arange(1, 4)
            fit = np.linalg.lstsq(frame[:, None] ** powers, gamma, rcond=None)[0]
            factor *= (powers * frame[:, None] ** (powers - 1)) @ fit * np.cos(gamma)
            share = thickness * fabric**2 / self.side * factor / np.sin(np.pi / 4 - frame / 2)
            return share[None], gamma[None]
        share = 2.0 * thickness * fabric**2 / self.side * np.cos(np.pi / 4 - gamma / 2)
        return share[None], gamma[None]


Specimen = OffAxis | PictureFrame


def _within(curve: Curve, limit: float, why: str) -> FloatArray:
    """The displacement of the rows, mm; InputError beyond the limit of the fibres."""
    if (reached := curve.displacement.max()) >= limit:
        words = f"the displacement reaches {reached:.4g} mm, but {why.format(limit)}"
        raise InputError(words)
    return curve.displacement


def _angle(curve: Curve) -> FloatArray:
    """The measured shear angles, radians; InputError where they are impossible."""
    if (largest := np.abs(curve.shear_angle).max()) >= np.pi / 2:
        words = f"the shear angle reaches {np.degrees(largest):.4g} degrees"
        raise InputError(f"{words}, beyond the limit of 90: check its unit")
    return curve.shear_angle
