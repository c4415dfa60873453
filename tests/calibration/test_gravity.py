"""Gravity as the reference: static poses, bias, scale, misalignment, and nothing where there is nothing."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import binom
from support import DATA, one_now

from calrig.calibration.gravity_fit import EFFECTS, Problem, fit_gravity
from calrig.calibration.separation.gravity import (
    calibrate_by_gravity,
    gravity_document,
    search,
    trace_gravity,
)
from calrig.calibration.static_detector import static_poses
from calrig.calibration.static_segments import GravityError, StaticPoses
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


@pytest.mark.parametrize("wanders_g", [2e-3, 0.0])
def test_a_bias_that_wanders_over_the_log_has_the_error_that_its_parts_show(wanders_g):
    """The y axis' offset goes up and down twice; noise alone widens errors in a hundredth of the tables."""
    ratios, apart = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        poses = poses_of(directions(rng, 96), rng)
        phase = rng.uniform(0.0, 2.0 * np.pi)
        wander_g = wanders_g * np.sin(np.linspace(0.0, 4.0 * np.pi, 96) + phase)
        raw_g = poses.accel_g + np.outer(wander_g, [0.0, 1.0, 0.0])
        fitted = fit_gravity(Problem.of(replace(poses, accel_g=raw_g)))
        independent = float(fitted.residual_g @ fitted.residual_g) / (96 - 6 - 2)
        plain = np.sqrt(independent * np.diag(np.linalg.inv(fitted.jacobian.T @ fitted.jacobian)))
        ratios.append(np.sqrt(np.diag(fitted.covariance)) / plain)
        apart.append((fitted.bias_g[1] - BIAS_G[1]) / fitted.bias_std_g[1])
    wider = np.mean(np.asarray(ratios)[:, 1] > 1.001)
    assert (wider > 0.5) if wanders_g else (wider < 0.1)
    assert np.mean(np.abs(apart) < 3.0) >= 0.9


@pytest.mark.statistical
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


def written(poses_g, rng, *, rows=1, noise_g=1e-3):
    """A table of positions: `rows` of each, or that many drawn for each, with a sensor's errors and noise."""
    each = np.full(len(poses_g), rows) if np.isscalar(rows) else rng.integers(*rows, len(poses_g))
    raw = np.repeat(BIAS_G + SCALE * np.linalg.solve(MATRIX, poses_g.T).T, each, axis=0)
    return raw + rng.normal(0.0, noise_g, raw.shape)


@pytest.mark.parametrize(("n", "rows", "held_out_mg"), [(160, 1, 1.2), (24, 1, 1.8), (60, (3, 11), 0.7)])
@pytest.mark.parametrize("time", one_now(["none", "row by row"]))
def test_a_table_of_one_or_some_rows_a_position_is_one_pose_each(n, rows, held_out_mg, time):
    rng = np.random.default_rng(20)
    accel_g = written(directions(rng, n), rng, rows=rows)
    time_s = None if time == "none" else np.arange(len(accel_g)) * 10.0

    document = gravity_document(calibrate_by_gravity(accel_g, time_s=time_s))

    assert document["n_poses"] == n
    assert [effect["name"] for effect in document["effects"]] == ["misalignment"]
    assert document["final"]["held_out_rms_mg"] <= held_out_mg
    assert ("one row a position" if rows == 1 else f"{n} positions") in document["warnings"][0]
    for name, truth in (("bias", BIAS_G), ("scale", SCALE)):
        std = np.array(document["final"]["bias_std_g" if name == "bias" else "scale_std"])
        found = np.array(document["final"]["bias_g" if name == "bias" else "scale"])
        assert (np.abs(found - truth) < 4.0 * std).all()


def test_bad_rows_are_named_by_line_and_left_out():
    rng = np.random.default_rng(21)
    accel_g = written(directions(rng, 178), rng)
    clean = gravity_document(calibrate_by_gravity(np.delete(accel_g, [28, 134, 164], axis=0)))
    accel_g[28] *= 0.93
    accel_g[134, 2] += 0.4 * np.sign(accel_g[134, 2])
    accel_g[164] *= 1.02

    document = gravity_document(calibrate_by_gravity(accel_g), line_of=lambda row: row + 2)

    named = [warning.split(":")[0] for warning in document["warnings"] if "left out" in warning]
    assert named == ["line 30", "line 136", "line 166"]
    assert document["n_poses"] == 175
    assert document["final"]["matrix"] == clean["final"]["matrix"]


