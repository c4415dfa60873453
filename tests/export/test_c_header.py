"""`calibration.h` is compiled as strict C99 and gives what Python gives."""

from __future__ import annotations

import numpy as np
import pytest
from compiled_header import COMPILER, applied, compiled, document, test_vectors
from issued_documents import BIAS_G, MATRIX
from scipy.interpolate import CubicSpline

from calrig.calibration.regression import c_literal
from calrig.calibration.regression.effect import ApplyError, Circumstances
from calrig.calibration.results.correction import calibrated_elevation_deg, effects_on_reading_deg
from calrig.export.formats.c_header import c_header
from calrig.loaded import Calibration

needs_a_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (gcc or clang) is installed")

OFFSET = ("accelerometer_offset", {"y_mg": 12.0, "z_mg": -25.0})
MISMATCH = ("axis_mismatch", {"gain_pct": -0.9, "skew_deg": 0.4})
CUBIC = ("nonlinearity", {"deg_per_deg2": 3e-5, "deg_per_deg3": -1e-6})
WARM = ("temperature_bias", {"deg_per_c": 0.0164, "reference_c": 24.3})
WARM_Y = ("temperature_bias", {"deg_per_c": -0.05, "reference_c": 24.3, "of_axis_y": 1.0})
CURVED = ("temperature_curvature", {"deg_per_c2": -3e-4, "reference_c": 26.0})
STEEPER = ("temperature_scale", {"per_c": 2e-4, "reference_c": 24.3})
BEYOND_HALF_A_TURN = [
    ([0.0, 350.0], [0.0, 1.0, 120.0, 179.0, 240.0, 349.0, 350.0]),
    ([-175.0, 175.0], [-175.0, -90.0, 0.0, 174.0, 175.0]),
    ([-350.0, -10.0], [-350.0, -240.0, -180.0, -10.0]),
]
SLIPPED = ("mount_slip", {"step_deg": -0.12, "at_s": 300.0})


@needs_a_compiler
@pytest.mark.parametrize(
    ("effects", "changes"),
    [
        ([], {}),
        ([WARM], {}),
        ([WARM_Y], {}),
        ([OFFSET], {}),
        ([MISMATCH, CUBIC], {}),
        ([OFFSET, MISMATCH, CUBIC, WARM, CURVED, STEEPER], {}),
        ([OFFSET, STEEPER], {"scale": -0.98, "range_deg": [-90.0, 90.0], "temperature_c": None}),
        ([WARM], {"bias_deg": 179.6}),
        ([("temperature_scale", {"per_c": 0.014, "reference_c": 24.3})], {}),
        ([WARM], {"scale": 1.01, "range_deg": [0.0, 350.0]}),
    ],
)
def test_the_compiled_header_gives_pythons_elevation_to_a_ten_thousandth_of_a_degree(
    effects, changes, tmp_path
):
    calibration = document(effects, **changes)
    bias_deg, scale = calibration["bias_deg"], calibration["scale"]
    theta_deg, temperature_c = (
        axis.ravel() for axis in np.meshgrid(np.linspace(*calibration["range_deg"], 121), [0.0, 24.3, 60.0])
    )
    given = Circumstances(temperature_c=temperature_c)
    felt_deg = bias_deg + scale * theta_deg
    reading_deg = felt_deg + effects_on_reading_deg(effects, theta_deg, given, felt_deg)
    reading_deg = np.degrees(np.angle(np.exp(1j * np.radians(reading_deg))))

    found_deg = applied(compiled(c_header(calibration), tmp_path), reading_deg, temperature_c)

    in_python_deg = calibrated_elevation_deg(
        reading_deg, bias_deg, scale, effects, given, tuple(calibration["range_deg"])
    )
    np.testing.assert_allclose(found_deg, in_python_deg, atol=1e-4)
    np.testing.assert_allclose(found_deg, theta_deg, atol=1e-4)


@pytest.mark.parametrize("first", [1000.0, 9.536743e-07, -8.6e15])
def test_a_constant_in_the_header_is_the_float_itself(first):
    """A float needs FLT_DECIMAL_DIG = 9 digits to come back as it was (C11, 5.2.4.2.2)."""
    value = np.float32(first)
    for _ in range(200):
        literal = c_literal(float(value))
        assert np.float32(literal.strip("()").removesuffix("f")) == value
        value = np.nextafter(value, np.float32(np.inf))


