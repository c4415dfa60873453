"""Outliers told from what only looks wild beside its neighbours."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed

from calrig.calibration.diagnosis.candidates import candidates_of
from calrig.calibration.diagnosis.outliers import briefly_apart
from calrig.calibration.diagnosis.selection import Findings, search
from calrig.calibration.poses import Pose
from calrig.calibration.regression.responses import responses_of

N_POSES = 120


def searched(run: list[Pose]) -> Findings:
    r = responses_of([run])
    return search(r, candidates_of(r), np.random.default_rng(1), bootstraps=99)


def run_of(theta: np.ndarray, error: np.ndarray, seed: int) -> list[Pose]:
    """0.8° of bias, noise of 0.03°, one pose every four seconds."""
    readings = 0.8 + 1.002 * theta + error + np.random.default_rng(seed).normal(0.0, 0.03, len(theta))
    return posed(target_deg=theta, reading_deg=readings, time_s=4.0 * np.arange(len(theta)))


def anywhere(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-60.0, 60.0, N_POSES)


@pytest.mark.parametrize("size_deg", [0.3, 0.6, 3.0])
def test_the_poses_beside_a_slip_stay_however_large_it_is(size_deg: float) -> None:
    findings = searched(run_of(anywhere(3), np.where(np.arange(N_POSES) < 47, 0.0, size_deg), seed=3))
    assert len(findings.kept) == N_POSES
    assert [f.candidate.name for f in findings.found] == ["mount_slip"]


def test_the_ends_of_a_curve_stay() -> None:
    theta = np.linspace(-60.0, 60.0, N_POSES)
    findings = searched(run_of(theta, 2e-4 * theta**2, seed=4))
    assert len(findings.kept) == N_POSES


@pytest.mark.parametrize("at", [0, 1, 60, N_POSES - 1])
def test_a_pose_that_went_wrong_alone_is_set_aside(at: int) -> None:
    wrong = np.where(np.arange(N_POSES) == at, 3.0, 0.0)
    findings = searched(run_of(anywhere(6), wrong, seed=6))
    assert set(range(N_POSES)) - set(findings.kept.tolist()) == {at}
    assert not findings.found


def test_a_pose_that_went_wrong_hides_no_effect_and_is_none() -> None:
    drifting = 0.3 * np.arange(N_POSES) / N_POSES
    findings = searched(run_of(anywhere(7), np.where(np.arange(N_POSES) == 30, -3.0, drifting), seed=7))
    assert [f.candidate.name for f in findings.found] == ["time_drift"]
    assert 30 not in findings.kept


@pytest.mark.parametrize(
    ("wrong_deg", "are_left_out"), [([-0.33, 0.28], True), ([0.33, -0.28, 0.2, -0.17], False)]
)
def test_poses_clear_of_all_others_are_left_out_and_a_tail_that_thins_out_stays(
    wrong_deg: list[float], are_left_out: bool
) -> None:
    """Nine to eleven standard deviations off: in the tail the next ones lie at half of that."""
    error = 0.3 * np.arange(N_POSES) / N_POSES
    wrong = np.array([30, 81, 55, 104])[: len(wrong_deg)]
    error[wrong] += wrong_deg
    findings = searched(run_of(anywhere(7), error, seed=7))
    assert [f.candidate.name for f in findings.found] == ["time_drift"]
    assert set(range(N_POSES)) - set(findings.kept.tolist()) == (
        set(wrong.tolist()) if are_left_out else set()
    )


def passes(count: int, poses: int = 200) -> np.ndarray:
    up = np.linspace(0.0, 40.0, poses)
    return np.concatenate([up if k % 2 == 0 else up[::-1] for k in range(count)])


def worm(theta: np.ndarray) -> np.ndarray:
    return 0.4 * np.sin(2.0 * np.pi * theta / 5.0)


@pytest.mark.parametrize("wrong", [(50, 90, 91, 130, 160), (60, 61, 62, 63), (3,)])
def test_poses_that_went_wrong_together_do_not_hide_beneath_a_wave(wrong: tuple[int, ...]) -> None:
    """None is far from bias and scale, by the spread that the wave gives."""
    theta = passes(1)
    error = worm(theta)
    error[list(wrong)] += np.resize([1.2, -1.2, -1.3, 1.1, 1.2], len(wrong)) if len(wrong) > 4 else 1.2
    findings = searched(run_of(theta, error, seed=8))
    assert set(range(len(theta))) - set(findings.kept.tolist()) == set(wrong)
    assert [f.candidate.name for f in findings.found] == ["stage_periodic"]


def test_a_slip_beneath_a_wave_is_no_brief_burst() -> None:
    theta = passes(1)
    findings = searched(run_of(theta, worm(theta) + 1.2 * (np.arange(len(theta)) >= 120), seed=9))
    assert len(findings.kept) == len(theta)
    assert {f.candidate.name for f in findings.found} == {"stage_periodic", "mount_slip"}


def brief(theta: np.ndarray, error: np.ndarray) -> list[int]:
    r = responses_of([run_of(theta, error, seed=10)])
    return briefly_apart(r, r.values[:, 0] - np.polyval(np.polyfit(theta, r.values[:, 0], 1), theta)).tolist()


def test_a_dent_that_every_pass_feels_is_of_the_angle_and_one_that_one_pass_feels_is_not() -> None:
    theta = passes(4)
    dent = 1.2 * (np.abs(theta - 17.0) < 0.25)
    assert brief(theta, dent) == []
    once = np.flatnonzero(dent[:200])
    assert brief(theta, np.where(np.arange(800) < 200, dent, 0.0)) == once.tolist()


def test_what_begins_where_the_stage_turns_is_no_burst() -> None:
    since = np.arange(800) % 200
    assert brief(passes(4), 1.5 * np.exp(-since / 1.5) * (np.arange(800) >= 200)) == []