def test_a_pose_that_was_moved_is_named_by_its_samples_in_a_log_of_any_rate():
    rng = np.random.default_rng(22)
    _, accel_g = log_of(directions(rng, 24), rng)
    accel_g[3500:3900] *= 1.05
    document = gravity_document(calibrate_by_gravity(accel_g))
    (named,) = (warning for warning in document["warnings"] if "left out" in warning)
    first, last = map(int, re.findall(r"\d+", named.split(":")[0]))
    assert 3500 <= first < last < 3900
    assert document["final"]["held_out_rms_mg"] < 1.0


@pytest.mark.parametrize("rate_hz", [10, *one_now([100, 1000])])
def test_without_a_rate_a_log_gives_what_it_gives_with_one(rate_hz):
    rng = np.random.default_rng(23)
    time_s, accel_g = log_of(directions(rng, 24), rng, rate_hz=rate_hz, matrix=MATRIX, noise_g=2e-3)
    known = gravity_document(calibrate_by_gravity(accel_g, time_s=time_s))
    unknown = gravity_document(calibrate_by_gravity(accel_g))
    assert known["n_poses"] == unknown["n_poses"] == 24
    for key, std_key in (("bias_g", "bias_std_g"), ("scale", "scale_std")):
        apart = np.subtract(known["final"][key], unknown["final"][key])
        assert (np.abs(apart) < 2.0 * np.array(known["final"][std_key])).all()
    assert any("rate is not known" in warning for warning in unknown["warnings"])


def test_a_rate_wins_over_the_time_and_a_disagreement_is_said():
    rng = np.random.default_rng(24)
    time_s, accel_g = log_of(directions(rng, 20), rng)
    given = calibrate_by_gravity(accel_g, time_s=time_s / 1000.0, rate_hz=100.0)
    assert len(given.poses) == 20
    assert "100 Hz" in given.warnings[0]
    assert "100000 Hz" in given.warnings[0]
    assert not calibrate_by_gravity(accel_g, time_s=time_s, rate_hz=100.5).warnings
    with pytest.raises(GravityError, match="above 0"):
        calibrate_by_gravity(accel_g, rate_hz=0.0)


@pytest.mark.parametrize(
    "kind",
    [
        "one row",
        pytest.param("some rows", marks=pytest.mark.statistical),
        pytest.param("log", marks=pytest.mark.statistical),
    ],
)
def test_the_standard_errors_hold(kind):
    """Truth is within two standard errors of bias and gain in 92 to 98 of 100 cases."""
    inside = []
    for seed in range(20 if kind == "log" else 80):
        rng = np.random.default_rng(seed)
        true_g = directions(rng, 40)
        if kind == "log":
            accel_g = log_of(true_g, rng, rate_hz=20, matrix=MATRIX)[1]
        else:
            accel_g = written(true_g, rng, rows=1 if kind == "one row" else (3, 11), noise_g=2e-3)
        poses = static_poses(accel_g)
        fitted = fit_gravity(Problem.of(poses), [EFFECTS[0]])
        inside += [np.abs(fitted.bias_g - BIAS_G) < 2.0 * fitted.bias_std_g]
        inside += [np.abs(fitted.gain - SCALE) < 2.0 * fitted.gain_std]
        values, stds = fitted.parameters(EFFECTS[0], poses)
        inside += [np.abs(values - 1e3 * MATRIX[[0, 0, 1], [1, 2, 2]]) < 2.0 * stds]
    assert 0.92 <= np.mean(inside) <= 0.98


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda a: a * [0.667, 1.0, 1.0], r"gain of accel_x would be 0\.6"),
        (lambda a: a + np.array([0.0, 0.7, 0.0]), r"bias of accel_y would be \+0\.6"),
        (lambda a: a * (1.0 + 0.05 * np.resize([1.0, -1.0], len(a)))[:, None], r"leave 49\.\d mg"),
        (lambda a: a * 9.80665, "look like m/s²"),
        (lambda a: np.tile(a[0], (160, 1)), "one static pose"),
        (lambda a: a[0] + 1e-3 * a, "one static pose"),
        (
            lambda a: a * [1.0, 1.0, 0.0] / np.linalg.norm(a[:, :2], axis=1)[:, None],
            "do not determine bias z",
        ),
        (lambda a: np.where(np.arange(len(a))[:, None] % 4 == 0, 1.3 * a, a), "contradict"),
        (lambda a: a[:8], "few"),
    ],
)
def test_a_table_that_cannot_be_right_is_refused(change, says):
    rng = np.random.default_rng(25)
    with pytest.raises(GravityError, match=says):
        calibrate_by_gravity(change(written(directions(rng, 160), rng)))


