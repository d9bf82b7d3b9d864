"""The command line, declared from typed functions: each command is one function.

A command imports what it uses when it runs, so that `quasiform --help` is quick. Exit status: 0 the
goal was reached; 1 `compare` or `validate` found a band missed; 2 wrong input, with one line; 3 the
run stopped early.
"""

from __future__ import annotations

import os
import re
import signal
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, astuple, dataclass
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from itertools import count
from math import isfinite
from pathlib import Path
from time import perf_counter
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_origin

from cyclopts import App, CycloptsError, Group, Parameter, Token
from cyclopts.exceptions import CoercionError, UnknownOptionError, UnusedCliTokensError
from cyclopts.validators import LimitedChoice, Number

import quasiform as qf

from ..checks import InputError, check_number, interruptible, suggestion
from . import terminal

if TYPE_CHECKING:
    from ..result.files import Claim

app = App(
    name="quasiform",
    help="Implicit, quasi-static forming of dry 0°/90° biaxial non-crimp fabrics.",
    help_epilogue="Lengths in mm, forces in N, angles in degrees. Exit status: 0 completed, 1 a "
    "band missed, 2 wrong input, 3 stopped early.",
    help_format="plaintext",
    default_parameter=Parameter(negative=(), json_list=False, json_dict=False),
    suppress_keyboard_interrupt=False,
)
CLAIMS: list[Claim] = []  # folders that the command writes to
app.register_install_completion_command(help="Add completion to your shell's startup file.")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    words, status = sys.argv[1:] if argv is None else list(argv), 2
    before: Any = signal.SIG_DFL
    with suppress(ValueError):  # not in the main thread
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        if not words:
            names = [name for name in app if not name.startswith("-")]
            raise InputError(f"expected a command: {' or '.join(names)} (see --help)")
        with interruptible():
            done = app(words, print_error=False, exit_on_error=False, result_action="return_value")
        return done or 0
    except CycloptsError as error:
        message = str(InputError(_one_line(error)))
    except InputError as error:
        message = str(error)
    except MemoryError:
        message = "not enough memory: choose a larger --size"
    except KeyboardInterrupt:
        message, status = "interrupted: only what was written before is kept", 3
    finally:
        with suppress(ValueError):
            signal.signal(signal.SIGTERM, before)
        while CLAIMS:
            CLAIMS.pop().release()
    print("quasiform:", message, file=sys.stderr)
    return status


def _one_line(error: CycloptsError) -> str:
    """What is wrong, and what was probably meant; where nothing is near, what there is."""
    if isinstance(error, UnknownOptionError):
        names = [n for a in error.argument_collection for n in a.names if n.startswith("-")]
        option = error.token.keyword or error.token.value
        return f"unknown option '{option}': {suggestion(option, names)}"
    if isinstance(error, UnusedCliTokensError) and error.unused_tokens:
        return f"unexpected argument '{error.unused_tokens[0]}'"
    if isinstance(error, CoercionError) and error.argument and error.token and not error.msg:
        if choices := error.argument.get_choices(force=True):
            value = error.token.value
            return f"{error.token.keyword}: unknown value '{value}': {suggestion(value, choices)}"
    return str(error)


# How the words of an option are read


def about(help: str, **more: Any) -> Parameter:
    """Help of an option."""
    return Parameter(help=help, **more)


def word(converter: Callable[[str], Any], metavar: str) -> Parameter:
    """An option of one word that a function reads; it can be repeated where its type is a list."""

    def convert(kind: Any, tokens: Sequence[Token]) -> Any:
        found = [converter(token.value) for token in tokens]
        return found if get_origin(kind) is list else found[0]

    return Parameter(converter=convert, metavar=metavar, n_tokens=1, accepts_keys=False)


def _positive(text: str) -> float:
    with suppress(ValueError):  # of float, or an InputError
        return check_number("value", float(text))
    raise ValueError(f"expected a positive number, got '{text}'")


def _degrees(text: str) -> float:
    with suppress(ValueError):
        if isfinite(number := float(text)):
            return number
    raise ValueError(f"expected a number of degrees, got '{text}'")


def _auto(text: str) -> float | str:
    with suppress(ValueError):
        if text == "auto" or isfinite(float(text)):
            return text if text == "auto" else float(text)
    raise ValueError(f"expected a number or auto, got '{text}'")


def _cycle(text: str) -> int | str:
    if text in ("last", "first", "envelope") or (text.isdecimal() and int(text)):
        return int(text) if text.isdecimal() else text
    raise ValueError(f"expected last, first, envelope or a number from 1, got '{text}'")


