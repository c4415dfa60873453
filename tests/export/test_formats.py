"""Calibrations in other programs' formats: read and applied as those do, they give the truth back."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import yaml
from issued_documents import BIAS_G, GYRO_BIAS_DPS, MATRIX, PLANAR, WARM, issued, whole

from calrig.export.formats.ardupilot import ardupilot
from calrig.export.formats.imu_tk import imu_tk
from calrig.export.formats.imucal import imucal
from calrig.export.formats.kalibr import kalibr
from calrig.export.formats.px4 import px4
from calrig.export.formats.vins import vins
from calrig.export.triads import NotHeldError, accelerometer_of
from calrig.noise.analysis import analyse
from calrig.noise.report import noise_document

G_MPS2 = 9.80665
STRAIGHT = {"accelerometer": {"bias_g": BIAS_G.tolist(), "matrix": np.diag(np.diag(MATRIX)).tolist()}}
"""An accelerometer whose axes are square, which offsets and scales hold whole."""
RAW_G = np.array([0.2, 0.7, -0.6])
NUMBERS = r"\[([^\]]*)\]"


def vectors(line):
    return [np.array(found.split(","), dtype=float) for found in re.findall(NUMBERS, line)]


def test_lines(text, sensor):
    """The test vector in a file's comments, and the temperature that it is at."""
    (said, after) = re.search(rf"# test vector, {sensor}(.*):\n#   (raw .*)", text).groups()
    celsius = re.search(r"at (\S+) degrees", said)
    return vectors(after), None if celsius is None else float(celsius[1])


test_lines.__test__ = False


class Px4:
    """PX4's own arithmetic on parameters as QGroundControl reads them."""

    @staticmethod
    def chip(vector):
        """MPU6000.cpp: x forward, y right, z down."""
        return vector * np.array([1.0, -1.0, -1.0])

    def __init__(self, text):
        rows = [line.split("\t") for line in text.splitlines() if not line.startswith("#")]
        assert all(len(row) == 5 and row[:2] == ["1", "1"] for row in rows)
        assert all(len(row[2]) <= 16 for row in rows), "MAVLink's names have at most 16 characters"
        self.of = {name: float(value) for _, _, name, value, _ in rows}
        self.types = {name: int(kind) for _, _, name, _, kind in rows}

    def triple(self, names, default):
        return np.array([self.of.get(names.format(axis), default) for axis in "XYZ"])

    def accel(self, data, celsius):
        thermal = np.zeros(3)
        if self.of.get("TC_A_ENABLE"):
            d = np.clip(celsius, self.of["TC_A0_TMIN"], self.of["TC_A0_TMAX"]) - self.of["TC_A0_TREF"]
            for order in range(4):
                thermal += d**order * np.array([self.of[f"TC_A0_X{order}_{k}"] for k in range(3)])
        return (data - thermal - self.triple("CAL_ACC0_{}OFF", 0.0)) * self.triple("CAL_ACC0_{}SCALE", 1.0)

    def gyro(self, data):
        return data - self.triple("CAL_GYRO0_{}OFF", 0.0)


class ArduPilot:
    """ArduPilot's own arithmetic on parameters as Mission Planner reads them."""

    @staticmethod
    def chip(vector):
        """AP_InertialSensor_Invensense.cpp."""
        return np.array([vector[1], vector[0], -vector[2]])

    def __init__(self, text):
        rows = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
        assert all(len(name) <= 16 for name, _ in rows)
        self.of = {name: float(value) for name, value in rows}

    def triple(self, names, default):
        return np.array([self.of.get(names.format(axis), default) for axis in "XYZ"])

    def polynomial(self, d):
        c = [self.triple(f"INS_TCAL1_ACC{order}_{{}}", 0.0) for order in (1, 2, 3)]
        return (c[0] + (c[1] + c[2] * d) * d) * d * 1e-6

    def accel(self, data, celsius):
        if self.of.get("INS_TCAL1_ENABLE") == 1:
            ends = self.of["INS_TCAL1_TMIN"], self.of["INS_TCAL1_TMAX"]
            data = data - self.polynomial(np.clip(celsius, *ends) - 35.0)
            data = data + self.polynomial(np.clip(self.of["INS_ACC1_CALTEMP"], *ends) - 35.0)
        return (data - self.triple("INS_ACCOFFS_{}", 0.0)) * self.triple("INS_ACCSCAL_{}", 1.0)

    def gyro(self, data):
        return data - self.triple("INS_GYROFFS_{}", 0.0)


BOTH = pytest.mark.parametrize(("written", "program"), [(px4, Px4), (ardupilot, ArduPilot)])


