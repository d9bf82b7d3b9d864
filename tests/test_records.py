"""Measured curves: read from CSV in its many forms, cut to the loading, averaged; refusals."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quasiform.checks import InputError
from quasiform.identification import records
from quasiform.identification.loading import WHOLE, Part
from quasiform.identification.records import Curve, mean_of

N_ROWS = 12
X = np.round(np.linspace(0.0, 33.0, N_ROWS), 3)  # mm
F = np.round(0.1 * X + 0.002 * X**2, 4)  # N, from zero
ANGLE = np.round(1.7 * X, 3)  # deg


def rows(*columns, separator=",", decimal="."):
    """Lines of a table whose numbers are written in full."""
    return "\n".join(
        separator.join(repr(float(v)).replace(".", decimal) for v in row)
        for row in zip(*columns, strict=True)
    )


@pytest.fixture
def read(tmp_path):
    """Read a text as if it were a file."""

    def read(text, columns=None, units=None, encoding="utf-8", part=WHOLE):
        path = tmp_path / "test.csv"
        path.write_bytes(text.encode(encoding) if isinstance(text, str) else text)
        return records.read(path, columns, units, part)

    return read


def refused(read, tmp_path, *given, **keywords):
    """Return why a text is refused, after the path, in one line."""
    with pytest.raises(InputError) as refusal:
        read(*given, **keywords)
    message = str(refusal.value)
    assert message.startswith(f"{tmp_path / 'test.csv'}: ")
    assert "\n" not in message
    return message.split("test.csv: ")[1]


def curve(x, f):
    return "displacement [mm],force [N]\n" + rows(x, f)


# Forms of a file


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\n\n"])
@pytest.mark.parametrize(
    ("separator", "decimal"),
    [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("  ", "."), (" ", ",")],
)
def test_forms_of_a_table(read, separator, decimal, end, encoding):
    heading = separator.join(["Time", "Verschiebung [mm]", "Scherwinkel [°]", "Kraft [N]"])
    table = rows(X + 1, X, ANGLE, F, separator=separator, decimal=decimal)
    text = f"# lab für Textil\nSpecimen{separator}A12\n\n{heading}\n{table}\n"
    c = read(text.replace("\n", end), encoding=encoding)
    assert_allclose(c.displacement, X, rtol=1e-12)
    assert_allclose(c.force, F, rtol=1e-12)
    assert_allclose(c.shear_angle, np.radians(ANGLE), rtol=1e-12)
    assert c.notices == ()
    assert not c.per_length


@pytest.mark.parametrize(
    ("heading", "columns"),
    [
        ("Shear angle [deg]   Shear force [N/mm]", None),
        ("# gamma F_sh\n# deg N/mm", {"shear_force": "2", "shear_angle": "1"}),
        ("# gamma_deg F_sh_N/mm\n# second specimen", None),
        ('"Shear Angle" "normalised shear force"\ndeg N/mm', None),
        ("", {"shear_force": "2", "shear_angle": "1"}),
    ],
)
def test_headings_with_blanks_and_without(read, heading, columns):
    c = read(f"{heading}\n{rows(ANGLE, F, separator='  ')}", columns)
    assert_allclose(c.shear_angle, np.radians(ANGLE), rtol=1e-12)
    assert_allclose(c.force, F, rtol=1e-12)
    assert c.displacement is None
    assert c.per_length


@pytest.mark.parametrize("separator", [";", "\t", ",", "  "])
@pytest.mark.parametrize(
    "heading",
    [
        "Station 1 Displacement [mm]|Station 1 Force [N]|Time [s]",
        "Channel 1: Displacement (mm)|Channel 2: Force (N)|Time",
        "Specimen 4 of 12\nDisplacement [mm]|Force [N]|Time [s]",
        "Station 1|Station 2|3 of 3\nDisplacement|Force|Time\nmm|N|s",
        "10 20|Speed|of 2\nDisplacement [mm]|Force [N]|Time [s]",
    ],
)
def test_headings_that_hold_figures(read, heading, separator):
    table = rows(X, F, X + 1, separator=separator)
    c = read(heading.replace("|", separator) + "\n" + table)
    assert_allclose(c.displacement, X, rtol=1e-12)
    assert_allclose(c.force, F, rtol=1e-12)


def test_positions_below_a_heading_of_figures(read):
    c = read(f"Cell,1,2\n{rows(X, F, X + 1)}", {"displacement": "1", "force": "2"})
    assert_allclose(c.force, F, rtol=1e-12)


def test_two_stations_are_a_choice(read, tmp_path):
    text = "Displacement\tStation 1 Force (N)\tStation 2 Force (N)\n"
    text += rows(X, F, 2 * F, separator="\t")
    assert "(column 2) and 'Station 2 Force (N)' (column 3) may" in refused(read, tmp_path, text)
    c = read(text, {"force": "Station 2 Force (N)"})
    assert_allclose(c.force, 2 * F, rtol=1e-12)


def test_quoted_decimal_commas(read):
    table = "\n".join(
        f'"{x},{f}"'.replace(",", '","').replace(".", ",") for x, f in zip(X, F, strict=True)
    )
    c = read(f'"Extension","Load"\n"(mm)","(N)"\n{table}')
    assert_allclose(c.force, F, rtol=1e-12)
    assert c.notices == ()


@pytest.mark.parametrize(
    ("heading", "name"),
    [
        *((name, "displacement") for name in records.NAMES["displacement"].split()),
        *((name, "displacement") for name in ["CROSSHEAD [mm]", "Dis_placement(mm)", "weg in mm"]),
        *((name, "force") for name in records.NAMES["force"].split()),
        *((name, "force") for name in ["F_N", "Standard-Kraft/N", "LOAD N"]),
    ],
)
def test_names(read, heading, name):
    table = {"displacement": X, "force": F}
    other = ({"displacement", "force"} - {name}).pop()
    c = read(f"{heading};{other}\n" + rows(table[name], table[other], separator=";"))
    assert_allclose(getattr(c, name), table[name], rtol=1e-12)


@pytest.mark.parametrize(
    ("heading", "name", "unit"),
    [
        *(
            (name, q, "mm" if q == "displacement" else "N")
            for q in records.SECOND
            for name in records.SECOND[q].split()
        ),
        ("Crosshead displacement (mm)", "displacement", "mm"),
        ("Position(mm)", "displacement", "mm"),
        ("Traversenweg in mm", "displacement", "mm"),
    ],
)
def test_names_that_may_be_anothers(read, heading, name, unit):
    table = {"displacement": X, "force": F}
    other = ({"displacement", "force"} - {name}).pop()
    c = read(f"{heading};{other}\n" + rows(table[name], table[other], separator=";"))
    assert_allclose(getattr(c, name), table[name], rtol=1e-12)
    assert f"The column '{heading}' was taken as the {name}." in c.notices
    # beside the name itself they are ignored, and where another column is asked for
    text = f"{heading};{name} [{unit}];{other}\n"
    text += rows(table[name] + 1, table[name], table[other], separator=";")
    c = read(text)
    assert_allclose(getattr(c, name), table[name], rtol=1e-12)
    assert not any("was taken as" in notice for notice in c.notices if heading in notice)
    assert_allclose(getattr(read(text, {name: "2"}), name), table[name], rtol=1e-12)


@pytest.mark.parametrize(
    ("quantity", "unit", "size"),
    [
        *(("displacement", u, s) for u, s in [("m", 1e3), ("cm", 10), ("mm", 1), ("in", 25.4)]),
        ("displacement", "inch", 25.4),
        *(("displacement", u, 1e-3) for u in ["um", "µm", "μm"]),
        *(
            ("force", u, s)
            for u, s in [("N", 1), ("kN", 1e3), ("cN", 0.01), ("lbf", 4.44822161526)]
        ),
        *(("shear_angle", u, s) for u, s in [("deg", np.pi / 180), ("rad", 1), ("°", np.pi / 180)]),
        *(("shear_force", u, s) for u, s in [("N/mm", 1), ("N/m", 1e-3), ("kN/m", 1)]),
    ],
)
def test_units(read, quantity, unit, size):
    pairs = {"displacement": "force", "force": "displacement"}
    pairs |= {"shear_angle": "shear_force", "shear_force": "shear_angle"}
    other = pairs[quantity]
    normal = {"displacement": "mm", "force": "N", "shear_angle": "deg", "shear_force": "N/mm"}
    table = rows(X, F) if quantity in ("displacement", "shear_angle") else rows(F, X)
    expected = size * (X if quantity in ("displacement", "shear_angle") else F)
    for heading, units in [
        (f"{quantity} [{unit}],{other} [{normal[other]}]", None),
        (f"{quantity}_{unit},{other} ({normal[other]})", None),
        (f"{quantity}/{unit},{other}/{normal[other]}", None),
        (f"{quantity},{other}\n{unit},{normal[other]}", None),
        (f"{quantity},{other}\n[{unit.upper()}],({normal[other]})", None),
        (f"{quantity} [kp],{other}", {quantity: unit, other: normal[other]}),
    ]:
        c = read(f"{heading}\n{table}", units=units)
        got = c.force if quantity.endswith("force") else getattr(c, quantity)
        assert_allclose(got, expected, rtol=1e-11)
        read_in = [notice for notice in c.notices if "was read in" in notice]
        assert len(read_in) == (size not in (1, np.pi / 180) or unit == "rad")


def test_undeclared_units_are_told(read):
    c = read(f"u;F;gamma\n{rows(X, F, ANGLE, separator=';')}")
    assert c.notices == (
        "The displacement has no unit: taken as mm.",
        "The force has no unit: taken as N.",
        "The shear angle has no unit: taken as deg.",
    )
    c = read(f"u;F;gamma\n{rows(X, F, X / 30, separator=';')}")
    assert_allclose(c.shear_angle, X / 30, rtol=1e-12)
    assert "The shear angle has no unit and stays below 1.6: taken as rad." in c.notices


def test_what_stands_before_the_heading(read):
    before = "Speed;10;20\n;;\nGauge length [mm];100\n\n"
    c = read(f"{before}Weg;Kraft\n[mm];[kN]\n{rows(X, F, separator=';')}")
    assert_allclose(c.force, 1e3 * F, rtol=1e-12)
    assert c.notices == ("The force was read in kN.",)


def test_comments_and_units_in_two_places(read):
    table = rows(X, F).replace("\n", "\n# paused\n", 1)
    c = read(f"Displacement [cm],Force\n,kN\n{table}", encoding="utf-8-sig")
    assert_allclose(c.displacement, 10 * X, rtol=1e-12)
    assert_allclose(c.force, 1e3 * F, rtol=1e-12)


def test_columns_asked_for(read):
    table = rows(X, 2 * F, F, F, separator=";")
    heading = "Weg;Kraft 1 [N];Kraft 2 [N];Force [N]"
    assert_allclose(read(f"{heading}\n{table}", {"force": "Kraft 1"}).force, 2 * F)
    assert_allclose(read(f"{heading}\n{table}", {"force": "kraft 2 [N]"}).force, F)
    assert_allclose(read(f"{heading}\n{table}", {"force": "2"}).force, 2 * F)
    c = read(f"{heading}\n{table}", {"shear_force": "2"}, {"shear_force": "N/m"})
    assert_allclose(c.force, 2e-3 * F)
    assert c.per_length
    c = read(table, {"displacement": "1", "force": "2"})
    assert_allclose(c.force, 2 * F)
    c = read(f"a;b [kN];c;d\n{table}", {"displacement": "1", "force": "2"})
    assert_allclose(c.force, 2e3 * F)


# Refusals of a file


def broken(k, cell):
    """Return a table whose force in row `k` (line k + 2) is the cell."""
    lines = curve(X, F).split("\n")
    lines[k + 1] = f"{X[k]},{cell}"
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "columns", "units", "message"),
    [
        (b"\x00\x01\x02", None, None, "not a text file"),
        ("", None, None, "no rows of two or more numbers"),
        ("displacement;force\n", None, None, "no rows of two or more numbers"),
        ("# 1 2\n# 3 4", {"displacement": "1", "force": "2"}, None, "that are not comments"),
        (rows(X, F), None, None, "no line of headings: give positions"),
        (f"time,force\n{rows(X, F)}", None, None, "no column of a displacement or shear angle"),
        (f"time,force\n{rows(X, F)}", None, None, "found 'time', 'force'"),
        (
            f"time,Stretch (mm),force\n{rows(X, X, F)}",
            None,
            None,
            'name it with --columns displacement="Stretch (mm)" (in TOML and Python: columns)',
        ),
        (rows(X, F), None, None, "--columns displacement=1,force=2 (in TOML and Python: columns)"),
        (f"weg,force\n{rows(X, F / 1000)}", None, None, '--units force="kN" (in TOML and'),
        (
            f"Position,Traversenweg,Kraft\n{rows(X, X, F)}",
            None,
            None,
            "'Position' (column 1) and 'Traversenweg' (column 2) may both be the displacement",
        ),
        (f"weg,F2\nmm,N\n{rows(X, F)}", None, None, "force or shear force: found 'weg', 'F2'"),
        (
            f"weg,Kraft 1\n{rows(X, F)}",
            {"force": "Kraft 2"},
            None,
            "'Kraft 2' not found: did you mean 'Kraft 1'? (columns: 'weg', 'Kraft 1')",
        ),
        (rows(X, F), {"displacement": "1", "force": "3"}, None, "column 3 not found: there are 2"),
        (
            curve(X, F),
            {"forces": "2"},
            None,
            "[columns] unknown key 'forces': did you mean 'force'",
        ),
        (curve(X, F), None, {"time": "s"}, "[units] unknown key 'time'"),
        (
            f"weg,Force,Load\n{rows(X, F, F)}",
            None,
            None,
            "'Force' (column 2) and 'Load' (column 3) may both be the force: choose with --columns",
        ),
        (
            f"weg,Force,F_sh\n{rows(X, F, F)}",
            None,
            None,
            "'Force' is a force and 'F_sh' a shear force: choose one",
        ),
        (
            f"weg,force [kp]\n{rows(X, F)}",
            None,
            None,
            "unknown unit 'kp' of the force: expected one of N, kN, cN, lbf",
        ),
        (f"weg,force\nmm,kp\n{rows(X, F)}", None, None, "unknown unit 'kp' of the force"),
        (curve(X, F), None, {"displacement": "ft"}, "unknown unit 'ft' of the displacement"),
        (curve(X, F), None, {"force": "N/mm"}, "it is one of a shear force"),
        (f"weg,force\n{rows(X, F / 1000)}", None, None, "looks like kN: declare it, Force [kN]"),
        (broken(4, "abc"), None, None, "line 6: the force is not a number: 'abc'"),
        (broken(0, "abc"), None, None, "line 2: the force is not a number: 'abc'"),
        (broken(5, ""), None, None, "line 7: the force is not a number: ''"),
        (broken(5, '"1,5"'), None, None, "line 7: the force is not a number: '1,5'"),
        (broken(7, "1_0"), None, None, "line 9: the force is not a number: '1_0'"),
        (broken(4, "nan"), None, None, "line 6: the force is not finite: 'nan'"),
        (broken(0, "-inf"), None, None, "line 2: the force is not finite: '-inf'"),
        (broken(3, "1e999"), None, None, "line 5: the force is not finite: '1e999'"),
        (curve(X[:7], F[:7]), None, None, "only 7 rows of numbers, at least 8"),
        (curve(-X, F), None, None, "only 1 row belongs to the loading"),
        (curve(-X, F), None, None, "the displacement is largest at line 2"),
        (curve(X, np.r_[F[:5], 0 * F[5:]]), None, None, "only 4 rows belong to the loading"),
        (curve(X, -F), None, None, "nowhere positive while loading: is its sign reversed?"),
    ],
)
def test_refused(read, tmp_path, text, columns, units, message):
    assert message in refused(read, tmp_path, text, columns, units)


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match=r"none\.csv: No such file"):
        records.read(tmp_path / "none.csv")
    with pytest.raises(InputError, match="Is a directory"):
        records.read(tmp_path)


# The loading part

LONG = np.linspace(0.0, 60.0, 301)


def law(x):
    """Force of a fabric, N, that is stiff at first, then soft, then locks."""
    return 3 * (1 - np.exp(-x / 2)) + 0.05 * x + 4 * (x / 60) ** 5


def test_clean_curve_stays_as_it_is(read):
    c = read(curve(LONG, law(LONG)))
    assert_array_equal(c.displacement, LONG)
    assert_array_equal(c.force, law(LONG))
    assert c.notices == ()
    assert c.sigma.max() < 1e-3 * c.force.max()


def test_unloading_is_cut(read):
    c = read(curve(np.r_[LONG, LONG[-2::-5]], np.r_[law(LONG), 0.9 * law(LONG[-2::-5])]))
    assert_array_equal(c.displacement, LONG)
    assert c.notices == ("60 rows after the largest displacement, 60 mm, were cut.",)


@pytest.mark.parametrize(("share", "left"), [(0.75, 200), (0.85, 301)])
def test_tearing_is_cut(read, share, left):
    f = law(LONG)
    f[201:] = share * f[200]
    c = read(curve(LONG, f))
    assert len(c.force) == left
    assert len(c.sigma) == left
    assert any("drops by more than 20 %" in notice for notice in c.notices) == (left == 200)


def test_going_back_is_refused(read, tmp_path):
    x = LONG.copy()
    x[150:] -= 3.3
    message = refused(read, tmp_path, curve(x, law(LONG)))
    assert message == "displacement is not monotone: goes back by 3.1 mm at line 152"
    text = "gamma [deg],F_sh [N/mm]\n" + rows(x, law(LONG))
    assert "shear angle is not monotone: goes back by 3.1 deg" in refused(read, tmp_path, text)


def test_jitter_is_left_out(read):
    x = LONG.copy()
    x[[50, 120]] -= 0.3
    x[200] = x[199]
    c = read("u_mm,F_N,gamma_deg\n" + rows(x, law(LONG), LONG))
    assert_array_equal(c.displacement, np.delete(x, [50, 120, 200]))
    assert_allclose(c.shear_angle, np.radians(np.delete(LONG, [50, 120, 200])), rtol=1e-12)
    assert_array_equal(c.force, np.delete(law(LONG), [50, 120, 200]))
    assert c.notices == ("3 rows that do not move ahead were left out.",)
    x = LONG.copy()
    x[50] -= 0.3
    c = read("u_mm,F_N\n" + rows(np.r_[x, x[-1] - 1], law(np.r_[LONG, LONG[-1]])))
    assert "1 row that does not move ahead was left out." in c.notices
    assert any(n.startswith("1 row after") and n.endswith("was cut.") for n in c.notices)


@pytest.mark.parametrize(
    ("first", "preload", "zero", "notice"),
    [
        (15.0, 0.0, 15.0, "shifted by -15 mm: it starts without a force"),
        (-0.4, 0.0, -0.4, "shifted by 0.4 mm"),
        (-0.4, 2.9, -2.26, "a preload of 2.91 N in the first row, at -0.4 mm"),
        (15.0, 2.9, 13.14, "a preload of 2.91 N in the first row, at 15 mm"),
        (0.0, 0.8, -0.52, "in the first row, at 0 mm"),
        (0.0, 0.0, 0.0, ""),
    ],
)
def test_zero_and_preload(read, first, preload, zero, notice):
    """The tangent at the start, 1.55 N/mm, meets no force at -preload/1.55 mm."""
    rng = np.random.default_rng(1)
    f = law(LONG) * (1 + 0.005 * rng.standard_normal(len(LONG))) + preload
    c = read(curve(LONG + first, f))
    assert_allclose(c.displacement, LONG + first - zero, atol=0.05 * preload or 1e-12)
    assert_array_equal(c.force, f)
    assert any(notice in told for told in c.notices) or not notice
    assert any("preload" in told for told in c.notices) == (preload > 0)


def test_zero_and_preload_are_given(read, tmp_path):
    text = curve(LONG + 0.35, law(LONG) + 1.0)
    c = read(text, part=Part(zero=0.35, preload=0.0))
    assert_allclose(c.displacement, LONG, atol=1e-12)
    assert_allclose(c.force, law(LONG), atol=0.02)
    assert "shifted by -0.35 mm: given." in c.notices[1]
    c = read(text, part=Part(zero=1.0))  # rows before it are cut
    assert c.displacement[0] == pytest.approx(0.15)
    assert c.force[0] == pytest.approx(law(0.8) + 1.0)
    # a load cell that was set to zero at a preload of 2 N
    c = read(curve(LONG, law(LONG)), part=Part(preload=2.0))
    assert_allclose(c.force, law(LONG) + 2.0, atol=0.02)
    assert c.displacement[0] == pytest.approx(2.0 / 1.55, abs=0.05)
    text = "gamma [deg],F_sh [N/mm]\n" + rows(LONG, law(LONG))
    with pytest.raises(InputError, match="of a record with a displacement, not of an angle"):
        read(text, part=Part(zero=1.0))


# Cycles


def cycles(*peaks, soft=0.9):
    """Loading to each peak, mm, and back to 1 mm; later loadings need a smaller force."""
    x, f, scale = [], [], 1.0
    for peak in peaks:
        up = np.arange(1.0 if x else 0.0, peak + 0.1, 0.2)
        x += [up, np.arange(peak - 0.5, 1.0, -0.5)]
        f += [scale * law(up), 0.7 * scale * law(x[-1])]
        scale *= soft
    return np.concatenate(x), np.concatenate(f)


@pytest.mark.parametrize(
    ("cycle", "scale", "words"),
    [
        (None, 1.0, "3 cycles: their envelope"),
        ("envelope", 1.0, "their envelope"),
        ("first", 1.0, "number 1 is used"),
        ("last", 0.81, "number 3 is used, from 1 mm"),
        ("2", 0.9, "number 2 is used"),
        (3, 0.81, "number 3 is used"),
    ],
)
def test_one_cycle_of_three(read, cycle, scale, words):
    x, f = cycles(40.0, 40.0, 40.0)
    c = read("u [mm];F [kN]\n" + rows(x, f / 1e3, separator=";"), part=Part(zero=0.0, cycle=cycle))
    assert any(words in told for told in c.notices)
    assert_allclose(c.force, scale * law(c.displacement), rtol=1e-9, atol=1e-12)
    assert c.displacement[-1] == pytest.approx(40.0, abs=0.3)
    assert c.displacement[0] == pytest.approx(0.0 if scale == 1 else 1.0, abs=0.3)


def test_the_envelope_of_growing_cycles(read):
    x, f = cycles(10.0, 25.0, 45.0, soft=1.0)
    c = read(curve(x, f))
    assert c.displacement[-1] == pytest.approx(45.0, abs=0.3)
    assert_allclose(c.force, law(c.displacement), rtol=1e-9, atol=1e-12)
    assert np.diff(c.displacement).max() < 1.5


def test_an_approach_is_no_cycle(read, tmp_path):
    x = np.r_[np.arange(8.0, 0.0, -0.5), LONG]
    message = refused(read, tmp_path, curve(x, np.r_[np.zeros(16), law(LONG)]))
    assert "displacement is not monotone: goes back by 8 mm" in message


def test_a_cycle_that_is_not_there(read, tmp_path):
    for text, words in ((curve(*cycles(40.0, 40.0)), "2 cycles"), (curve(X, F), "1 cycle")):
        message = refused(read, tmp_path, text, part=Part(cycle=5))
        assert message == f"cycle 5 is not in the record, which has {words}"


def test_a_curve_that_begins_where_a_sheet_would_be_is_not_shifted(read):
    """Rows below 2° were cut, and locking makes the first force small beside the largest."""
    u = np.linspace(2.77, 58.0, 300)
    f = 8 * np.sqrt(u) * (1 + np.where(u > 55, 10 * (u - 55) ** 2, 0.0))
    assert f[0] < 0.02 * f.max()
    c = read(curve(u, f))
    assert_allclose(c.displacement, u)
    assert any("begins at 2.77 mm" in told and "not shifted" in told for told in c.notices)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("start", [4.0, 12.0])
@pytest.mark.parametrize("offset", [0.1, -0.2])
def test_slack(read, seed, start, offset):
    rng = np.random.default_rng(seed)
    x = np.linspace(2.0, 62.0, 301)
    force = law(np.maximum(x - start, 0.0)) + offset
    f = force + 0.005 * force.max() * rng.standard_normal(len(x))
    angle = x / 2
    text = "displacement [mm],force [N],angle [deg]\n" + rows(x, f, angle)
    c = read(text)
    assert len(c.notices) == 1
    assert c.notices[0].startswith(f"Slack up to {x[-1] - c.displacement[-1]:.4g} mm was cut")
    assert x[-1] - c.displacement[-1] == pytest.approx(start, abs=0.3)
    assert f[-1] - c.force[-1] == pytest.approx(offset, abs=0.04)
    assert 0 < c.displacement[0] < 0.2 + 1e-9
    n = len(c.force)
    assert_allclose(c.shear_angle, np.radians(angle[-n:]), rtol=1e-12)  # cut but not shifted


def test_slack_of_rounded_forces(read):
    f = np.round(np.maximum(LONG - 6.0, 0.0) / 10, 1)  # an insensitive load cell
    c = read(curve(LONG + 1.0, f))
    assert 61.0 - c.displacement[-1] == pytest.approx(7.0, abs=0.3)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    "soft",
    [
        lambda x: x / 6,
        lambda x: 10 * (x / 60) ** 3,
        lambda x: 10 * (np.exp(x / 10) - 1) / 402,
        lambda x: 5.0 + 0 * x + 5 * (x > 30) * (x / 30 - 1),  # a plateau of friction
    ],
)
def test_no_slack_is_invented(read, seed, soft):
    noise = 0.005 * soft(LONG).max() * np.random.default_rng(seed).standard_normal(len(LONG))
    c = read(curve(LONG, soft(LONG) + noise))
    assert_array_equal(c.displacement, LONG)
    assert not any("Slack" in notice for notice in c.notices)


def test_angles_are_not_shifted(read):
    angle = LONG + 5.0
    c = read("gamma [deg],F_sh [N/mm]\n" + rows(angle, np.maximum(LONG - 20, 0) + 0.3))
    assert_allclose(c.shear_angle, np.radians(angle), rtol=1e-12)
    assert c.force[0] == 0.3


# Noise


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("even", [True, False])
def test_sigma_recovers_the_noise(read, seed, even):
    rng = np.random.default_rng(seed)
    x = np.linspace(0, 60, 1200) if even else np.sort(rng.uniform(0, 60, 1200))
    f = (law(x) + 0.5) * (1 + 0.01 * rng.standard_normal(len(x)))
    c = read(curve(x, f), units={"force": "N"})
    floor = 0.02 * f.max()
    assert_allclose(c.sigma / np.maximum(c.force, floor), 0.01, rtol=0.15)


def test_curvature_is_no_noise(read):
    x = np.linspace(0, 60, 25)
    f = 10 * np.exp(x / 10) / 402
    c = read(curve(x, f))
    assert (c.sigma / np.maximum(f, 0.2)).max() < 1e-3


# Repeats


def repeat(scale, n=200, first=0.0, last=60.0, noise=1e-6, **keywords):
    x = np.linspace(first, last, n)
    given = {"displacement": x, "shear_angle": x / 60, **keywords}
    return Curve(scale * law(x), sigma=noise * law(x), notices=("Cut.",), **given)


def test_mean_of_one_is_it():
    c = repeat(1.0)
    assert mean_of([c]) is c


def test_mean_of_repeats():
    curves = [repeat(0.9, 150, 1.0, 55.0), repeat(1.0, 200), repeat(1.1, 400, 0.5, 58.0)]
    c = mean_of(curves)
    x = np.linspace(1.0, 55.0, 200)
    assert_allclose(c.displacement, x, rtol=1e-12)
    assert_allclose(c.force, law(x), rtol=3e-3)
    assert_allclose(c.shear_angle, x / 60, rtol=1e-12)
    assert_allclose(c.sigma, 0.1 / np.sqrt(3) * law(x), rtol=3e-2)
    assert c.notices == ("Cut.", "3 repeats, scatter 10.0 %")
    without = [dataclasses.replace(curves[0], shear_angle=None), *curves[1:]]
    assert mean_of(without).shear_angle is None
    angles = mean_of([dataclasses.replace(k, displacement=None) for k in curves])
    assert_allclose(angles.shear_angle, x / 60, rtol=1e-12)
    assert angles.displacement is None


def test_scatter_is_pooled_along_the_curve():
    wave = 1 + 0.1 * np.sin(np.linspace(0, 60, 200))
    curves = [Curve(f, LONG[:200], None, 1e-6 * f) for f in (wave, 2 - wave)]
    sigma = mean_of(curves).sigma  # the scatter of two is 0.1 √2 |sin|, its mean square 0.01
    assert_allclose(sigma[20:-20], 0.1 / np.sqrt(2), rtol=0.1)


def test_sigma_of_the_mean_is_not_below_the_noise():
    c = mean_of([repeat(1.0, noise=0.03), repeat(1.0, noise=0.03)])
    assert_allclose(c.sigma[5:], 0.03 / np.sqrt(2) * c.force[5:], rtol=1e-6)


@pytest.mark.parametrize(
    ("curves", "message"),
    [
        ([], "at least one curve"),
        (
            [repeat(1), repeat(1, displacement=None)],
            "force over displacement and force over shear angle",
        ),
        (
            [repeat(1), repeat(1, per_length=True)],
            "got force over displacement and shear force over displacement",
        ),
        (
            [repeat(1, last=20.0), repeat(1, first=30.0)],
            "no displacement in common: 0 mm to 20 mm, 30 mm to 60 mm",
        ),
    ],
)
def test_repeats_that_do_not_belong_together(curves, message):
    with pytest.raises(InputError, match=message):
        mean_of(curves)


def test_a_measured_angle_is_not_overruled_by_a_position(read):
    heading = "Position (V),shear angle (deg),Force (N)\n"
    found = read(heading + rows(0.1 * X, ANGLE, F))
    plain = read("shear angle (deg),Force (N)\n" + rows(ANGLE, F))
    assert found.displacement is None
    assert_array_equal(found.shear_angle, plain.shear_angle)
