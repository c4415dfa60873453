"""Outliers told from what only looks wild beside its neighbours."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed

from calrig.calibration.diagnosis.candidates import candidates_of
from calrig.calibration.diagnosis.outliers import briefly_apart, gross_errors
from calrig.calibration.diagnosis.selection import Findings, search
from calrig.calibration.diagnosis.tracing import Diagnosis, diagnose, document
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


def lost_digits(share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Elevations of four turns and back, their readings, and which of these lost their last digit."""
    theta = np.concatenate([np.linspace(0.0, 1400.0, 100), np.linspace(1395.0, 5.0, 100)])
    rng = np.random.default_rng(4)
    readings = np.round(100.0 + 1.02 * theta + rng.normal(0.0, 0.5, len(theta)), 1)
    wrong = np.zeros(len(theta), dtype=bool)
    wrong[rng.choice(np.arange(2, len(theta) - 2), int(share * len(theta)), replace=False)] = True
    return theta, np.where(wrong, readings // 10.0, readings), wrong


def diagnosed(theta: np.ndarray, readings: np.ndarray) -> Diagnosis:
    poses = posed(target_deg=theta, reading_deg=readings, time_s=4.0 * np.arange(len(theta)))
    return diagnose([poses], bootstraps=99, cross_fit=False)


def test_gross_errors_are_left_out_beyond_the_most_outliers_and_stay_on_no_other_turn() -> None:
    theta, readings, wrong = lost_digits(0.08)
    found = diagnosed(theta, readings)
    assert [pose.target_deg for pose in found.runs[0]] == theta[~wrong].tolist()
    slope, level = np.polyfit(theta[~wrong], readings[~wrong], 1)
    said = document(found, ["1"])
    assert said["base"]["scale"] == pytest.approx(slope)
    assert said["base"]["bias_deg"] == pytest.approx(level)
    assert said["base"]["fit_rms_deg"] < 0.6
    assert said["warnings"][0].startswith(f"outliers, {wrong.sum()} poses")
    assert not any("another turn" in sentence for sentence in said["warnings"])


def test_outliers_beyond_the_most_that_are_left_out_are_counted() -> None:
    theta, readings, wrong = lost_digits(0.15)
    found = diagnosed(theta, readings)
    left_out = len(theta) - len(found.runs[0])
    more = next(sentence for sentence in found.warnings if "more poses lie as far" in sentence)
    assert "at most 6 of 200 are left out" in more
    assert 0.8 * wrong.sum() <= left_out + int(more.split()[0]) <= wrong.sum()


def test_an_outlier_too_many_is_told_by_its_angle() -> None:
    theta = np.arange(-90.0, 91.0, 5.0)
    readings = theta + 0.03 * np.random.default_rng(3).standard_normal(len(theta))
    readings[[20, 28]] += [9.0, -0.9]  # of 37 poses one is left out
    found = diagnosed(theta, readings)
    (more,) = (sentence for sentence in found.warnings if "more pose" in sentence)
    assert more.startswith("1 ") and "at 50°" in more


@pytest.mark.parametrize("seed", range(3))
def test_an_outlier_that_hides_a_curve_leaves_with_it(seed: int) -> None:
    """A magnet beside a motor: dwells of a few rows, and one read while the arm still swung back."""
    rng = np.random.default_rng(seed)
    there = np.append(np.repeat(np.arange(0.0, 131.0, 10.0), rng.integers(1, 5, 14)), [92.0, 87.0, 85.0])
    error = (
        37.0 * (there / 130.0) ** 6 - 14.0 * np.sin(np.pi * there / 130.0) + rng.normal(0.0, 0.5, len(there))
    )
    error[-3] += 28.0
    theta = there + rng.normal(0.0, 0.3, len(there))
    found = document(diagnose([posed(target_deg=theta, reading_deg=theta + error)], bootstraps=99), ["1"])
    assert {effect["covariate"] for effect in found["effects"]} == {"target_deg"}
    assert sum(f"pose {len(theta) - 3} at" in said for said in found["warnings"]) == 1
    assert found["final"]["fit_rms_deg"] < 0.1 * found["base"]["fit_rms_deg"]


@pytest.mark.parametrize("event", ["slip", "dent", "many", "small"])
def test_what_may_be_an_effect_is_no_gross_error(event: str) -> None:
    theta = passes(4)
    shape = {
        "slip": 90.0 * (np.arange(len(theta)) >= 740),
        "dent": 90.0 * (np.abs(theta - 17.0) < 0.25),
        "many": 90.0 * (np.arange(len(theta)) % 8 == 3),
        "small": 30.0 * (np.arange(len(theta)) == 333),
    }
    assert gross_errors(responses_of([run_of(theta, shape[event], seed=11)])).tolist() == []
    alone = 90.0 * (np.arange(len(theta)) == 333)
    assert gross_errors(responses_of([run_of(theta, alone, seed=11)])).tolist() == [333]
