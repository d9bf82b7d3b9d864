"""The command line: what each command does with its arguments, and what it says.

Exit status: 0 the goal was reached; 1 `compare` found a band missed; 2 wrong input, with one line;
3 the run ended early.
"""

from __future__ import annotations

import argparse
import csv
import os
import re
import sys
import time
import webbrowser
from collections.abc import Callable, Sequence
from contextlib import chdir
from itertools import count
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ..checks import InputError
from ..comparison import FILES as COMPARISON_FILES
from ..comparison import compare
from ..draw import pictures, view
from ..handover import abaqus_deck, export, flat_pattern
from ..handover.handover import FILES as HANDOVER_FILES
from ..handover.handover import NOTES as HANDOVER_NOTES
from ..handover.pattern import FILES as PATTERN_FILES
from ..handover.pattern import NOT_MODELLED
from ..identification import Identification, identify
from ..identification.campaign import METHODS, Campaign, load
from ..identification.identified import FILES as MATERIAL_FILES
from ..model import Scene
from ..result.files import FILES, INCREMENTS, RESUME, check_folder, replaced
from ..result.record import Record
from ..result.run import Result
from ..scenes.fabric_tests import off_axis_tension
from ..scenes.forming import forming
from ..scenes.scene_file import built_in
from ..solve import Journal, refine, solve, spread
from . import completion, doctor, forecast
from .arguments import commands, parse
from .progress import LiveProgress

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

WIDE = 2.0  # degrees: an error of the shear angle that is pointed out
SPREAD = ("force_N", "shear_angle_deg", "shear_angle_mean_deg")  # what is said of perturbed starts

