"""Membrane energy of an elastic diaphragm: neo-Hookean, in plane stress.

With the right Cauchy-Green tensor C of the mean surface, D = det C and q = ν/(1 - ν)

    E = Σ t0 A W,   W = μ/2 [tr C - 2 + (D⁻q - 1)/q],   μ = E/(2 (1 + ν)).

This is the law of Blatz and Ko [1]_ (their f = 1), W3 = μ/2 [tr C3 - 3 + (J⁻²β - 1)/β] with
β = ν/(1 - 2 ν), at the thickness that makes the normal stress zero, C33 = D⁻q. At ν = 1/2 it is the
incompressible neo-Hookean law [2]_, C33 = 1/D. A diaphragm with a prestretch λ is larger by λ when
the run begins than without stress; `thickness` is that without stress.

References
----------
.. [1] P. J. Blatz, W. L. Ko, Trans. Soc. Rheol. 6 (1962) 223-251.
.. [2] L. R. G. Treloar, Trans. Faraday Soc. 39 (1943) 241-246.
"""

from __future__ import annotations

import numpy as np

from ..unknowns import FloatArray, Sheet
from .membrane import Membrane, cross, dot, nodal_stiffness
from .term import Term


class Diaphragm(Membrane):
    """Neo-Hookean membrane of a sheet in space: modulus E, MPa, Poisson's ratio, prestretch."""

    foresees = False
    add_hessian = Term.add_hessian

    def __init__(
        self, sheet: Sheet, modulus: float, poisson: float = 0.5, prestretch: float = 1.0
    ) -> None:
        super().__init__(sheet)
        self.mu, self.q = 0.5 * modulus / (1.0 + poisson), poisson / (1.0 - poisson)
        self._g = prestretch * self._g
        self.g = self._g.transpose(2, 0, 1)
        self.volume = self.volume / prestretch**2

    def _evaluate(self, x: FloatArray) -> tuple[FloatArray, ...]:
        f = self._fibre_vectors(x)
        I4, I6, I8 = dot(f[0], f[0]), dot(f[0], f[1]), dot(f[1], f[1])
        D = dot(*[cross(*f)] * 2)
        power = D ** (-self.q)
        W = 0.5 * self.mu * (I4 + I8 - 2.0 + (power - 1.0) / self.q)
        part = power / D
        S = self.mu * np.array([[1.0 - part * I8, part * I6], [part * I6, 1.0 - part * I4]])
        return f, I4, I6, I8, W, S, D

    def thickness(self, x: FloatArray) -> FloatArray:
        """(n_triangles,) thickness of the stretched diaphragm, mm."""
        return self.fabric.thickness * self._at(x)[6] ** (-0.5 * self.q)

    def turned_over(self, x: FloatArray, trial: FloatArray) -> bool:
        return bool(((self.normals(x) * self.normals(trial)).sum(1) <= 0).any())

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        """With `convex` without the negative eigenvalues of the second derivative by a and b."""
        (a, b), I4, I6, I8, _, _, D = self._at(x)
        first, second = -(D ** (-self.q - 1.0)), (self.q + 1.0) * D ** (-self.q - 2.0)
        slopes = 2.0 * np.array([I8 * a - I6 * b, I4 * b - I6 * a])  # of D by a and b
        eye = np.eye(3)[:, :, None]
        K = second * slopes[:, None, :, None] * slopes[None, :, None]
        K[0, 0] += 2.0 * first * (I8 * eye - b[:, None] * b)
        K[1, 1] += 2.0 * first * (I4 * eye - a[:, None] * a)
        mixed = 2.0 * first * (2.0 * a[:, None] * b - b[:, None] * a - I6 * eye)
        K[0, 1] += mixed
        K[1, 0] += mixed.swapaxes(0, 1)
        for p in range(2):
            K[p, p] += 2.0 * eye
        K *= 0.5 * self.mu * self.volume
        if convex:
            values, modes = np.linalg.eigh(K.transpose(4, 0, 2, 1, 3).reshape(-1, 6, 6))
            K = (modes * np.maximum(values, 0.0)[:, None]) @ modes.swapaxes(1, 2)
            K = K.reshape(-1, 2, 3, 2, 3).transpose(1, 3, 2, 4, 0)
        return nodal_stiffness(self._g, K)
