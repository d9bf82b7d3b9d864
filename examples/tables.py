"""Results as tables: pandas DataFrames of the history, of a field, and of several runs.

`result.history` and the scalar fields are dicts of numpy arrays by name, which pandas takes as they
are. quasiform itself does not need pandas.
"""

import numpy as np
import pandas as pd

import quasiform as qf

runs = {
    law: qf.solve(qf.off_axis_tension(law=law, displacement=55, size=20), estimate=False)
    for law in ("best-fit", "locking")
}

# one row an increment, both runs side by side
history = pd.concat({law: pd.DataFrame(run.history) for law, run in runs.items()}, names=["law"])
forces = history.reset_index("law").pivot(index="displacement_mm", columns="law", values="force_N")
print(forces.round(2))

# one row a triangle: where it lies on the flat blank, its area, and the scalar fields
locking = runs["locking"]
flat = dict(zip(("X_mm", "Y_mm"), locking.blank.centroids.T, strict=True))
scalars = {name: values for name, values in locking.sheet.cell_fields.items() if values.ndim == 1}
triangles = pd.DataFrame(flat | {"area_mm2": locking.blank.areas} | scalars)
sheared = triangles[triangles["shear_angle"].abs() > 45]
print(f"{sheared['area_mm2'].sum() / triangles['area_mm2'].sum():.1%} is sheared beyond 45 degrees")

# one row a run
summary = pd.DataFrame(
    {
        law: {
            "force_N": run.force,
            "p99_deg": run.quantities["shear_angle_deg"],
            "largest_E11": np.abs(run.sheet.cell_fields["E11"]).max(),
            "certified": bool(run.certified),
        }
        for law, run in runs.items()
    }
).T
print(summary)
