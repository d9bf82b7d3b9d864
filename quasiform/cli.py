"""The command line: arguments to a scene, a scene to a result, a result to its folder.

Exit status: 0 the goal was reached; 1 `compare` found a band missed; 2 wrong input, with one line;
3 the run ended early.
"""

from __future__ import annotations

import argparse
import csv
import os
import re
import sys
import webbrowser
from collections.abc import Callable, Sequence
from contextlib import chdir, suppress
from itertools import count
from math import isfinite
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

import numpy as np

from . import completion, doctor, forecast, pictures, saved, view
from .checks import InputError, check_number, suggestion
from .compare import FILES as COMPARISON_FILES
from .compare import compare
from .compare.comparison import ALIGN, STANDINGS
from .experiments import off_axis_tension
from .export import FORMATS, abaqus_deck, export, flat_pattern
from .export.fibres import AXES
from .export.handover import FILES as HANDOVER_FILES
from .export.pattern import FILES as PATTERN_FILES
from .files import FILES, INCREMENTS, check_folder, replaced
from .forming import forming
from .identification import Identification, identify
from .identification.campaign import KINDS, METHODS, Campaign, load
from .identification.fit import ALGORITHMS, NAMES
from .identification.identified import FILES as MATERIAL_FILES
from .material import PRESETS
from .progress import LiveProgress
from .result import Result, package_version
from .scene import Scene
from .scene_file import built_in
from .solve import Journal, refine, solve, spread
from .solve.linear import NAMES as LINEAR_SOLVERS

# What a scene is made from, of the arguments of its command; kept for `resume`
SCENES: dict[str, Callable[[argparse.Namespace], Scene]] = {
    "oat": lambda given: off_axis_tension(
        given.angle, given.law, given.length, given.width, given.displacement, given.size
    ),
    "form": lambda given: forming(
        given.scene, given.orientation, given.law, given.size, given.travel, given.symmetry
    ),
}
RECIPE = (
    *("command", "directory", "angle", "law", "length", "width", "displacement", "size"),
    *("scene", "orientation", "travel", "symmetry", "accuracy", "increment", "linear", "seeds"),
)

