"""Units clamped with x, y and z along the stage's axis: against truth, bound and what was promised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calrig.calibration.poses import DiagnosisError
from calrig.calibration.separation.accelerometer import sensed_vector
from calrig.calibration.separation.clamping import face_matrix, stage_direction, tilted
from calrig.calibration.separation.least_squares import fitted
from calrig.calibration.separation.report import solution_document
from calrig.calibration.separation.solution import solve
from calrig.calibration.separation.unit_results import accelerometer
from calrig.estimation.gyro import moves_about_axes

from .cube import MOVES, Seat, drawn_cube_bench
from .cube_oracle import bound
from .three_axes import FIVE_TURNS, felt_turns, felt_turns_found, judge, judge_gyro, whole_solution


@pytest.fixture(scope="module")
def bench():
    return drawn_cube_bench(7, turns=FIVE_TURNS)


@pytest.fixture(scope="module")
def solution(bench):
    return whole_solution(bench, 7, cubic=True)


@pytest.fixture(scope="module")
def lots(bench):
    return bench.measured(np.random.default_rng(7))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


# --- Against truth and bound ---


def test_a_matrix_makes_gravity_of_what_the_unit_feels_whatever_the_attitude(solution, bench):
    """The calibration applied to attitudes that no pose had: |a| = 1 g, where the raw one is 0.1 g off."""
    direction = np.random.default_rng(0).normal(size=(200, 3))
    raw = bench.unit.felt_g(direction / np.linalg.norm(direction, axis=1)[:, None])
    (unit,) = solution_document(solution)["units"]
    found = unit["accelerometer"]
    bias, matrix = np.array(found["bias_g"]), np.array(found["matrix"])
    along = (raw - bias) / np.diag(np.linalg.inv(matrix))
    bent = found["quadratic_g_per_g2"] * along**2 + found["cubic_g_per_g3"] * along**3
    true = (raw - bent - bias) @ matrix.T
    assert rms(np.linalg.norm(raw, axis=1) - 1.0) > 0.03
    assert rms(np.linalg.norm(true, axis=1) - 1.0) < 1e-3
    assert not np.tril(matrix, -1).any(), "in the sensor's own frame it is upper triangular"


def test_what_is_stated_is_the_bound_of_an_independent_bench(bench):
    still = replace(bench, turns=())
    least = bound(still, linear=False)
    found = accelerometer(whole_solution(still, 7, cubic=True).fit, 0)
    assert 1e3 * rms(found.stds[:3]) == pytest.approx(least.bias_mg, rel=0.12)
    assert 1e6 * rms(np.diag(found.stds[3:].reshape(3, 3))) == pytest.approx(least.scale_ppm, rel=0.12)


@pytest.mark.statistical
def test_whole_units_reach_their_bound_and_two_standard_errors_hold():
    judged = [judge(seed, cubic=True) for seed in range(20)]
    achieved = np.sqrt(np.mean([one.squares for one in judged], axis=0))
    least = np.sqrt(np.mean([one.bounds**2 for one in judged], axis=0))
    assert (achieved < 1.3 * least).all(), achieved / least
    within = np.mean([one.within for one in judged], axis=0)
    assert (within > 0.89).all(), within


def test_derivatives_are_those_of_the_vectors(solution):
    fit, step = solution.fit, 1e-6
    normal = fit.problem.normal(fit.parameters, fit.weights)
    of_map = np.arange(fit.problem.first_order, fit.problem.size)
    for mount in range(len(fit.problem.table.mounts)):
        rows = fit.problem.table.mount == mount
        at = np.concatenate([fit.problem.own[mount], of_map])
        for k in (0, 4, 7, 10, 13, 18, 19, 20, 21, 22, 25):
            change = np.zeros(len(fit.parameters))
            change[at[k]] = step
            ahead, behind = (
                fit.problem.expected(fit.parameters + s * change).vector_g[rows] for s in (1, -1)
            )
            slope = (ahead - behind) / (2.0 * step * fit.problem.shape[0])
            np.testing.assert_allclose(normal.derivatives[rows][:, :, k], slope, atol=1e-7)


def test_in_the_faces_frame_the_turn_of_the_sensor_is_in_the_matrix(solution, bench):
    """Twelve numbers: a degree of the sensor against its case stands beside the diagonal."""
    found = accelerometer(solution.fit, 0, "faces")
    response = np.linalg.inv(bench.unit.in_sensor_frame()) @ bench.unit.to_sensor_frame()
    error = found.matrix - np.linalg.inv(response)
    assert (np.abs(error) < 4.0 * found.stds[3:].reshape(3, 3)).all()
    assert found.turn_std_rad == pytest.approx(np.radians(0.3), rel=0.9), "seats were off by 0.3°"


def test_the_axis_out_of_level_and_the_mounts_are_found(solution, bench):
    document = solution_document(solution)
    dip = document["stage"]["axis_dip_deg"]
    assert dip["value"] == pytest.approx(bench.dip_deg, abs=4.0 * dip["std"])
    assert [mount["mount_axis"] for mount in document["mounts"]] == ["x", "y", "z"]
    assert document["separable"]
    assert document["rank"]["told"] == document["rank"]["parameters"]
    assert document["final"]["held_out_rms_deg"] < 0.2 < document["before"]["held_out_rms_deg"]


def test_several_units_on_one_stage_are_solved_together(bench):
    """A unit clamped by one face alone has its elevation from the map that the other made known."""
    still = replace(bench, turns=())
    first = still.measured(np.random.default_rng(1), "A")
    second = replace(still, unit=drawn_cube_bench(8).unit, seats=still.seats[:1])
    document = solution_document(solve([*first, *second.measured(np.random.default_rng(2), "B")]))
    a, b = document["units"]
    assert a["accelerometer"] is not None
    assert b["accelerometer"] is None
    assert max(b["elevation_std_deg"]["std_deg"]) < 0.03
    assert any("unit B: these poses do not tell" in said for said in document["warnings"])


def test_noisier_axes_count_less(lots):
    rng = np.random.default_rng(3)
    noisy = [
        replace(
            lot, poses=[replace(p, accel_z_g=p.accel_z_g + float(rng.normal(0.0, 2e-3))) for p in lot.poses]
        )
        for lot in lots
    ]
    (unit,) = solution_document(solve(noisy))["units"]
    assert unit["noise_mg"] == pytest.approx([0.52, 0.52, 2.07], rel=0.25)


# --- The gyro ---


def test_full_turns_tell_the_gyro_whatever_the_stage_is(solution, bench):
    found = felt_turns_found(solution.fit)
    assert found == pytest.approx(felt_turns(bench), abs=60e-6)
    (unit,) = solution_document(solution)["units"]
    gyro = unit["gyro"]
    assert gyro["turns"] == {**gyro["turns"], "n": 15, "closed": True, "both_ways": True}
    assert gyro["clock"] == "board"
    error = np.array(gyro["bias_dps"]) - bench.unit.gyro_bias_dps
    assert (np.abs(error) < 4.0 * np.array(gyro["bias_std_dps"])).all()


@pytest.mark.statistical
def test_what_is_stated_of_a_gyro_holds():
    judged = [judge_gyro(seed) for seed in range(12)]
    along, diagonal, beside, *_ = np.sqrt(np.mean([one.squares for one in judged], axis=0))
    assert along < 1.3 * 15e-6, "15 ppm of noise from five turns at 60 °/s"
    assert diagonal < 50e-6
    assert beside < 400e-6
    within = np.nanmean([one.within[1:] for one in judged], axis=0)
    assert (within > 0.88).all(), within


def test_turns_one_way_leave_earths_rate_in_and_say_so(bench):
    document = solution_document(whole_solution(replace(bench, turns=(1, 1)), 7, cubic=True))
    assert any("turned one way only" in said for said in document["warnings"])
    (unit,) = document["units"]
    assert max(max(row) for row in unit["gyro"]["matrix_std"]) > 3e-4


def test_without_the_moves_of_all_axes_there_is_no_matrix_of_the_gyro(lots):
    bare = [
        replace(
            lot,
            poses=[
                replace(p, covariates={k: v for k, v in p.covariates.items() if k not in MOVES})
                for p in lot.poses
            ],
        )
        for lot in lots
    ]
    document = solution_document(solve(bare))
    (unit,) = document["units"]
    assert unit["gyro"]["matrix"] is None
    assert unit["gyro"]["dps_per_g"] is not None
    assert any("gyro_move_x_deg" in said for said in document["warnings"])


def test_a_boards_clock_is_held_against_the_hosts(lots):
    """0.4 % fast; each pose told some 5 ms late."""
    rng = np.random.default_rng(5)
    timed = [
        replace(
            lot,
            poses=[
                replace(
                    p,
                    covariates={
                        **p.covariates,
                        "host_time_s": 1.7e9 + p.time_s / 1.004 + float(rng.exponential(0.005)),
                    },
                )
                for p in lot.poses
            ],
        )
        for lot in lots
    ]
    document = solution_document(solve(timed))
    found = document["units"][0]["gyro"]["clock_error_ppm"]
    assert found["value"] == pytest.approx(4000.0, abs=4.0 * found["std"])
    assert found["std"] < 20.0
    assert any("the board's clock is fast by " in said for said in document["warnings"])


def test_moves_about_all_axes_come_from_a_runs_samples():
    """Two dwells of 1 s, a turn of 90° in 3 s about an axis of its own between them, a bias on each axis."""
    time_s = np.arange(0.0, 5.0, 0.005)
    axis, bias = np.array([0.6, 0.0, 0.8]), np.array([1.0, -2.0, 0.5])
    moving = (time_s >= 1.0) & (time_s < 4.0)
    gyro = bias + 30.0 * moving[:, None] * axis
    (nothing, turned) = moves_about_axes(time_s, gyro, [(0.0, 0.995), (4.0, 4.995)])
    assert nothing is None
    assert turned == pytest.approx(90.0 * axis, abs=0.1)


# --- What cannot be meant, and what the poses do not tell ---


def test_two_faces_do_not_tell_all_and_it_is_said_which_one_would(lots):
    document = solution_document(solve(lots[:2]))
    (unit,) = document["units"]
    assert unit["accelerometer"] is None
    assert document["rank"]["told"] < document["rank"]["parameters"]
    assert any(
        "do not tell xy skew" in said and "clamp it with its z" in said for said in document["warnings"]
    )


def test_a_face_that_lies_elsewhere_is_refused(lots):
    with pytest.raises(DiagnosisError, match="cube, mount m1: mount_axis is z, but gravity lies along z"):
        solve([lots[0], replace(lots[1], axis="z"), lots[2]])
    with pytest.raises(DiagnosisError, match=r"mount_axis is 'w', which is none of x, -x, y"):
        solve([lots[0], replace(lots[1], axis="w"), lots[2]])
    with pytest.raises(DiagnosisError, match=r"mount m1.*turn against the stage"):
        solve([lots[0], replace(lots[1], axis="-y"), lots[2]])


def test_wild_poses_are_left_out_and_said(lots):
    poses = list(lots[1].poses)
    poses[5] = replace(poses[5], accel_x_g=poses[5].accel_x_g + 0.05)
    found = solve([lots[0], replace(lots[1], poses=poses), lots[2]])
    assert (~found.fit.kept).sum() == 1
    assert any("1 outliers were left out" in said for said in found.warnings)


def test_units_that_are_stated_to_be_linear_and_are_not_are_told_of(lots):
    document = solution_document(solve(lots, linear=True))
    assert any(
        "stated to be linear, and these poses contradict that" in said for said in document["warnings"]
    )


def test_too_few_poses_are_refused(lots):
    with pytest.raises(DiagnosisError, match="9 poses are too few for"):
        solve([replace(lot, poses=lot.poses[:3]) for lot in lots])
    blind = [replace(lot, poses=[replace(p, accel_x_g=None) for p in lot.poses]) for lot in lots]
    with pytest.raises(DiagnosisError, match="mount m0: 29 poses lack accel_x_g, accel_y_g or accel_z_g"):
        solve(blind)


def test_a_unit_turned_about_the_vertical_is_another_face_of_the_same(bench):
    """-x: its elevation changes sign; beside x, y and z it only adds poses."""
    reversed_too = replace(bench, turns=(), seats=(*bench.seats, Seat("-x", 1.0)))
    found = solve(reversed_too.measured(np.random.default_rng(4)))
    document = solution_document(found)
    assert document["mounts"][3]["angle_deg"]["value"] == pytest.approx(1.0, abs=1.0)
    assert document["rank"]["told"] == document["rank"]["parameters"]
    assert fitted(found.fit.problem, found.fit.weights).noise == pytest.approx(found.fit.noise, rel=1e-6)


@pytest.mark.parametrize("face", ["x", "y", "z", "-x", "-y", "-z"])
def test_faces_are_rotations(face):
    matrix = face_matrix(face)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    first = "xyz".index(face[-1])
    assert matrix[first, 0] == (-1.0 if face.startswith("-") else 1.0)
    turn, _ = tilted(np.array([0.1, -0.2]))
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    up, _, _ = stage_direction(np.array([0.0]), 0.0)
    felt = sensed_vector(np.zeros(21), up @ matrix.T).vector_g[0]
    assert felt[(first + 2) % 3] == 1.0, "at a turn of 0 the third axis is up"