def _path(text: str) -> Path:
    if not text:
        raise ValueError("expected the name of a file or folder, got ''")
    return Path(text)


def _known(what: str, name: str, known: Iterable[str]) -> str:
    if name not in known:
        raise ValueError(f"unknown {what} '{name}': {suggestion(name, known)}")
    return name


def _pairs(what: str, module: str, value: type, example: str) -> Parameter:
    """NAME=VALUE,... with names that a module knows; a comma without a NAME= is of a value."""

    def read(text: str) -> dict[str, Any]:
        names, pairs = import_module(f"quasiform.identification.{module}").NAMES, {}
        for entry in re.split(r",(?=\s*\w+\s*=)", text):
            name, _, given = (part.strip() for part in entry.partition("="))
            expected = f"expected {example} with each name once, got '{entry}'"
            if _known(what, name, names) in pairs or not (given := given.strip("\"'")):
                raise ValueError(expected)
            try:
                pairs[name] = value(given)
            except ValueError:
                raise ValueError(expected) from None
        return pairs

    return word(read, "NAME=VALUE,...")


def _pictures(text: str) -> tuple[str, ...]:
    from ..draw.pictures import PICTURES

    return tuple(_known("picture", name.strip(), PICTURES) for name in text.split(","))


def _three(text: str) -> tuple[float, float, float]:
    with suppress(ValueError):
        x, y, z = (float(number) for number in text.split(","))
        if isfinite(x + y + z):
            return x, y, z
    raise ValueError(f"expected three numbers X,Y,Z, got '{text}'")


def _direction(text: str) -> tuple[float, float, float]:
    with suppress(ValueError):
        if any(found := _three(text)):
            return found
    raise ValueError(f"expected X,Y,Z of a direction, got '{text}'")


def _disc(text: str) -> tuple[str, tuple[tuple[float, float], float]]:
    name, _, numbers = text.partition("=")
    with suppress(ValueError):
        x, y, radius = (float(number) for number in numbers.split(","))
        if name and isfinite(x + y) and 0 < radius < float("inf"):
            return name, ((x, y), radius)
    raise ValueError(f"expected NAME=X,Y,RADIUS in mm, got '{text}'")


def _override(text: str) -> tuple[str, Any]:
    """KEY=VALUE; a value that is none of TOML is a text."""
    key, _, value = (part.strip() for part in text.partition("="))
    if not key or not value:
        raise ValueError(f"expected KEY=VALUE such as tools.holder.mass=8, got '{text}'")
    with suppress(ValueError):
        return key, tomllib.loads(f"value = {value}")["value"]
    return key, value


def _uncertain(text: str) -> tuple[str, float]:
    key, _, value = (part.strip() for part in text.partition("="))
    with suppress(ValueError):
        if key:
            return key, check_number(key, float(value))
    raise ValueError(f"expected KEY=VALUE such as fabric.friction=0.02, got '{text}'")


def _share(text: str) -> tuple[int, int]:
    with suppress(ValueError):
        i, n = (int(number) for number in text.split("/"))
        if 1 <= i <= n:
            return i, n
    raise ValueError(f"expected I/N with I from 1 to N, got '{text}'")


def _or_file(*names: str) -> Callable[[object], list[str]]:
    """Completion by names, and by the TOML files of the working directory."""
    return lambda _: [*names, *(str(path) for path in sorted(Path().glob("*.toml")))]