@BOTH
def test_an_autopilot_gets_the_truth_from_offsets_scales_and_temperature(written, program):
    text = written(whole(effects=[WARM], **STRAIGHT))
    autopilot = program(text)
    for celsius in (21.0, 29.5):
        at_c = BIAS_G + 1e-3 * np.array([0.0, 0.35, -0.2]) * (celsius - 25.0)
        true = program.chip(np.diag(MATRIX) * (RAW_G - at_c)) * G_MPS2
        np.testing.assert_allclose(autopilot.accel(program.chip(RAW_G) * G_MPS2, celsius), true, atol=1e-6)
    rate = np.array([3.0, 40.0, -7.0])
    found = autopilot.gyro(np.radians(program.chip(rate)))
    np.testing.assert_allclose(found, np.radians(program.chip(rate - GYRO_BIAS_DPS)), atol=1e-8)
    (raw, corrected), celsius = test_lines(text, r"m/s\^2")
    np.testing.assert_allclose(autopilot.accel(raw, celsius), corrected, atol=1e-6)
    (raw, corrected), _ = test_lines(text, "rad/s")
    np.testing.assert_allclose(autopilot.gyro(raw), corrected, atol=1e-8)


@BOTH
def test_a_planar_calibration_gives_y_and_z_and_leaves_x_as_it_is_on_the_vehicle(written, program):
    text = written(issued(PLANAR))
    autopilot = program(text)
    left_alone = {"CAL_ACC0_XOFF", "CAL_ACC0_XSCALE", "INS_ACCOFFS_Y", "INS_ACCSCAL_Y"}
    assert not left_alone & autopilot.of.keys(), "the chip's x, which is ArduPilot's y"
    true = np.array([0.0, 0.6, 0.8])
    skew = np.sin(np.radians(0.4))
    raw = np.array([0.0, 0.991 * (true[1] + skew * true[2]) + 0.012, true[2] - 0.025])
    found = program.chip(autopilot.accel(program.chip(raw) * G_MPS2, 25.0)) / G_MPS2
    np.testing.assert_allclose(found, [0.0, true[1] + skew * true[2], true[2]], atol=1e-8)
    assert "misalignment of axes is not held by these parameters, up to 0.4 degrees" in text
    assert "not held by these parameters: bias_deg, scale" in text


@BOTH
def test_an_angles_bias_and_scale_make_no_parameters(written, program):
    nothing = {"bias_dps": [None, None, None], "scale": None}
    with pytest.raises(NotHeldError, match="bias and scale of an angle"):
        written(issued(gyro=nothing))
    gyro_alone = program(written(issued(gyro={"bias_dps": [1.4, None, 0.3], "scale": None})))
    assert len(gyro_alone.of) == 2


def test_px4s_switch_is_a_whole_number_and_all_else_is_not():
    types = Px4(px4(whole(effects=[WARM]))).types
    assert {name for name, kind in types.items() if kind == 6} == {"TC_A_ENABLE"}
    assert set(types.values()) == {6, 9}


def test_imu_tk_reads_misalignment_scale_and_bias():
    text = imu_tk(whole())
    numbers = np.array(text.split()[:21], dtype=float)  # as CalibratedTriad::load does
    misalignment, scale, bias = numbers[:9].reshape(3, 3), numbers[9:18].reshape(3, 3), numbers[18:]
    assert np.diag(misalignment).tolist() == [1.0, 1.0, 1.0]
    np.testing.assert_allclose(scale, np.diag(np.diag(scale)))
    corrected = misalignment @ scale @ (RAW_G * G_MPS2 - bias)
    np.testing.assert_allclose(corrected, MATRIX @ (RAW_G - BIAS_G) * G_MPS2, atol=1e-9)
    raw, expected = vectors(next(line for line in text.splitlines() if "test vector" in line))
    np.testing.assert_allclose(misalignment @ scale @ (raw - bias), expected, atol=1e-8)


def test_imucal_itself_reads_and_applies_its_json():
    from imucal import FerrarisCalibrationInfo

    matrix = np.array([[1.002, 0.001, 0.0], [0.003, 0.996, -0.002], [0.0, 0.001, 1.004]])
    per_g = np.array([[0.1, 0.0, 0.02], [0.0, -0.05, 0.0], [0.03, 0.0, 0.0]])
    gyro = {"bias_dps": GYRO_BIAS_DPS.tolist(), "matrix": matrix.tolist(), "dps_per_g": per_g.tolist()}
    info = FerrarisCalibrationInfo.from_json(imucal(whole(gyro=gyro)))
    rate = np.array([3.0, 40.0, -7.0])
    true_g = MATRIX @ (RAW_G - BIAS_G)
    acc, gyr = info.calibrate(RAW_G[None], rate[None], acc_unit="g", gyr_unit="deg/s")
    np.testing.assert_allclose(acc[0], true_g * G_MPS2, atol=1e-9)
    np.testing.assert_allclose(gyr[0], matrix @ (rate - GYRO_BIAS_DPS - per_g @ true_g), atol=1e-9)
    assert (info.acc_unit, info.gyr_unit) == ("m/s^2", "deg/s")
    assert np.allclose(info.K_a, np.diag(np.diag(info.K_a)))
    raw_a, raw_g, *expected = vectors(info.comment)
    found = info.calibrate(raw_a[None], raw_g[None], acc_unit="g", gyr_unit="deg/s")
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one[0], other, atol=1e-7)


