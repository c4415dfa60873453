"""`calrig solve` of a unit clamped with its x, y and z along the stage's axis."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest
from command_line import calrig

from .cube import as_csv, drawn_cube_bench


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("cube")


@pytest.fixture(scope="module")
def cube(folder):
    bench = drawn_cube_bench(3, turns=(1, 1, -1))
    (folder / "cube.csv").write_text(as_csv(bench.measured(np.random.default_rng(0))))
    return bench


def test_a_file_with_mount_axis_gives_the_whole_unit_and_its_calibration(cube, folder):
    found = json.loads(calrig("solve", folder / "cube.csv", "--out", folder / "made", "--json").stdout)
    (unit,) = found["units"]
    error_mg = 1e3 * np.array(unit["accelerometer"]["bias_g"]) - cube.unit.bias_mg
    assert np.abs(error_mg).max() < 1.0
    assert unit["gyro"]["turns"]["closed"]
    made = json.loads((folder / "made" / "U0.json").read_text())
    assert made["accelerometer"] == unit["accelerometer"]
    assert made["gyro"]["matrix"] == unit["gyro"]["matrix"]
    assert made["gyro"]["scale"] == unit["gyro"]["matrix"][0][0]
    assert {effect["name"] for effect in made["effects"]} >= {"accelerometer_offset", "axis_mismatch"}
    stated = made.pop("sha256")
    plain = json.dumps(made, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    assert stated == hashlib.sha256(plain.encode()).hexdigest()
    stage = json.loads((folder / "made" / "stage-map.json").read_text())
    assert stage["map"] == found["stage"]["map"]


def test_a_person_reads_matrices_with_their_errors(cube, folder):
    said = calrig("solve", folder / "cube.csv", "--frame", "faces").stdout
    assert "in the frame of its faces" in said
    assert "against the board's clock" in said
    assert "axis_dip_deg" in said
    refused = calrig("solve", folder / "cube.csv", "--frame", "body", status=2).stderr
    assert "--frame is 'body': it is sensor or faces" in refused