Length = Annotated[float, word(_positive, "MM")]
Degrees = Annotated[float, word(_positive, "DEG")]
Factor = Annotated[float, word(_positive, "FACTOR")]
Percent = Annotated[float, word(_positive, "PERCENT")]
Angle = Annotated[float, word(_degrees, "DEG")]
Count = Annotated[int, Parameter(metavar="N", validator=Number(gte=1, lte=1000))]
Folder = Annotated[Path, word(_path, "DIR")]
File = Annotated[Path, word(_path, "FILE")]
Law = Annotated[str, Parameter(metavar="LAW", completer=_or_file("locking", "best-fit"))]
SceneName = Annotated[str, Parameter(completer=_or_file("box", "hemisphere", "tetrahedron"))]
Keep = Annotated[
    dict[str, float], _pairs("parameter", "fit", float, "NAME=VALUE,... such as I_lo=0.8")
]
Columns = Annotated[
    dict[str, str], _pairs("quantity", "records", str, "NAME=WORD,... such as force=3")
]
Overrides = Annotated[list[tuple[str, Any]], word(_override, "KEY=VALUE")]
Uncertain = Annotated[list[tuple[str, float]], word(_uncertain, "KEY=VALUE")]
Discs = Annotated[list[tuple[str, Any]], word(_disc, "NAME=X,Y,RADIUS")]
MESH = Group("Mesh", validator=LimitedChoice())
PRODUCT = Group("What to write", validator=LimitedChoice(1))


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Output:
    """Where a command writes."""

    out: Folder | None = None
    """Folder of the result; by default a new one, named after the case."""
    force: Annotated[bool, about("Replace the result in --out.")] = False

    def folder(self, name: str, files: Sequence[str]) -> Path:
        """Folder to write to; refused where it holds one of the files."""
        from ..result.files import check_folder

        return check_folder(self.claim(name).folder, force=self.force, names=files)

    def claim(self, name: str) -> Claim:
        """Claim the folder until the command ends."""
        from ..result.files import Claim, claim_new

        CLAIMS.append(Claim(self.out) if self.out else claim_new(_numbered(_case(name))))
        return CLAIMS[-1]

    def file(self, path: Path) -> Path:
        """File to write; refused where it exists."""
        if path.exists() and not self.force:
            raise InputError(f"{path} is there already: choose another, or replace it with --force")
        return path


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Solver(Output):
    """How a model is solved."""

    increment: Length | None = None
    """Travel of an increment; by default the program chooses it."""
    no_estimate: bool = False
    """Do not estimate the error of the mesh."""
    draft: bool = False
    """A quick answer with a wider error: twice the size, twice the increments."""
    dry_run: bool = False
    """Print the model and the expected time; solve and write nothing."""
    linear: Literal["auto", "pardiso", "superlu"] | None = None
    """Linear solver, for experts (auto)."""
    sensitivity: bool = False
    """Derivatives of the results by every parameter -> sensitivity.csv, .png."""
    uncertain: Uncertain | None = None
    """What a parameter is uncertain by, such as fabric.friction=0.02: the errors that follow."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Scene:
    """What can be changed of a forming scene; by default its own values."""

    orientation: Annotated[Angle | None, about("Angle from x to the warp.")] = None
    law: Annotated[Law | None, about("Fabric: locking, best-fit or FILE.toml.")] = None
    size: Annotated[Length | None, Parameter(group=MESH)] = None
    """Spacing of the fibre lines. `form` then follows the whole path on this mesh. By default that
    of the scene, or 5, or finer where a fillet needs it."""
    travel: Annotated[Length | None, about("Travel of the punch.")] = None
    symmetry: Literal["auto", "half", "none"] | None = None
    """Mirror planes that are used: all there are (a half or a quarter), at most one, or none."""
    set: Overrides | None = None
    """Another value of a key of the scene, such as tools.holder.mass=8 or fabric.friction=0.2."""

    def model(self, scene: str, **run: Any) -> qf.Model:
        """Build the model of a scene; `run` is how it is solved, where that is given."""
        given = {f"run.{key}": value for key, value in run.items() if value is not None}
        overrides = dict(self.set or ()) | given
        return qf.forming(scene, *astuple(self)[:-1], overrides=overrides)


@app.command
def oat(
    *,
    angle: Annotated[Angle, about("Angle between load and warp.")] = 45.0,
    law: Annotated[Law, about("Fabric: locking, best-fit or FILE.toml.")] = "locking",
    length: Annotated[Length, about("Free length of the specimen.")] = 320.0,
    width: Annotated[Length, about("Width of the specimen.")] = 160.0,
    displacement: Annotated[Length, about("Displacement of the grip at the end.")] = 80.0,
    size: Annotated[Length, about("Cell edge along the specimen's axes at 45°.")] = 10.0,
    solver: Solver = Solver(),
) -> int:
    """Off-axis tension test of a strip."""
    model = qf.off_axis_tension(angle, law, length, width, displacement, size)
    return _solve(model, solver)


@app.command
def form(
    scene: Annotated[SceneName, about("hemisphere, tetrahedron, box or FILE.toml.")],
    /,
    *,
    accuracy: Annotated[
        Degrees | None,
        about("Refine until the estimated error of the shear angle (p99) is below.", group=MESH),
    ] = None,
    seeds: Annotated[
        Count | None, about("Solve the path N times more with noise, to see what is robust.")
    ] = None,
    options: Scene = Scene(),
    solver: Solver = Solver(),
) -> int:
    """Forming test with a punch, a die and a blank holder."""
    if solver.dry_run:
        terminal.say(f"building the model of {scene} ...")
    model = options.model(
        scene,
        increment=solver.increment,
        accuracy=accuracy,
        linear=solver.linear,
        seeds=seeds,
        one_mesh=True if options.size is not None else None,
        estimate=False if solver.no_estimate else None,
        draft=solver.draft or None,
    )
    return _solve(model, solver, dict(model.recipe.given)["file"].run)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Tests:
    """What the tests are, and what is identified from them."""

    method: Literal["fit", "inverse", "table", "as-printed"] | None = None
    """By default the file's, or fit."""
    keep: Keep | None = None
    """Parameters that are not fitted, such as C_lo=1000,I_lo=0.819."""
    algorithm: Literal["least-squares", "nelder-mead"] | None = None
    """Of the fit (least-squares)."""
    name: Annotated[str | None, about("Of the fabric; by default the file's.")] = None
    kind: Literal["off-axis", "picture-frame", "cantilever", "bending"] | None = None
    """Kind of the test in a CSV file (off-axis)."""
    family: Literal["warp", "weft"] | None = None
    """Fibres along a strip whose cantilever profile or bending moments are in the file."""
    areal_weight: Annotated[float | None, word(_positive, "G"), about("In g/m² (600).")] = None
    angle: Annotated[Degrees | None, about("Angle between load and warp (45).")] = None
    length: Annotated[Length | None, about("Free length of the strip (320).")] = None
    width: Annotated[Length | None, about("Width of the strip (160).")] = None
    side: Annotated[Length | None, about("Side of the picture frame (100).")] = None
    fabric_side: Annotated[Length | None, about("Side of the fabric in it (the frame's).")] = None
    amplification: Annotated[
        Factor | None, about("Displacement of the frame's corner over that of the machine (1).")
    ] = None
    thickness: Annotated[Length | None, about("Of the fabric (1.004).")] = None
    to: Annotated[Degrees | None, about("Largest shear angle that is used (all).")] = None
    zero: Annotated[
        Any, word(_auto, "MM|auto"), about("Reading at which the fabric is not strained (auto).")
    ] = None
    preload: Annotated[
        Any, word(_auto, "N|auto"), about("Force on the fabric in the first row (auto).")
    ] = None
    cycle: Annotated[
        Any, word(_cycle, "last|first|N|envelope"), about("Cycle of a cyclic record (envelope).")
    ] = None
    size: Length | None = None
    """Method inverse: cell edge of the finite-element test (14)."""
    columns: Columns | None = None
    """Headings or positions in a CSV file: displacement="Position(mm)",force=3."""
    units: Columns | None = None
    """Units in a CSV file, instead of those it states: displacement=inch,force=kN."""


