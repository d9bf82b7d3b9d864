# %% [markdown]
# A notebook as a script: Jupyter (with Jupytext), VS Code and Spyder run it cell by cell.
# %%
"""Two fibre orientations of a forming test, side by side, as cells of a notebook."""

from tempfile import mkdtemp

import numpy as np
from matplotlib.figure import Figure

import quasiform as qf

# %% The model before it is solved: it says what is in it and what was left out, and why
model = qf.forming("hemisphere", orientation=0, size=20, travel=15)
for entry, why in model.description:
    print(f"{entry}: {why}")

# %% Solve. `callback=qf.progress` shows on stderr how far it has come
results = {
    angle: qf.solve(qf.forming("hemisphere", orientation=angle, size=20, travel=15), estimate=False)
    for angle in (0, 45)
}
print(results[45])

# %% Curves: a history is a dict of arrays
figure = Figure(figsize=(6, 3.5), layout="constrained")
axes = figure.subplots()
for angle, result in results.items():
    axes.plot(result.history["travel_mm"], result.history["force_N"], "o-", label=f"{angle}°")
axes.set(xlabel="travel, mm", ylabel="punch force, N")
axes.legend(title="warp to x")
figure  # noqa: B018  (a notebook shows the value of a cell's last line)

# %% Fields: arrays by triangle, on the formed or on the flat sheet
flat = results[45].blank.centroids
steepest = np.abs(results[45].shear_angle).argmax()
print(f"largest shear angle near X = {flat[steepest].round()} mm on the flat blank")

# %% Files and pictures for those who have no Python
folder = results[45].save(f"{mkdtemp()}/hemisphere-45")
print(sorted(path.name for path in folder.iterdir() if "increment" not in path.name))
