"""Identification: from test data to a fabric (Schäfer et al., Sect. 2.3).

records    files of a lab -> curves
specimen   curves -> shares of the zones in the force (power balance)
energy_method, fit, inverse    forces -> S12 as a spline, six parameters, the same by elements
cantilever                     overhangs, tips and profiles -> bending stiffness
campaign, identified           a file of tests -> a fabric with its provenance
"""

from .identified import Identification, identify

__all__ = ["Identification", "identify"]
