"""Raw samples leave as the columns of a static log, exactly."""

from __future__ import annotations

import csv
import dataclasses
import io

import numpy as np

from calrig.export.samples_csv import COLUMNS, write_samples_csv, write_samples_npz
from calrig.store import RawSamples


def samples(n: int) -> RawSamples:
    rng = np.random.default_rng(4)
    return RawSamples(
        np.arange(n) / 200, rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), np.full(n, np.nan)
    )


def test_csv_holds_every_sample_and_leaves_unknown_cells_empty():
    log = samples(12_000)
    rows = list(csv.reader(io.StringIO("".join(write_samples_csv([log])))))

    assert rows[0] == list(COLUMNS)
    assert {row[-1] for row in rows[1:]} == {""}
    table = np.array([[float(cell) for cell in row[:-1]] for row in rows[1:]])
    np.testing.assert_array_equal(table, np.column_stack((log.time_s, log.accel_g, log.gyro_dps)))


def test_no_samples_are_a_header():
    assert "".join(write_samples_csv([samples(0)])) == ",".join(COLUMNS) + "\n"


def test_blocks_come_one_after_the_other_and_none_are_a_header():
    log = samples(30)
    blocks = [
        RawSamples(
            log.time_s[k : k + 7],
            log.accel_g[k : k + 7],
            log.gyro_dps[k : k + 7],
            log.temperature_c[k : k + 7],
        )
        for k in range(0, 30, 7)
    ]
    assert "".join(write_samples_csv(blocks)) == "".join(write_samples_csv([log]))
    assert "".join(write_samples_csv([])) == ",".join(COLUMNS) + "\n"


def test_npz_holds_one_array_a_column():
    log = samples(7)
    with np.load(io.BytesIO(write_samples_npz(log)), allow_pickle=False) as arrays:
        assert arrays.files == list(COLUMNS)
        np.testing.assert_array_equal(arrays["accel_y_g"], log.accel_g[:, 1])
        np.testing.assert_array_equal(arrays["gyro_z_dps"], log.gyro_dps[:, 2])
        np.testing.assert_array_equal(arrays["temperature_c"], log.temperature_c)


def test_the_angle_of_a_board_that_filters_itself_is_a_column_more():
    log = dataclasses.replace(samples(3), angle_deg=np.array([1.25, np.nan, -3.5]))
    rows = list(csv.DictReader(io.StringIO("".join(write_samples_csv([log])))))
    assert list(rows[0]) == [*COLUMNS, "angle_deg"]
    assert [row["angle_deg"] for row in rows] == ["1.25", "", "-3.5"]
