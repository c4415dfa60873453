"""Curves of the accelerometer's axes in other programs' formats: the best straight line, or the curve."""

from __future__ import annotations

import re

import numpy as np
import pytest
from compiled_header import COMPILER, test_vectors
from issued_documents import BIAS_G, MATRIX, issued, whole
from test_formats import G_MPS2, Px4

from calrig.export.formats.ardupilot import ardupilot
from calrig.export.formats.c_header import c_header
from calrig.export.formats.imu_tk import imu_tk
from calrig.export.formats.imucal import imucal
from calrig.export.formats.px4 import px4

CURVE_G = 5e-3
"""Of square and cubic term of each axis."""
CURVED = {
    "bias_g": BIAS_G.tolist(),
    "matrix": MATRIX.tolist(),
    "quadratic_g_per_g2": [CURVE_G] * 3,
    "cubic_g_per_g3": [CURVE_G] * 3,
}
TANGENT_MG, BEST_MG = 2.93, 1.67
"""RMS over all directions of 5·(u² + u³) and of what its best line leaves, u uniform in ±1 (by hand)."""


def directions():
    """(n, 3) of gravity, g, uniform over the sphere."""
    vectors = np.random.default_rng(0).normal(size=(40_000, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def sensed_g(true_g, matrix=MATRIX):
    """(n, 3) what the curved accelerometer measures: each axis bends in what acts along it."""
    response = np.linalg.inv(matrix)
    along = true_g @ (response / np.diag(response)[:, None]).T
    return true_g @ response.T + CURVE_G * (along**2 + along**3) + BIAS_G


def rms_mg(error_g):
    return 1e3 * np.sqrt((error_g**2).mean(axis=0))


def of_imu_tk(raw_g):
    numbers = np.array(imu_tk(whole(accelerometer=CURVED)).split()[:21], dtype=float)
    misalignment, scale, bias = numbers[:9].reshape(3, 3), numbers[9:18].reshape(3, 3), numbers[18:]
    return (raw_g * G_MPS2 - bias) @ (misalignment @ scale).T / G_MPS2


def of_imucal(raw_g):
    from imucal import FerrarisCalibrationInfo

    info = FerrarisCalibrationInfo.from_json(imucal(whole(accelerometer=CURVED)))
    return info.calibrate(raw_g, np.zeros_like(raw_g), acc_unit="g", gyr_unit="deg/s")[0] / G_MPS2


@pytest.mark.parametrize("read", [of_imu_tk, of_imucal])
def test_a_matrix_is_the_best_over_all_directions_and_not_the_tangent(read):
    true_g = directions()
    raw_g = sensed_g(true_g)
    left_mg = rms_mg(read(raw_g) - true_g)
    np.testing.assert_allclose(left_mg, BEST_MG, rtol=0.02)
    np.testing.assert_allclose(rms_mg((raw_g - BIAS_G) @ MATRIX.T - true_g), TANGENT_MG, rtol=0.02)
    design = np.column_stack([np.ones(len(raw_g)), raw_g])
    best = true_g - design @ np.linalg.lstsq(design, true_g, rcond=None)[0]
    np.testing.assert_allclose(left_mg, rms_mg(best), rtol=0.02)


def test_an_autopilots_offsets_and_scales_are_the_best_over_all_directions():
    straight = np.diag(np.diag(MATRIX))
    autopilot = Px4(px4(whole(accelerometer={**CURVED, "matrix": straight.tolist()})))
    true_g = directions()[:2000]
    found = np.array(
        [Px4.chip(autopilot.accel(Px4.chip(raw) * G_MPS2, 25.0)) for raw in sensed_g(true_g, straight)]
    )
    np.testing.assert_allclose(rms_mg(found / G_MPS2 - true_g), BEST_MG, rtol=0.05)


@pytest.mark.parametrize("written", [px4, ardupilot, imu_tk, imucal])
def test_every_file_says_what_the_straight_line_leaves(written):
    said = re.search(
        r"best straight line over all directions.*x (\S+) mg, y (\S+) mg, z (\S+) mg", text_of(written)
    )
    assert [float(mg) for mg in said.groups()] == pytest.approx([1.7, 1.7, 1.7])
    assert "quadratic" not in text_of(written)
    assert "straight line" not in written(whole())


def text_of(written):
    return written(whole(accelerometer=CURVED))


@pytest.mark.parametrize("range_deg", [[-60.0, 60.0], [-20.0, 75.0]])
def test_a_curve_of_the_angle_is_the_best_offset_and_gain_of_y_over_the_calibrated_elevations(range_deg):
    square, cube = 4e-5, -6e-7
    bent = ("nonlinearity", {"deg_per_deg2": square, "deg_per_deg3": cube})
    text = px4(issued([bent], range_deg=range_deg, bias_deg=0.0, scale=1.0))
    autopilot = Px4(text)
    theta_deg = np.linspace(*range_deg, 501)
    s, c = np.sin(np.radians(theta_deg)), np.cos(np.radians(theta_deg))
    raw_y_g = s + np.radians(square * theta_deg**2 + cube * theta_deg**3) / c
    raw_g = np.column_stack([np.zeros(501), raw_y_g, c])
    found = np.array([Px4.chip(autopilot.accel(Px4.chip(raw) * G_MPS2, 25.0)) for raw in raw_g]) / G_MPS2
    design = np.column_stack([np.ones(501), s])
    best_g = raw_y_g - s - design @ np.linalg.lstsq(design, raw_y_g - s, rcond=None)[0]
    left_mg, best_mg, tangent_mg = rms_mg(found[:, 1] - s), rms_mg(best_g), rms_mg(raw_y_g - s)
    assert left_mg == pytest.approx(best_mg, rel=0.02)
    assert left_mg < 0.9 * tangent_mg
    np.testing.assert_allclose(found[:, 2], c, atol=1e-9)
    assert f"over the calibrated elevations; RMS of what it leaves: y {best_mg:.2g} mg" in text


def test_a_line_is_the_best_where_the_sensor_is_and_not_where_the_reference_is():
    """Bias and scale are left out of the file: at ±60° this sensor feels −53° to 73°."""
    bent = ("axis_nonlinearity", {"y_mg_per_g2": 5.0, "y_mg_per_g3": 5.0})
    autopilot = Px4(px4(issued([bent], bias_deg=10.0, scale=1.05)))
    felt_deg = 10.0 + 1.05 * np.linspace(-60.0, 60.0, 501)
    s, c = np.sin(np.radians(felt_deg)), np.cos(np.radians(felt_deg))
    raw_g = np.column_stack([np.zeros(501), s + CURVE_G * (s**2 + s**3), c])
    found = np.array([Px4.chip(autopilot.accel(Px4.chip(raw) * G_MPS2, 25.0)) for raw in raw_g]) / G_MPS2
    design = np.column_stack([np.ones(501), s])
    left = CURVE_G * (s**2 + s**3)
    best_g = left - design @ np.linalg.lstsq(design, left, rcond=None)[0]
    assert rms_mg(found[:, 1] - s) == pytest.approx(rms_mg(best_g), rel=0.02)


@pytest.mark.parametrize("written", [px4, ardupilot, imu_tk, imucal])
def test_every_file_says_one_uncertainty_with_what_the_straight_line_leaves_in_it(written):
    known = {"expanded_uncertainty_deg": 0.02, "coverage_factor": 2.0}
    theta = np.radians(np.linspace(-60.0, 60.0, 721))
    u = np.linspace(-1.0, 1.0, 721)
    line = np.polyfit(u, CURVE_G * (u**2 + u**3), 1)
    left_y, left_z = (CURVE_G * (a**2 + a**3) - np.polyval(line, a) for a in (np.sin(theta), np.cos(theta)))
    left_deg = np.degrees(np.sqrt(np.mean((left_y * np.cos(theta) - left_z * np.sin(theta)) ** 2)))
    curved, straight, unknown = (
        re.search(r"elevation.*(?:U = (\S+) degrees \(k = 2\)|not known)", written(whole(**how))).group(1)
        for how in ({"accelerometer": CURVED, **known}, known, {})
    )
    assert float(curved) == pytest.approx(2.0 * np.hypot(0.01, left_deg), rel=0.03)
    assert float(straight) == 0.02
    assert unknown is None


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_the_header_takes_the_curve_itself_out(tmp_path):
    header = c_header(whole(accelerometer=CURVED))
    rows = re.search(r"calrig_test_accelerations\[6\]\[6\] = \{(.*?)\};", header, re.DOTALL).group(1)
    numbers = np.array(re.findall(r"-?\d[^f,\s]*(?=f)", rows), dtype=float).reshape(6, 6)
    np.testing.assert_allclose(numbers[:, :3], sensed_g(numbers[:, 3:]), atol=1e-6)
    found, expected = test_vectors(header, tmp_path, with_matrix=True).T
    np.testing.assert_allclose(found, expected, atol=3e-6)
