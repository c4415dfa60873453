"""Poses as CSV: every row a pose or an error that names line and column; what is written reads back."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import DATA

from calrig.calibration.line import fit_line
from calrig.calibration.poses import COLUMNS, Pose
from calrig.export import csv_table
from calrig.export.csv_errors import CsvError
from calrig.export.poses_csv import (
    read_about_x,
    read_labelled_columns,
    read_mounted,
    read_poses,
    read_run,
    write_poses,
)

number = st.floats(-1e30, 1e30, allow_nan=False)
count = st.integers(0, 2**53)
name = st.from_regex(r"[A-Za-zäµ°_][\w ,;\"/%-]{0,20}\w", fullmatch=True).filter(lambda n: n not in COLUMNS)


@st.composite
def poses(draw: st.DrawFn) -> list[Pose]:
    names = draw(st.lists(name, unique=True, max_size=3))
    times = sorted(draw(st.lists(number, min_size=1, max_size=8)))
    optional = st.none() | number
    known = {
        "sweep": st.none() | count,
        "approach": st.sampled_from([None, -1, 0, 1]),
        "n_samples": st.none() | count,
    } | {
        column: optional
        for column in COLUMNS[2:]
        if column not in {"pass", "approach", "n_samples", "time_s"}
    }
    return [
        Pose(
            target_deg=draw(number),
            reading_deg=draw(number),
            time_s=draw(st.sampled_from([None, time])),
            covariates={n: draw(optional) for n in names},
            **{column: draw(values) for column, values in known.items()},
        )
        for time in times
    ]


def values_of(pose: Pose) -> dict[str, float | int]:
    return {name: value for name, value in pose.row().items() if value is not None}


@given(poses())
@settings(deadline=None, max_examples=50)
def test_what_is_written_reads_back_exactly(written):
    back = read_poses(write_poses(written).encode())
    assert back.warnings == []
    assert [values_of(pose) for pose in back.poses] == [values_of(pose) for pose in written]


plain = st.text(st.characters(exclude_characters=',"\r\n', exclude_categories=["Cs"]), max_size=4)
cell = st.sampled_from(["", "1", "1", "-2.5", "1e3", "nan", "x", "inf", "1_0", "٣", "=1"]) | plain
headers = st.lists(st.sampled_from([*COLUMNS[2:], "humidity", "note", ""]), max_size=3)


@st.composite
def files(draw: st.DrawFn) -> tuple[bytes, int]:
    """A file that is mostly in order, and how many rows it has."""
    names = ["target_deg", "reading_deg", *draw(headers)]
    rows = draw(st.lists(st.lists(cell, min_size=len(names) - 2, max_size=len(names) - 2), max_size=4))
    lines = [",".join(["1", draw(cell), *row]) for row in rows]
    end = draw(st.sampled_from(["\n", "\r\n", "\r", "\n\n"]))
    return end.join([",".join(names), *lines]).encode(), len(rows)


@given(files())
@settings(deadline=None, max_examples=300)
def test_every_row_is_a_pose_or_an_error(file):
    data, n_rows = file
    try:
        imported = read_poses(data)
    except CsvError as error:
        assert str(error).isprintable()
        return
    assert len(imported.poses) == n_rows
    assert all(math.isfinite(value) for pose in imported.poses for value in values_of(pose).values())


@given(
    st.binary(max_size=200)
    | st.binary(max_size=200).map(lambda tail: b"target_deg,reading_deg\n1,2\n" + tail)
)
@settings(deadline=None, max_examples=300)
def test_no_bytes_crash_the_reader(data):
    try:
        assert read_poses(data).poses
    except CsvError as error:
        assert str(error).isprintable()


def test_a_spreadsheets_bom_line_ends_and_spaces_are_accepted():
    data = "\ufefftarget_deg , reading_deg,pass,humidity\r\n 10 ,10.25,0.0,41\r\n\r\n20,20.5,,\r\n".encode()
    assert read_poses(data).poses == [
        Pose(10.0, 10.25, sweep=0, covariates={"humidity": 41.0}),
        Pose(20.0, 20.5, sweep=None, covariates={"humidity": None}),
    ]


@pytest.mark.parametrize("name", ["=cmd()", "+5V", "-dT_c", "@lux", "＝1", "'=x", "''=x", "'quoted"])
def test_a_name_that_a_spreadsheet_would_compute_is_text_in_the_file_and_itself_again_when_read(name):
    written = [Pose(1.0, -0.5, covariates={name: -3.5}), Pose(2.0, 0.5, covariates={name: 1e-9})]
    header, *rows = write_poses(written).splitlines()
    assert header.split(",")[2].startswith("'")
    assert rows[0] == "1.0,-0.5,-3.5"
    assert read_poses(write_poses(written).encode()).poses == written


@pytest.mark.parametrize(
    "data",
    [
        b"target_deg;reading_deg;lux\r\n10;10.25;1e3\r\n-20;;\r\n".replace(b";;", b";-20.5;"),
        b"target_deg;reading_deg;lux\n10;10,25;1e3\n-20; -20,5 ;\n",
        b"\xef\xbb\xbftarget_deg\treading_deg\tlux\n10\t10.25\t1e3\n-20\t-20.5\t\n",
        b"target_deg\treading_deg\tlux\r\n10,0\t10,25\t1000\r\n-20,\t-20,5\t\r\n",
        b'\n"target_deg";"reading_deg";"lux"\n"10";"10,25";"1000"\n"-20";"-20,5";""\n',
    ],
    ids=["semicolons", "decimal commas", "tabs", "tabs and decimal commas", "quoted"],
)
def test_semicolons_tabs_and_decimal_commas_are_read_as_they_are_meant(data):
    imported = read_poses(data)
    assert imported.warnings == []
    assert imported.poses == [
        Pose(10.0, 10.25, covariates={"lux": 1000.0}),
        Pose(-20.0, -20.5, covariates={"lux": None}),
    ]


def test_a_name_with_a_semicolon_in_it_does_not_make_one_the_separator():
    imported = read_poses(b"target_deg,reading_deg,a;b;c;d\n1,2,3\n")
    assert imported.poses == [Pose(1.0, 2.0, covariates={"a;b;c;d": 3.0})]


def test_quoted_cells_may_hold_commas_and_line_breaks():
    imported = read_poses(b'note,target_deg,"reading_deg"\n"one, two\nthree","1","2"\n,3,4\n')
    assert [(p.target_deg, p.reading_deg) for p in imported.poses] == [(1.0, 2.0), (3.0, 4.0)]


def test_columns_that_cannot_be_covariates_are_left_out_with_a_warning():
    imported = read_poses(b"target_deg,reading_deg,operator,,lux\n1,2,7,0,\n3,4,eve,1,\n")
    assert imported.poses == [Pose(1.0, 2.0), Pose(3.0, 4.0)]
    assert imported.warnings == [
        "column operator: is not numeric (line 3: 'eve' is not a number); left out",
        "column 4: has no name; left out",
        "column lux: has no values; left out",
    ]


def test_lines_of_a_logger_before_the_names_are_left_out_with_a_word():
    imported = read_poses(b"Bench 3\nDate;2021-05-05\n\n# by hand\nTarget [rad];reading_deg\n0;1,5\n1;2,5\n")
    assert [p.reading_deg for p in imported.poses] == [1.5, 2.5]
    assert "before the names of the columns, in line 5, is not read" in imported.warnings[0]


def test_rows_out_of_time_are_sorted_with_a_warning():
    imported = read_poses(b"target_deg,reading_deg,time_s\n1,0,30\n2,0,10\n3,0,20\n")
    assert [p.target_deg for p in imported.poses] == [2.0, 3.0, 1.0]
    assert imported.warnings == ["the rows were not in order of time_s; they are sorted by it"]


def test_rows_whose_time_is_partly_unknown_stay_where_they_are_with_a_warning():
    imported = read_poses(b"target_deg,reading_deg,time_s\n1,0,30\n2,0,\n3,0,20\n")
    assert [p.target_deg for p in imported.poses] == [1.0, 2.0, 3.0]
    assert "goes backwards and is not known for every row" in imported.warnings[0]


@pytest.mark.parametrize(
    ("data", "line", "column", "says"),
    [
        (b"", None, None, "empty"),
        (b"\xef\xbb\xbf\r\n\r\n", None, None, "empty"),
        (b"target_deg,reading_deg\n", 1, None, "no rows"),
        (b"target_deg,reading_deg\n1,2\n\xff,3\n", 3, None, "not UTF-8"),
        (b"reading_deg,time_s\n1,2\n", 1, "target_deg", "no such column"),
        (
            b"tilt_deg,reading_deg\n1,2\n",
            1,
            "target_deg",
            "there are: tilt_deg, reading_deg (calrig/docs/reference/file-formats.md",
        ),
        (b"target_deg;tilt;lux\n1;2;3\n", 1, "reading_deg", "there are: target_deg, tilt, lux"),
        (b"target_deg;reading_deg\n1,5;2.5\n", 2, "target_deg", "decimals are written with a point"),
        (b"target_deg;reading_deg\n1,5;2,5\n1;1,234,567\n", 3, "reading_deg", "'1,234,567' is not a number"),
        (b"target_deg\treading_deg\n1\t2\n1,5\t2\t3\n", 3, None, "3 cells where the header has 2"),
        (b"1.0,2.0\n3.0,4.0\n", 1, "target_deg", "the first line holds numbers"),
        (b"2021-05-05 10:00:00,2.0,-3\n", 1, "target_deg", "the first line holds numbers"),
        (b"Bench 3\n\ntilt_deg,reading_deg\n1,2\n", 1, "target_deg", "the names are in line 3"),
        (b"Bench 3\ntilt_deg,reading_deg\n\n1,2\n", 1, "target_deg", "the names are in line 2"),
        (b"Run;7;\n\nGroup;Count;Time;\n\nName;pos;vel\nUnit;a;b\n0;1;2\n", 1, "target_deg", "in line 5"),
        (b"Plot,2\nItems,2,,MIN,MAX\n-1,3,,-9,8\nt,goal,now\n0,1,2\n1,2,3\n", 1, "target_deg", "in line 4"),
        (b"1e1 2.5 -3\n4 5 6\n", 1, "target_deg", "spaces separate the numbers"),
        (b"0.5 " * 40 + b"1\n", 1, "0.5 " * 40 + "1", "before it; spaces separate the numbers"),
        (b"0.5 " * 140 + b"1\n", 1, None, "before it; spaces separate the numbers"),
        (b"PK\x03\x04\x14\x00\x06\x00[Content_Types].xml", 1, None, "is a workbook or an archive"),
        (b"MATLAB 5.0 MAT-file, Platform\0\xff", 1, None, "is a file of MATLAB or HDF5"),
        (b"0.0,-1.1,0,0\n0.1,-1.2,0,0\n", 1, "0", "the column names must come before it"),
        (b"Winkel;Anzeige\n1,5;2,5\n", 1, "target_deg", "there are: Winkel, Anzeige (calrig"),
        (b"tilt,meter\n1,2\n1,2,3\n", 1, "target_deg", "there are: tilt, meter (calrig"),
        (b"target_deg,reading_deg,lux,lux\n1,2,3,4\n", 1, "lux", "twice"),
        (b"target_deg,reading_deg\n1,2\n1,2,3\n", 3, None, "3 cells where the header has 2"),
        (b"target_deg,reading_deg\n1,5,2,5\n", 2, None, "decimals are written with a point"),
        (b"target_deg,reading_deg\n1,2\n\n3,abc\n", 4, "reading_deg", "'abc' is not a number"),
        (b'target_deg,reading_deg\n1,"2,5"\n', 2, "reading_deg", "decimals are written with a point"),
        (b"target_deg,reading_deg\n1,nan\n", 2, "reading_deg", "a pose needs it"),
        (b"target_deg,reading_deg\n1,inf\n", 2, "reading_deg", "not a number"),
        (b"target_deg,reading_deg\n1,1e999\n", 2, "reading_deg", "beyond"),
        (b"target_deg,reading_deg,stage_deg\n1,2,1_000\n", 2, "stage_deg", "not a number"),
        (b"target_deg,reading_deg,pass\n1,2,0.5\n", 2, "pass", "not whole"),
        (b"target_deg,reading_deg,pass\n1,2,-1\n", 2, "pass", "not a count"),
        (b"target_deg,reading_deg,mount_deg\n1,2,half\n", 2, "mount_deg", "'half' is not a number"),
        (b"target_deg,reading_deg,n_samples\n1,2,1e25\n", 2, "n_samples", "not a count"),
        (b"target_deg,reading_deg,approach\n1,2,1\n1,2,2\n", 3, "approach", "none of -1, 0, 1"),
        (b'target_deg,reading_deg\n1,"2\n', 2, None, "is not CSV"),
        (b"target_deg,reading_deg" + b",x" * 199 + b"\n", 1, None, "201 columns; at most 200"),
        (b"target_deg,reading_deg\n" + b"1,2\n" * 100_001, 100_002, None, "more than 100000 rows"),
        (b"target_deg,reading_deg\n" + b"," * 2_000_000, 2, None, "longer than"),
        (b'target_deg,reading_deg\n"' + b"\n" * 200_000, None, None, "is not CSV"),
        (b"target_deg,reading_deg\n" + b"1,2\n" * 50_000 + b"\xff,2\n", 50_002, None, "byte 0xFF"),
        (b"target_deg,reading_deg,=a,'=a\n1,2,3,4\n", 1, "=a", "this name twice"),
        (b"target_deg,reading_deg," + b"x" * 101 + b"\n1,2,3\n", 1, "x" * 101, "at most 100 characters"),
    ],
)
def test_a_bad_file_is_told_by_line_and_column(data, line, column, says):
    with pytest.raises(CsvError) as bad:
        read_poses(data)
    assert says in str(bad.value)
    assert bad.value.column == column
    assert line is None or bad.value.line == line
    if line is not None:
        assert str(bad.value).startswith(f"line {line}")


@pytest.mark.parametrize(
    ("columns", "rows", "line", "says"),
    [
        ("mount_axis", ["y", "q"], 3, "'q' is none of x, -x, y, -y, z, -z"),
        ("mount_axis", ["+Y", "y", ""], 4, "'x' after 'y'"),
        ("unit", ["A", "B"], 3, "'B' after 'A'"),
        ("mount,mount_deg", ["a,0", "a,120"], 3, "'a' was clamped at 0° and at 120°"),
        ("mount,mount_deg", ["a,0", "b,120", "c,0"], 4, "'c' and 'a' are two clampings at 0°"),
    ],
)
def test_a_file_of_several_runs_is_not_imported_as_one(columns, rows, line, says):
    text = "\n".join([f"target_deg,reading_deg,{columns}", *(f"1,2,{row}" for row in rows)])
    with pytest.raises(CsvError) as bad:
        read_run(text.encode(), "A")
    assert (bad.value.line, says in bad.value.what) == (line, True), bad.value


def test_a_file_beyond_the_size_is_refused_before_it_is_read():
    with pytest.raises(CsvError, match="at most 150000000 are read"):
        read_poses(b"\xff" * (csv_table.MAX_BYTES + 1))


def test_short_cells_cannot_take_all_memory(monkeypatch):
    monkeypatch.setattr(csv_table, "MAX_CELLS", 200_000)
    width = csv_table.MAX_COLUMNS
    head = ",".join(["target_deg", "reading_deg", *(f"c{k}" for k in range(width - 2))])
    rows = csv_table.MAX_CELLS // width
    with pytest.raises(
        CsvError, match=f"line {rows + 2}: the file has more than {csv_table.MAX_CELLS} cells"
    ):
        read_poses((head + ("\n" + "1," * (width - 1) + "1") * (rows + 1)).encode())


def test_the_measured_warm_up_is_144_poses_at_one_elevation():
    file = DATA / "mpu6050_warmup_poses.csv"
    if not file.is_file():
        pytest.skip(f"{file} is not here: set CALRIG_DATA to the folder of measured data")
    imported = read_poses(file.read_bytes())

    assert (len(imported.poses), imported.warnings) == (144, [])
    assert {p.target_deg for p in imported.poses} == {0.0}
    assert all(before.time_s < after.time_s for before, after in itertools.pairwise(imported.poses))
    for pose in imported.poses:  # a mean of angles is the angle of the means to within its standard error
        angle_deg = math.degrees(math.atan2(pose.accel_y_g, pose.accel_z_g))
        stderr_deg = pose.reading_std_deg / math.sqrt(pose.n_samples)
        assert pose.reading_deg == pytest.approx(angle_deg, abs=stderr_deg)


def test_the_angle_of_the_mount_turns_the_elevation_modulo_a_turn():
    text = "target_deg,stage_deg,reading_deg,mount_deg\n10,10.5,1,350\n20,,2,120\n30,30.1,3,\n"
    poses = read_poses(text.encode()).poses
    assert [pose.theta_deg for pose in poses] == pytest.approx([0.5, 140.0, 30.1])


def test_few_rows_without_a_reading_are_left_out_and_counted_and_more_are_refused():
    rows = [f"{k},{k + 0.5},m{k},{2 * k}" for k in range(40)]
    rows[3], rows[20], rows[21] = "3,,m3,6", "20,nan,m20,40", ",21.5,m21,42"
    text = "\n".join(["target_deg,reading_deg,mount,load_kg", *rows])
    poses, texts, said = read_labelled_columns(text.encode(), ["mount"])
    kept = [k for k in range(40) if k not in {3, 20, 21}]
    assert poses.cells("target_deg") == kept
    assert poses.cells("load_kg") == [2.0 * k for k in kept]
    assert texts["mount"].texts == [f"m{k}" for k in kept]
    assert said == ["3 of 40 rows lack target_deg or reading_deg and are left out, the first in line 5"]

    rows[4:6] = ["4,,m4,8", "5,,m5,10"]
    text = "\n".join(["target_deg,reading_deg,mount,load_kg", *rows])
    with pytest.raises(CsvError, match="line 5, column reading_deg: '' is not known, and a") as refused:
        read_labelled_columns(text.encode(), ["mount"])
    assert "line 23, column target_deg" in str(refused.value)


READERS = {
    "diagnosed": read_about_x,
    "imported": lambda data: (read_run(data, "AS-1")[0][:], read_run(data, "AS-1")[2]),
    "solved": lambda data: (
        read_mounted(data, "log", "AS-1")[0][0].poses,
        read_mounted(data, "log", "AS-1")[1],
    ),
}


def _table(target_deg, reading_deg):
    rows = zip(target_deg.tolist(), reading_deg.tolist(), strict=True)
    return "".join(["target_deg,reading_deg\n", *(f"{t},{r}\n" for t, r in rows)]).encode()


@pytest.mark.parametrize("reader", READERS)
def test_targets_written_from_0_to_360_around_0_are_taken_on_one_arc(reader):
    true_deg = np.arange(-30.0, 31.0)
    noise_deg = np.random.default_rng(1).normal(0.0, 0.02, len(true_deg))
    data = _table(true_deg % 360.0, (0.4 + 1.02 * true_deg + noise_deg) % 360.0)
    poses, said = READERS[reader](data)
    assert [pose.target_deg for pose in poses] == true_deg.tolist()
    assert any("targets above 30° were taken as less by 360°" in sentence for sentence in said)
    line = fit_line(*np.array([(pose.theta_deg, pose.reading_deg) for pose in poses]).T)
    assert line.bias_deg == pytest.approx(0.4, abs=0.02)
    assert line.scale == pytest.approx(1.02, abs=0.001)


def test_rows_that_go_on_over_0_are_of_one_arc_where_no_line_says_so():
    """A scale of 1 and a drift of 2° leave readings as far from a line as written as with the circle cut."""
    true_deg = np.tile(np.arange(-60.0, 61.0, 8.0), 3)
    drift_deg = np.linspace(0.0, 2.0, len(true_deg))
    poses, said = read_about_x(_table(true_deg % 360.0, (0.4 + true_deg + drift_deg) % 360.0))
    assert [pose.target_deg for pose in poses] == true_deg.tolist()
    assert any("targets above 60° were taken as less by 360°" in sentence for sentence in said)


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    ("written_deg", "scale"),
    [
        pytest.param(np.concatenate([np.arange(31.0), np.arange(330.0, 361.0)]), 1.02, id="moved-to-330"),
        pytest.param(np.concatenate([np.arange(31.0), np.arange(330.0, 361.0)]), 1.0, id="as-good"),
        pytest.param(np.arange(0.0, 360.0, 5.0), 1.02, id="full-turn"),
        *(
            pytest.param(
                np.random.default_rng(seed).permutation(
                    np.concatenate([np.arange(0.0, 101.0, 10.0), np.arange(260.0, 351.0, 10.0)])
                ),
                1.0,
                id=f"random-order-{seed}",
            )
            for seed in range(4)
        ),
        pytest.param(np.append(np.arange(0.0, 31.0), np.arange(690.0, 720.0)), 1.02, id="several-turns"),
        pytest.param(np.array([5.0]), 1.02, id="one-pose"),
    ],
)
def test_targets_stay_as_written_where_no_better_line_is_found_elsewhere(reader, written_deg, scale):
    noise_deg = np.random.default_rng(2).normal(0.0, 0.02, len(written_deg))
    poses, said = READERS[reader](_table(written_deg, (0.4 + scale * written_deg + noise_deg) % 360.0))
    assert [pose.target_deg for pose in poses] == written_deg.tolist()
    assert not any("less by 360°" in sentence for sentence in said)
