"""Outliers told from what only looks wild beside its neighbours."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed

from calrig.calibration.diagnosis.candidates import candidates_of
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
