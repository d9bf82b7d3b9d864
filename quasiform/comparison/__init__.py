"""A result beside another one, or beside another code's or a measured field.

    comparison = qf.compare("out/", "measured.csv", standing="measured", align="rigid")
    print(comparison.table())
    comparison.save("comparison/")

One file an idea: `sheet` (what is compared), `read`, `mesh_file` and `table` (from files), `place`
(unfolded, shifted and turned), `mapping` (a field at another mesh's points), `comparison` (the
differences and their bands), `picture`.
"""

from .comparison import FILES, Comparison, Row, compare
from .read import Reading

__all__ = ["FILES", "Comparison", "Reading", "Row", "compare"]
