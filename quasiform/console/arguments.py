"""The words of the command line: commands, their options, and what may be given for each."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from math import isfinite
from pathlib import Path
from typing import Any, NoReturn

from ..checks import InputError, check_number, suggestion
from ..comparison.comparison import ALIGN, STANDINGS
from ..draw import pictures
from ..fabric import PRESETS
from ..handover import FORMATS
from ..handover.fibres import AXES
from ..identification.campaign import KINDS, METHODS
from ..identification.fit import ALGORITHMS, NAMES
from ..identification.records import NAMES as QUANTITIES
from ..result.summary import package_version
from ..scenes.scene_file import built_in
from ..solve.linear import NAMES as LINEAR_SOLVERS
from . import completion


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, told by `main`."""

    def error(self, message: str) -> NoReturn:
        raise InputError(message.removeprefix("argument "))


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Read the words after `quasiform`.

    Parameters
    ----------
    argv : sequence of str

    Returns
    -------
    argparse.Namespace
        `command`, and what was given for it.

    Raises
    ------
    InputError
        For an unknown command, option or value, with the one that was meant.
    """
    parser, commands = _parsers()
    # the options before a command take no value, so the first word without a dash is the command
    command = next((word for word in argv if not word.startswith("-")), None)
    if command is not None and command not in commands:
        raise InputError(f"unknown command '{command}': {suggestion(command, commands)}")
    arguments, unknown = parser.parse_known_args(argv)
    if arguments.command is None:
        raise InputError(f"expected a command: {' or '.join(commands)} (see --help)")
    for word in unknown:
        if not word.startswith("-"):
            raise InputError(f"unexpected argument '{word}'")
        option = word.split("=")[0]
        known = re.findall(r"--[a-z-]+", commands[arguments.command].format_usage())
        raise InputError(f"unknown option '{option}': {suggestion(option, known)}")
    return arguments


def commands() -> dict[str, argparse.ArgumentParser]:
    """Return the parser of each command."""
    return _parsers()[1]


def _parsers() -> tuple[argparse.ArgumentParser, dict[str, argparse.ArgumentParser]]:
    """The parser of the whole, and that of each command."""
    parser = _Parser(
        prog="quasiform",
        description="Implicit, quasi-static forming of dry 0°/90° biaxial non-crimp fabrics.",
        epilog="Lengths in mm, forces in N, angles in degrees. "
        "Exit status: 0 completed, 1 a band missed, 2 wrong input, 3 ended early.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"quasiform {package_version()}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for add in (
        *(_add_oat, _add_form, _add_identify, _add_validate, _add_compare, _add_export),
        *(_add_resume, _add_plot, _add_view, _add_new, _add_doctor, _add_completion),
    ):
        add(commands)
    return parser, commands.choices


def _add_oat(commands: Any) -> None:
    parser = commands.add_parser(
        "oat",
        help="off-axis tension test",
        description="Off-axis tension test of a strip, 0°/90° fibres turned against the load.",
        allow_abbrev=False,
    )
    _add_number(parser, "--angle", 45.0, "DEG", "angle between load and warp", _degrees)
    _add_law(parser)
    _add_number(parser, "--length", 320.0, "MM", "free length of the specimen")
    _add_number(parser, "--width", 160.0, "MM", "width of the specimen")
    _add_number(parser, "--displacement", 80.0, "MM", "displacement of the grip at the end")
    _add_number(parser, "--size", 10.0, "MM", "cell edge along the specimen's axes at 45°")
    _add_common(parser)


def _add_form(commands: Any) -> None:
    parser = commands.add_parser(
        "form",
        help="forming with punch, die and blank holder",
        description="Forming test with a punch, a die and a blank holder.",
        allow_abbrev=False,
    )
    parser.add_argument("scene", metavar="SCENE", help=f"{', '.join(built_in())} or FILE.toml")
    _add_scene(parser)
    mesh = parser.add_mutually_exclusive_group()
    mesh.add_argument(
        "--size",
        type=_positive,
        metavar="MM",
        help="spacing of fibre lines; the whole path on this one mesh (else: the end at the "
        "scene's size, or 5, and the way there on a coarser mesh)",
    )
    mesh.add_argument(
        "--accuracy",
        type=_positive,
        metavar="DEG",
        help="refine until the estimated error of the shear angle (99th percentile) is below this",
    )
    parser.add_argument(
        "--seeds",
        type=_count,
        metavar="N",
        help="solve the path N times more with noise on the nodes, to see what is robust",
    )
    _add_common(parser)


def _add_identify(commands: Any) -> None:
    parser = commands.add_parser(
        "identify",
        help="test data to a material file",
        description="A material file from off-axis tension, picture-frame and cantilever tests.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "file", type=_path, metavar="FILE", help="CSV of one test, or TOML of several (see README)"
    )
    parser.add_argument(
        "--method", type=_one_of(*METHODS), metavar="|".join(METHODS), help="(the file's, or fit)"
    )
    parser.add_argument(
        "--keep",
        type=_kept,
        metavar="NAME=VALUE,...",
        help="parameters that are not fitted, such as C_lo=1000,I_lo=0.819",
    )
    parser.add_argument(
        "--algorithm",
        type=_one_of(*ALGORITHMS),
        metavar="|".join(ALGORITHMS),
        help="of the fit (least-squares)",
    )
    parser.add_argument("--name", metavar="NAME", help="of the fabric (the file's)")
    kinds = "|".join(KINDS)
    parser.add_argument(
        "--kind", type=_one_of(*KINDS), metavar=kinds, help="of a CSV file's test (off-axis)"
    )
    for option, unit, text in (
        ("--angle", "DEG", "angle between load and warp (45)"),
        ("--length", "MM", "free length of the strip (320)"),
        ("--width", "MM", "width of the strip (160)"),
        ("--side", "MM", "side of the picture frame (100)"),
        ("--thickness", "MM", "of the fabric (1.004)"),
        ("--size", "MM", "inverse: cell edge of the finite-element test (14)"),
    ):
        parser.add_argument(option, type=_positive, metavar=unit, help=text)
    for option, text in (
        ("--columns", 'headings or positions in a CSV file, displacement="Position(mm)",force=3'),
        ("--units", "units in a CSV file, over what it says, displacement=inch,force=kN"),
    ):
        parser.add_argument(option, type=_by_quantity, metavar="NAME=WORD,...", help=text)
    _add_out(parser)
    parser.add_argument(
        "--dry-run", action="store_true", help="read the tests, tell what is in them; write nothing"
    )


def _add_resume(commands: Any) -> None:
    parser = commands.add_parser(
        "resume",
        help="carry on a run that was killed or stopped",
        description="Carry on a run of `oat` or `form` from the last increment in its folder.",
        allow_abbrev=False,
    )
    parser.add_argument("folder", type=_path, metavar="DIR", help="folder of the run")


def _add_compare(commands: Any) -> None:
    parser = commands.add_parser(
        "compare",
        help="two results, or a result and another code's or a measured field",
        description="Differences of a result from a reference at equal travel: shear angle, "
        "outline, force, area means. Exit status 1 if a band is missed.",
        allow_abbrev=False,
    )
    parser.add_argument("result", type=_path, metavar="RESULT", help="folder of a result")
    parser.add_argument(
        "reference",
        type=_path,
        metavar="REFERENCE",
        help="another result; a .vtu, .vtk, .xdmf or .inp mesh; a CSV of points and angles, or of "
        "a contour",
    )
    parser.add_argument("--field", metavar="NAME", help="field or column of the angle, or none")
    parser.add_argument(
        "--angle",
        type=_one_of("shear", "between"),
        metavar="shear|between",
        help="what it is: the shear angle, or the angle between the fibres (shear)",
    )
    parser.add_argument("--radians", action="store_true", help="it is in radians")
    parser.add_argument("--signed", action="store_true", help="its sign counts")
    parser.add_argument(
        "--orientation",
        type=_degrees,
        metavar="DEG",
        help="of the reference's warp to x, where only its displacements are known (0)",
    )
    parser.add_argument(
        "--values", type=_path, metavar="FILE", help="CSV by node or element label for an .inp"
    )
    parser.add_argument(
        "--coordinates",
        type=_one_of("formed", "flat"),
        metavar="formed|flat",
        help="what the coordinates of the reference are",
    )
    parser.add_argument(
        "--history", type=_path, metavar="FILE", help="CSV of the reference's travel and force"
    )
    for option, unit, text in (
        ("--scale", "FACTOR", "mm per unit of the reference's lengths (1)"),
        ("--force-factor", "FACTOR", "of the reference's forces: 4 for those of a quarter (1)"),
        ("--travel", "MM", "where to compare (the largest travel of both)"),
        ("--reference-travel", "MM", "of the reference's last state, if it does not tell"),
        ("--within", "MM", "points farther than this from the other sheet are not compared"),
        ("--band-angle", "DEG", "largest difference of the shear angle on 95 %% of the area"),
        ("--band-outline", "MM", "largest distance of the outlines"),
        ("--band-force", "PERCENT", "largest difference of the force"),
    ):
        parser.add_argument(option, type=_positive, metavar=unit, help=text)
    parser.add_argument(
        "--by",
        type=_one_of("auto", "flat", "formed"),
        metavar="auto|flat|formed",
        help="coordinates by which points are matched (flat if both have them)",
    )
    parser.add_argument(
        "--align",
        type=_one_of(*ALIGN),
        metavar="|".join(ALIGN),
        help="shift, or shift and turn, the reference to where it fits best (none)",
    )
    parser.add_argument(
        "--mirror",
        type=_planes,
        metavar="x|y|x,y",
        help="unfold the reference, a half or a quarter, at x = 0, y = 0 or both",
    )
    parser.add_argument(
        "--area",
        type=_area,
        action="append",
        metavar="NAME=X,Y,RADIUS",
        help="a disc of the flat blank for a mean, mm; may be repeated (the scene's)",
    )
    parser.add_argument(
        "--standing", type=_one_of(*STANDINGS), metavar="WORD", help="of the reference (peer)"
    )
    _add_out(parser)


def _add_export(commands: Any) -> None:
    parser = commands.add_parser(
        "export",
        help="fibre directions for a structural code, a flat pattern, or a deck",
        description="Hand a result over: fibre directions by element (--to), a flat pattern of a "
        "trim line (--trim); or write an Abaqus/Explicit deck of a scene (--deck).",
        allow_abbrev=False,
    )
    parser.add_argument(
        "source",
        metavar="DIR|SCENE",
        help=f"folder of a result; with --deck {', '.join(built_in())} or FILE.toml",
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--to",
        type=_one_of(*FORMATS),
        metavar="|".join(FORMATS),
        help="; ".join(f"{name}: {text}" for name, text in FORMATS.items()),
    )
    what.add_argument(
        "--trim",
        metavar="FILE.csv|edge|die",
        help="closed line x, y, z (or x, y: seen along z), the sheet's edge, or the die's opening",
    )
    what.add_argument("--deck", action="store_true", help="an Abaqus/Explicit deck of a scene")
    hand_over = parser.add_argument_group("with --to or --trim")
    hand_over.add_argument(
        "--mesh",
        type=_path,
        metavar="FILE",
        help="structural mesh (.inp, .vtu, ...) that the directions are mapped onto (the formed)",
    )
    hand_over.add_argument(
        "--scale",
        type=_positive,
        default=1.0,
        metavar="FACTOR",
        help="mm per unit of the mesh's or the line's lengths (1)",
    )
    hand_over.add_argument(
        "--within",
        type=_positive,
        metavar="MM",
        help="what is farther is off the sheet (of a mesh: the spacing; of a line: the thickness)",
    )
    hand_over.add_argument(
        "--axis",
        type=_one_of(*AXES),
        default="warp",
        metavar="|".join(AXES),
        help="calculix: what local 1 is (warp)",
    )
    hand_over.add_argument(
        "--reference",
        type=_direction,
        default=(1.0, 0.0, 0.0),
        metavar="X,Y,Z",
        help="radioss, optistruct: direction that angles run from (1,0,0)",
    )
    deck = parser.add_argument_group("with --deck")
    _add_scene(deck)
    deck.add_argument(
        "--size", type=_positive, metavar="MM", help="spacing of fibre lines (the scene's, or 5)"
    )
    _add_out(parser)


def _add_plot(commands: Any) -> None:
    parser = commands.add_parser(
        "plot",
        help="pictures of results, one or several side by side, and their table",
        description="Pictures of saved results on one scale of colours, marked where the fabric "
        "locks, from the files of their folders; and a table of their key numbers.",
        allow_abbrev=False,
    )
    parser.add_argument("folders", type=_path, nargs="+", metavar="DIR", help="folders of results")
    parser.add_argument(
        "--table", action="store_true", help="print the table alone; draw and write nothing"
    )
    parser.add_argument(
        "--only",
        type=_names_of(*pictures.PICTURES),
        metavar="NAME,...",
        help=f"some of {', '.join(pictures.PICTURES)} (all)",
    )
    parser.add_argument(
        "--travel", type=_positive, metavar="MM", help="show the states nearest to it (the last)"
    )
    parser.add_argument(
        "--scale",
        type=_positive,
        metavar="DEG",
        help="end of the colour scale (round, beyond all shear angles and the locking angle)",
    )
    parser.add_argument(
        "--animate",
        type=_one_of("gif", "mp4"),
        metavar="gif|mp4",
        help="also write the travel as an animation (mp4 needs ffmpeg)",
    )
    _add_out(parser)


def _add_view(commands: Any) -> None:
    parser = commands.add_parser(
        "view",
        help="a result as a page to be turned, zoomed and probed in a browser",
        description="Write a saved result as one HTML file that needs nothing else: turned, zoomed "
        "and probed in any browser. Needs plotly (pip install 'quasiform[report]').",
        allow_abbrev=False,
    )
    parser.add_argument("folder", type=_path, metavar="DIR", help="folder of a result")
    parser.add_argument(
        "--travel", type=_positive, metavar="MM", help="show the state nearest to it (the last)"
    )
    parser.add_argument(
        "--out", type=_path, metavar="FILE.html", help="(a new one named after the folder)"
    )
    parser.add_argument("--force", action="store_true", help="replace the file in --out")
    parser.add_argument("--open", action="store_true", help="open it in the browser")


def _add_new(commands: Any) -> None:
    parser = commands.add_parser(
        "new",
        help="a commented scene file to start from",
        description="Write a forming scene with comments: it runs as it is.",
        allow_abbrev=False,
    )
    parser.add_argument("file", type=_path, metavar="FILE.toml", help="name of the scene")
    parser.add_argument("--force", action="store_true", help="replace FILE.toml")


def _add_doctor(commands: Any) -> None:
    commands.add_parser(
        "doctor",
        help="versions, linear solvers, threads and optional parts that were found",
        description="Tell what this installation has, a line each.",
        allow_abbrev=False,
    )


def _add_completion(commands: Any) -> None:
    parser = commands.add_parser(
        "completion",
        help="a script that lets the shell complete commands and options",
        description="Print the script; for good, put into ~/.bashrc the line: "
        'eval "$(quasiform completion bash)"',
        allow_abbrev=False,
    )
    parser.add_argument(
        "shell", type=_one_of(*completion.SHELLS), metavar="SHELL", help="bash (zsh reads it too)"
    )


def _add_validate(commands: Any) -> None:
    parser = commands.add_parser(
        "validate",
        help="the validation suite, with a report",
        description="Run validation cases, compare them with their references, write a report.",
        epilog="Exit status: 0 every band held; 1 a band was missed, or a case, value or reference "
        "is missing.",
        allow_abbrev=False,
    )
    parser.add_argument("cases", nargs="*", metavar="CASE", help="names of cases (all)")
    parser.add_argument("--quick", action="store_true", help="the quick suite: under 5 minutes")
    _add_out(parser)


def _add_scene(parser: argparse._ActionsContainer) -> None:
    """What may be changed of a forming scene."""
    parser.add_argument(
        "--orientation", type=_degrees, metavar="DEG", help="angle of the warp to x (the scene's)"
    )
    _add_law(parser, None, "the scene's")
    parser.add_argument(
        "--travel", type=_positive, metavar="MM", help="travel of the punch (the scene's)"
    )
    parser.add_argument(
        "--symmetry",
        type=_one_of("auto", "none"),
        metavar="auto|none",
        help="model a half or a quarter where everything is mirrored, or always the whole "
        "(the scene's, or auto)",
    )


def _add_out(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--out",
        type=_path,
        metavar="DIR",
        help="folder of the result (a new one named after the case)",
    )
    parser.add_argument("--force", action="store_true", help="replace the result in --out")


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--increment",
        type=_positive,
        metavar="MM",
        help="travel of an increment (chosen by the program)",
    )
    _add_out(parser)
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="print the model and the expected time; solve and write nothing",
    )
    parser.add_argument(
        "--linear",
        type=_one_of(*LINEAR_SOLVERS),
        default="auto",
        metavar="|".join(LINEAR_SOLVERS),
        help="advanced: the linear solver (auto)",
    )


def _add_law(
    parser: argparse._ActionsContainer, default: str | None = "locking", word: str = "locking"
) -> None:
    parser.add_argument(
        "--law",
        default=default,
        metavar="|".join([*PRESETS, "FILE.toml"]),
        help=f"material ({word})",
    )


def _positive(text: str) -> float:
    try:
        return check_number("value", float(text))
    except ValueError:  # of float, or an InputError
        raise argparse.ArgumentTypeError(f"expected a positive number, got '{text}'") from None


def _count(text: str) -> int:
    if not text.isdecimal() or not 0 < int(text) <= 1000:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1 to 1000, got '{text}'")
    return int(text)


def _degrees(text: str) -> float:
    with suppress(ValueError):
        if isfinite(number := float(text)):
            return number
    raise argparse.ArgumentTypeError(f"expected a number of degrees, got '{text}'")


def _kept(text: str) -> dict[str, float]:
    kept = {}
    for entry in text.split(","):
        name, _, value = entry.partition("=")
        if name.strip() not in NAMES:
            raise argparse.ArgumentTypeError(
                f"unknown parameter '{name.strip()}': {suggestion(name.strip(), NAMES)}"
            )
        try:
            kept[name.strip()] = float(value)
        except ValueError:
            raise argparse.ArgumentTypeError(
                f"expected NAME=VALUE,... such as I_lo=0.819, got '{entry}'"
            ) from None
    return kept


def _by_quantity(text: str) -> dict[str, str]:
    """Words by quantity; a comma is part of a word unless NAME= follows, a quote is not."""
    words = {}
    for entry in re.split(r",(?=\s*\w+\s*=)", text):
        name, _, word = (part.strip() for part in entry.partition("="))
        if name not in QUANTITIES:
            raise argparse.ArgumentTypeError(
                f"unknown quantity '{name}': {suggestion(name, QUANTITIES)}"
            )
        word = word.strip("\"'")
        if not word or name in words:
            raise argparse.ArgumentTypeError(
                f"expected NAME=WORD,... with each name once, such as force=3, got '{text}'"
            )
        words[name] = word
    return words


def _names_of(*known: str) -> Callable[[str], tuple[str, ...]]:
    check = _one_of(*known)
    return lambda text: tuple(check(word.strip()) for word in text.split(","))


def _planes(text: str) -> tuple[str, ...]:
    planes = tuple(word.strip() for word in text.split(","))
    if planes not in (("x",), ("y",), ("x", "y"), ("y", "x")):
        raise argparse.ArgumentTypeError(f"expected x, y or x,y, got '{text}'")
    return planes


def _direction(text: str) -> tuple[float, float, float]:
    with suppress(ValueError):
        x, y, z = (float(word) for word in text.split(","))
        if any((x, y, z)) and isfinite(x + y + z):
            return x, y, z
    raise argparse.ArgumentTypeError(f"expected X,Y,Z of a direction, got '{text}'")


def _area(text: str) -> tuple[str, tuple[tuple[float, float], float]]:
    name, _, numbers = text.partition("=")
    with suppress(ValueError):
        x, y, radius = (float(word) for word in numbers.split(","))
        if name and isfinite(x) and isfinite(y) and 0 < radius < float("inf"):
            return name, ((x, y), radius)
    raise argparse.ArgumentTypeError(f"expected NAME=X,Y,RADIUS in mm, got '{text}'")


def _path(text: str) -> Path:
    if not text:
        raise argparse.ArgumentTypeError("expected the name of a folder, got ''")
    return Path(text)


def _one_of(*known: str) -> Callable[[str], str]:
    def check(text: str) -> str:
        if text not in known:
            raise argparse.ArgumentTypeError(f"unknown value '{text}': {suggestion(text, known)}")
        return text

    return check


def _add_number(
    parser: argparse.ArgumentParser,
    option: str,
    default: float,
    unit: str,
    text: str,
    check: Callable[[str], float] = _positive,
) -> None:
    parser.add_argument(
        option, type=check, default=default, metavar=unit, help=f"{text} ({default:g})"
    )