@needs_a_compiler
@pytest.mark.parametrize(("range_deg", "elevation_deg"), BEYOND_HALF_A_TURN)
def test_angles_beyond_half_a_turn_survive_in_c_and_in_python(range_deg, elevation_deg, tmp_path):
    """The sensor reads 5 + 1.01·θ: what it adds up to beyond half a turn, and the same less a turn."""
    calibration = document([], bias_deg=5.0, scale=1.01, range_deg=range_deg)
    unwrapped_deg = 5.0 + 1.01 * np.array(elevation_deg)
    program = compiled(c_header(calibration), tmp_path)
    for reading_deg in (unwrapped_deg, (unwrapped_deg + 180.0) % 360.0 - 180.0):
        in_c_deg = applied(program, reading_deg, np.full(len(reading_deg), 20.0))
        np.testing.assert_allclose(in_c_deg, elevation_deg, atol=1e-4)
        in_python_deg = Calibration(calibration).elevation_deg(reading_deg)
        np.testing.assert_allclose(in_python_deg, elevation_deg, atol=1e-9)


@needs_a_compiler
@pytest.mark.parametrize(
    ("range_deg", "reading_deg", "elevation_deg"),
    [
        ([-180.0, 180.0], 5.0 + 1.01 * 240.0, -120.0),
        ([-180.0, 180.0], 5.0 + 1.01 * 179.0, 179.0),
        ([-60.0, 60.0], 5.0 + 1.01 * 240.0, -120.0),
        ([-60.0, 60.0], 5.0 + 1.01 * 61.0, 61.0),
        ([0.0, 720.0], 5.0 + 1.01 * 700.0, 700.0),
        ([0.0, 720.0], 5.0 + 1.01 * 750.0, 750.0),
    ],
)
def test_of_angles_that_differ_by_whole_turns_it_is_the_one_in_the_range_or_next_to_its_middle(
    range_deg, reading_deg, elevation_deg, tmp_path
):
    """CONTRACT section 6; a range of more than a turn takes readings as they are."""
    calibration = document([], bias_deg=5.0, scale=1.01, range_deg=range_deg)
    program = compiled(c_header(calibration), tmp_path)
    assert applied(program, np.array([reading_deg]), np.array([20.0])) == pytest.approx(
        elevation_deg, abs=1e-4
    )
    assert Calibration(calibration).elevation_deg(reading_deg) == pytest.approx(elevation_deg, abs=1e-9)


@needs_a_compiler
def test_half_a_turn_is_positive_in_c_as_in_python(tmp_path):
    """Angles lie in (−180, 180]: both readings are the same direction, and so the same elevation."""
    program = compiled(c_header(document([], bias_deg=0.0, scale=1.0)), tmp_path)
    assert applied(program, np.array([180.0, -180.0]), np.array([20.0, 20.0])).tolist() == [180.0, 180.0]


@needs_a_compiler
@pytest.mark.parametrize(
    "unit",
    [
        "*/ int oops; /*",
        "AS\n#error oops",
        "AS??/",
        "??)\\",
        "/*",
        "7",
        "",
        "Ünit № ٣",
        "\u202e\u2066",
        "x" * 5000,
        'a"b',
        "ends in \\\\",
        "\\u2028#error oops",
    ],
)
def test_no_serial_number_breaks_the_header(unit, tmp_path):
    program = compiled(c_header(document(unit=unit, run_id=unit)), tmp_path)
    assert applied(program, np.array([0.2537]), np.array([20.0])) == pytest.approx([0.0], abs=1e-6)


@needs_a_compiler
@pytest.mark.parametrize("matrix", [None, MATRIX.tolist()])
def test_a_program_gives_what_the_headers_own_test_vectors_say(matrix, tmp_path):
    accelerometer = matrix and {"bias_g": BIAS_G.tolist(), "matrix": matrix}
    calibration = document([OFFSET, MISMATCH, WARM], accelerometer=accelerometer)
    found, expected = test_vectors(c_header(calibration), tmp_path, with_matrix=bool(matrix)).T
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert len(found) == (32 if matrix else 14)
    if matrix:
        np.testing.assert_allclose(expected[-3:], [0.48, 0.64, -0.6], atol=1e-7)
        np.testing.assert_allclose(found[14:], expected[14:], atol=1e-6)


def test_each_serial_number_has_a_guard_of_its_own():
    guards = {
        c_header(document(unit=unit)).split("#ifndef ")[1].split()[0] for unit in ("AS-1", "AS_1", "as-1")
    }
    assert len(guards) == 3


def test_what_does_not_stay_with_the_unit_is_left_out_of_the_header():
    backlash = ("backlash", {"backlash_deg": 0.08})
    gyro = ("gyro_scale", {"gain_pct": 0.5})

    header = c_header(document([backlash, WARM, gyro, SLIPPED]))

    assert "accepted, but not of this unit at rest: backlash, gyro_scale, mount_slip" in header
    code = header.split("*/", 1)[1]
    assert code == c_header(document([WARM])).split("*/", 1)[1]


