"""A log read in pieces by numpy's parser is the table that the exact parser reads, errors and places too."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from calrig.export import static_csv
from calrig.export.csv_errors import CsvError
from calrig.export.csv_table import MAX_ROW_CHARACTERS, layout_of, read_tables
from calrig.export.static_csv import read_log_table

LIMITS = {"max_rows": 1000, "max_bytes": 100_000}
GOOD = ("0", "-1.5", "+2e-3", ".5", "", "nan", "NaN", " 3", '"4"', "1e30")
BAD = ("-nan", "inf", "1_0", "1e31", "1e", "x", "#", "0x1", "1,5")
ENDS = ("\n", "\r\n", "\n\n", "\r")
rows = st.lists(
    st.tuples(st.sampled_from(GOOD), st.sampled_from(GOOD), st.sampled_from(ENDS)), min_size=1, max_size=30
)


@pytest.fixture
def small_pieces(monkeypatch):
    """So that a short text has many; the property below must see their seams."""
    monkeypatch.setattr(static_csv, "PIECE_BYTES", 16)


def text_of(rows, start="a,b\n"):
    return (start + "".join(f"{a},{b}{end}" for a, b, end in rows)).encode()


@pytest.mark.usefixtures("small_pieces")
@given(rows=rows, start=st.sampled_from(["a,b\n", "\ufeffa,b\r\n", "\n\na,b\n", "\r\na,b\r"]))
@example(rows=[("", "", "\n")] * 30, start="a,b\n")
def test_pieces_are_the_whole(rows, start):
    text = text_of(rows, start)
    assert outcome(log_of, text) == outcome(exact_of, text)


@pytest.mark.usefixtures("small_pieces")
@given(before=rows, bad=st.sampled_from(BAD), after=rows)
def test_a_bad_cell_is_told_as_the_exact_parser_tells_it(before, bad, after):
    text = text_of([*before, ("1", bad, "\n"), *after])
    told = outcome(log_of, text)
    assert isinstance(told, str)
    assert told == outcome(exact_of, text)


def log_of(data):
    table = read_log_table(data, ["b"], **LIMITS)
    column = table.columns[1]
    return [None if np.isnan(x) else x for x in column], [table.line_of(k) for k in range(len(column))]


def exact_of(data):
    found = [
        (table.column(1).numbers(table.layout.report), list(table.lines))
        for table in read_tables(data, ["b"])
    ]
    ((numbers, lines),) = found
    return numbers, lines


def outcome(read, data):
    try:
        return read(data)
    except CsvError as error:
        return str(error)


@pytest.mark.usefixtures("small_pieces")
@given(
    rows=st.lists(st.tuples(st.floats(-1e3, 1e3), st.none() | st.integers(-9, 9)), min_size=2, max_size=30)
)
@pytest.mark.parametrize(("separator", "decimal"), [(";", "."), (";", ","), ("\t", "."), ("\t", ",")])
def test_a_log_is_the_same_whatever_separates_its_cells(rows, separator, decimal):
    def text(separator, decimal):
        cells = ((f"{a:.3f}".replace(".", decimal), "" if b is None else str(b)) for a, b in rows)
        return "\n".join(["a" + separator + "b", *map(separator.join, cells)]).encode()

    tables = [read_log_table(t, ["a", "b"], **LIMITS) for t in (text(",", "."), text(separator, decimal))]
    for place in (0, 1):
        np.testing.assert_array_equal(tables[0].columns[place], tables[1].columns[place])


@pytest.mark.usefixtures("small_pieces")
def test_reading_says_how_far_it_is():
    shares = []
    read_log_table(b"a\n" + b"1\n" * 100, ["a"], **LIMITS, progress=shares.append)
    assert shares == sorted(shares)
    assert len(shares) > 5
    assert shares[-1] == 1.0


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"a\n" + b"1\n" * 1001, "line 1002: the file has more than 1000 rows"),
        (b"a\n" + b" " * 100_000, "the file has 100002 bytes; at most 100000 are read"),
        (
            b' {"a": [1, 2]}\n',
            "line 1: is JSON, not a table: write the names of the columns, then a row each",
        ),
        (
            b"[\n[1, 2],\n[3, 4]]\n",
            "line 1: is JSON, not a table: write the names of the columns, then a row each",
        ),
        (b"a\n1\n\xff\n", "line 3: is not UTF-8 text (byte 0xFF): save the file as UTF-8"),
    ],
)
def test_what_is_too_long_or_not_text_is_refused(data, says):
    with pytest.raises(CsvError) as bad:
        read_log_table(data, ["a"], **LIMITS)
    assert str(bad.value) == says


def test_a_header_without_end_is_not_taken_apart():
    """It would have as many columns as it has bytes."""
    commas = b"," * (4 * MAX_ROW_CHARACTERS + 1)
    with pytest.raises(CsvError, match=f"^line 2: the row is longer than {MAX_ROW_CHARACTERS} characters"):
        layout_of(b"\n" + commas, ["a"])
