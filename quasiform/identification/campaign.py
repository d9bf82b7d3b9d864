"""A campaign of tests on one fabric: what a TOML file, or a CSV file with its specimen, says.

name = "my fabric"
method = "fit"                          # or inverse, table, as-printed
keep = { C_lo = 1000.0, I_lo = 0.819 }  # parameters that are not fitted

[fabric]                                # what the tests do not say (Fabric's own names)
thickness = 1.004
areal_weight = 600.0

[[tests]]
kind = "off-axis"                       # length, width, angle
files = ["a.csv", "b.csv"]              # repeats of one test
angle = 45.0

[[tests]]
kind = "picture-frame"                  # side, fabric_side
files = ["frame.csv"]
to = 45.0                               # shear angles that are used, degrees (also: from)
zero = 0.35                             # where the fabric is not strained, mm; "auto"
preload = 1.0                           # force on it in the first row, N; "auto"
cycle = "last"                          # or "first", "envelope", a number

[slip]                                  # with method inverse: law and slip together
pitch = 5.0                             # of the rovings, mm
stiffness = 0.02                        # where the fit starts, N/mm³
resistance = 0.005                      # the same, MPa; inf: elastic slip only

[[tests]]
kind = "pull-out"                       # rovings drawn out of held ones: with [slip]
files = ["pull.csv"]
length = 60.0                           # of the crossing, mm
width = 20.0                            # of the drawn rovings, mm

[[tests]]
kind = "cantilever"                     # overhang and angle; or length and tip; or a profile
family = "warp"
overhang = [166.0, 163.0]

[[tests]]
kind = "bending"                        # moment over curvature of a pure-bending tester
family = "weft"
moments = "moment.csv"
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, StrictStr, Tag, create_model

from ..checks import InputError, check_number, suggestion
from ..fabric import Fabric, MomentCurve, Slip, fabric_of
from ..schema import LARGEST, OPEN, Table, checked, number, path, validated
from ..tables import read_numbers
from ..toml_file import read_toml
from .cantilever import Stiffness, from_profile, from_repeats, from_tip
from .energy_method import Forces, energy_method
from .fit import ALGORITHMS, check_kept, fit
from .loading import Part, rows_of
from .moment import read_moments
from .records import Curve, mean_of, read
from .slipping import PullOut
from .specimen import OffAxis, PictureFrame, Specimen

METHODS = {
    "fit": "six parameters by the power balance (Eq. 10, energy-consistent)",
    "inverse": "six parameters, finite-element tests in the loop",
    "table": "table by the power balance (Eq. 10, energy-consistent)",
    "as-printed": "six parameters by Eq. 10 as printed, which does not conserve energy",
}
KINDS = {"off-axis": OffAxis, "picture-frame": PictureFrame}
SIZES = {kind: tuple(f.name for f in fields(specimen)) for kind, specimen in KINDS.items()}
OF_A_TEST = ("kind", "family", "columns", "units", "from", "to", "zero", "preload", "cycle")
OF_BENDING = {"cantilever": ("profile", ("length",)), "bending": ("moments", ())}
OF_FABRIC = ("thickness", "areal_weight")
SETTINGS = ("method", "keep", "algorithm", "size")
VALUES = tuple(f.name for f in fields(Fabric) if f.name not in ("name", "provenance"))
ASSUMED = "assumed: that of "  # begins the origin of a value that no test and no user gave
SURE = 10.0  # twice the logarithm of a likelihood ratio that decides
KINEMATIC = 30.0  # degrees: of strips, by Cao et al. 2008; beyond, the fibres slip
COMPUTED = 0.2  # degrees: an angle that is nearer to the kinematic one was computed
SHORT = 2.0  # length over width: below, the zones of a strip shear less uniformly
START = 1e-3  # of the last displacement: an earlier row has no force to speak of
WITHIN = 0.95  # of the limit of the fibres: where a fit with slip starts from the power balance
LOWEST = 0.5  # degrees: below, a specimen settles in its grips


@dataclass(frozen=True)
class ShearTest:
    """Repeats of one test in shear, ready for identification."""

    name: str
    specimen: Specimen
    curve: Curve  # their mean
    low: float = LOWEST  # smallest and largest shear angle that is used, degrees
    high: float = 90.0
    whole: Curve | None = None  # also beyond the limit of the fibres, for a fit with slip

    def forces(self, thickness: float, as_printed: bool = False) -> Forces:
        """The test in the power balance; `thickness` in mm."""
        try:
            shares, angles = self.specimen.shares(self.curve, thickness, as_printed)
        except InputError as error:
            raise InputError(f"{self.name}: {error}") from error
        return Forces(self.curve.force, self.curve.sigma, shares, angles)

    def cut(self) -> Self:
        """The same test without the rows outside its angles; InputError if 8 are not left."""
        try:
            gamma, curve = np.degrees(self.specimen.angle_of(self.curve)), self.curve
        except InputError as error:
            raise InputError(f"{self.name}: {error}") from error
        used = (gamma >= self.low) & (gamma > 0) & (gamma <= self.high) & (curve.force > 0)
        if used.sum() < 8:
            raise InputError(
                f"{self.name}: only {rows_of(int(used.sum()))} with a positive force between "
                f"{self.low:g} and {self.high:g} degrees of shear, expected at least 8"
            )
        cut = replace(self, curve=_rows(curve, used))
        cut.forces(1.0)  # refuses rows beyond the limit of the fibres
        return cut

    def trusted(self) -> tuple[float, str]:
        """Largest shear angle, degrees, to which the law may count as tested; and its origin."""
        top, strip = float(self.kinematic.max()), isinstance(self.specimen, OffAxis)
        if self.measured is not None:
            return min(top, float(self.measured.max())) if strip else top, "angle measured"
        if self.curve.displacement is None:
            return top, "angle of the file"
        if strip and self.high == 90.0 and top > KINEMATIC:
            return KINEMATIC, f"kinematic angle, trusted to {KINEMATIC:g} degrees"
        return top, "kinematic angle" + ", the end is given" * (self.high < 90.0)

    @property
    def kinematic(self) -> np.ndarray:
        """(n,) shear angles of the rows by which the law is identified, degrees."""
        return np.degrees(self.specimen.angle_of(self.curve))

    @property
    def measured(self) -> np.ndarray | None:
        """(n,) angles that were measured beside a displacement, degrees, and not computed."""
        curve = self.curve
        if curve.shear_angle is None or curve.displacement is None:
            return None
        computed = self.specimen.angle_of(replace(curve, shear_angle=None))
        off = np.degrees(np.abs(curve.shear_angle - computed).max())
        return np.degrees(curve.shear_angle) if off > COMPUTED else None


@dataclass(frozen=True)
class Campaign:
    """Tests on one fabric, and how it shall be identified from them."""

    name: str
    fabric: Fabric  # of what the tests do not say; its provenance may say where a value comes from
    shear: tuple[ShearTest, ...] = ()
    bending: Mapping[str, Stiffness | MomentCurve] = field(default_factory=dict)  # by family
    method: str = "fit"  # a key of METHODS
    keep: Mapping[str, float] = field(default_factory=dict)  # parameters that are not fitted
    algorithm: str = "least-squares"
    size: float = 14.0  # cell edge of the finite-element tests, mm
    standing: str = "measured"  # of the data
    sources: tuple[Path, ...] = ()  # files it was read from
    slip: Slip | None = None  # where its fit starts
    pulled: tuple[PullOut, ...] = ()

    def __post_init__(self) -> None:
        for name, known in (("method", METHODS), ("algorithm", ALGORITHMS)):
            value = getattr(self, name)
            if not isinstance(value, str) or value not in known:
                raise InputError(f"unknown {name} {value!r}: {suggestion(str(value), known)}")
        check_number("size", self.size)
        check_kept(self.keep)
        if self.slip and (self.method != "inverse" or self.keep or not self.shear):
            raise InputError("[slip] needs method = 'inverse', no keep, and an off-axis test")
        if self.pulled and not self.slip:
            raise InputError("a pull-out test needs [slip] with the pitch of the rovings")
        if not self.shear and not self.bending:
            raise InputError("no tests: expected at least one [[tests]]")
        if self.method == "inverse" and self.algorithm != "least-squares":
            raise InputError("the inverse method knows no other algorithm than 'least-squares'")
        if self.method == "table" and self.keep:
            raise InputError("a table has no parameters to keep: choose method 'fit' or 'inverse'")


def load(file: str | Path, **given: Any) -> Campaign:
    """Read a campaign from a TOML file, or from the CSV file of one test.

    `given` replaces method, keep, algorithm, size and name of a file. Of a CSV file it also has
    kind, length, width, angle, side, fabric_side, thickness, areal_weight, columns, units, from,
    to, zero, preload, cycle; of a cantilever's profile or of a table of moments also family.
    """
    file = Path(file)
    sizes = [size for names in SIZES.values() for size in names]
    if file.suffix.lower() == ".toml":
        for key in given:
            if key in (*sizes, *OF_A_TEST, *OF_FABRIC):
                where = "[fabric]" if key in OF_FABRIC else "[[tests]]"
                raise InputError(f"{file}: {key} belongs into the file, under {where}")
        return read_toml(file, lambda table: _campaign(table | given, file))
    kind = given.get("kind", "off-axis")
    files, known = OF_BENDING.get(kind, ("files", SIZES.get(kind, sizes)))
    for key in given:
        if kind in OF_BENDING and key in OF_A_TEST and key not in ("kind", "family"):
            raise InputError(f"{file}: {key} does not apply to a {kind} test")
        if key in sizes and key not in known:
            raise InputError(f"{file}: {key} is not a size of the {kind} test")
    if kind in OF_BENDING and "family" not in given:
        raise InputError(f"{file}: family missing: --family warp or weft, along which it was cut")
    table = {key: value for key, value in given.items() if key in SETTINGS}
    fabric = {key: value for key, value in given.items() if key in OF_FABRIC}
    test = {k: v for k, v in given.items() if k not in (*SETTINGS, *OF_FABRIC, "name")}
    own = str(file.absolute())
    test = {"kind": kind, **test, files: own if kind in OF_BENDING else [own]}
    table |= {"name": given.get("name", file.stem), "fabric": fabric, "tests": [test]}
    return replace(_campaign(table, file), sources=(file,))


# The schema of a file; specimens and fabrics check their numbers themselves


def _files(value: Any) -> list[str]:
    files = [value] if isinstance(value, str) else value
    if not isinstance(files, list) or not files or not all(isinstance(f, str) for f in files):
        raise InputError(f"= {files!r}: expected a list of files")
    return files


def number_or_auto(value: Any) -> float | None:
    """Return a number, or None for "auto"."""
    if value == "auto":
        return None
    if type(value) not in (int, float) or not abs(value) < LARGEST:
        raise InputError(f"= {value!r}: expected a number or auto")
    return float(value)


def cycle_of(value: Any) -> str | int:
    """Return which cycle of a record is used."""
    if value not in CYCLES and not (type(value) is int and value > 0):
        raise InputError(f"= {value!r}: expected {', '.join(CYCLES)} or a number from 1")
    return value


ANY = (Any, OPEN)
CYCLES = ("last", "first", "envelope")


class _Shear(Table):
    files: checked(_files)
    columns: dict[str, StrictStr] = OPEN
    units: dict[str, StrictStr] = OPEN
    low: Annotated[number("Smallest shear angle", "deg", zero=True), Field(alias="from")] = LOWEST
    high: Annotated[number("Largest shear angle", "deg"), Field(alias="to")] = 90.0
    zero: checked(number_or_auto) = None
    preload: checked(number_or_auto) = None
    cycle: checked(cycle_of) = None


class _Cantilever(Table):
    kind: Literal["cantilever"]
    family: Literal["warp", "weft"]
    overhang: Any = OPEN
    angle: Any = 41.5
    length: Any = OPEN
    tip: Any = OPEN
    profile: path("Table of x and drop, mm") = OPEN


class _Bending(Table):
    kind: Literal["bending"]
    family: Literal["warp", "weft"]
    moments: path("Table of curvature and moment per width, with their units")


class _PullOut(Table):
    kind: Literal["pull-out"]
    files: checked(_files)
    length: Any
    width: Any
    columns: dict[str, StrictStr] = OPEN
    units: dict[str, StrictStr] = OPEN


def kind(table: Any) -> str | None:
    """Which model a test has."""
    return str(table.get("kind")) if isinstance(table, Mapping) else None


_STRIP, _FRAME = (
    create_model(name, __base__=_Shear, kind=(Literal[name], ...), **dict.fromkeys(sizes, ANY))
    for name, sizes in SIZES.items()
)
TEST = Annotated[
    Annotated[_STRIP, Tag("off-axis")]
    | Annotated[_FRAME, Tag("picture-frame")]
    | Annotated[_Cantilever, Tag("cantilever")]
    | Annotated[_Bending, Tag("bending")]
    | Annotated[_PullOut, Tag("pull-out")],
    Discriminator(kind),
]
NAMES = ("thickness", "areal_weight", "bending_warp", "bending_weft", "friction")
_Fabric = create_model("Fabric", __base__=Table, base=(Any, "locking"), **dict.fromkeys(NAMES, ANY))


class _Slip(Table):
    pitch: Any
    stiffness: Any = 0.02
    resistance: Any = 0.005


class _File(Table):
    name: StrictStr = OPEN
    method: Any = OPEN
    keep: dict[str, Any] = {}  # noqa: RUF012
    algorithm: Any = OPEN
    size: Any = OPEN
    standing: StrictStr = "measured"
    fabric: _Fabric = _Fabric()
    slip: _Slip = OPEN
    tests: list[TEST] = []  # noqa: RUF012


def _campaign(table: Mapping[str, Any], file: Path) -> Campaign:
    """The campaign of a table; its paths are relative to `file`."""
    given = validated(_File, table, file.parent)
    fabric = _fabric(given.fabric, file.parent)
    shear, bending, pulled, sources = [], {}, [], [file]
    try:
        slip = given.slip and Slip(**given.slip.model_dump())
    except InputError as error:
        raise InputError(f"[slip] {error}") from error
    for i, test in enumerate(given.tests, start=1):
        try:
            if isinstance(test, _Cantilever | _Bending):
                if test.family in bending:
                    raise InputError(f"family {test.family!r} is there twice: give its repeats")
                bent = isinstance(test, _Bending)
                own = test.moments if bent else test.profile
                bending[test.family] = read_moments(own) if bent else _stiffness(test, fabric)
                sources += [own] if own else []
                continue
            if isinstance(test, _PullOut):
                paths = [file.parent / name for name in test.files]
                curve = mean_of([read(path, test.columns, test.units) for path in paths])
                pulled.append(PullOut(test.length, test.width, curve))
                sources += paths
                continue
            keys = test.model_dump(include=set(SIZES[test.kind]), exclude_unset=True)
            specimen = KINDS[test.kind](**keys)
        except InputError as error:
            where = f"[tests {i}]" if file.suffix == ".toml" else f"{file}:"
            raise InputError(f"{where} {error}") from error
        paths = [file.parent / name for name in test.files]
        shear.append(_shear_test(test, specimen, paths, slip is not None))
        sources += [path for path in paths if path not in sources]
    settings = given.model_dump(include={*SETTINGS, "standing"}, exclude_defaults=True)
    name = file.stem if given.name is None else given.name
    more = {"sources": tuple(sources), "slip": slip, "pulled": tuple(pulled)}
    return Campaign(name, fabric, tuple(shear), bending, **more, **settings)


def _fabric(table: Table, folder: Path) -> Fabric:
    base = str(table.base)
    fabric = fabric_of(folder / base if base.endswith(".toml") else base)
    given = table.model_dump(exclude_unset=True, exclude={"base"})
    there = [name for name in VALUES if getattr(fabric, name) is not None]
    origins = dict.fromkeys(there, f"{ASSUMED}{fabric.name}")
    for name in origins.keys() & fabric.provenance.keys():
        known = str(fabric.provenance[name])
        passed_on = known.startswith((ASSUMED, "that of "))
        origins[name] = known if passed_on else f"that of {fabric.name}: {known}"
    return replace(fabric, **given, provenance=origins | dict.fromkeys(given, "given"))


def _shear_test(test: _Shear, specimen: Specimen, paths: list[Path], slips: bool) -> ShearTest:
    name = " + ".join(path.name for path in paths)
    part = Part(test.zero, test.preload, test.cycle)
    curves = [read(path, test.columns, test.units, part) for path in paths]
    curve = mean_of([_borne(ShearTest(name, specimen, c, test.low, test.high)) for c in curves])
    if words := specimen.described(curve):
        names = [name for name in SIZES[test.kind] if getattr(specimen, name)]
        unset = [name for name in names if name not in test.model_fields_set]
        end = f"; not given, defaults: {', '.join(unset)}." if unset else "."
        curve = replace(curve, notices=(f"Taken as a {words}{end}", *curve.notices))
    if curve.per_length and test.kind == "off-axis":
        raise InputError(f"{name}: a force per length is that of a picture frame, not of a strip")
    whole = None
    if slips and test.kind == "off-axis" and curve.displacement is not None:
        begun = (curve.force > 0) & (curve.displacement > START * curve.displacement.max())
        whole, limit = _rows(curve, begun), specimen.net.displacement_limit
        curve = _rows(curve, curve.displacement < WITHIN * limit)
    found = ShearTest(name, specimen, curve, test.low, test.high, whole).cut()
    words = [*_origin(found)] if test.kind == "off-axis" else []
    return replace(found, curve=replace(found.curve, notices=(*found.curve.notices, *words)))


def _rows(curve: Curve, used: np.ndarray) -> Curve:
    """Return some rows of a record, (n,) bool."""
    columns = {k: v[used] for k, v in vars(curve).items() if isinstance(v, np.ndarray)}
    return replace(curve, **columns)


def _origin(test: ShearTest) -> Iterator[str]:
    """What is said about the angle and the size of a strip."""
    strip = test.specimen
    if strip.length < SHORT * strip.width:
        yield (
            f"Length over width is {strip.length / strip.width:.3g}, below {SHORT:g}: the zones of "
            "the power balance overlap, S12 is off by 3 % at 1.5 and by up to 40 % at 1.1 (method "
            "inverse models the strip)."
        )
    if test.measured is not None:
        yield (
            "The measured angle is a check, the law follows the kinematic one: "
            f"at the end {test.measured[-1]:.1f} and {test.kinematic[-1]:.1f} degrees."
        )
    elif test.curve.shear_angle is not None and test.curve.displacement is not None:
        yield "The shear angle follows from the displacement: it was computed, not measured."


def _borne(test: ShearTest) -> Curve:
    """The record, less the force of its first row where that is the load cell's, not a preload.

    Both readings are fitted. That of the load cell counts where it is `SURE` or identifies more.
    """
    curve, found = test.curve, []
    if not curve.preload:
        return curve
    x, note = curve.displacement - curve.displacement[0], curve.notices[-1]
    bare = replace(curve, displacement=x, force=curve.force - curve.preload)
    try:
        for each in (curve, bare):
            forces = replace(test, curve=each).cut().forces(1.0)
            fitted = fit([forces], energy_method([forces]))
            off = (forces.predicted(fitted.law) - forces.force) / forces.sigma
            states = [p.state for p in fitted.parameters]
            found.append((len(off) * np.log(np.mean(off**2)), states.count("fitted")))
    except InputError:  # reported where the test is used
        return curve
    (borne, many), (offset, more) = found
    if offset - borne < (SURE if more > many else -SURE):
        note = (
            f"The force was shifted by {-curve.preload:.3g} N and the displacement to start at 0: "
            "a level of the load cell fits this record better than a preload on the fabric"
        )
        curve = bare
    words = f"{note.rstrip('.')} (--zero MM, --preload N)."
    return replace(curve, notices=(*curve.notices[:-1], words))


def _stiffness(test: _Cantilever, fabric: Fabric) -> Stiffness:
    given = [key for key in ("overhang", "tip", "profile") if key in test.model_fields_set]
    weight = fabric.areal_weight
    if len(given) != 1:
        raise InputError(f"expected one of overhang, tip, profile, got {given or 'none'}")
    if given == ["overhang"]:
        return from_repeats(test.overhang, test.angle, weight)
    if "length" not in test.model_fields_set:
        raise InputError("length missing: the free length of the strip")
    try:
        if given == ["tip"]:
            x, drop = np.atleast_2d(np.array(test.tip, dtype=float)).T
            return from_tip(x, drop, test.length, weight)
        x, drop = read_numbers(test.profile, most=2)[2].T
        return from_profile(x, drop, weight, test.length)
    except InputError:
        raise
    except (ValueError, TypeError) as error:
        expected = "expected numbers in mm, two columns x, drop"
        raise InputError(f"{given[0]}: {expected}: {error}") from error
