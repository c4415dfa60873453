"""Tables as people write them: what has one reading gives the arrays of the plain file, and says so."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from calrig.export import static_csv
from calrig.export.csv_errors import CsvError
from calrig.export.poses_csv import read_run
from calrig.export.static_csv import read_static

POSES = ("target_deg", "reading_deg", "time_s", "temperature_c", "accel_y_g", "pass", "supply_v")
LOG = ("time_s", "accel_x_g", "accel_y_g", "accel_z_g", "gyro_x_dps", "temperature_c")
UNITS = {"deg": "°", "s": "s", "c": "°C", "g": "g", "dps": "deg/s", "v": "V"}
EPOCH = np.datetime64("2024-02-29T23:59:50")


class Sheet:
    """Rows of text cells under names, which decorations change; lines above and between rows."""

    def __init__(self, names, rows):
        self.names = list(names)
        self.rows = [list(row) for row in rows]
        self.above: list[str] = []
        self.units: list[str] = []
        self.comments: dict[int, str] = {}
        self.separator, self.decimal = ",", "."

    def each(self, names, change):
        for row in self.rows:
            for place, name in enumerate(self.plain):
                if name in names and row[place] not in {"", "nan"}:
                    row[place] = change(row[place])

    @property
    def plain(self):
        return POSES if len(self.names) == len(POSES) else LOG

    def text(self):
        rows = [[cell.replace(".", self.decimal) for cell in row] for row in self.rows]
        lines = [self.separator.join(row) for row in rows]
        for place in sorted(self.comments, reverse=True):
            lines.insert(place, self.comments[place])
        head = [*self.above, self.separator.join(self.names)]
        head += [self.separator.join(self.units)] if self.units else []
        return "\n".join([*head, *lines, ""]).encode()


def unit_of(name):
    return UNITS.get(name.rpartition("_")[2], "")


def bare(name):
    return name.rpartition("_")[0] if unit_of(name) and name != "supply_v" else name


def units_row(sheet):
    sheet.units = [unit_of(name) for name in sheet.plain]


def bare_names_over_units(sheet):
    units_row(sheet)
    sheet.names = [bare(name) for name in sheet.plain]


def capitals(sheet):
    sheet.names = [name if name == "supply_v" else name.upper() for name in sheet.names]


def brackets(sheet):
    sheet.names = [name if bare(name) == name else f"{bare(name)} [{unit_of(name)}]" for name in sheet.plain]


def parentheses(sheet):
    sheet.names = [
        f"{bare(name).title()} ({name.rpartition('_')[2]})" if bare(name) != name else name
        for name in sheet.plain
    ]


def blanks(sheet):
    sheet.names = [
        name.replace("_", " ").capitalize() if bare(name) != name else name for name in sheet.plain
    ]


def comments(sheet):
    sheet.above += ['# bench 3, by hand; "zero" set at 10:00', "#", "# 1,5;2,5"]
    sheet.comments[2] = "# remounted, said M."


def spaces_and_degrees(sheet):
    sheet.each({"target_deg", "gyro_x_dps"}, lambda cell: cell + ("°" if sheet.plain is POSES else " deg/s"))
    sheet.each({"reading_deg"}, lambda cell: cell + " deg")
    sheet.each({"temperature_c"}, lambda cell: cell + " °C")


def not_available(sheet):
    for row in sheet.rows:
        row[:] = ["#N/A" if cell == "nan" else cell for cell in row]


def typographic_minus(sheet):
    sheet.each({"reading_deg", "accel_y_g"}, lambda cell: cell.replace("-", "−"))


def iso_times(sheet):
    def stamp(cell):
        return str(EPOCH + np.timedelta64(round(float(cell) * 1000), "ms")) + "+02:00"

    sheet.each({"time_s"}, stamp)


def semicolons(sheet):
    sheet.separator = ";"


def decimal_commas(sheet):
    sheet.separator, sheet.decimal = ";", ","


def crlf_free_tabs(sheet):
    sheet.separator = "\t"


NAMES = [capitals, brackets, parentheses, blanks, bare_names_over_units]
OTHERS = [
    units_row, comments, spaces_and_degrees, not_available, typographic_minus, iso_times, semicolons,
    decimal_commas, crlf_free_tabs,
]  # fmt: skip
EVERY = [*NAMES, *OTHERS]
TOGETHER = [
    pair
    for pair in itertools.combinations(EVERY, 2)
    if not set(pair) <= set(NAMES)
    and pair not in {(bare_names_over_units, units_row)}
    and not {iso_times, decimal_commas} <= set(pair)  # the comma of a time is its own
]


def sheet_of(names, seed):
    draw = np.random.default_rng(seed)
    rows = []
    for k in range(int(draw.integers(3, 12))):
        row = {name: f"{draw.normal(0.0, 20.0):.4f}" for name in names}
        row |= {"time_s": f"{0.25 * k:.2f}", "pass": str(k), "temperature_c": f"{20.5 + k:.1f}"}
        if k == 2:
            row["temperature_c"] = "nan"
        rows.append([row[name] for name in names])
    return Sheet(names, rows)


def read_poses(data):
    poses, _, said, _ = read_run(data, "A")
    return {name: poses.cells(name) for name in ["pass", *POSES]}, said


def read_log(data):
    log = read_static(data)
    return {**log.channels, "time_s": log.time_s}, list(log.warnings)


def same(found, plain):
    assert found.keys() == plain.keys()
    for name in plain:
        values = [np.array(one[name], dtype=np.float64) for one in (found, plain)]
        np.testing.assert_allclose(*values, rtol=0, atol=1e-9, err_msg=name)


@pytest.mark.parametrize(("names", "read"), [(POSES, read_poses), (LOG, read_log)], ids=["poses", "log"])
@pytest.mark.parametrize(
    "decorations", [*((one,) for one in EVERY), *TOGETHER], ids=lambda d: "+".join(x.__name__ for x in d)
)
def test_decorated_tables_give_the_arrays_of_the_plain_one(names, read, decorations, monkeypatch):
    monkeypatch.setattr(static_csv, "PIECE_BYTES", 120)
    for seed in range(2):
        plain, nothing = read(sheet_of(names, seed).text())
        assert nothing == []
        sheet = sheet_of(names, seed)
        for change in decorations:
            change(sheet)
        found, said = read(sheet.text())
        same(found, plain)
        silent = {semicolons, decimal_commas, crlf_free_tabs}
        changed = sheet.text() != sheet_of(names, seed).text() and not set(decorations) <= silent
        assert bool(said) == changed, (said, sheet.text())
        assert len(said) <= 4


@pytest.mark.parametrize(
    ("names", "row", "expected"),
    [
        (
            "target_rad,reading [rad]",
            "0.5,-1",
            {"target_deg": 28.64788975654116, "reading_deg": -57.29577951308232},
        ),
        ("Target (mrad),Reading / °", "500,1", {"target_deg": 28.64788975654116, "reading_deg": 1.0}),
        ("target_deg,reading_deg,Temperature [°F]", "1,2,212", {"temperature_c": 100.0}),
        ("target_deg,reading_deg,temperature (K)", "1,2,273.15", {"temperature_c": 0.0}),
        ("target_deg,reading_deg,accel_z (m/s²)", "1,2,9.80665", {"accel_z_g": 1.0}),
        ("target_deg,reading_deg,accel_z [mg]", "1,2,-998", {"accel_z_g": -0.998}),
        ("target_deg,reading_deg,time [ms]", "1,2,1500", {"time_s": 1.5}),
        ("targetDeg,readingDeg,nSamples [-]", "1,2,7", {"target_deg": 1.0, "n_samples": 7}),
        (
            "target_deg,reading_deg,supply_v,azimuth_deg",
            "1,2,5.1 V,-90°",
            {"supply_v": 5.1, "azimuth_deg": -90.0},
        ),
        ("target_deg,reading_deg,time_ms", "1,2,1500", {"time_s": 1.5, "time_ms": None}),
        ("target_deg,reading_deg,TimeUs", "1,2,1500", {"time_s": 1.5e-3}),
        ("Target_deg,reading_deg,time_ms,time_s", "1,2,1500,7", {"time_s": 7.0, "time_ms": 1500.0}),
        ("Target_deg,reading_deg,time_min", "1,2,1.5", {"time_s": None, "time_min": 1.5}),
        ("target_deg,reading_deg,temperature_k", "1,2,300", {"temperature_k": 300.0, "temperature_c": None}),
        ("# bench\n# target_deg,reading_deg", "1,2", {"target_deg": 1.0, "reading_deg": 2.0}),
    ],
)
def test_a_stated_unit_is_converted_where_that_is_exact(names, row, expected):
    poses, _, said, _ = read_run(f"{names}\n{row}\n".encode(), "A")
    assert said
    for name, value in expected.items():
        cells = poses.cells(name)
        assert (None if cells is None else cells[0]) == (
            None if value is None else pytest.approx(value, abs=1e-12)
        )


@pytest.mark.parametrize(
    ("text", "places", "says"),
    [
        ("Target_deg,target [°],reading_deg\n1,2,3\n", [(1, "target [°]")], ["target_deg", "Target_deg"]),
        ("target_deg,Target_deg,reading_deg\n1,2,3\n", [(1, "Target_deg")], ["target_deg"]),
        (
            "tagret_deg,readin_deg,foo\n1,2,3\n",
            [(1, "target_deg"), (1, "reading_deg")],
            ["did you mean target_deg?", "did you mean reading_deg?", "there are: tagret_deg"],
        ),
        ("target,reading_deg\n1,2\n", [(1, "target_deg")], ["target: did you mean target_deg"]),
        ("target_deg [rad],reading_deg\n1,2\n", [(1, "target_deg [rad]")], ["rad", "deg"]),
        ("target_deg,reading_deg\nrad,deg\n1,2\n", [(1, "target_deg")], ["rad", "deg"]),
        ("target_deg,reading_deg\nfurlong,deg\n1,2\n", [(1, "target_deg")], ["furlong", "deg"]),
        (
            "target [gon],reading_deg\n1,2\n",
            [(1, "target_deg")],
            ["target [gon]: did you mean target_deg, in deg"],
        ),
        ("target_deg,reading_deg\n1 rad,2\n", [(2, "target_deg")], ["1 rad", "in rad"]),
        ("target_deg,reading_deg\n1,2\n#N/A,#N/A\n", [(3, "target_deg"), (3, "reading_deg")], ["#N/A"]),
        (
            "target_deg,reading_deg,pass\nx,,0.5\n1,2,3,4\n\n1,y,-1\n",
            [(2, "target_deg"), (2, "reading_deg"), (2, "pass"), (3, None), (5, "reading_deg"), (5, "pass")],
            ["'x'", "''", "'0.5'", "4 cells", "'y'", "'-1'"],
        ),
        (
            "target_deg;reading_deg\n" + "1,5;2,5\n" * 5 + "2.5;2,5\n1,1;1,1\n",
            [(7, "target_deg")],
            ["'2.5'", "with a comma"],
        ),
        (
            "target_deg,reading_deg,time_s\n1,2,2024-01-01T12:00:00Z\n2,3,5\n3,3,2024-01-01T12:00:01\n",
            [(3, "time_s"), (4, "time_s")],
            ["'5'", "first row"],
        ),
        ("# 1\n# 2\n", [(None, None)], ["no rows"]),
    ],
)
def test_what_has_no_one_reading_is_refused_with_every_place(text, places, says):
    with pytest.raises(CsvError) as bad:
        read_run(text.encode(), "A")
    said = str(bad.value)
    assert (bad.value.line, bad.value.column) == places[0]
    for line, column in places:
        assert f"line {line}" in said or line is None
        assert f"column {column}" in said or column is None
    assert all(words in said for words in says), said
    assert said.count("; line ") == len(places) - 1


def test_rows_that_all_end_in_a_separator_are_read_and_others_refused():
    poses, _, said, _ = read_run(b"target_deg,reading_deg,load_kg\n1,2,3,\n\n# half\n4,5,,\n7,8,9, \n", "A")
    assert poses.cells("reading_deg") == [2.0, 5.0, 8.0]
    assert poses.cells("load_kg") == [3.0, None, 9.0]
    assert "the rows end in a separator, the names do not: it is left out" in said
    for rows in (b"1,2,3,\n4,5,6\n", b"1,2,3,\n4,5,6,7\n", b"1,2,3,,\n"):
        with pytest.raises(CsvError, match="cells where the header has 3"):
            read_run(b"target_deg,reading_deg,load_kg\n" + rows, "A")


@pytest.mark.parametrize("separator", [" ", "   ", ","])
def test_of_a_table_separated_by_spaces_the_separator_is_said_to_be_wrong(separator):
    with pytest.raises(CsvError, match=r"spaces separate .*: save the file with commas, semicolons or tabs"):
        read_run(f"target_deg{separator}reading_deg\n  1.5   2.5\n".encode(), "A")


def test_of_very_many_faults_the_first_are_told_and_the_others_counted():
    rows = "".join(f"{k},{'x' if k % 2 else k}\n" for k in range(90_000))
    with pytest.raises(CsvError) as bad:
        read_run(f"target_deg,reading_deg\n{rows}".encode(), "A")
    said = str(bad.value)
    assert said.startswith("line 3, column reading_deg: 'x'")
    assert "line 21, " in said
    assert "line 23, " not in said
    assert said.endswith("and 44990 more")


def test_a_column_that_is_nearly_a_known_one_stays_a_covariate_with_a_warning():
    header = "target_deg,reading_deg,temprature_c,heading_deg,temperature2_c,accel_std_g"
    poses, _, said, _ = read_run(f"{header}\n1,2,20,4,21,0.1\n".encode(), "A")
    assert poses.cells("temprature_c") == [20.0]
    assert poses.cells("temperature_c") is None
    (warning,) = said
    assert "temprature_c (did you mean temperature_c?)" in warning
    assert not any(name in warning for name in ("heading_deg", "temperature2_c", "accel_std_g"))


@pytest.mark.parametrize(
    ("text", "n_poses"),
    [
        ("label,target_deg,reading_deg\n#1,1,2\n#2,2,3\n", 2),
        ("target_deg,reading_deg\n1,2\n#2,3\n4,5\n", 2),
        ('note,target_deg,reading_deg\n"a\n# b",1,2\n# c\n,2,3\n', 2),
        ('target_deg,reading_deg\n# 5" rod\n1,2\n', 1),
    ],
    ids=["a label is no comment", "a row that was taken out", "in a quoted cell", "a quote in a comment"],
)
def test_only_comments_are_left_out(text, n_poses):
    assert len(read_run(text.encode(), "A")[0]) == n_poses


@pytest.mark.parametrize(
    ("names", "meant"),
    [
        ("acel_x_g,acel_y_g", "acel_y_g (did you mean accel_y_g?)"),
        ("ax_g,ay_g", "ay_g (did you mean accel_y_g?)"),
        ("Acc X,Acc Y", "Acc Y (did you mean accel_y_g, in g?)"),
        ("GX,GY", "GY (did you mean gyro_y_dps, in deg/s?)"),
        ("x (g),y (g)", "y (g) (did you mean accel_y_g, in g?)"),
    ],
)
def test_a_log_names_the_nearest_channel_where_it_has_none(names, meant):
    with pytest.raises(CsvError) as refused:
        read_static(f"{names}\n1,2\n".encode())
    assert meant in str(refused.value)


@pytest.mark.parametrize("name", ["x", "y (mm)", "axle", "tilt_x", "index", "az_deg", "Az [°]", "gx_v"])
def test_a_name_that_only_shares_a_letter_with_a_channel_asks_nothing(name):
    _, _, said, _ = read_run(f"target_deg,reading_deg,{name}\n1,2,20\n".encode(), "A")
    assert said == []


def test_a_name_like_a_known_one_over_words_is_a_column_of_words():
    poses, _, _, _ = read_run(b"target_deg,reading_deg,Pass\n0,0.1,OK\n1,1.2,FAIL\n", "A")
    assert poses.cells("pass") is None
    with pytest.raises(CsvError, match="line 2, column pass"):
        read_run(b"target_deg,reading_deg,pass\n0,0.1,OK\n1,1.2,FAIL\n", "A")


@pytest.mark.parametrize("name", ["reading_deg min", "temperature_c/min", "temperature_c 1", "pass [V]"])
def test_a_known_name_with_something_else_beside_it_is_a_column_of_its_own(name):
    poses, _, _, _ = read_run(f"target_deg,reading_deg,{name}\n0,0.1,1.5\n1,1.2,2.5\n".encode(), "A")
    assert poses.cells(name) == [1.5, 2.5]


def test_a_comment_before_the_first_row_hides_no_clock():
    poses, _, _, _ = read_run(
        b"time,target_deg,reading_deg\n# started\n2024-05-01T12:00:00,0,0\n2024-05-01T12:00:09,1,1\n", "A"
    )
    assert poses.cells("time_s") == [0.0, 9.0]


def test_a_name_without_end_is_refused_at_once():
    with pytest.raises(CsvError, match="at most 100 characters"):
        read_run(b"target_deg,reading_deg,a(" + b" " * 100_000 + b"x\n0,0,0\n", "A")


@pytest.mark.parametrize(
    ("own", "value"), [("5,01", 5.01), ("-0,125", -0.125), ("1,234", None), ("1,5 2", None)]
)
def test_a_column_of_ones_own_may_have_another_decimal_sign_if_none_of_its_cells_has_thousands(own, value):
    poses, _, said, _ = read_run(
        f"target_deg;reading_deg;supply_v\n1.5;2.5;{own}\n2.5;3.5;{own}\n".encode(), "A"
    )
    assert poses.cells("target_deg") == [1.5, 2.5]
    assert poses.cells("supply_v") == (None if value is None else [value, value])
    assert any("supply_v" in sentence for sentence in said)


def test_a_first_row_of_numbers_with_units_is_no_row_of_units():
    poses, _, _, _ = read_run("target_deg,reading_deg,grade\n-60°,-59.9°,C\n-30°,-29.9°,C\n".encode(), "A")
    assert poses.cells("target_deg") == [-60.0, -30.0]


def test_what_a_spreadsheet_could_not_calculate_is_no_comment():
    with pytest.raises(CsvError) as bad:
        read_run(b"target_deg,reading_deg\n1,2\n#DIV/0!,3\n", "A")
    assert (bad.value.line, bad.value.column) == (3, "target_deg")


@pytest.mark.parametrize(
    ("stated", "sign"), [("sep=;", ";"), ('"SEP=;"', ";"), ("sep=,", ","), ("sep=\t", "\t")]
)
def test_a_spreadsheets_line_before_the_header_states_the_separator(stated, sign):
    rows = [["target_deg", "reading_deg", "time_s"], ["10", "10.25", "0"], ["20", "20.5", "1"]]
    text = "\r\n".join([stated, *(sign.join(row) for row in rows), ""])
    poses, _, warnings, _ = read_run(("\ufeff" + text).encode(), "A")
    assert poses.cells("reading_deg") == [10.25, 20.5]
    assert warnings == ["line 1 is read as the separator of the cells"]


def test_a_separator_that_is_not_read_is_refused_with_what_to_do():
    with pytest.raises(CsvError, match=r"line 1: says that '\|' separates .* save the file with commas"):
        read_run(b"sep=|\ntarget_deg|reading_deg\n10|10.5\n", "A")