@app.command
def identify(
    file: Annotated[File, about("CSV of one test, or TOML of several tests of a fabric.")],
    /,
    *,
    tests: Tests = Tests(),
    dry_run: Annotated[bool, about("Print what is in the tests; write nothing.")] = False,
    output: Output = Output(),
) -> None:
    """Material file from off-axis tension, picture-frame and cantilever tests."""
    from ..identification.campaign import load
    from ..identification.identified import FILES

    folder = output.folder(f"{file.stem}-fabric", FILES)
    campaign = load(file, **_given(tests))
    if dry_run:
        terminal.say(terminal.campaign(campaign))
        return
    terminal.say(f"writing to {folder}", terminal.campaign(campaign))
    if campaign.shear:
        loop = " or minutes, with finite elements in the loop"
        terminal.say(f"fitting, some seconds{loop if campaign.method == 'inverse' else ''}")
    found = qf.identify(campaign)
    found.save(folder, force=output.force)
    terminal.say(terminal.identified(found), terminal.files(folder, FILES))


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Reference:
    """How a reference is read and compared."""

    field: Annotated[str | None, about("Field or column of the angle, or none.")] = None
    angle: Literal["shear", "between"] | None = None
    """What it is: the shear angle (default), or the angle between the fibres."""
    radians: Annotated[bool, about("The angle is in radians.")] = False
    signed: Annotated[bool, about("The sign of the angle counts.")] = False
    orientation: Angle | None = None
    """Angle from x to the reference's warp, where only its displacements are known (0)."""
    values: Annotated[File | None, about("CSV by node or element label for an .inp.")] = None
    coordinates: Literal["formed", "flat"] | None = None
    """What the coordinates of the reference are."""
    history: Annotated[File | None, about("CSV of the reference's travel and force.")] = None
    scale: Annotated[Factor | None, about("Unit of the reference's lengths in mm (1).")] = None
    force_factor: Factor | None = None
    """Of the reference's forces: 4 for those of a quarter (1)."""
    travel: Length | None = None
    """Where to compare; by default at the largest travel of both."""
    reference_travel: Length | None = None
    """Travel of the reference's last state, where its file does not give it."""
    within: Length | None = None
    """Points farther than this from the other sheet are not compared."""
    band_angle: Degrees | None = None
    """Largest difference of the shear angle on 95 % of the area."""
    band_outline: Annotated[Length | None, about("Largest distance of the outlines.")] = None
    band_force: Annotated[Percent | None, about("Largest difference of the force.")] = None
    by: Literal["auto", "flat", "formed"] | None = None
    """Coordinates by which points are matched; auto: flat if both have them."""
    align: Literal["none", "shift", "rigid"] | None = None
    """Shift, or shift and rotate, the reference to where it fits best."""
    mirror: Literal["x", "y", "x,y"] | None = None
    """Unfold the reference, a half or a quarter, at x = 0, y = 0 or both."""
    standing: Literal[
        "measured", "stated", "exact", "peer", "prototype", "inferred", "assumed", "own"
    ] = "peer"
    """Standing of the reference."""
    ply: Annotated[Count | None, about("Of stacks, from the punch down (1).")] = None


