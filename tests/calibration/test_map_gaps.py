"""A map between far angles, over more than a turn, and with a gear that nobody stated: what reads it."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.calibration.poses import Pose
from calrig.calibration.separation import MountedPoses, StageMap, map_document, mapped, pose_residuals, solve
from calrig.calibration.separation.map_validity import _means, _Run
from calrig.calibration.separation.stage_map import inside_gaps, undetermined_gaps
from calrig.canonical_json import sha256_of
from calrig.export.solution_documents import stage_map_document


def solution_of(dial, gear_deg=0.0):
    """Of one unit in three mounts, noise of 0.3 mg."""
    rng, lots = np.random.default_rng(1), []
    for mount_deg in (0.0, 120.0, 240.0):
        error = 0.3 * np.sin(np.radians(dial + 40.0)) + gear_deg * np.sin(np.radians(50.0 * dial))
        turn = np.radians(dial + error + mount_deg)
        vector = np.stack([np.sin(turn) + 0.05, np.cos(turn) - 0.03], axis=1)
        vector += rng.normal(0.0, 3e-4, vector.shape)
        poses = [
            Pose(target_deg=d, reading_deg=float(np.degrees(np.arctan2(y, z))), accel_y_g=y, accel_z_g=z)
            for d, (y, z) in zip(dial.tolist(), vector.tolist(), strict=True)
        ]
        lots.append(MountedPoses("u", f"{mount_deg:g}", mount_deg, f"run {mount_deg:g}", poses))
    return solve(lots)


def off_the_map(solution):
    """Mean of what the poses leave of the map as it is drawn."""
    drawn, poses = map_document(mapped(solution)), pose_residuals(solution)
    known = [row for row in zip(drawn["stage_deg"], drawn["error_deg"], strict=True) if row[1] is not None]
    return float(
        np.mean(np.array(poses["on_map_deg"]) - np.interp(poses["dial_deg"], *zip(*known, strict=True)))
    )


def read_back(solution):
    document = stage_map_document(solution)
    return StageMap.from_document({**document, "sha256": sha256_of(document)})


def test_a_gear_that_nobody_stated_leaves_residuals_of_poses():
    solution = solution_of(np.arange(-90.0, 90.0) + np.random.default_rng(2).uniform(-0.5, 0.5, 180), 0.06)
    assert solution.gear is not None
    assert off_the_map(solution) == pytest.approx(0.0, abs=1e-3)


def test_a_round_grid_whose_gaps_hold_every_even_angle_has_a_map_at_its_angles():
    solution = solution_of(np.arange(-175.0, 176.0, 10.0))
    found = mapped(solution)
    known = np.isfinite(found.error_deg)
    np.testing.assert_allclose(found.stage_deg[known], np.arange(-175.0, 176.0, 10.0))
    assert np.isfinite(found.mounts_deg).all()
    assert 0.0 < read_back(solution).std_deg < 0.01


def test_poses_of_a_wide_gap_lie_on_the_map_and_its_uncertainty_is_that_outside():
    solution = solution_of(np.concatenate([np.arange(-90.0, -30.0, 3.0), np.arange(10.0, 91.0, 3.0)]))
    assert off_the_map(solution) == pytest.approx(0.0, abs=5e-4)
    stated, stage_map = mapped(solution).std_deg, read_back(solution)
    assert stage_map.std_deg == pytest.approx(np.sqrt(np.nanmean(stated**2)), rel=0.03)
    assert stage_map.covers(stage_map.known_deg).all()


@pytest.mark.parametrize("turn_deg", [0.0, 360.0])
def test_angles_visited_a_turn_later_are_in_no_gap(turn_deg):
    dial = np.concatenate([np.arange(-170.0, -99.0, 3.0), np.arange(100.0, 281.0, 3.0) - 360.0 + turn_deg])
    gaps = undetermined_gaps(dial)
    assert not inside_gaps(dial, gaps).any()
    assert len(gaps) == 0


def test_noise_of_a_run_is_whitened_as_by_its_correlation_matrix():
    rng, n, rho = np.random.default_rng(3), 40, 0.6
    run = _Run(rng.normal(size=n), tuple((k, 0) for k in range(4)), np.eye(4)[np.arange(n) % 4])
    inverse = np.linalg.inv(correlation := rho ** np.abs(np.subtract.outer(np.arange(n), np.arange(n))))
    information, found = run.design.T @ inverse @ run.design, _means(run, rho)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(information))
    np.testing.assert_allclose(found.mean_deg, found.covariance @ run.design.T @ inverse @ run.error_deg)
    logs = np.linalg.slogdet(correlation)[1] + np.linalg.slogdet(information)[1]
    assert found.log_determinant == pytest.approx(logs)