@pytest.mark.parametrize("seeds", [range(24), pytest.param(range(24, 200), marks=pytest.mark.statistical)])
def test_any_table_gives_a_result_or_a_reason(seeds):
    """Tables of few or many rows, repeats, constants, unknown cells and wrong rates: 24 have all of each."""
    results = 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        n, kind = int(np.exp(rng.uniform(np.log(3), np.log(60)))), seed % 8
        accel_g = written(directions(rng, n), rng, rows=int(rng.choice([1, 1, 2, 7])))[:n]
        if kind == 1:
            accel_g = np.round(accel_g, int(rng.integers(0, 3)))
        elif kind == 2:
            accel_g[:, rng.integers(0, 3)] = rng.choice([0.0, 1.0])
        elif kind == 3:
            accel_g[rng.random(accel_g.shape) < 0.1] = np.nan
        elif kind == 4:
            accel_g = np.cumsum(accel_g, axis=0) / np.sqrt(n)
        elif kind == 5:
            accel_g[:] = accel_g[0]
        elif kind == 6:
            accel_g[rng.integers(0, n)] = 0.0
        time_s = [None, np.zeros(n), np.arange(n) * 0.01, np.arange(n) * 30.0][rng.integers(0, 4)]
        temperature_c = None if seed % 3 else np.full(n, 20.0) + rng.choice([0.0, 1.0]) * np.arange(n)
        try:
            found = calibrate_by_gravity(
                accel_g, time_s=time_s, rate_hz=[None, 1.0, 1e4][seed % 3], temperature_c=temperature_c
            )
        except GravityError as error:
            assert str(error)
        else:
            json.dumps(gravity_document(found), allow_nan=False)
            assert (np.abs(found.final.gain - SCALE) < 6.0 * found.final.gain_std + 0.02).all()
            results += 1
    assert results >= len(seeds) / 10


@pytest.mark.statistical
def test_nothing_is_claimed_of_units_that_lack_nothing():
    """400 units at a nominal 1 %: no more than such a rate gives in 999 of 1000 cases."""
    claimed = 0
    for seed in range(400):
        rng = np.random.default_rng(10_000 + seed)
        problem = Problem.of(poses_of(directions(rng, 22), rng))
        claimed += bool(search(problem, fit_gravity(problem), rng, 199)[1])
    assert claimed <= binom.ppf(0.999, 400, 0.01)


def test_static_poses_without_any_noise_lack_nothing():
    for seed in range(2):
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


def test_effects_that_too_few_poses_are_left_to_search_for_are_fitted_again_without_each_pose():
    rng = np.random.default_rng(3)
    poses = poses_of(directions(rng, 12), rng, matrix=np.array([[1, 0.01, -5e-3], [0, 1, 8e-3], [0, 0, 1]]))
    at = np.triu_indices(3)

    def errors_g(p, raw):
        matrix = np.zeros((3, 3))
        matrix[at] = p[3:]
        return np.linalg.norm((raw - p[:3]) @ matrix.T, axis=1) - 1.0

    expected_g = []
    for k in range(12):
        others = np.delete(poses.accel_g, k, axis=0)
        found = least_squares(errors_g, [0, 0, 0, 1, 0, 0, 1, 0, 1], args=(others,), xtol=1e-14, ftol=1e-14)
        expected_g += list(errors_g(found.x, poses.accel_g[[k]]))

    document = gravity_document(trace_gravity(poses))

    assert [effect["name"] for effect in document["effects"]] == ["misalignment"]
    assert document["held_out"]["how"] == "leave one pose out, with the effects of all poses"
    after_mg = 1e3 * np.sqrt(np.mean(np.square(expected_g)))
    assert document["final"]["held_out_rms_mg"] == pytest.approx(after_mg, rel=1e-4)
    assert after_mg < document["base"]["held_out_rms_mg"] / 3.0


def test_six_faces_show_no_misalignment_and_it_is_said():
    rng = np.random.default_rng(8)
    faces = np.vstack([np.eye(3), -np.eye(3)] * 3)
    document = gravity_document(trace_gravity(poses_of(faces, rng, matrix=MATRIX)))
    assert document["effects"] == []
    assert "misalignment xy, xz, yz cannot be seen" in document["warnings"][0]


