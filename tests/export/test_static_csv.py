"""Logs of samples are read in any of the contract's units, and a bad one is told by line and column."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calrig.export.csv_errors import CsvError
from calrig.export.static_csv import accel_g_of, read_static


def test_a_log_in_any_unit_comes_as_g_and_degrees_per_second():
    log = read_static(
        b"\xef\xbb\xbftime_s,accel_x_mps2,accel_y_g,accel_z_lsb,gyro_x_rps,gyro_y_dps,gyro_z_lsb,temperature_c\r\n"
        b"0,9.80665,0.5,16384,3.141592653589793,2,131.072,25\r\n"
        b"0.01,-9.80665,,0,0,0,0,26\r\n",
        accel_range_g=2.0,
        gyro_range_dps=250.0,
    )

    assert list(log.channels) == [
        *("accel_x_g", "accel_y_g", "accel_z_g", "gyro_x_dps", "gyro_y_dps", "gyro_z_dps", "temperature_c")
    ]
    first = {name: values[0] for name, values in log.channels.items()}
    assert list(first.values()) == pytest.approx([1.0, 0.5, 1.0, 180.0, 2.0, 1.0, 25.0])
    assert math.isnan(log.channels["accel_y_g"][1])
    assert (len(log), log.time_s.tolist(), log.warnings) == (2, [0.0, 0.01], ())
    assert log.axes("gyro", "dps").shape == (2, 3)


def test_counts_of_an_unknown_range_stay_counts():
    log = read_static(b"accel_x_lsb,accel_y_lsb,accel_z_lsb\n1,2,16384\n")

    assert {name: values.tolist() for name, values in log.channels.items()} == {
        "accel_x_lsb": [1.0],
        "accel_y_lsb": [2.0],
        "accel_z_lsb": [16384.0],
    }
    assert log.time_s is None
    with pytest.raises(CsvError, match=r"column accel_x_lsb: is in counts.*--accel-range"):
        accel_g_of(log)


def test_a_title_before_the_names_is_passed_over():
    log = read_static(b"Level surface, Z up.\naccel_x_g,accel_y_g,accel_z_g\n0.1,0,1\n0.2,0,1\n")

    assert log.channels["accel_x_g"].tolist() == [0.1, 0.2]
    assert log.warnings == ("what comes before the names of the columns, in line 2, is not read",)


def test_what_is_no_channel_is_left_out_with_a_warning():
    log = read_static(b"time_s,accel_x_g,lux,gyro_x_dps\n0,1,a,\n1,1,b,\n2,1,c,\n")

    assert list(log.channels) == ["accel_x_g"]
    assert log.warnings == (
        "column lux is not a channel of a log; left out",
        "column gyro_x_dps has no values; left out",
    )


@pytest.mark.parametrize(
    ("times", "flaw"),
    [
        ("0,2,1", "goes back from 2 to 1 in line 4"),
        ("0,,1", "is not known in line 3"),
        ("0,0,1", ""),
    ],
)
def test_time_comes_as_logged_and_is_taken_for_what_passed_only_if_it_goes_forward(times, flaw):
    rows = "".join(f"{time},1\n" for time in times.split(","))
    log = read_static(f"time_s,accel_x_g\n{rows}".encode())

    assert log.time_flaw == flaw
    np.testing.assert_array_equal(log.time_s, [float(time or "nan") for time in times.split(",")])
    assert (log.forward_time_s is None) == bool(flaw)


def test_a_log_may_be_longer_than_a_run_has_poses():
    rows = 150_000
    log = read_static(b"accel_z_g\n" + b"1.0\n" * rows)
    assert log.channels["accel_z_g"].sum() == rows


@pytest.mark.parametrize(
    ("data", "line", "column", "says"),
    [
        (b"", None, None, "empty"),
        (b"accel_x_g\n", 1, None, "no rows"),
        (b"ax,ay,az\n1,2,3\n", 1, None, "no channel of a log"),
        (b"accel_x_g,gyro_x_dps\n1,2\n1,x\n", 3, "gyro_x_dps", "'x' is not a number"),
        (b"accel_x_g,accel_x_mps2\n1,2\n", 1, "accel_x_mps2", "the same as accel_x_g in another unit"),
        (b"accel_x_g,accel_y_g\n1\n", 2, None, "1 cells where the header has 2"),
    ],
)
def test_a_bad_log_is_told_by_line_and_column(data, line, column, says):
    with pytest.raises(CsvError) as bad:
        read_static(data)
    assert says in str(bad.value)
    assert (bad.value.line, bad.value.column) == (line, column)


def test_time_in_another_unit_at_the_end_of_its_name_is_converted():
    log = read_static(b"time_ms,accel_x_g\n250,0\n500,1\n")
    assert log.time_s.tolist() == [0.25, 0.5]


def test_gravity_needs_all_three_axes():
    with pytest.raises(CsvError, match="column accel_z_g: there is no such column"):
        accel_g_of(read_static(b"accel_x_g,accel_y_g\n0,1\n"))


@pytest.mark.parametrize("full_scale", [0.0, -2.0, np.inf, np.nan])
def test_a_range_is_above_nothing(full_scale):
    with pytest.raises(ValueError, match="it must be above 0"):
        read_static(b"accel_x_lsb\n1\n", accel_range_g=full_scale)
