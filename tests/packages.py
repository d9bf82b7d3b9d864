"""Wheel and sdist, each installed into an empty environment and used there.

    python tests/packages.py                 with every Python 3.11 to 3.13 on the PATH
    python tests/packages.py --lowest        the lowest dependencies that pyproject.toml allows

Prints one line a check and exits with 1 if one failed. It asks the package index, takes minutes,
and is therefore no test of the suite.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PYTHONS = ("3.11", "3.12", "3.13")
NEEDED = ("quasiform/geometries/hemisphere.toml",)
USE = (  # what a newcomer does first; run where no clone is near
    "quasiform --version",
    "quasiform form hemisphere --dry-run",
    "quasiform form tetrahedron --size 20 --travel 5 --out formed",
    "quasiform oat --law best-fit --displacement 5 --size 40 --out pulled",
    "quasiform schema",
    "python -c 'import quasiform as qf; help(qf)'",
)
TESTS = (
    "material",
    "blank",
    "outline",
    "energy",
    "oracle",
    "linear",
    "solve",
    "scene_file",
    "tool",
)


def main() -> int:
    """Run the checks; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--lowest", action="store_true", help="with the lowest dependencies")
    parser.add_argument("--python", action="append", metavar="X.Y", help="only this one")
    arguments = parser.parse_args()
    with TemporaryDirectory() as name:
        folder = Path(name)
        if arguments.lowest:
            return lowest(folder, (arguments.python or PYTHONS[:1])[0])
        return packages(folder, arguments.python or PYTHONS)


def packages(folder: Path, versions: list[str] | tuple[str, ...]) -> int:
    """Build both archives and use them with each Python."""
    builder = environment(folder / "builder", sys.executable)
    tree = clean_copy(folder / "tree")
    run(f"{builder}/pip install --quiet build && {builder}/python -m build {tree} --outdir dist",
        folder)  # fmt: skip
    wheel, sdist = (next((folder / "dist").glob(ending)) for ending in ("*.whl", "*.tar.gz"))
    inside = zipfile.ZipFile(wheel).namelist()
    failed = [told(f"{wheel.name} holds {name}", name in inside) for name in NEEDED].count(False)
    found = 0
    for version in versions:
        if not (python := interpreter(version)):
            print(f"       Python {version}: not on the PATH", flush=True)
            continue
        found += 1
        for archive in (wheel, sdist):
            home = folder / f"{version}-{archive.suffix[1:]}"
            scripts = environment(home, python)
            commands = [f"{scripts}/pip install --quiet {archive}"]
            commands += [f"{scripts}/{command}" for command in USE]
            for command in commands:
                words = f"Python {version}, {archive.name}: {plain(command, scripts)}"
                good = told(words, succeeds(command, home))
                failed += not good
    return 1 if failed or not found else 0


def lowest(folder: Path, version: str) -> int:
    """Run a part of the tests with the lowest dependencies that are declared."""
    bounds = [re.sub(r"[,<].*", "", entry).replace(">=", "==") for entry in PROJECT["dependencies"]]
    scripts = environment(folder / "lowest", interpreter(version))
    tree = clean_copy(folder / "tree")
    tests = " ".join(f"tests/test_{name}.py" for name in TESTS)
    pinned = " ".join(bounds)
    commands = (
        f"{scripts}/pip install --quiet {tree} {pinned}",
        f"{scripts}/pip install --quiet pytest hypothesis jsonschema {pinned}",
        f"{scripts}/python -m pytest --quiet {tests}",
    )
    good = [told(f"Python {version}: {plain(c, scripts)}", succeeds(c, tree)) for c in commands]
    return 0 if all(good) else 1


def interpreter(version: str) -> str | None:
    """Path of a Python that answers, or None."""
    path = shutil.which(f"python{version}")
    return path if path and succeeds(f"{path} -c ''", ROOT, quiet=True) else None


def environment(home: Path, python: str | None) -> Path:
    """Make an empty virtual environment; return the folder of its scripts."""
    run(f"{python} -m venv {home}", ROOT)
    return home / "bin"


def clean_copy(tree: Path) -> Path:
    """Copy the files that git knows as they are now, without what has grown beside them."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    )  # fmt: skip
    for name in filter(None, listed.stdout.split("\0")):
        if (ROOT / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tree / name)
    return tree


def run(command: str, folder: Path) -> None:
    """Run a shell command.

    Raises
    ------
    SystemExit
        With its output if it fails.
    """
    done = subprocess.run(command, shell=True, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{command}\n{done.stdout[-3000:]}{done.stderr[-3000:]}")


def succeeds(command: str, folder: Path, quiet: bool = False) -> bool:
    """Whether a shell command does; what it said if not."""
    try:
        run(command, folder)
    except SystemExit as error:
        if not quiet:
            print(error, flush=True)
        return False
    return True


def plain(command: str, scripts: Path) -> str:
    """Return a command without the folder of its script."""
    return command.replace(f"{scripts}/", "")


def told(words: str, good: bool) -> bool:
    """Print what became of a check."""
    print("ok    " if good else "FAILED", words, flush=True)
    return good


if __name__ == "__main__":
    sys.exit(main())
