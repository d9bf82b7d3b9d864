"""What this installation has: versions, linear solvers, threads, optional parts; a line each."""

from __future__ import annotations

import os
import platform
import shutil
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

import numpy as np
from scipy.sparse import csr_array

from ..solve.linear import linear_solver

PACKAGES = ("numpy", "scipy", "scikit-fem", "meshio", "shapely", "matplotlib", "cyclopts")
SOLVERS = {"pardiso": "the fastest", "superlu": "scipy's"}
EXTRAS = {"pardiso": "pip install 'quasiform[fast]'"}  # where the fault does not say so
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
PARTS = {  # name: (module, what for, extra)
    "numba": ("numba", "compiled energies", "fast"),
    "libigl": ("igl", "tools from surface files", "surface"),
    "gmsh": ("gmsh", "tools and blanks from CAD files", "cad"),
    "ezdxf": ("ezdxf", "outlines from DXF files", "cad"),
    "distributed": ("distributed", "studies on a Dask cluster", "study"),
    "h5py": ("h5py", "fields of a study in one file", "study"),
    "plotly": ("plotly", "3D views in a browser", "report"),
}
PROGRAMS = {"ffmpeg": "mp4 animations (gif needs nothing)", "ccx": "tests of CalculiX decks only"}


def examine() -> list[tuple[str, str]]:
    """Name and state of each part; what is missing or broken is a state too, nothing raises."""
    system = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    found = [("quasiform", _version("quasiform")), ("python", system)]
    found += [(name, _version(name)) for name in PACKAGES]
    chosen = ""
    for name, use in SOLVERS.items():
        fault = _fault(name)
        state = f"missing or broken: {use}; {fault}" if fault else f"works: {use}"
        if fault and name in EXTRAS and "pip install" not in fault:
            state += f"; {EXTRAS[name]}"
        if not fault and not chosen:
            chosen, state = name, f"works, is used: {use}"
        found.append((f"linear solver {name}", state))
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    found.append(("processors", str(cores)))
    found += [(name, os.environ.get(name, "not set: as many as there are")) for name in THREADS]
    for name, (module, use, extra) in PARTS.items():
        missing = f"missing: {use}; pip install 'quasiform[{extra}]'"
        found.append((name, f"{_version(name)}: {use}" if find_spec(module) else missing))
    states = {name: "found" if shutil.which(name) else "missing" for name in PROGRAMS}
    return [*found, *((name, f"{states[name]}: {use}") for name, use in PROGRAMS.items())]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"


def _fault(name: str) -> str:
    """What goes wrong when a linear solver solves a small system; empty if nothing does."""
    diagonal = np.array([2.0, 3.0, 4.0])
    try:
        solver = linear_solver(name, csr_array(np.eye(3)), np.eye(3)[:, :2])
        solver.factor(diagonal)
        right = np.allclose(diagonal * solver.solve(np.ones(3)), 1.0)
    except Exception as error:  # whatever a foreign library raises
        return " ".join(str(error).split()) or type(error).__name__
    return "" if right else "its solution is wrong"
