"""`calrig diagnose` and `calrig gravity` on files from anybody's rig: JSON for programs, words for people."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import pytest
from support import DATA

WARM_UP = DATA / "mpu6050_warmup_poses.csv"
measured = pytest.mark.skipif(not WARM_UP.exists(), reason=f"the measured data are not at {DATA}")


def calrig(*arguments, cwd):
    """Runs the command line as a person does."""
    command = [sys.executable, "-m", "calrig", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, timeout=120)


@measured
def test_the_warm_up_drift_is_traced_to_temperature_not_time(tmp_path):
    done = calrig("diagnose", WARM_UP, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    linear, second = found["effects"]
    assert (linear["name"], linear["verdict"]) == ("temperature_bias", "named")
    assert linear["parameters"]["deg_per_c"]["value"] == pytest.approx(0.0164, abs=0.0005)
    assert second["name"] == "temperature_curvature"
    assert found["base"]["scale"] is None
    assert found["base"]["fit_rms_deg"] == pytest.approx(0.062, abs=0.0005)
    assert found["final"]["held_out_rms_deg"] < 0.008


@measured
def test_a_person_reads_the_verdict_first(tmp_path):
    done = calrig("diagnose", WARM_UP, cwd=tmp_path)
    assert done.stdout.startswith("named: reading = bias + scale·θ + temperature_bias")
    assert "noise floor" in done.stdout


@measured
@pytest.mark.parametrize(
    ("log", "fit_mg", "left_out_mg"),
    [
        ("mpu9150_unit0_multiposition", 0.25, 0.4),
        ("mpu9150_unit2_multiposition", 0.25, 0.4),
        ("xsens_multiposition", 0.15, 0.2),
    ],
)
def test_gravity_finds_that_the_axes_are_not_square(tmp_path, log, fit_mg, left_out_mg):
    done = calrig("gravity", DATA / f"{log}.csv", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert [effect["name"] for effect in found["effects"]] == ["misalignment"]
    assert found["final"]["fit_rms_mg"] <= fit_mg < found["base"]["fit_rms_mg"]
    assert found["final"]["held_out_rms_mg"] <= left_out_mg < found["base"]["held_out_rms_mg"]


@pytest.mark.parametrize(
    ("command", "content", "reason"),
    [
        ("diagnose", "target_deg,reading_deg\n0,0.1\n10,x\n", r"bad.csv: .*line 3, column reading_deg"),
        ("diagnose", "target_deg,reading_deg\n0,0.1\n10,10.1\n", r"2 poses are too few"),
        ("gravity", "accel_x_g,accel_y_g,accel_z_g\n0,0,one\n", r"bad.csv: .*line 2, column accel_z_g"),
    ],
)
def test_a_bad_file_is_one_line_and_status_2(tmp_path, command, content, reason):
    (tmp_path / "bad.csv").write_text(content, encoding="utf-8")
    done = calrig(command, "bad.csv", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert re.search(reason, done.stderr), done.stderr


def test_files_and_runs_are_not_mixed(tmp_path):
    done = calrig("diagnose", "poses.csv", "17", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (2, "calrig: diagnose: name files or run ids, not both\n")
