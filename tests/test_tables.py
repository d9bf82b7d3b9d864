"""Tables: names, units and separators are known in one place, and nothing is dropped in silence."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quasiform.checks import InputError
from quasiform.identification import records
from quasiform.tables import FIRST_NAMES, NAMES, SECOND, UNITS, name_of, read_numbers, read_table


@pytest.fixture
def write(tmp_path):
    """Write a text to a file, and return its path."""

    def write(text, encoding="utf-8"):
        path = tmp_path / "table.csv"
        path.write_bytes(text.encode(encoding))
        return path

    return write


def test_each_name_has_one_meaning():
    names = " ".join([*NAMES.values(), *SECOND.values()]).split()
    assert len(names) == len(set(names))
    assert len(FIRST_NAMES) == len(" ".join(NAMES.values()).split())
    assert UNITS.keys() <= NAMES.keys()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1"])
@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (";", ","), ("\t", ","), ("  ", "."), (" ", ",")]
)
def test_forms_of_a_table(write, separator, decimal, encoding):
    lines = ["# für alle", separator.join(["x_cm", "y/m", "Scherwinkel[rad]", "S12"])]
    lines += [separator.join(row).replace(".", decimal) for row in ("1.5 2 0.5 7".split(),) * 2]
    table = read_table(write("\n".join(lines), encoding))
    assert list(table) == ["x", "y", "angle", "S12"]
    first = [column[0] for column in table.values()]
    assert_allclose(first, [15.0, 2000.0, np.degrees(0.5), 7.0], rtol=1e-15)


def test_units_in_a_line_below_the_heading(write):
    table = read_table(write("time;travel;force\ns;m;kN\n0;1;2\n1;3;4\n".replace("s;", "mm;")))
    assert_array_equal(table["travel"], [1000.0, 3000.0])
    assert_array_equal(table["force"], [2000.0, 4000.0])


def test_a_unit_of_another_quantity_leaves_the_column_alone():
    assert name_of("x [px]") == ("x [px]", 1.0)
    assert name_of("force (mm)") == ("force (mm)", 1.0)
    assert name_of("Reaction [kN]") == ("force", 1000.0)


def test_the_usual_name_goes_before_one_that_may_be_anothers(write):
    table = read_table(write("force_N,reaction\n1,2\n3,4\n"))
    assert list(table) == ["force", "reaction"]
    with pytest.raises(InputError, match="two columns of the same meaning: 'load'"):
        read_table(write("force,load\n1,2\n3,4\n"))


def test_rows_without_numbers_are_counted(write):
    table = read_table(write("x,y,angle\n0,0,1\n,,\nnan,nan,\n1,,2\n"))
    assert table.left_out == 2
    assert_array_equal(table["y"], [0.0, np.nan])
    rows = [f"{u},{u * u}" for u in range(9)]
    rows[4:4] = ["# paused", ",,"]
    curve = records.read(write("displacement [mm],force [N]\n" + "\n".join(rows)))
    assert len(curve.force) == 9
    assert curve.notices[0] == "2 rows without numbers were left out."


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,y\n1,2\n3,4,5\n", "line 3: 3 cells, the first row of numbers has 2"),
        ("x,y\n1,2\n3\n", "line 3: 1 cells, the first row of numbers has 2"),
        ("x,y\n1,2\n3,inf\n", "line 3: column 2 is not finite: 'inf'"),
        ("x,y\n1,2\n3,1_0\n", "line 3: column 2 is not a number: '1_0'"),
        ("x\n1\n2\n", "no rows of two or more numbers"),
        ("x,y\n1,2\0\n", "not a text file"),
    ],
)
def test_what_is_no_number_is_refused(write, text, message):
    with pytest.raises(InputError, match=message):
        read_table(write(text))


def test_only_the_first_columns(write):
    path = write("corner 1\n0 0 first # comment\n10 0\n10 5 last\n")
    assert_array_equal(read_numbers(path, most=2)[2], [[0, 0], [10, 0], [10, 5]])