def test_parameters_with_their_standard_errors_are_taken_too():
    with_std = {"deg_per_c": {"value": 0.0164, "std": 1e-4}, "reference_c": {"value": 24.3, "std": None}}
    assert c_header(document([("temperature_bias", with_std)])) == c_header(document([WARM]))


@pytest.mark.parametrize(
    ("changes", "error", "says"),
    [
        ({"scale": None}, ValueError, "scale is not known"),
        ({"bias_deg": float("nan")}, ValueError, "bias_deg is not known"),
        ({"bias_deg": 1e39}, ValueError, "not a number that a float holds"),
        ({"effects": [("unnamed", {})]}, ApplyError, "'unnamed' has no formula"),
        (
            {"effects": [("nonlinearity", {"deg_per_deg2": 0.02})]},
            ApplyError,
            "not a small correction",
        ),
        (
            {"effects": [("temperature_scale", {"per_c": 0.3, "reference_c": 24.3})]},
            ApplyError,
            "take them back",
        ),
        (
            {"effects": [("temperature_bias", {"deg_per_c": 1.0})]},
            ApplyError,
            "needs its parameter reference_c",
        ),
    ],
)
def test_what_cannot_be_applied_in_flight_is_refused(changes, error, says):
    with pytest.raises(error, match=says):
        c_header(document(**changes))


CURVE = (
    "unnamed",
    {
        "size_deg": 2.1,
        **{f"knot_{k}_deg": knot for k, knot in enumerate([-60.0, -31.0, 2.0, 4.5, 60.0])},
        **{f"curve_{k}_deg": value for k, value in enumerate([0.0, 1.2, -0.9, -0.7, 0.4])},
    },
)
OF_THE_ANGLE = [
    ("stage_eccentricity", {"amplitude_deg": 0.97, "phase_deg": 64.0}),
    ("stage_periodic", {"amplitude_deg": 1.74, "phase_deg": -155.0, "period_deg": 90.0}),
    ("stage_periodic", {"amplitude_deg": 0.017, "phase_deg": 46.0, "period_deg": 7.2}),
]


@needs_a_compiler
@pytest.mark.parametrize(
    ("effects", "changes"),
    [
        (OF_THE_ANGLE, {"range_deg": [0.0, 358.2], "bias_deg": -0.064}),
        (OF_THE_ANGLE, {"range_deg": [258.0, 617.0], "bias_deg": -259.3, "scale": 1.002}),
        ([CURVE], {}),
        ([CURVE, *OF_THE_ANGLE, OFFSET, CUBIC, WARM], {"bias_deg": 1.5}),
    ],
)
def test_what_a_good_reference_makes_the_units_is_the_same_in_python_and_in_c(effects, changes, tmp_path):
    calibration = document(effects, **changes)
    theta_deg = np.linspace(*calibration["range_deg"], 241)
    temperature_c = np.full(len(theta_deg), 24.3)
    reading_deg = reading_of(calibration, theta_deg)

    in_python_deg = Calibration(calibration).elevation_deg(reading_deg, temperature_c=temperature_c)
    np.testing.assert_allclose(in_python_deg, theta_deg, atol=1e-6)
    found_deg = applied(compiled(c_header(calibration), tmp_path), reading_deg, temperature_c)
    np.testing.assert_allclose(found_deg, in_python_deg, atol=2e-4)


def reading_of(calibration, theta_deg):
    """(n,) readings by the sum of the effects, each by its formula as the contract has it, at 24.3 °C.

    What is of the sensor turns no vector: the accelerometer errs at bias + scale·θ.
    """
    added_deg = np.zeros(len(theta_deg))
    felt_deg = calibration["bias_deg"] + calibration["scale"] * theta_deg
    s, c = np.sin(np.radians(felt_deg)), np.cos(np.radians(felt_deg))
    for effect in calibration["effects"]:
        p = effect["parameters"]
        match effect["name"]:
            case "stage_eccentricity":
                added_deg += p["amplitude_deg"] * np.sin(np.radians(theta_deg + p["phase_deg"]))
            case "stage_periodic":
                phase = np.radians(360.0 * theta_deg / p["period_deg"] + p["phase_deg"])
                added_deg += p["amplitude_deg"] * np.sin(phase)
            case "nonlinearity":
                added_deg += p["deg_per_deg2"] * theta_deg**2 + p["deg_per_deg3"] * theta_deg**3
            case "accelerometer_offset":
                y, z = s + p["y_mg"] / 1000.0, c + p["z_mg"] / 1000.0
                added_deg += np.degrees(np.arctan2(y * c - z * s, y * s + z * c))
            case "unnamed":
                knots, values = ([p[f"{name}_{k}_deg"] for k in range(5)] for name in ("knot", "curve"))
                added_deg += CubicSpline(knots, values, bc_type="natural")(theta_deg)
    return felt_deg + added_deg
