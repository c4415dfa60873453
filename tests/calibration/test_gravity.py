"""Gravity as the reference: static poses, bias, scale, misalignment, and nothing where there is nothing."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import binom
from support import DATA

from calrig.calibration.separation.gravity import (
    EFFECTS,
    GravityError,
    Problem,
    calibrate_by_gravity,
    fit_gravity,
    gravity_document,
    search,
    trace_gravity,
)
from calrig.calibration.static_detector import StaticPoses, static_poses
from calrig.export.static_csv import accel_g_of, read_static

BIAS_G = np.array([0.02, -0.03, 0.05])
SCALE = np.array([1.003, 0.996, 1.01])
MATRIX = np.array([[1.0, 0.003, -0.005], [0.0, 1.0, 0.004], [0.0, 0.0, 1.0]])


def directions(rng, n):
    drawn = rng.normal(size=(n, 3))
    return drawn / np.linalg.norm(drawn, axis=1)[:, None]


def poses_of(true_g, rng, *, noise_g=3e-4, matrix=None, per_c=0.0):
    """Static poses of a warming unit: true = matrix·(raw − bias)/scale."""
    n = len(true_g)
    time_s = 8.0 * np.arange(n)
    temperature_c = 28.0 - 8.0 * np.exp(-time_s / 60.0)
    square = np.eye(3) if matrix is None else matrix
    raw = BIAS_G + SCALE * np.linalg.solve(square, true_g.T).T + rng.normal(0.0, noise_g, (n, 3))
    raw = raw + np.outer(temperature_c - temperature_c.mean(), np.full(3, per_c))
    return StaticPoses(raw, temperature_c, time_s, np.zeros((n, 2), dtype=np.intp))


def log_of(true_g, rng, *, rate_hz=100, matrix=None, noise_g=5e-3):
    """A log by hand: each pose for 4 s, with a second of turning and shaking between."""
    rows = []
    for here, there in zip(true_g, np.roll(true_g, -1, axis=0), strict=True):
        share = np.linspace(0.0, 1.0, rate_hz)[:, None]
        turning = (1.0 - share) * here + share * there + rng.normal(0.0, 0.2, (rate_hz, 3))
        rows += [np.tile(here, (4 * rate_hz, 1)), turning]
    true = np.vstack(rows)
    square = np.eye(3) if matrix is None else matrix
    raw = BIAS_G + SCALE * np.linalg.solve(square, true.T).T + rng.normal(0.0, noise_g, true.shape)
    return np.arange(len(raw)) / rate_hz, raw


def test_every_pose_of_a_log_is_found_and_no_motion():
    rng = np.random.default_rng(0)
    true_g = directions(rng, 20)
    time_s, accel_g = log_of(true_g, rng)

    poses = static_poses(accel_g, time_s=time_s)

    assert len(poses) == 20
    np.testing.assert_allclose(poses.accel_g, BIAS_G + SCALE * true_g, atol=2e-3)
    in_second = np.floor(poses.spans / 100.0) % 5
    assert (in_second < 4).all()
    without_time = static_poses(accel_g)
    assert len(without_time) == 20
    assert np.abs(without_time.spans - poses.spans).max() < 50
    at_rate = static_poses(accel_g, rate_hz=100.0)
    np.testing.assert_array_equal(at_rate.spans, poses.spans)


def test_a_knock_makes_no_second_pose():
    rng = np.random.default_rng(1)
    accel_g = np.array([0.0, 0.0, 1.0]) + rng.normal(0.0, 5e-3, (2000, 3))
    accel_g[700:720] += rng.normal(0.0, 0.3, (20, 3))
    assert len(static_poses(accel_g)) == 1


def test_a_turn_that_the_accelerometer_hardly_shows_is_seen_by_the_gyro():
    """Turning about the vertical changes nothing of gravity."""
    rng = np.random.default_rng(2)
    true_g = directions(rng, 12)
    time_s, accel_g = log_of(true_g, rng)
    gyro_dps = np.array([1.0, -2.0, 0.5]) + rng.normal(0.0, 0.1, accel_g.shape)
    gyro_dps[1000:1400, 2] += 5.0  # the whole of the third pose

    assert len(static_poses(accel_g, time_s=time_s, gyro_dps=gyro_dps)) == 11


def test_a_sensor_that_shows_no_noise_at_all_can_be_static():
    steps = np.repeat(np.round(directions(np.random.default_rng(3), 10), 2), 400, axis=0)
    assert len(static_poses(steps)) == 10


def test_the_fit_equals_an_independent_least_squares_of_the_same_model():
    rng = np.random.default_rng(4)
    poses = poses_of(directions(rng, 30), rng, matrix=MATRIX)

    def errors_g(x):
        square = np.array([[1.0, x[6], x[7]], [0.0, 1.0, x[8]], [0.0, 0.0, 1.0]])
        return np.linalg.norm(((poses.accel_g - x[:3]) / x[3:6]) @ square.T, axis=1) - 1.0

    start = [0.0] * 3 + [1.0] * 3 + [0.0] * 3
    expected = least_squares(errors_g, start, xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    fitted = fit_gravity(Problem.of(poses), [EFFECTS[0]])

    np.testing.assert_allclose(fitted.bias_g, expected[:3], atol=1e-8)
    np.testing.assert_allclose(1.0 / np.diag(fitted.matrix), expected[3:6], atol=1e-8)
    xy_xz_yz_mrad, _ = fitted.parameters(EFFECTS[0], poses)
    assert xy_xz_yz_mrad[2] == pytest.approx(1e3 * expected[8], abs=1e-5)


def test_misalignment_is_found_with_parameters_and_errors_that_hold():
    """200 units: found each time, nothing else in most, truth within three standard errors."""
    found, apart = 0, []
    truth_mrad = 1e3 * MATRIX[[0, 0, 1], [1, 2, 2]]
    for seed in range(200):
        rng = np.random.default_rng(seed)
        poses = poses_of(directions(rng, 22), rng, matrix=MATRIX)
        problem = Problem.of(poses)
        fitted, effects = search(problem, fit_gravity(problem), rng, 199)
        names = [one.effect.name for one in effects]
        found += names[:1] == ["misalignment"] and not effects[0].rivals
        value, std = fitted.parameters(EFFECTS[0], poses)
        apart.append((value - truth_mrad) / std)
    assert found >= 198
    assert np.mean(np.abs(apart) < 3.0) >= 0.98


def test_nothing_is_claimed_of_units_that_lack_nothing():
    """400 units at a nominal 1 %: no more than such a rate gives in 999 of 1000 cases."""
    claimed = 0
    for seed in range(400):
        rng = np.random.default_rng(10_000 + seed)
        problem = Problem.of(poses_of(directions(rng, 22), rng))
        claimed += bool(search(problem, fit_gravity(problem), rng, 199)[1])
    assert claimed <= binom.ppf(0.999, 400, 0.01)


def test_static_poses_without_any_noise_lack_nothing():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        poses = poses_of(directions(rng, 24), rng, noise_g=0.0)
        assert gravity_document(trace_gravity(poses, bootstraps=199))["verdict"] == "nothing"


def test_a_bias_that_moves_with_temperature_is_traced_or_said_to_be_time_or_temperature():
    rng = np.random.default_rng(6)
    gravity = trace_gravity(poses_of(directions(rng, 38), rng, per_c=1e-3))

    (effect,) = gravity_document(gravity)["effects"]

    assert effect["name"] == "temperature_bias"
    assert set(effect["confusable_with"]) <= {"time_drift", "temperature_scale"}
    for axis in "xyz":
        value, std = effect["parameters"][f"{axis}_mg_per_c"].values()
        assert abs(value - 1.0) < 4.0 * std < 0.3
    assert effect["parameters"]["reference_c"]["value"] == pytest.approx(gravity.poses.temperature_c.mean())


def test_the_document_has_the_contracts_names_and_takes_a_reading_to_the_truth():
    rng = np.random.default_rng(7)
    true_g = directions(rng, 24)
    time_s, accel_g = log_of(true_g, rng, matrix=MATRIX, noise_g=2e-3)

    document = json.loads(
        json.dumps(gravity_document(calibrate_by_gravity(accel_g, time_s=time_s)), allow_nan=False)
    )

    assert document["n_poses"] == 24
    assert document["held_out"] == {"how": "leave one pose out", "n_poses": 24}
    assert document["verdict"] == "named"
    assert set(document["base"]) == {"bias_g", "scale", "fit_rms_mg", "held_out_rms_mg"}
    matrix = np.array(document["final"]["matrix"])
    assert (matrix == np.triu(matrix)).all()
    raw = BIAS_G + SCALE * np.linalg.solve(MATRIX, true_g.T).T
    found_g = (raw - document["final"]["bias_g"]) @ matrix.T
    # attitude itself is free: an upper triangular matrix fixes the frame to the z axis, as MATRIX does
    np.testing.assert_allclose(found_g, true_g, atol=1e-3)
    assert document["final"]["held_out_rms_mg"] < 0.3 < document["base"]["held_out_rms_mg"]


def test_base_takes_the_truth_to_a_reading_and_a_pose_held_out_fits_worse_than_one_fitted():
    rng = np.random.default_rng(11)
    document = gravity_document(trace_gravity(poses_of(directions(rng, 24), rng), bootstraps=99))
    np.testing.assert_allclose(document["base"]["scale"], SCALE, atol=1e-3)
    np.testing.assert_allclose(document["base"]["bias_g"], BIAS_G, atol=1e-3)
    for model in (document["base"], document["final"]):
        assert model["fit_rms_mg"] < model["held_out_rms_mg"]


def test_six_faces_show_no_misalignment_and_it_is_said():
    rng = np.random.default_rng(8)
    faces = np.vstack([np.eye(3), -np.eye(3)] * 3)
    document = gravity_document(trace_gravity(poses_of(faces, rng, matrix=MATRIX)))
    assert document["effects"] == []
    assert "misalignment xy, xz, yz cannot be seen" in document["warnings"][0]


@pytest.mark.parametrize(
    ("accel_g", "says"),
    [
        (np.tile([0.0, 0.0, 1.0], (3000, 1)), "one static pose: nothing was turned"),
        (np.tile([0.0, 0.0, 9.81], (3000, 1)), "look like m/s²"),
        (np.tile([0.0, 0.0, 16500.0], (3000, 1)), "counts of ±2 g"),
        (np.tile([0.0, 0.0, 0.1], (3000, 1)), "g in columns named _mps2"),
        (np.tile([0.0, 0.0, 77.0], (3000, 1)), "check the unit and the range"),
        (np.full((3000, 3), np.nan), "no sample in which all three axes"),
        (np.tile([0.0, 0.0, 1.0], (50, 1)), "one static pose"),
        (np.random.default_rng(0).normal(0.0, 0.6, (3000, 3)), "never static"),
    ],
)
def test_a_log_that_cannot_serve_is_told_why(accel_g, says):
    with pytest.raises(GravityError, match=says):
        calibrate_by_gravity(accel_g)


def test_too_few_poses_and_poses_about_one_axis_are_told_what_is_missing():
    rng = np.random.default_rng(9)
    with pytest.raises(GravityError, match="6 static poses are too few: at least 9"):
        trace_gravity(poses_of(directions(rng, 6), rng))
    turn = np.linspace(0.0, 2.0 * np.pi, 15)[:-1]
    about_x = np.column_stack([np.zeros(14), np.sin(turn), np.cos(turn)])
    with pytest.raises(GravityError, match=r"do not determine bias x, scale x: .* x up and x down as well"):
        trace_gravity(poses_of(about_x, rng))


@pytest.mark.parametrize(
    ("name", "n_poses", "before_mg", "after_mg"),
    [
        ("mpu9150_unit0", 22, (1.66, 2.21), (0.25, 0.4)),
        ("mpu9150_unit2", 22, (1.72, 2.33), (0.25, 0.4)),
        ("xsens", 38, (3.44, 3.98), (0.15, 0.2)),
    ],
)
def test_measured_logs_are_traced_to_misalignment(name, n_poses, before_mg, after_mg):
    file = DATA / f"{name}_multiposition.csv"
    if not file.is_file():
        pytest.skip(f"{file} is not here: set CALRIG_DATA to the folder of measured data")
    log = read_static(file.read_bytes())

    gravity = calibrate_by_gravity(accel_g_of(log), time_s=log.time_s, gyro_dps=log.axes("gyro", "dps"))
    document = gravity_document(gravity)

    assert document["n_poses"] == n_poses
    assert [effect["name"] for effect in document["effects"]] == ["misalignment"]
    assert (document["verdict"], document["effects"][0]["p_value"]) == ("named", 0.001)
    base, final = document["base"], document["final"]
    assert (base["fit_rms_mg"], base["held_out_rms_mg"]) == pytest.approx(before_mg, rel=0.05)
    assert final["fit_rms_mg"] <= after_mg[0]
    assert final["held_out_rms_mg"] <= after_mg[1]