@app.command
def study(
    file: Annotated[File, about("Scene, varied keys and outputs of the study, .toml.")],
    /,
    *,
    workers: Annotated[Count | None, about("Processes on this machine (1).")] = None,
    scheduler: Annotated[
        str | None,
        about("Dask scheduler that gives the runs to its workers."),
        Parameter(metavar="ADDRESS"),
    ] = None,
    share: Annotated[
        tuple[int, int] | None,
        word(_share, "I/N"),
        about("Solve part I of N here: for the arrays of a batch system."),
    ] = None,
    resume: Annotated[bool, about("Repeat runs that failed.")] = False,
    dry_run: Annotated[
        bool, about("Print how many runs there are, and the expected time.")
    ] = False,
    out: Annotated[Folder | None, about("Folder of the study; its runs are not repeated.")] = None,
) -> None:
    """Many runs over varied keys of a scene or of off-axis tension -> study.csv."""
    from ..studies import plan, store
    from . import forecast
    from .progress import StudyBar

    if scheduler and (workers or share):
        raise InputError("--scheduler does not go with --workers or --share")
    planned = plan(file)
    folder = out or Path(planned.study.name)
    rows = store.read_rows(folder)
    jobs = store.part(planned.jobs, share)
    words = forecast.study(planned, store.pending(planned, jobs, rows, resume), rows)
    if dry_run:
        terminal.say(words)
        return
    terminal.say(f"writing to {folder}", words)
    how = {"callback": StudyBar(), "pictures": True}
    table = qf.study(planned, workers or 1, scheduler, share, resume, folder, **how)
    answer = folder / store.ANSWER
    lines = answer.read_text(encoding="utf-8").splitlines() if answer.exists() and not share else []
    terminal.say(terminal.study(table), *(f"  {line}" for line in lines))
    terminal.say(terminal.files(folder, store.FILES))


@app.command
def compare(
    result: Annotated[Folder, about("Folder of a result.")],
    reference: Annotated[File, about("A result; a .vtu, .vtk, .xdmf or .inp; a CSV of points.")],
    /,
    *,
    options: Reference = Reference(),
    area: Annotated[Discs | None, about("Disc of the flat blank for a mean (the scene's).")] = None,
    output: Output = Output(),
) -> int:
    """Two results, or a result and another code's or a measured field, at equal travel."""
    from ..comparison import FILES

    folder = output.folder(f"{result.name}-beside-{reference.stem}", FILES)
    given = _given(options) | ({"areas": dict(area)} if area else {})
    if options.mirror:
        given["mirror"] = options.mirror.split(",")
    comparison = qf.compare(result, reference, **given)
    terminal.say(f"writing to {folder}")
    comparison.save(folder, force=output.force)
    warned = [note for note in comparison.notes if note.startswith("warning")]
    notes = [f"  {note}" for note in comparison.notes if note not in warned]
    terminal.say(*warned, comparison.table(), *notes)
    terminal.say(terminal.files(folder, FILES))
    return 0 if comparison.held else 1


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Target:
    """The structural mesh or line that `export` maps, and how."""

    mesh: Annotated[File | None, about("--to: structural mesh (the formed sheet's).")] = None
    scale: Annotated[Factor, about("Unit of length of the mesh or line in mm.")] = 1.0
    origin: Annotated[
        tuple[float, float, float],
        word(_three, "X,Y,Z"),
        about("Point of the mesh, mm, that lies at the origin of the part."),
    ] = (0.0, 0.0, 0.0)
    rotate: Annotated[
        tuple[float, float, float],
        word(_three, "X,Y,Z"),
        about("Turn of the mesh about x, y and z to the part, degrees."),
    ] = (0.0, 0.0, 0.0)
    align: Annotated[
        Literal["none", "shift", "rigid"], about("Move the mesh to where it fits the part best.")
    ] = "none"
    within: Annotated[
        Length | None, about("Farther is off the sheet (spacing of a mesh; thickness for a line).")
    ] = None
    axis: Annotated[Literal["warp", "weft", "bisector"], about("calculix, layups: local 1.")] = (
        "warp"
    )
    reference: Annotated[
        tuple[float, float, float],
        word(_direction, "X,Y,Z"),
        about("radioss, optistruct: direction from which angles are measured."),
    ] = (1.0, 0.0, 0.0)