COMPARED_BY = (
    *("field", "angle", "radians", "signed", "orientation", "values", "coordinates", "scale"),
    *("history", "force_factor", "travel", "reference_travel", "by", "within", "align", "mirror"),
    *("standing", "band_angle", "band_outline", "band_force"),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    try:
        return _run(parse(sys.argv[1:] if argv is None else argv))
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
    return COMMANDS[arguments.command](arguments)


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
    folder, clock = journal.folder, time.perf_counter()
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
    _say(f"  {'all in all':<15}{time.perf_counter() - clock:.1f} s, with error estimate and files")
    if (folder / RESUME).exists():
        _say(f"carry on with: quasiform resume {folder}")
    written = [name for name in FILES if (folder / name).exists()]
    if scene.outputs["increments"]:
        written.append(f"{len(list(folder.glob(INCREMENTS)))} {INCREMENTS}")
    _say(f"files in {folder}: {', '.join(written)}")
    return 0 if result.status == "completed" else 3


def _identify(arguments: argparse.Namespace) -> int:
    folder = arguments.out or _unused(_case(arguments.file.stem) + "-fabric")
    check_folder(folder, force=arguments.force, names=MATERIAL_FILES)
    names = ("kind", "length", "width", "angle", "side", "thickness", "method", "keep")
    names += ("algorithm", "size", "name", "columns", "units")
    given = {name: getattr(arguments, name) for name in names}
    campaign = load(arguments.file, **{k: v for k, v in given.items() if v is not None})
    if arguments.dry_run:
        _say(_campaign(campaign))
        return 0
    _say(f"writing to {folder}")
    _say(_campaign(campaign))
    if campaign.shear:
        loop = " or minutes, with finite elements in the loop"
        _say(f"fitting, some seconds{loop if campaign.method == 'inverse' else ''}")
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
        lines = "1 line" if len(pattern.trim) == 1 else f"{len(pattern.trim)} lines"
        _say(f"{lines} to cut, {pattern.area:.6g} mm² inside")
        notices, general, told = pattern.notices, NOT_MODELLED, "pattern.txt"
        written = [name for name in PATTERN_FILES if (folder / name).exists()]
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
        notices, general, told = handed.notices, handed.general, HANDOVER_NOTES
        written = handed.files
    own = [f"  note: {notice}" for notice in notices if notice not in general]
    _say("\n".join([*own, f"  and {len(general)} notes true of every such export, in {told}"]))
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
    runs = [Record.read(folder) for folder in arguments.folders]
    if arguments.travel is not None:
        runs = [run.near(arguments.travel) for run in runs]
    rows = pictures.table(runs)
    if arguments.table:
        _say(_across(rows))
        return 0
    pictures.check_animation(arguments.animate)
    one = f"{_case(runs[0].name)}-pictures" if len(runs) == 1 else "pictures"
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
    run = Record.read(arguments.folder)
    if arguments.travel is not None:
        run = run.near(arguments.travel)
    path = arguments.out or _unused(_case(run.name), ".html")
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


def _completion(arguments: argparse.Namespace) -> int:
    more = {"form": " ".join(built_in()), "completion": " ".join(completion.SHELLS)}
    _say(completion.script(commands(), more))
    return 0


def _validate(arguments: argparse.Namespace) -> int:
    return _suite().validate(
        arguments.cases, quick=arguments.quick, out=arguments.out, force=arguments.force
    )


def _suite() -> ModuleType:
    """The command of the validation suite, which lies beside the package or in its wheel."""
    folder = Path(__file__).parents[1] / "suite"
    if not folder.is_dir():  # a clone
        folder = Path(__file__).parents[2]
    if not (folder / "validation" / "run.py").is_file():
        raise InputError("the validation suite is not installed with this package")
    sys.path.insert(0, str(folder))
    from validation import run

    return run


def _case(name: str) -> str:
    """Name of a folder for a case."""
    return re.sub(r"[^\w.+-]+", "-", name).lstrip(".-") or "result"


def _unused(name: str, suffix: str = "") -> Path:
    """First of name, name-2, name-3, ... that does not exist."""
    names = (f"{name}{suffix}" if i == 1 else f"{name}-{i}{suffix}" for i in count(1))
    return next(path for path in map(Path, names) if not os.path.lexists(path))


COMMANDS: dict[str, Callable[[argparse.Namespace], int]] = {
    "oat": _solve,
    "form": _solve,
    "identify": _identify,
    "validate": _validate,
    "compare": _compare,
    "export": _export,
    "resume": _resume,
    "plot": _plot,
    "view": _view,
    "new": _new,
    "doctor": _doctor,
    "completion": _completion,
}


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
    errors = {k: v for k, v in summary["estimated_errors"].items() if v is not None}
    rows = {
        "force": f"{summary['force_N']:.4g}{_off(errors, 'force_N')} N",
        "shear angle": f"max {gamma['max']:.2f}, p99 {gamma['p99']:.2f}"
        f"{_off(errors, 'shear_angle_deg')}, mean {gamma['mean']:.2f}"
        f"{_off(errors, 'shear_angle_mean_deg')} deg",
    }
    if "draw_in_mm" in summary:
        found = {name: _off(errors, f"draw_in_{name}_mm") for name in summary["draw_in_mm"]}
        rows["draw-in"] = _pairs(summary["draw_in_mm"], ".2f", found) + " mm"
    if summary.get("areas"):
        found = {name: _off(errors, f"area_{name}_deg") for name in summary["areas"]}
        rows["areas"] = _pairs(summary["areas"], ".2f", found) + " deg (mean shear angle)"
    if not errors:
        why = "no coarser mesh of this scene came to the same end"
        if result.reason or result.collapse:
            why = "the run stopped early" if result.reason else "the sheet has collapsed"
        rows["error estimate"] = f"none: {why}"
    elif summary["error_estimate"]["shear_angle_deg"] > WIDE:
        finer = "--accuracy 1 or a smaller" if result.scene.contacts else "a smaller"
        rows["error estimate"] = f"wide: {finer} --size narrows it"
    doubtful = {k: v for k, v in summary["doubtful_share"].items() if v >= 0.005}
    if doubtful:
        rows["doubtful"] = _pairs({k.replace("_", " "): v for k, v in doubtful.items()}, ".0%")
        rows["doubtful"] += " of the area"
    if summary["collapse"]:
        rows["collapse"] = (
            "from {travel_mm:.4g} mm on, first at X = ({at[0]:.1f}, {at[1]:.1f}) mm, "
            "{shear_angle_deg:.1f} deg".format(**summary["collapse"])
        )
    certified = summary["certified"]
    if summary["one_of_many"]:
        rows["one of many"] = summary["one_of_many"]
    if summary["spread"]:
        scattered = [k for k, v in summary["spread"].items() if not v["robust"]]
        rows["perturbed"] = ", ".join(
            f"{name} {entry['low']:.4g} to {entry['high']:.4g}"
            for name, entry in summary["spread"].items()
            if name in SPREAD
        )
        rows["perturbed"] += f"; scattered: {', '.join(scattered)}" if scattered else "; all robust"
    if summary["path_size_mm"]:
        rows["path"] = f"followed at size {summary['path_size_mm']:g} mm"
    reasons = "; ".join(summary["certificate"]["reasons"])
    rows["certified"] = "yes" if certified else f"no: {reasons}"
    rows["linear solves"] = (
        f"{summary['linear_solves']:.0f} of the finest mesh ({summary['solver']['linear']}) "
        f"in {summary['increments']} increments"
    )
    rows["wall time"] = f"{summary['wall_s']:.1f} s"
    reason = f": {summary['reason']}" if summary["reason"] else ""
    return "\n".join(
        [f"{summary['status']} at {reached}{reason}"]
        + [f"  {name:<15}{value}" for name, value in rows.items()]
    )


def _campaign(campaign: Campaign) -> str:
    fabric, origins = campaign.fabric, campaign.fabric.provenance
    method = METHODS[campaign.method] if campaign.shear else "cantilever tests"
    rows = [f"{campaign.name}: {method}"]
    if campaign.shear:
        rows.append(f"  thickness {fabric.thickness:g} mm ({origins['thickness']})")
    if campaign.bending:
        rows.append(f"  areal weight {fabric.areal_weight:g} g/m² ({origins['areal_weight']})")
    for test in campaign.shear:
        gamma = np.degrees(test.forces(fabric.thickness).angles[0])
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


def _off(errors: dict[str, float], name: str) -> str:
    """Return the estimated error of a quantity as " ± ..."; empty where there is none."""
    return f" ± {errors[name]:.2g}" if name in errors else ""


def _pairs(table: dict[str, Any], form: str, off: dict[str, str] | None = None) -> str:
    """Return the entries in words; an area without a triangle has no value."""
    return ", ".join(
        f"{key} {'none' if value is None or value != value else format(value, form)}"
        + (off or {}).get(key, "")
        for key, value in table.items()
    )
