"""A tool of your own: a ring pressed into the sheet, as a signed distance in closed form.

A shape answers with the distance d of points from its surface, the gradient n of d and its second
derivative H, in its own frame. For a ring of radius R and section r around the z axis, with the
distance ρ of a point from that axis, q = √((ρ - R)² + z²) from the middle line of the ring and the
angle φ of the way there over the horizontal,

    d = q - r,   n = cos φ e_ρ + sin φ e_z,   H = m m'/q + (cos φ/ρ) t t'

where m is across n in the meridian plane and t goes around. For a surface from a file nothing has
to be written: `file = "punch.stl"` in a scene does it.
"""

from dataclasses import dataclass, replace

import numpy as np

import quasiform as qf
from quasiform.scenes import scene_file


@dataclass(frozen=True)
class Ring:
    """A ring around the z axis whose lowest points lie in z = 0; mm."""

    radius: float
    section: float

    @property
    def sharpest(self):
        """Smallest radius of curvature: shows whether the mesh resolves the tool."""
        return self.section

    def distance(self, points):
        """Distance (m,), its gradient (m, 3) and second derivative (m, 3, 3) at points (m, 3)."""
        x, y, z = points.T
        z = z - self.section
        rho = np.maximum(np.hypot(x, y), 1e-9)
        q = np.maximum(np.hypot(rho - self.radius, z), 1e-9)
        cos, sin, zero = (rho - self.radius) / q, z / q, np.zeros_like(z)
        outward = np.column_stack([x / rho, y / rho, zero])
        around = np.column_stack([-y / rho, x / rho, zero])
        up = np.array([0.0, 0.0, 1.0])
        n = cos[:, None] * outward + sin[:, None] * up
        m = cos[:, None] * up - sin[:, None] * outward
        H = np.einsum("i,ij,ik->ijk", 1 / q, m, m)
        return q - self.section, n, H + np.einsum("i,ij,ik->ijk", cos / rho, around, around)


# the built-in scene with another punch; everything else of the file stays
file = scene_file.load("hemisphere")
tools = tuple(
    replace(part, geometry=Ring(radius=40.0, section=15.0)) if part.role == "punch" else part
    for part in file.tools
)
model = qf.forming(replace(file, name="ring", tools=tools), size=20, travel=15)
result = qf.solve(model, estimate=False)

print(f"{result.status}: {result.force:.1f} N, shear to {np.abs(result.shear_angle).max():.1f} deg")