@app.command
def export(
    source: Annotated[str, about("Folder of a result; with --deck a scene.")],
    /,
    *,
    to: Annotated[
        Literal[
            "abaqus",
            "abaqus-pair",
            "abaqus-layup",
            "calculix",
            "calculix-layup",
            "radioss",
            "optistruct",
            "csv",
            "vtu",
            "pyacp",
        ]
        | None,
        about("Fibre directions by element.", group=PRODUCT),
    ] = None,
    trim: Annotated[
        str | None,
        about("Flat pattern of a line, the sheet's edge or the die's opening.", group=PRODUCT),
        Parameter(metavar="FILE.csv|edge|die"),
    ] = None,
    ply_book: Annotated[
        str | None,
        about("A page to print for each ply, with this flat pattern.", group=PRODUCT),
        Parameter(metavar="FILE.csv|edge|die"),
    ] = None,
    deck: Annotated[bool, about("Abaqus/Explicit deck of a scene.", group=PRODUCT)] = False,
    place: Target = Target(),
    options: Scene = Scene(),
    output: Output = Output(),
) -> None:
    """Fibre directions for a structural code, a flat pattern, or an Abaqus deck (of a scene)."""
    from ..handover import book, handover

    path, force, how = Path(source), output.force, asdict(place)
    line = {key: how[key] for key in ("within", "scale")}
    if deck:
        model = options.model(source)
        file = f"{_case(model.name)}.inp"
        folder = output.folder(f"{model.name}-deck", (file,))
        terminal.say(f"writing to {folder}")
        notes = qf.abaqus_deck(model, folder / file, force=force)
        terminal.say(*terminal.notes(notes), terminal.files(folder, (file,)))
    elif trim:
        _flat_patterns(path, trim, line, output)
    elif ply_book:
        folder = output.folder(f"{path.resolve().name}-ply-book", (book.FILE,))
        terminal.say(f"writing to {folder}")
        written = qf.ply_book(path, folder, ply_book, **line, force=force)
        terminal.say(f"file: {written}")
    else:
        folder = output.folder(f"{path.resolve().name}-{to}", handover.FILES)
        handed = qf.export(path, to, folder, **how, force=force)
        terminal.say(f"writing to {folder}")
        terminal.say(*terminal.notes(handed.notices, handed.general, handover.NOTES))
        terminal.say(terminal.files(folder, handed.files))


def _flat_patterns(path: Path, trim: str, line: Mapping[str, Any], output: Output) -> None:
    """Write the flat pattern of each ply."""
    from ..handover import pattern
    from ..result.record import Record

    names = (*pattern.FILES, *(f"ply_*_{name}" for name in pattern.FILES))
    folder = output.folder(f"{path.resolve().name}-pattern", names)
    found = [qf.flat_pattern(ply, trim, **line) for ply in Record.read(path).plies]
    terminal.say(f"writing to {folder}")
    for one in found:
        one.save(folder, force=output.force)
        lines = "1 line" if len(one.trim) == 1 else f"{len(one.trim)} lines"
        terminal.say(f"{one.name}: {lines} to cut, {one.area:.6g} mm² inside")
        terminal.say(*terminal.notes(one.notices, pattern.NOT_MODELLED, one.files[-1]))
        terminal.say(terminal.files(folder, one.files))