COMPARED_BY = (
    *("field", "angle", "radians", "signed", "orientation", "values", "coordinates", "scale"),
    *("history", "force_factor", "travel", "reference_travel", "by", "within", "align", "mirror"),
    *("standing", "band_angle", "band_outline", "band_force"),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    try:
        return _run(_arguments(sys.argv[1:] if argv is None else argv))
    except InputError as error:
        print("quasiform:", " ".join(str(error).split()), file=sys.stderr)
        return 2
    except MemoryError:
        print("quasiform: not enough memory: choose a larger --size", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("quasiform: interrupted: only what was written before is kept", file=sys.stderr)
        return 3


def _run(arguments: argparse.Namespace) -> int:
    return arguments.run(arguments)


def _solve(arguments: argparse.Namespace) -> int:
    scene = SCENES[arguments.command](arguments)
    if arguments.dry_run:
        _say(_describe(scene))
        one_mesh = getattr(arguments, "size", None) is not None
        seeds = getattr(arguments, "seeds", None) or 0
        found = forecast.meshes(scene, one_mesh, arguments.linear, seeds)
        _say(f"  expected time: {forecast.words(found)}")
        if getattr(arguments, "accuracy", None):
            _say("  and longer where --accuracy asks for a finer mesh than that")
        return 0
    recipe = {name: value for name, value in vars(arguments).items() if name in RECIPE}
    recipe["directory"] = str(Path.cwd())
    folder = arguments.out or _unused(_case(scene.name))
    journal = Journal(folder, recipe, force=arguments.force)
    return _record(scene, arguments, journal)


def _resume(arguments: argparse.Namespace) -> int:
    journal = Journal(arguments.folder, resume=True)
    recipe = journal.recipe if isinstance(journal.recipe, dict) else {}
    if str(recipe.get("command")) not in SCENES or not set(recipe) <= set(RECIPE):
        raise InputError(
            f"{arguments.folder}: the run there was not started by a command; carry it on with "
            "solve(scene, out=..., resume=True)"
        )
    given = argparse.Namespace(**(dict.fromkeys(RECIPE) | recipe))
    try:
        with chdir(str(given.directory)):
            scene = SCENES[given.command](given)
    except TypeError as error:
        raise InputError(f"{arguments.folder}: not a record of a run ({error})") from error
    except OSError as error:
        raise InputError(f"{given.directory}: {error.strerror}") from error
    return _record(scene, given, journal)


def _record(scene: Scene, arguments: argparse.Namespace, journal: Journal) -> int:
    """Solve a scene and leave its files in the journal's folder."""
    folder = journal.folder
    _say(f"writing to {folder}")
    _say(_describe(scene))
    increment, linear = arguments.increment, arguments.linear
    with LiveProgress(scene.travel) as callback:
        if getattr(arguments, "size", None) is None:
            result = refine(scene, callback, arguments.accuracy, increment, linear, out=journal)
        else:
            result = solve(scene, callback, increment, linear=linear, out=journal)
    if result.status == "completed" and getattr(arguments, "seeds", None):
        try:
            spread(result, range(1, arguments.seeds + 1))
        except KeyboardInterrupt:
            result.reason = "interrupted while perturbed starts were solved"
        journal.close(result)
    _say(_report(result))
    written = [name for name in FILES if (folder / name).exists()]
    if scene.outputs["increments"]:
        written.append(f"{len(list(folder.glob(INCREMENTS)))} {INCREMENTS}")
    _say(f"files in {folder}: {', '.join(written)}")
    return 0 if result.status == "completed" else 3


def _identify(arguments: argparse.Namespace) -> int:
    folder = arguments.out or _unused(_case(arguments.file.stem) + "-fabric")
    check_folder(folder, force=arguments.force, names=MATERIAL_FILES)
    names = ("kind", "length", "width", "angle", "side", "thickness", "method", "keep")
    names += ("algorithm", "size", "name")
    given = {name: getattr(arguments, name) for name in names}
    campaign = load(arguments.file, **{k: v for k, v in given.items() if v is not None})
    if arguments.dry_run:
        _say(_campaign(campaign))
        return 0
    _say(f"writing to {folder}")
    _say(_campaign(campaign))
    found = identify(campaign)
    found.save(folder, force=arguments.force)
    _say(_identified(found))
    written = [name for name in MATERIAL_FILES if (folder / name).exists()]
    _say(f"files in {folder}: {', '.join(written)}")
    return 0


def _compare(arguments: argparse.Namespace) -> int:
    result, reference = arguments.result, arguments.reference
    folder = arguments.out or _unused(_case(f"{result.name}-beside-{reference.stem}"))
    check_folder(folder, force=arguments.force, names=COMPARISON_FILES)
    given = {name: getattr(arguments, name) for name in COMPARED_BY}
    given = {name: value for name, value in given.items() if value is not None}
    if arguments.area:
        given["areas"] = dict(arguments.area)
    comparison = compare(result, reference, **given)
    _say(f"writing to {folder}")
    comparison.save(folder, force=arguments.force)
    _say("\n".join([comparison.table(), *(f"  {note}" for note in comparison.notes)]))
    written = [name for name in COMPARISON_FILES if (folder / name).exists()]
    _say(f"files in {folder}: {', '.join(written)}")
    return 0 if comparison.held else 1


def _export(arguments: argparse.Namespace) -> int:
    if arguments.deck:
        return _deck(arguments)
    source = Path(arguments.source)
    kind = "pattern" if arguments.trim is not None else arguments.to
    folder = arguments.out or _unused(_case(f"{source.resolve().name}-{kind}"))
    names = PATTERN_FILES if arguments.trim is not None else HANDOVER_FILES
    check_folder(folder, force=arguments.force, names=names)
    if arguments.trim is not None:
        pattern = flat_pattern(
            source, arguments.trim, within=arguments.within, scale=arguments.scale
        )
        _say(f"writing to {folder}")
        pattern.save(folder, force=arguments.force)
        _say(f"{len(pattern.trim)} lines to cut, {pattern.area:.6g} mm² inside")
        notices, written = pattern.notices, PATTERN_FILES
    else:
        handed = export(
            source,
            arguments.to,
            folder,
            mesh=arguments.mesh,
            scale=arguments.scale,
            within=arguments.within,
            axis=arguments.axis,
            reference=arguments.reference,
            force=arguments.force,
        )
        _say(f"writing to {folder}")
        notices, written = handed.notices, handed.files
    _say("\n".join(f"  note: {notice}" for notice in notices))
    _say(f"files in {folder}: {', '.join(written)}")
    return 0


def _deck(arguments: argparse.Namespace) -> int:
    arguments.scene = arguments.source
    scene = SCENES["form"](arguments)
    folder = arguments.out or _unused(_case(f"{scene.name}-deck"))
    name = f"{_case(scene.name)}.inp"
    check_folder(folder, force=arguments.force, names=(name,))
    _say(f"writing to {folder}")
    notices = abaqus_deck(scene, folder / name, force=arguments.force)
    _say("\n".join(f"  note: {notice}" for notice in notices))
    _say(f"files in {folder}: {name}")
    return 0


def _plot(arguments: argparse.Namespace) -> int:
    runs = [saved.read(folder) for folder in arguments.folders]
    if arguments.travel is not None:
        runs = [run.near(arguments.travel) for run in runs]
    rows = pictures.table(runs)
    if arguments.table:
        _say(_across(rows))
        return 0
    pictures.check_animation(arguments.animate)
    one = f"{_case(runs[0].label)}-pictures" if len(runs) == 1 else "pictures"
    folder = arguments.out or _unused(one)
    check_folder(folder, force=arguments.force, names=pictures.FILES)
    _say(f"writing to {folder}")
    with replaced(folder, force=arguments.force, names=pictures.FILES) as staging:
        notes = pictures.save(runs, staging, arguments.only, arguments.scale, arguments.animate)
        with (staging / "table.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows(rows)
    _say("\n".join([_across(rows), *(f"  note: {note}" for note in notes)]))
    written = [name for name in pictures.FILES if (folder / name).exists()]
    _say(f"files in {folder}: {', '.join(written)}")
    return 0


def _view(arguments: argparse.Namespace) -> int:
    run = saved.read(arguments.folder)
    if arguments.travel is not None:
        run = run.near(arguments.travel)
    path = arguments.out or _unused(_case(run.label), ".html")
    if path.exists() and not arguments.force:
        raise InputError(f"{path} is there already: choose another, or replace it with --force")
    view.save(run, path)
    _say(view.words(run))
    _say(f"file: {path}")
    if arguments.open and not webbrowser.open(path.resolve().as_uri()):
        raise InputError(f"no browser was found: open {path} yourself")
    return 0


def _new(arguments: argparse.Namespace) -> int:
    path = arguments.file
    if path.suffix != ".toml":
        raise InputError(f"{path}: expected the name of a .toml file")
    if path.exists() and not arguments.force:
        raise InputError(f"{path} is there already: choose another, or replace it with --force")
    template = (Path(__file__).parent / "new.toml").read_text(encoding="utf-8")
    try:
        path.write_text(template.replace("NAME", _case(path.stem)), encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write to {path}: {error.strerror or error}") from error
    _say(f"file: {path}\nlook at it: quasiform form {path} --dry-run")
    return 0


def _doctor(arguments: argparse.Namespace) -> int:
    _say("\n".join(f"{name:<24}{state}" for name, state in doctor.examine()))
    return 0


def _validate(arguments: argparse.Namespace) -> int:
    return _suite().validate(
        arguments.cases, quick=arguments.quick, out=arguments.out, force=arguments.force
    )


def _suite() -> ModuleType:
    """The command of the validation suite, which lies beside the package or in its wheel."""
    folder = Path(__file__).parent / "suite"
    if not folder.is_dir():  # a clone
        folder = Path(__file__).parent.parent
    if not (folder / "validation" / "run.py").is_file():
        raise InputError("the validation suite is not installed with this package")
    sys.path.insert(0, str(folder))
    from validation import run

    return run


# Arguments


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, told by `main`."""

    def error(self, message: str) -> NoReturn:
        raise InputError(message.removeprefix("argument "))


def _arguments(argv: Sequence[str]) -> argparse.Namespace:
    parser = _Parser(
        prog="quasiform",
        description="Implicit, quasi-static forming of dry 0°/90° biaxial non-crimp fabrics.",
        epilog="Lengths in mm, forces in N, angles in degrees. "
        "Exit status: 0 completed, 1 a band missed, 2 wrong input, 3 ended early.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"quasiform {package_version()}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    _add_oat(commands)
    _add_form(commands)
    _add_identify(commands)
    _add_validate(commands)
    _add_compare(commands)
    _add_export(commands)
    _add_resume(commands)
    _add_plot(commands)
    _add_view(commands)
    _add_new(commands)
    _add_doctor(commands)
    _add_completion(commands)
    # the options before a command take no value, so the first word without a dash is the command
    command = next((word for word in argv if not word.startswith("-")), None)
    if command is not None and command not in commands.choices:
        raise InputError(f"unknown command '{command}': {suggestion(command, commands.choices)}")
    arguments, unknown = parser.parse_known_args(argv)
    if arguments.command is None:
        raise InputError(f"expected a command: {' or '.join(commands.choices)} (see --help)")
    for word in unknown:
        if not word.startswith("-"):
            raise InputError(f"unexpected argument '{word}'")
        option = word.split("=")[0]
        known = re.findall(r"--[a-z-]+", commands.choices[arguments.command].format_usage())
        raise InputError(f"unknown option '{option}': {suggestion(option, known)}")
    return arguments


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
    parser.add_argument(
        "--orientation", type=_degrees, metavar="DEG", help="angle of the warp to x (the scene's)"
    )
    _add_law(parser, None, "the scene's")
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
        "--travel", type=_positive, metavar="MM", help="travel of the punch (the scene's)"
    )
    parser.add_argument(
        "--symmetry",
        type=_one_of("auto", "none"),
        metavar="auto|none",
        help="model a half or a quarter where everything is mirrored, or always the whole "
        "(the scene's, or auto)",
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
    _add_out(parser)
    parser.add_argument(
        "--dry-run", action="store_true", help="read the tests, tell what is in them; write nothing"
    )
    parser.set_defaults(run=_identify)


def _add_resume(commands: Any) -> None:
    parser = commands.add_parser(
        "resume",
        help="carry on a run that was killed or stopped",
        description="Carry on a run of `oat` or `form` from the last increment in its folder.",
        allow_abbrev=False,
    )
    parser.add_argument("folder", type=_path, metavar="DIR", help="folder of the run")
    parser.set_defaults(run=_resume)


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
    parser.set_defaults(run=_compare)


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
    deck.add_argument(
        "--orientation", type=_degrees, metavar="DEG", help="angle of the warp to x (the scene's)"
    )
    _add_law(deck, None, "the scene's")
    deck.add_argument(
        "--size", type=_positive, metavar="MM", help="spacing of fibre lines (the scene's, or 5)"
    )
    deck.add_argument(
        "--travel", type=_positive, metavar="MM", help="travel of the punch (the scene's)"
    )
    deck.add_argument(
        "--symmetry",
        type=_one_of("auto", "none"),
        metavar="auto|none",
        help="a half or a quarter where everything is mirrored, or always the whole (auto)",
    )
    _add_out(parser)
    parser.set_defaults(run=_export)


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
    parser.set_defaults(run=_plot)


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
    parser.set_defaults(run=_view)


def _add_new(commands: Any) -> None:
    parser = commands.add_parser(
        "new",
        help="a commented scene file to start from",
        description="Write a forming scene with comments: it runs as it is.",
        allow_abbrev=False,
    )
    parser.add_argument("file", type=_path, metavar="FILE.toml", help="name of the scene")
    parser.add_argument("--force", action="store_true", help="replace FILE.toml")
    parser.set_defaults(run=_new)


def _add_doctor(commands: Any) -> None:
    parser = commands.add_parser(
        "doctor",
        help="versions, linear solvers, threads and optional parts that were found",
        description="Tell what this installation has, a line each.",
        allow_abbrev=False,
    )
    parser.set_defaults(run=_doctor)


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

    def run(arguments: argparse.Namespace) -> int:
        more = {"form": " ".join(built_in()), "completion": " ".join(completion.SHELLS)}
        _say(completion.script(commands.choices, more))
        return 0

    parser.set_defaults(run=run)


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
    parser.set_defaults(run=_validate)


def _add_out(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--out",
        type=_path,
        metavar="DIR",
        help="folder of the result (a new one named after the case)",
    )
    parser.add_argument("--force", action="store_true", help="replace the result in --out")


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=_solve)
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
    parser: argparse.ArgumentParser, default: str | None = "locking", word: str = "locking"
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


def _case(name: str) -> str:
    """Name of a folder for a case."""
    return re.sub(r"[^\w.+-]+", "-", name).lstrip(".-") or "result"


def _unused(name: str, suffix: str = "") -> Path:
    """First of name, name-2, name-3, ... that does not exist."""
    names = (f"{name}{suffix}" if i == 1 else f"{name}-{i}{suffix}" for i in count(1))
    return next(path for path in map(Path, names) if not os.path.lexists(path))


# What is said


def _say(text: str) -> None:
    """Print; a reader that has gone away (`| head`) does not end the run."""
    shown = "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)
    encoding = sys.stdout.encoding or "utf-8"
    try:
        print(shown.encode(encoding, "backslashreplace").decode(encoding), flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _describe(scene: Scene) -> str:
    """Return the model in words: its size, what is in it and what was left out, and why."""
    blank = scene.blank
    return "\n".join(
        [
            f"{scene.name}: {len(blank.nodes)} nodes, {len(blank.triangles)} triangles, "
            f"{(~scene.fixed).sum()} dofs, travel {scene.travel:g} mm",
            f"  fabric: {scene.fabric.name}",
            *(f"  {entry}: {why}" for entry, why in scene.model),
        ]
    )


def _report(result: Result) -> str:
    summary = result.summary()
    reached = f"{summary['reached_mm']:.4g} of {result.scene.travel:.4g} mm"
    gamma = summary["shear_angle_deg"]
    rows = {
        "force": f"{summary['force_N']:.4g} N",
        "shear angle": f"max {gamma['max']:.2f}, p99 {gamma['p99']:.2f}, "
        f"mean {gamma['mean']:.2f} deg",
    }
    if "draw_in_mm" in summary:
        rows["draw-in"] = _pairs(summary["draw_in_mm"], ".2f") + " mm"
        rows["areas"] = _pairs(summary["areas"], ".2f") + " deg (mean shear angle)"
    errors = summary["error_estimate"]
    if errors["shear_angle_deg"] is not None:
        rows["error estimate"] = (
            f"shear angle {errors['shear_angle_deg']:.2g} deg, force {errors['force_N']:.2g} N"
        )
    if summary["collapse"]:
        rows["collapse"] = (
            "from {travel_mm:.4g} mm on, first at X = ({at[0]:.1f}, {at[1]:.1f}) mm, "
            "{shear_angle_deg:.1f} deg".format(**summary["collapse"])
        )
    certified = summary["certified"]
    if summary["one_of_many"]:
        rows["one of many"] = summary["one_of_many"]
    if summary["spread"]:
        rows["robust"] = ", ".join(k for k, v in summary["spread"].items() if v["robust"]) or "none"
    if summary["path_size_mm"]:
        rows["path"] = f"followed at size {summary['path_size_mm']:g} mm"
    rows["certified"] = "yes" if certified is True else f"no: {certified}"
    rows["linear solves"] = (
        f"{summary['linear_solves']:g} ({summary['solver']['linear']}) "
        f"in {summary['increments']} increments"
    )
    rows["wall time"] = f"{summary['wall_s']:.1f} s"
    reason = f": {summary['reason']}" if summary["reason"] else ""
    return "\n".join(
        [f"{summary['status']} at {reached}{reason}"]
        + [f"  {name:<15}{value}" for name, value in rows.items()]
    )


def _campaign(campaign: Campaign) -> str:
    rows = [f"{campaign.name}: {METHODS[campaign.method]}"]
    for test in campaign.shear:
        gamma = np.degrees(test.forces(campaign.fabric.thickness).angles[0])
        rows.append(
            f"  {test.name}: {len(gamma)} rows, shear angle {gamma.min():.1f} to "
            f"{gamma.max():.1f} deg, force to {test.curve.force.max():.4g} "
            + ("N/mm" if test.curve.per_length else "N")
        )
        rows += [f"    {notice}" for notice in test.curve.notices]
    for family, stiffness in campaign.bending.items():
        rows.append(f"  cantilever, {family}: {stiffness.value:.4g} N mm")
    return "\n".join(rows)


def _identified(found: Identification) -> str:
    rows = []
    for p in found.parameters:
        interval = f"{p.low:.4g} to {p.high:.4g}" if p.low == p.low else "-"
        rows.append(f"  {p.name:<15}{p.value:<11.5g}{p.unit:<6}{interval:<24}{p.state}")
    if found.curve is not None:
        misfit = found.fabric.provenance["force_misfit_percent"]
        rows.append(
            f"  tested from {found.curve.low:.1f} to {found.curve.high:.1f} degrees of shear, "
            f"forces within {misfit:g} % (root mean square)"
        )
    if found.fitted is not None:
        first, third = found.fitted.stages
        rows.append(f"  first stage to {first:.1f} degrees, third from {third:.1f} degrees")
    read = {notice for test in found.campaign.shear for notice in test.curve.notices}
    notes = [f"  note: {notice}" for notice in found.notices if notice not in read]
    return "\n".join(["identified, with 95 % intervals", *rows, *notes])


def _across(rows: list[list[str]]) -> str:
    """Return a table on its side: a line for each heading, a column for each row."""
    columns = [[str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in columns]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in zip(*columns, strict=True)
    )


def _pairs(table: dict[str, Any], form: str) -> str:
    """Return the entries in words; an area without a triangle has no value."""
    return ", ".join(
        f"{key} {'none' if value is None or value != value else format(value, form)}"
        for key, value in table.items()
    )