@pytest.mark.parametrize("written", [imu_tk, imucal])
def test_a_whole_matrix_is_not_made_of_half(written):
    with pytest.raises(NotHeldError, match="mount_axis"):
        written(issued(PLANAR))


def test_imucal_without_the_gyro_is_refused():
    with pytest.raises(NotHeldError, match="gyro's offsets"):
        imucal(whole(gyro={"bias_dps": [1.0, None, 0.0], "scale": None}))


@pytest.mark.parametrize("written", [px4, ardupilot, imu_tk, imucal])
def test_no_serial_number_breaks_a_file(written):
    text = written(whole(unit="a\n1\t1\tCAL_ACC0_XOFF\t9\t9\r\nINS_ACCOFFS_X,9 \u2028 é"))
    assert text.isascii()
    if written is imucal:
        json.loads(text)
    else:
        assert all(line.startswith("#") for line in text.splitlines() if "é" in line or "unit a" in line)
        plain = [line for line in written(whole()).splitlines() if not line.startswith("#")]
        assert [line for line in text.splitlines() if not line.startswith("#")] == plain


@pytest.fixture(scope="module")
def noise():
    """The report of a log of 60 s at 100 Hz: 0.4 mg·√s and 0.004 °/s·√s, twice as much along z."""
    rng, n, root = np.random.default_rng(7), 6000, 10.0
    worse = {"x": 1.0, "y": 1.0, "z": 2.0}
    channels = {f"accel_{a}_g": rng.normal(0.0, 4e-4 * root * k, n) for a, k in worse.items()}
    channels |= {f"gyro_{a}_dps": rng.normal(0.0, 0.004 * root * k, n) for a, k in worse.items()}
    return noise_document(analyse(channels, np.arange(n) / 100.0))


def test_kalibr_reads_the_noise_of_the_noisiest_axis(noise):
    text = kalibr(noise, "unit N-1, static run 7")
    found = yaml.safe_load(text)
    assert found["accelerometer_noise_density"] == pytest.approx(8e-4 * G_MPS2, rel=0.1)
    assert found["gyroscope_noise_density"] == pytest.approx(np.radians(0.008), rel=0.1)
    assert (found["update_rate"], found["rostopic"]) == (100.0, "/imu0")
    assert 0.0 < found["accelerometer_random_walk"] < found["accelerometer_noise_density"]
    assert "too short to show a random walk of the gyro" in text
    # kalibr_common.ConfigReader: noise density/√(1/update rate)
    discrete = [
        found[f"{sensor}_noise_density"] / np.sqrt(1.0 / found["update_rate"])
        for sensor in ("accelerometer", "gyroscope")
    ]
    said = re.search(r"test vector, noise density \(discrete\): (\S+), (\S+)", text).groups()
    np.testing.assert_allclose(np.array(said, dtype=float), discrete, rtol=1e-7)


def test_vins_reads_standard_deviations_of_a_sample(noise):
    text = vins(noise, "unit N-1, static run 7")
    found = yaml.safe_load(text.split("\n", 1)[1])  # OpenCV's first line is no YAML 1.1
    continuous = yaml.safe_load(kalibr(noise, ""))
    assert found["acc_n"] == pytest.approx(10.0 * continuous["accelerometer_noise_density"])
    assert found["gyr_w"] == pytest.approx(10.0 * continuous["gyroscope_random_walk"])
    said = re.search(r"in a second: (\S+), (\S+)", text).groups()
    gathered = [100.0 * (0.01 * found[name]) ** 2 for name in ("acc_n", "gyr_n")]
    np.testing.assert_allclose(np.array(said, dtype=float), gathered, rtol=1e-7)


def test_noise_that_was_not_measured_is_not_made_up(noise):
    without = {name: one for name, one in noise["channels"].items() if name != "gyro_y_dps"}
    with pytest.raises(NotHeldError, match="white noise of gyro_y_dps"):
        kalibr({**noise, "channels": without}, "")


def test_the_axes_of_a_planar_calibration_undo_gain_and_skew():
    """CONTRACT section 5: y measures gain·(a_y + a_z·sin skew)."""
    mismatch = {"name": "axis_mismatch", "parameters": {"gain_pct": 2.0, "skew_deg": 3.0}}
    found = accelerometer_of({**issued(), "effects": [mismatch], "accelerometer": None})
    raw_g = np.array([0.0, 1.02 * (0.6 + 0.8 * np.sin(np.radians(3.0))), 0.8])
    np.testing.assert_allclose(found.true_g(raw_g)[1:], [0.6, 0.8], atol=1e-12)