def test_axes_that_are_not_square_are_found_where_the_poses_show_only_some_pairs():
    """Turned from z to x and from z to y, never from x to y: an independent fit has xz and yz alone."""
    rng = np.random.default_rng(1)
    turns = np.radians(np.arange(0.0, 360.0, 30.0))
    across = np.stack([np.sin(turns), 0.0 * turns, np.cos(turns)], axis=1)
    poses = poses_of(np.vstack([across, across[:, [1, 0, 2]]]), rng, matrix=MATRIX)

    gravity = trace_gravity(poses)
    document = gravity_document(gravity)

    def left_g(x):
        matrix = np.array([[x[3], 0.0, x[6]], [0.0, x[4], x[7]], [0.0, 0.0, x[5]]])
        return np.linalg.norm((poses.accel_g - x[:3]) @ matrix.T, axis=1) - 1.0

    fitted = least_squares(left_g, [0.0] * 3 + [1.0] * 3 + [0.0] * 2).x
    assert [effect["name"] for effect in document["effects"]] == ["misalignment"]
    parameters = document["effects"][0]["parameters"]
    assert parameters["xy_mrad"] == {"value": None, "std": None}
    for name, factor in (("xz_mrad", 6), ("yz_mrad", 7)):
        assert parameters[name]["value"] == pytest.approx(1e3 * fitted[factor] / fitted[5], abs=1e-4)
        assert abs(parameters[name]["value"]) > 4.0 * parameters[name]["std"]
    assert "misalignment xy cannot be seen" in " ".join(document["warnings"])


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


def test_a_table_of_too_few_positions_is_told_how_many_more_it_needs():
    with pytest.raises(GravityError, match=r"too few rows \(6\): at least 9 positions .* add 3 more"):
        calibrate_by_gravity(BIAS_G + SCALE * np.vstack([np.eye(3), -np.eye(3)]))


def test_too_few_poses_and_poses_about_one_axis_are_told_what_is_missing():
    rng = np.random.default_rng(9)
    with pytest.raises(GravityError, match="6 static poses are too few: at least 9"):
        trace_gravity(poses_of(directions(rng, 6), rng))
    turn = np.linspace(0.0, 2.0 * np.pi, 15)[:-1]
    about_x = np.column_stack([np.zeros(14), np.sin(turn), np.cos(turn)])
    with pytest.raises(GravityError, match=r"do not determine bias x, scale x: .* x up and x down as well"):
        trace_gravity(poses_of(about_x, rng))


@pytest.mark.parametrize(
    ("name", "given", "n_poses", "before_mg", "after_mg"),
    [
        *(
            ("mpu9150_unit0", given, 22, (1.66, 2.21), (0.25, 0.4))
            for given in ("time", "rate", "nothing", "one row a position")
        ),
        ("mpu9150_unit2", "time", 22, (1.72, 2.33), (0.25, 0.4)),
        ("xsens", "time", 38, (3.44, 3.98), (0.15, 0.2)),
    ],
)
def test_measured_logs_are_traced_to_misalignment(name, given, n_poses, before_mg, after_mg):
    file = DATA / f"{name}_multiposition.csv"
    if not file.is_file():
        pytest.skip(f"{file} is not here: set CALRIG_DATA to the folder of measured data")
    log = read_static(file.read_bytes())

    accel_g = accel_g_of(log)
    if given == "time":
        gravity = calibrate_by_gravity(accel_g, time_s=log.time_s, gyro_dps=log.axes("gyro", "dps"))
    elif given == "one row a position":
        gravity = calibrate_by_gravity(static_poses(accel_g, time_s=log.time_s).accel_g)
    else:
        gravity = calibrate_by_gravity(accel_g, rate_hz=100.0 if given == "rate" else None)
    document = gravity_document(gravity)

    assert document["n_poses"] == n_poses
    assert [effect["name"] for effect in document["effects"]] == ["misalignment"]
    assert (document["verdict"], document["effects"][0]["p_value"]) == ("named", 0.001)
    base, final = document["base"], document["final"]
    assert (base["fit_rms_mg"], base["held_out_rms_mg"]) == pytest.approx(before_mg, rel=0.05)
    assert final["fit_rms_mg"] <= after_mg[0]
    assert final["held_out_rms_mg"] <= after_mg[1]


def test_a_bad_position_at_another_temperature_changes_no_coefficient():
    """Those of the kept poses are stated about the kept poses' temperature."""
    rng = np.random.default_rng(5)
    up = rng.normal(size=(60, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    celsius = rng.uniform(20.0, 30.0, 60)
    accel_g = up + np.outer(celsius - 25.0, [1e-3, 2e-3, -1e-3]) + rng.normal(0.0, 1e-4, (60, 3))
    accel_g[7] *= 1.3
    celsius[7] = 100.0
    document = gravity_document(calibrate_by_gravity(accel_g, temperature_c=celsius))
    (effect,) = (one for one in document["effects"] if one["name"] == "temperature_bias")
    found = [effect["parameters"][f"{axis}_mg_per_c"]["value"] for axis in "xyz"]
    assert found == pytest.approx([1.0, 2.0, -1.0], abs=0.15)
