"""A calibration gives the elevations of its own poses back, however the sensor counts its turns."""

from __future__ import annotations

import numpy as np
import pytest
from compiled_header import COMPILER, applied, compiled
from hypothesis import given, settings
from hypothesis import strategies as st

from calrig.analysis.known_calibration import reading_doubts
from calrig.calibration.diagnosis import trace
from calrig.calibration.poses import Pose
from calrig.calibration.results import build_result, raw_error_deg
from calrig.export.calibration_document import calibration_content, line_of
from calrig.export.formats.c_header import c_header
from calrig.export.formats.table import correction_table
from calrig.loaded import Calibration

needs_a_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (gcc or clang) is installed")
COUNTED = {
    "from 0° to 360°": lambda reading_deg: reading_deg % 360.0,
    "to half a turn": lambda reading_deg: 180.0 - (180.0 - reading_deg) % 360.0,
    "on and on": lambda reading_deg: reading_deg,
}
"""What a sensor shows of a reading that goes on."""
RANGES_DEG = [(-60.0, 60.0), (-180.0, 180.0), (0.0, 350.0), (-10.0, 400.0), (-175.0, 170.0)]


def calibrated(theta_deg, reading_deg):
    poses = [Pose(float(t), float(r)) for t, r in zip(theta_deg, reading_deg, strict=True)]
    content = calibration_content(unit="AS-1", rig=None, poses=poses, result=build_result(poses, None))
    return {**content, "run_id": "1", "calibrated_at": None, "revision": 1}


def apart_deg(found_deg, theta_deg):
    """(n,) by how much elevations differ, whole turns apart."""
    return np.abs((found_deg - theta_deg + 180.0) % 360.0 - 180.0)


@settings(max_examples=300, deadline=None)
@given(
    range_deg=st.sampled_from(RANGES_DEG),
    count=st.sampled_from(sorted(COUNTED)),
    bias_deg=st.floats(-170.0, 170.0),
    scale=st.sampled_from([0.97, 0.9999, 1.0, 1.00004, 1.01, 1.05]),
    noise_deg=st.sampled_from([0.001, 0.02, 0.1]),
    seed=st.integers(0, 10_000),
)
def test_a_poses_reading_gives_its_elevation_or_none(range_deg, count, bias_deg, scale, noise_deg, seed):
    """None where a turn of the reading is another elevation of the range, and the calibration says so."""
    rng = np.random.default_rng(seed)
    theta_deg = np.linspace(*range_deg, 67)
    goes_on_deg = bias_deg + scale * theta_deg + noise_deg * rng.standard_normal(67)
    document = calibrated(theta_deg, COUNTED[count](goes_on_deg))
    found_deg = Calibration(document).elevation_deg(COUNTED[count](goes_on_deg))
    given_here = ~np.isnan(found_deg)
    assert apart_deg(found_deg, theta_deg)[given_here].max(initial=0.0) < 6.0 * document["rms_calibrated_deg"]
    is_told = bool(reading_doubts(document))
    assert is_told or given_here.all()
    if count == "on and on" or scale * (range_deg[1] - range_deg[0]) < 359.0:
        assert not is_told


@needs_a_compiler
@pytest.mark.parametrize("range_deg", RANGES_DEG)
@pytest.mark.parametrize("count", COUNTED)
def test_the_header_gives_what_python_gives(range_deg, count, tmp_path):
    theta_deg = np.linspace(*range_deg, 70)
    reading_deg = COUNTED[count](5.0 + 1.01 * theta_deg + 0.02 * np.sin(7.0 * np.arange(70)))
    document = calibrated(theta_deg, reading_deg)
    in_python_deg = Calibration(document).elevation_deg(reading_deg)
    in_c_deg = applied(compiled(c_header(document), tmp_path), reading_deg, np.full(70, 20.0))
    np.testing.assert_allclose(in_c_deg, in_python_deg, atol=1e-3)


def test_a_sensor_that_counts_from_0_to_360_is_read_right_on_both_sides_of_zero():
    """A scale of 1.01: a turn of the elevation taken off in its place would be 3.6° too much."""
    theta_deg = np.linspace(-60.0, 60.0, 25)
    document = calibrated(theta_deg, (5.0 + 1.01 * theta_deg) % 360.0)
    assert document["readings_wrap"] is True
    unit = Calibration(document)
    assert unit.elevation_deg([304.4, 334.7]) == pytest.approx([-60.0, -30.0], abs=1e-6)
    older = Calibration({key: value for key, value in document.items() if key != "readings_wrap"})
    assert older.elevation_deg([304.4, 334.7]) == pytest.approx([-60.0, -30.0], abs=1e-6)


def test_a_turn_of_the_stage_that_is_more_than_a_turn_of_the_reading_is_told():
    theta_deg = np.linspace(-180.0, 180.0, 37)
    document = calibrated(theta_deg, (5.0 + 1.01 * theta_deg) % 360.0)
    unit = Calibration(document)
    assert unit.elevation_deg([243.8, 126.2]) == pytest.approx([-120.0, 120.0], abs=1e-6)
    assert np.isnan(unit.elevation_deg(185.0))
    (doubt,) = reading_doubts(document)
    assert "stands for elevations 3.56° apart" in doubt.says
    assert "only from −176.4° to 176.4° is one given" in doubt.says
    assert correction_table(document).splitlines()[2].startswith("-177,")


def test_readings_that_the_poses_show_to_go_on_are_brought_back_by_turns_of_the_elevation():
    theta_deg = np.linspace(-180.0, 180.0, 37)
    document = calibrated(theta_deg, 5.0 + 1.01 * theta_deg)
    assert document["readings_wrap"] is False
    assert Calibration(document).elevation_deg(5.0 + 1.01 * 240.0) == pytest.approx(-120.0, abs=1e-6)


def test_run_diagnosis_document_and_poses_state_one_bias_of_readings_that_begin_elsewhere():
    """As in reading = bias + scale·θ, taken literally: an encoder goes on from where it began."""
    theta_deg = np.linspace(-30.0, 1500.0, 60)
    reading_deg = -253.0 + 1.02 * theta_deg + np.random.default_rng(1).normal(0.0, 0.1, 60)
    poses = [Pose(float(t), float(r)) for t, r in zip(theta_deg, reading_deg, strict=True)]
    document = calibrated(theta_deg, reading_deg)
    _, level = np.polyfit(theta_deg, reading_deg, 1)
    as_it_came_deg = reading_deg - theta_deg
    raw_deg = [raw_error_deg(pose, bias_deg=document["bias_deg"]) for pose in poses]
    assert document["bias_deg"] == pytest.approx(level)
    assert build_result(poses).bias_deg == document["bias_deg"] == line_of(document).bias_deg
    assert trace([poses], ["1"])["base"]["bias_deg"] == pytest.approx(document["bias_deg"])
    assert document["rms_raw_deg"] == pytest.approx(np.sqrt(np.mean(as_it_came_deg**2)))
    assert raw_deg == pytest.approx(as_it_came_deg)
    assert document["readings_wrap"] is False
