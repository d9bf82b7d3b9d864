"""A surrogate of forming runs: Gaussian processes fitted to a study, and how far they are off.

    pip install scikit-learn
    quasiform study examples/surrogate/hemisphere.toml --workers 2
    python examples/surrogate/fit.py hemisphere

Every fifth run is held out. Runs that were not completed, did not converge or are one of many
states are counted and left out. The error on the held-out runs stands beside the error of the data
themselves, that of the mesh: a surrogate that is nearer to the runs than these are to the truth is
good enough, and more runs on the same mesh would not help.
"""

import csv
import sys
from pathlib import Path

import numpy as np
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

HELD_OUT = 5  # every fifth run
ERRORS = {  # column of the error of the mesh, by output
    "force_N": "estimated_errors.force_N",
    "shear_angle_deg.p99": "estimated_errors.shear_angle_deg",
    "shear_angle_deg.mean": "estimated_errors.shear_angle_mean_deg",
    "draw_in_mm.+x": "estimated_errors.draw_in_+x_mm",
}


def read(folder: Path) -> tuple[list[str], list[dict[str, str]], str]:
    """Keys, usable rows, and how many there are of all."""
    with (folder / "study.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = list(rows[0])
    keys = names[1 : names.index(next(iter(ERRORS)))]
    converged = [row for row in rows if row["converged"] == "true"]
    good = [row for row in converged if row["status"] == "completed" and not row["one_of_many"]]
    words = f"{len(rows)} runs, {len(converged)} converged, {len(good)} of these in a single state"
    return keys, good, words


def fitted(x: np.ndarray, y: np.ndarray) -> GaussianProcessRegressor:
    """Gaussian process with a length for each key, for inputs and outputs of unit variance."""
    lengths = RBF(np.full(x.shape[1], 3.0), (0.1, 1e6))
    kernel = ConstantKernel(10.0, (1e-2, 1e4)) * lengths + WhiteKernel(1e-3, (1e-8, 1.0))
    return GaussianProcessRegressor(kernel, random_state=0).fit(x, y)


def report(folder: Path) -> dict[str, dict[str, float]]:
    """Errors of the surrogate of each output, which are printed too."""
    keys, rows, words = read(folder)
    print(f"{folder}: {words}")
    x = np.array([[float(row[key]) for key in keys] for row in rows])
    x = (x - x.mean(0)) / x.std(0)
    held_out = np.arange(len(rows)) % HELD_OUT == HELD_OUT - 1
    found = {}
    for output, column in ERRORS.items():
        y = np.array([float(row[output]) for row in rows])
        mesh = np.array([float(row[column] or "nan") for row in rows])[held_out]
        mean, scale = y[~held_out].mean(), y[~held_out].std()
        model = fitted(x[~held_out], (y[~held_out] - mean) / scale)
        guess, sigma = (scale * values for values in model.predict(x[held_out], return_std=True))
        off = guess + mean - y[held_out]
        found[output] = {
            "rms": float(np.sqrt(np.mean(off**2))),
            "largest": float(np.abs(off).max()),
            "spread": float(y[held_out].std()),
            "within two sigma": float(np.mean(np.abs(off) < 2 * sigma)),
            "median mesh error": float(np.nanmedian(mesh)),
            "within the mesh error": float(np.mean(np.abs(off) < mesh)),
        }
        values = ", ".join(f"{name} {value:.3g}" for name, value in found[output].items())
        print(f"  {output}, {(~held_out).sum()} runs fitted, {held_out.sum()} held out: {values}")
    return found


if __name__ == "__main__":
    for name in sys.argv[1:]:
        report(Path(name))
