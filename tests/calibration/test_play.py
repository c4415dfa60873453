"""Backlash where the stage has turned and not come far: the table stands in its play."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed
from support import one_now

from calrig.calibration.diagnosis.candidates import candidates_of
from calrig.calibration.diagnosis.sensor_model import fitted_model
from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.poses import Pose
from calrig.calibration.regression.effect import Circumstances
from calrig.calibration.regression.motion import travel_deg
from calrig.calibration.regression.responses import responses_of
from calrig.calibration.results.correction import effects_on_reading_deg, numbers_of
from calrig.calibration.results.result import build_result

NOISE_DEG, PLAY_DEG = 0.02, 0.4


def to_and_fro(seed: int = 1, sweeps: int = 6) -> list[Pose]:
    """Moves of 0.5 to 1.5°, but 0.1 to 0.4° after each turn; the gyro feels what the table does."""
    rng = np.random.default_rng(seed)
    senses = np.repeat([1.0, -1.0] * (sweeps // 2), 14)
    moves = rng.uniform(0.5, 1.5, len(senses))
    turned = np.flatnonzero(np.diff(senses)) + 1
    moves[turned] = rng.uniform(0.1, PLAY_DEG, len(turned))
    motor_deg = np.cumsum(senses * moves)
    table_deg, stands_deg = [], motor_deg[0] - PLAY_DEG / 2.0
    for at in motor_deg:
        stands_deg = float(np.clip(stands_deg, at - PLAY_DEG / 2.0, at + PLAY_DEG / 2.0))
        table_deg.append(stands_deg)
    readings = 0.3 + np.array(table_deg) + rng.normal(0.0, NOISE_DEG, len(senses))
    felt = np.diff(table_deg, prepend=np.nan) + rng.normal(0.0, 0.01, len(senses))
    return [
        Pose(
            target_deg=float(motor),
            reading_deg=float(reading),
            approach=int(sense),
            time_s=3.0 * k,
            gyro_move_deg=float(move) if k else None,
        )
        for k, (motor, reading, sense, move) in enumerate(zip(motor_deg, readings, senses, felt, strict=True))
    ]


def test_the_way_since_a_turn_is_short_only_where_the_stage_came_from_within() -> None:
    moves, senses = np.array([np.nan, 5.0, -0.3, -4.0, -1.0, 2.0]), np.array([1.0, 1, -1, -1, 1, 1])
    starts = np.arange(6) == 0
    expected = [np.inf, np.inf, 0.3, 4.3, np.inf, np.inf]  # the fifth was come to from beyond
    np.testing.assert_allclose(travel_deg(moves, senses, starts), expected)
    assert np.isinf(travel_deg(moves, None, starts)).all()


def test_a_backlash_is_found_alone_though_some_poses_lie_within_the_play() -> None:
    found = document(diagnose([to_and_fro()], bootstraps=199), ["1"])
    (effect,) = found["effects"]
    play = effect["parameters"]["backlash_deg"]
    assert (effect["name"], effect["verdict"]) == ("backlash", "named")
    assert play["value"] == pytest.approx(-PLAY_DEG, abs=4.0 * play["std"])
    assert found["final"]["held_out_rms_deg"] < 1.15 * NOISE_DEG


def test_what_is_applied_is_what_was_fitted() -> None:
    poses = to_and_fro()
    r = responses_of([poses])
    backlash = next(c for c in candidates_of(r) if c.name == "backlash")
    model = fitted_model(r, [backlash])
    play_deg = float(model.fitted.beta[-1])
    result = build_result(poses, effects=[("backlash", {"backlash_deg": play_deg})])
    assert result.rms_with_effects_deg == pytest.approx(float(model.fitted.residuals[1:, 0].std()), rel=0.05)


def test_without_the_way_all_play_is_taken_up() -> None:
    r = responses_of([to_and_fro()])
    effect = next(c for c in candidates_of(r) if c.name == "backlash").effect
    parameters = {"backlash_deg": -PLAY_DEG}
    known = Circumstances(approach=r.approach, travel_deg=r.travel_deg)
    whole = effects_on_reading_deg(
        [(effect.name, parameters)], r.theta_deg, Circumstances(approach=r.approach)
    )
    there = effects_on_reading_deg([(effect.name, parameters)], r.theta_deg, known)
    assert np.abs(whole) == pytest.approx(PLAY_DEG / 2.0)
    assert (there != whole).sum() == 5


@pytest.mark.parametrize("seed", one_now(range(5)))
def test_a_play_that_is_taken_up_before_each_pose_is_found_alone_however_short_the_moves(seed: int) -> None:
    """Fifty times the noise: poses a short move after a turn would else be far off."""
    rng = np.random.default_rng(seed)
    target_deg = rng.uniform(-60.0, 60.0, 60)
    target_deg[10::12] = target_deg[9:59:12] + 0.3 * np.sign(target_deg[8:58:12] - target_deg[9:59:12])
    approach = np.sign(np.diff(target_deg, prepend=-90.0))
    reading_deg = 0.2 + 1.001 * target_deg - 0.5 * approach + rng.normal(0.0, NOISE_DEG, 60)
    time_s = 6.0 * np.arange(60)
    poses = posed(target_deg=target_deg, reading_deg=reading_deg, approach=approach, time_s=time_s)
    found = document(diagnose([poses], bootstraps=199, cross_fit=False), ["1"])
    (effect,) = found["effects"]
    assert (effect["name"], effect["verdict"]) == ("backlash", "named")
    assert effect["parameters"]["backlash_deg"]["value"] == pytest.approx(-1.0, rel=0.05)
    assert found["final"]["fit_rms_deg"] <= 1.2 * NOISE_DEG
    left = effects_on_reading_deg(
        [("backlash", numbers_of(effect["parameters"]))],
        target_deg,
        Circumstances(approach=approach, travel_deg=np.full(60, 0.1)),
    )
    np.testing.assert_allclose(left, -0.5 * approach, atol=0.02)


def test_readings_ahead_of_their_moves_have_not_failed_to_settle() -> None:
    """Up and down in even steps, a backlash of the other sign is what a move overshot by a share would be."""
    target_deg = np.tile([*range(-60, 61, 10), *range(50, -60, -10)], 3).astype(float)
    approach = np.sign(np.diff(target_deg, prepend=-70.0))
    noise_deg = np.random.default_rng(0).normal(0.0, NOISE_DEG, len(target_deg))
    reading_deg = 0.2 + target_deg + 0.1 * approach + noise_deg
    poses = posed(
        target_deg=target_deg,
        reading_deg=reading_deg,
        approach=approach,
        time_s=6.0 * np.arange(len(target_deg)),
    )
    (effect,) = document(diagnose([poses], bootstraps=199, cross_fit=False), ["1"])["effects"]
    assert effect["name"] == "backlash"
    assert "settling" not in effect["confusable_with"]


@pytest.mark.parametrize("seed", one_now([0, 4]))
def test_an_angle_that_was_misread_from_pose_to_pose_is_no_lack_of_settling(seed: int) -> None:
    """An error of the reference is in the move to its pose too: readings seem to be behind their moves."""
    rng = np.random.default_rng(seed)
    moves_deg = rng.uniform(0.4, 1.2, 150)
    stood_deg = np.concatenate([np.cumsum(moves_deg), np.cumsum(moves_deg[::-1])[::-1] - 0.3])
    run = posed(
        target_deg=np.round(stood_deg + rng.normal(0.0, 0.15, 300), 1),
        reading_deg=stood_deg + rng.normal(0.0, NOISE_DEG, 300),
        time_s=4.0 * np.arange(300),
    )
    (effect,) = document(diagnose([run], bootstraps=199), ["1"])["effects"]
    assert (effect["verdict"], effect["covariate"]) == ("unnamed", "target_deg")
    assert effect["corrects"] is None
