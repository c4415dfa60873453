"""What sequential stopping costs: the scatter stated after it covers what it says, simulated."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from calrig.calibration.line import Line
from calrig.calibration.uncertainty.sequential_stopping import cautious
from calrig.model.plan import FEWEST_UNTIL

RUNS, MOST_POSES = 40_000, 25
COVERED = 0.945
"""Of 95 %: correcting for one degree of freedom less covers 93.9 % at worst, none 92.9 %."""


def stated_scatter(n_poses):
    """What is stated for a residual scatter of 1."""
    line = Line(0.0, 1.0, 1.0, 1.0, ((1.0, 0.0), (0.0, 1.0)), 1.0)
    return cautious(line, n_poses, None).residual_std_deg


def test_a_run_that_ends_once_it_is_good_enough_covers_what_it_states():
    """Each run ends at the first pose at which the expanded uncertainty of its bias is below the goal.

    The squared recursive residuals of a line are independent of each other and of the line itself (Brown,
    Durbin & Evans, J. R. Stat. Soc. B 37, 1975), so the coverage given the stated scatter is the normal's.
    """
    n = np.arange(3, MOST_POSES + 1)
    squares = np.cumsum(np.random.default_rng(26).chisquare(1, (RUNS, len(n))), axis=1)
    stated = np.sqrt(squares / (n - 2)) * [stated_scatter(int(count)) for count in n]
    factor = stats.t.ppf(0.975, n - 2)
    covered = []
    for goal in np.geomspace(0.3, 1.0, 12):
        is_over = (factor * stated / np.sqrt(n) <= goal) & (n >= FEWEST_UNTIL)
        is_over[:, -1] = True
        last = is_over.argmax(axis=1)
        scatter = stated[np.arange(RUNS), last]
        covered.append(float(np.mean(2.0 * stats.norm.cdf(factor[last] * scatter) - 1.0)))

    assert min(covered) > COVERED
    assert math.isclose(stated_scatter(10_000), 1.0, rel_tol=1e-3), "of many poses it costs nothing"


@pytest.mark.parametrize("n_poses", [6, 12, 25])
def test_a_scatter_below_the_noise_states_the_noise_that_is_known_as_of_a_normal_distribution(n_poses):
    """Student's quantile of n − 2 times the stated scatter is the normal's quantile times the noise."""
    noise_deg = 0.02
    line = Line(0.0, 1.0, 0.001, 1e-5, ((1e-6, 1e-9), (1e-9, 1e-10)), 1e-3)
    stated = cautious(line, n_poses, noise_deg)
    more = stats.norm.ppf(0.975) / stats.t.ppf(0.975, n_poses - 2) * noise_deg / 1e-3
    assert stated.residual_std_deg == pytest.approx(more * 1e-3, rel=1e-6)
    assert (stated.bias_std_deg, stated.scale_std) == pytest.approx((more * 1e-3, more * 1e-5), rel=1e-6)
    assert np.array(stated.covariance) == pytest.approx(more**2 * np.array(line.covariance), rel=1e-6)
