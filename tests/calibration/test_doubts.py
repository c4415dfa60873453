"""What makes a new calibration doubtful, compared with the one in force: its residual, and a changed bias."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from calrig.calibration.uncertainty.doubts import Line, remount_doubts, residual_doubts

NOISE_DEG = 0.005
IN_FORCE = "revision 1 in force"


def result(rms_deg, n_poses=20, noise_deg=NOISE_DEG, scale=1.0):
    """As much of a run's result as is compared."""
    return SimpleNamespace(rms_calibrated_deg=rms_deg, n_poses=n_poses, noise_deg=noise_deg, scale=scale)


def test_a_residual_far_above_the_one_in_force_names_both_figures():
    (doubt,) = residual_doubts(result(0.0064, 10), result(0.297, 10), IN_FORCE)
    assert doubt.kind == "residual"
    assert "0.30°" in doubt.says
    assert f"that of {IN_FORCE} is 0.0064°" in doubt.says


@pytest.mark.parametrize(
    ("before", "now"),
    [
        (result(0.005), result(0.012)),  # less than three times as much
        (result(0.3), result(0.6)),  # effects that neither line corrects
        (result(0.005), result(0.1, noise_deg=0.1)),  # a shorter dwell, or a noisier board
        (result(0.005, noise_deg=0.1), result(0.1)),  # a residual that was small by chance
        (result(0.005, 3), result(0.3, 3)),  # one degree of freedom each
        (result(0.0), result(0.01, noise_deg=None)),  # counts of the accelerometer
        (result(0.005, 2), result(0.3)),  # nothing left over to tell
        (result(None), result(0.3)),
    ],
)
def test_a_residual_that_may_have_another_reason_is_no_doubt(before, now):
    assert residual_doubts(before, now, IN_FORCE) == []


@pytest.mark.parametrize("n_poses", [3, 4, 6, 10])
def test_runs_of_one_unit_are_hardly_ever_doubted_by_chance(n_poses):
    """Where the noise is not known, so that F alone decides: 2e4 pairs, of which 1e-4 would be two."""
    scatter = np.random.default_rng(n_poses).standard_normal((20_000, 2, n_poses - 2))
    rms_deg = np.sqrt((scatter**2).sum(axis=2) / n_poses)
    doubted = sum(
        bool(residual_doubts(result(a, n_poses, None), result(b, n_poses, None), IN_FORCE))
        for a, b in rms_deg.tolist()
    )
    assert doubted <= 8


def test_the_scatter_of_a_new_run_does_not_excuse_its_bias():
    """A slip of 3° in mid-run: half of it in the bias, and as much again in its standard uncertainty."""
    before, slipped = Line(0.8, 1.0, 0.002, 1e-4), Line(2.3, 1.0, 0.5, 0.01)
    (doubt,) = remount_doubts(before, slipped, (-40.0, 40.0), 1.0, IN_FORCE)
    assert doubt.kind == "changed"
    assert remount_doubts(before, Line(1.6, 1.0, 0.5, 0.01), (-40.0, 40.0), 1.0, IN_FORCE) == []