@app.command
def resume(folder: Annotated[Folder, about("Folder of the run.")], /) -> int:
    """Continue a run of `oat` or `form` from the last increment in its folder."""
    from ..result.files import Claim

    CLAIMS.append(Claim(folder))
    journal = qf.Journal(CLAIMS[-1], resume=True)
    if set(journal.options) != set(OPTIONS):
        raise InputError(
            f"{folder}: the run there was not started by a command; continue it with "
            "solve(model, out=..., resume=True)"
        )
    return _run(journal.model(), journal)


@app.command
def plot(
    *folders: Annotated[Folder, about("Folders of results.")],
    table: Annotated[bool, about("Print the table alone; write nothing.")] = False,
    only: Annotated[
        tuple[str, ...] | None,
        word(_pictures, "NAME,..."),
        about("Some of shear_angle, fibres, outline, ... (all)."),
    ] = None,
    travel: Annotated[Length | None, about("Show the states nearest to it (the last).")] = None,
    ply: Annotated[Count, about("Of stacks, from the punch down.")] = 1,
    scale: Annotated[
        Degrees | None, about("End of the colour scale (above all shear and locking angles).")
    ] = None,
    animate: Annotated[
        Literal["gif", "mp4"] | None, about("Animate the travel (mp4 needs ffmpeg).")
    ] = None,
    output: Output = Output(),
) -> None:
    """Pictures of results, one or several side by side, and a table of their key numbers."""
    from ..draw import pictures
    from ..result.files import replaced
    from ..result.record import Record
    from ..tables import write_rows

    if not folders:
        raise InputError("plot: expected the folder of a result, DIR")
    runs = [Record.read(folder, ply) for folder in folders]
    if travel is not None:
        runs = [run.near(travel) for run in runs]
    rows = pictures.table(runs)
    shown = terminal.table(zip(*rows, strict=True))
    if table:
        terminal.say(shown)
        return
    pictures.check_animation(animate)
    name = f"{runs[0].name}-pictures" if len(runs) == 1 else "pictures"
    target = output.folder(name, pictures.FILES)
    terminal.say(f"writing to {target}")
    with replaced(target, force=output.force, names=pictures.FILES) as staging:
        notes = pictures.save(runs, staging, only, scale, animate)
        write_rows(staging / "table.csv", rows)
    terminal.say(shown, *terminal.notes(notes), terminal.files(target, pictures.FILES))


@app.command
def view(
    folder: Annotated[Folder, about("Folder of a result.")],
    /,
    *,
    travel: Annotated[Length | None, about("Show the state nearest to it (the last).")] = None,
    ply: Annotated[Count | None, about("One of a stack, from the punch down (all).")] = None,
    open: Annotated[bool, about("Open the page in the browser.")] = False,
    summary: Annotated[
        bool, about("One page to read instead, HTML and PDF, for somebody who did not run it.")
    ] = False,
    output: Output = Output(),
) -> None:
    """A result as one HTML page to rotate, zoom and probe; `--out` is its name.

    Needs plotly (pip install 'quasiform[report]').
    """
    import webbrowser

    from ..draw import page, view
    from ..result.record import Record

    run = Record.read(folder, ply or int(summary))
    if travel is not None:
        run = run.near(travel)
    name = _case(run.name) + "-summary" * summary
    path = output.file(output.out or _unused(name, ".html"))
    written = [path]
    if summary:
        output.file(path.with_suffix(".pdf"))
        written = page.save(run, path)
    else:
        view.save(run, path)
    terminal.say(view.words(run), *(f"file: {file}" for file in written))
    if open and not webbrowser.open(path.resolve().as_uri()):
        raise InputError(f"no browser was found: open {path} yourself")


@app.command
def new(
    file: Annotated[File, about("Name of the scene, ending in .toml.")],
    /,
    *,
    force: Annotated[bool, about("Replace the file.")] = False,
) -> None:
    """Write a commented scene file to start from; it runs as it is."""
    from ..result.files import writing_to

    if file.suffix != ".toml":
        raise InputError(f"{file}: expected the name of a .toml file")
    template = (Path(__file__).parent / "new.toml").read_text(encoding="utf-8")
    text = template.replace("NAME", _case(file.stem))
    with writing_to(file):
        Output(force=force).file(file).write_text(text, encoding="utf-8")
    terminal.say(f"file: {file}", f"look at it: quasiform form {file} --dry-run")


@app.command
def schema(*, study: Annotated[bool, about("Of the file of a study.")] = False) -> None:
    """Print the JSON schema of a scene file, for editors."""
    import json

    from ..scenes.scene_file import Scene, json_schema
    from ..studies.file import Study

    terminal.say(json.dumps(json_schema(Study if study else Scene), indent=2))


