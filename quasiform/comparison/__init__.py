"""A result beside another one, or beside another code's or a measured field.

    comparison = qf.compare("out/", "measured.csv", standing="measured", align="rigid")
    print(comparison.table())
    comparison.save("comparison/")

One file an idea: `read` and `shells` (from files), `place` (unfolded, shifted and turned),
`mapping` (a field at another mesh's points), `differences` (rows with their bands), `comparison`,
`picture`.
"""

from .comparison import FILES, Comparison, compare
from .differences import Row
from .read import Reading

__all__ = ["FILES", "Comparison", "Reading", "Row", "compare"]
