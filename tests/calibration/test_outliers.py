"""Wild poses told from what only looks wild in one order of the poses."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.calibration.outliers import without_outliers
from calrig.calibration.pose import Pose

N_POSES = 300


def bump(x: np.ndarray, at: float, width: float) -> np.ndarray:
    """An error of 0.6°, twenty times the noise, that nine poses or so have between them."""
    return 0.6 * np.exp(-0.5 * ((x - at) / width) ** 2)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("belongs_to", ["an angle", "a while"])
def test_an_error_that_neighbours_share_is_not_wild_whichever_way_they_are_neighbours(
    belongs_to: str, seed: int
) -> None:
    """A flaw of the graduation is alone in time, a gust is alone in elevation; neither pose is wrong."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(-60.0, 60.0, N_POSES)
    error = bump(theta, 20.0, 1.5) if belongs_to == "an angle" else bump(np.arange(N_POSES), 200.0, 3.75)
    readings = 0.8 + 1.002 * theta + error + rng.normal(0.0, 0.03, N_POSES)
    run = [Pose(target_deg=x, reading_deg=y) for x, y in zip(theta.tolist(), readings.tolist(), strict=True)]
    assert without_outliers([run]) == ([run], [])


@pytest.mark.parametrize("at", [0, 150, N_POSES - 1])
def test_a_pose_that_no_neighbour_agrees_with_is_left_out_of_its_run_alone(at: int) -> None:
    rng = np.random.default_rng(5)
    theta = rng.uniform(-60.0, 60.0, N_POSES)
    readings = 0.8 + theta + rng.normal(0.0, 0.03, N_POSES)
    calm = [Pose(target_deg=x, reading_deg=y) for x, y in zip(theta.tolist(), readings.tolist(), strict=True)]
    readings[at] += 0.6
    run = [Pose(target_deg=x, reading_deg=y) for x, y in zip(theta.tolist(), readings.tolist(), strict=True)]
    kept, (said,) = without_outliers([calm, run])
    assert kept == [calm, run[:at] + run[at + 1 :]]
    assert said.startswith(f"pose {at} of run 1 ")