@app.command
def doctor() -> None:
    """Print versions, linear solvers, threads and optional parts of this installation."""
    from . import doctor

    terminal.say(terminal.table(doctor.examine()))


@app.command
def validate(
    *cases: Annotated[str, about("Names of cases (all).")],
    quick: Annotated[bool, about("The quick suite: under 5 minutes.")] = False,
    output: Output = Output(),
) -> int:
    """Run the validation suite of a clone; exit status 1 if a band was missed."""
    for folder in (Path.cwd(), Path(__file__).parents[2]):
        package = folder / "validation" / "__init__.py"
        if package.with_name("run.py").is_file() and (folder / "pyproject.toml").is_file():
            spec = spec_from_file_location("validation", package)
            sys.modules["validation"] = module_from_spec(spec)
            spec.loader.exec_module(sys.modules["validation"])
            run = import_module("validation.run")
            return run.validate(list(cases), quick=quick, out=output.out, force=output.force)
    raise InputError("the validation suite is part of the source tree: run it from a clone")


# A run

# kept for `quasiform resume`
OPTIONS = ("increment", "accuracy", "linear", "seeds", "one_mesh", "estimate")


def _solve(model: qf.Model, solver: Solver, run: Mapping[str, Any] = MappingProxyType({})) -> int:
    """Solve a model, or describe it; `run` is how its scene says that it is solved."""
    from ..solve.asked import asked
    from . import sensitivity

    own = {"increment": solver.increment, "linear": solver.linear or "auto"}
    own |= {"estimate": not solver.no_estimate, "draft": solver.draft}
    model, options = asked(model, own | dict(run))
    if uncertain := dict(solver.uncertain or ()):
        sensitivity.check(model, uncertain)
    if not solver.dry_run:
        journal = qf.Journal(solver.claim(model.name), options, force=solver.force)
        return _run(model, journal, solver.sensitivity, uncertain)
    from . import forecast

    terminal.say(terminal.describe(model), "timing a Newton step on each mesh ...")
    lines = [f"  expected time: {forecast.words(forecast.asked(model, options))}"]
    lines += [f"  warning: {words}" for words in forecast.limits(model, options)]
    if options["accuracy"]:
        lines.append("  and longer where --accuracy asks for a finer mesh than that")
    terminal.say(*lines)
    return 0


def _run(
    model: qf.Model,
    journal: qf.Journal,
    every: bool = False,
    uncertain: Mapping[str, float] = MappingProxyType({}),
) -> int:
    """Solve a model and leave its files in the journal's folder."""
    from ..result.files import FILES, INCREMENTS, OF_PLIES, RESUME
    from ..solve.asked import solved
    from . import sensitivity
    from .progress import LiveProgress

    folder, options, clock = journal.folder, journal.options, perf_counter()
    terminal.say(f"writing to {folder}", terminal.describe(model))
    with LiveProgress(model.travel) as callback:
        result = solved(model, options, callback, journal)
    unwritten = "cannot write to" in result.reason
    asked = (every or uncertain) and not unwritten
    more = sensitivity.save(result, every, uncertain, folder) if asked else []
    lines = terminal.report(result, perf_counter() - clock, options["estimate"], more)
    if unwritten or (result.reason and result.states[-1].travel == 0):
        lines = lines.partition("\n")[0]  # there is no converged increment to report, or no room
    terminal.say(lines)
    if unwritten:
        return 3
    if (folder / RESUME).exists():
        terminal.say(f"continue with: quasiform resume {folder}")
    counted = {name: len(list(folder.glob(name))) for name in (INCREMENTS, *OF_PLIES)}
    more = (f", {count} {name}" for name, count in counted.items() if count)
    terminal.say(terminal.files(folder, FILES) + "".join(more))
    return 0 if result.status == "completed" else 3


def _given(options: Any) -> dict[str, Any]:
    """Options that are not None."""
    return {name: value for name, value in asdict(options).items() if value is not None}


def _case(name: str) -> str:
    """Name of a folder for a case."""
    return re.sub(r"[^\w.+-]+", "-", name).lstrip(".-") or "result"


def _unused(name: str, suffix: str = "") -> Path:
    """First of name, name-2, name-3, ... that does not exist."""
    return next(path for path in _numbered(name, suffix) if not os.path.lexists(path))


def _numbered(name: str, suffix: str = "") -> Iterator[Path]:
    """Name, name-2, name-3, ..."""
    return (Path(f"{name}{suffix}" if i == 1 else f"{name}-{i}{suffix}") for i in count(1))
