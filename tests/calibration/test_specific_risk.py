"""The specific risk: what is drawn agrees with what can be computed, and with whole calibrations repeated."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2, norm, t

from calrig.calibration.uncertainty.risk import probability_of_conformity
from calrig.model.result import RangeErrors, Reference
from calrig.model.verdict import Limit

NODES_DEG = tuple(range(-60, 61, 10))


def found(error_deg=0.0, nodes_deg=NODES_DEG, **options):
    """A calibration that leaves one error everywhere; nothing is uncertain of its own."""
    errors = (error_deg,) * len(nodes_deg)
    figures = {
        "bias_deg": 0.0,
        "scale": 1.0,
        "covariance": None,
        "freedom": 50,
        "expanded_uncertainty_deg": 0.5,
        "error_expanded_uncertainty_deg": 0.5,
        "coverage_factor": 1.65,
        "coverage": 0.95,
        "elevation_deg": nodes_deg,
        "lowest_error_deg": errors,
        "highest_error_deg": errors,
        "mean_error_deg": 0.0,
    }
    return RangeErrors(**{**figures, **options})


def probability(limit, one, reference, *, level_known=True, rms_deg=0.0):
    asked = Limit(name="", **limit)
    return probability_of_conformity(asked, one, reference, rms_deg=rms_deg, level_known=level_known)


NORMAL = Reference(0.1, "common", "normal")
FIXED = Reference(1e-9, "common")


@pytest.mark.parametrize(("error_deg", "allowed_deg"), [(0.1, 0.3), (0.0, 0.2), (0.25, 0.2)])
def test_at_one_elevation_it_is_the_tails_of_a_normal(error_deg, allowed_deg):
    expected = norm.cdf((allowed_deg - error_deg) / 0.1) - norm.cdf((-allowed_deg - error_deg) / 0.1)
    one = found(error_deg, nodes_deg=(20.0,))
    assert probability({"max_error_deg": allowed_deg}, one, NORMAL) == pytest.approx(expected, abs=5e-4)


def test_errors_of_a_line_by_steps_run_the_risk_of_its_covariance():
    """Of the steps of a line alone; a third that undoes them at every elevation leaves none."""
    nodes = tuple(np.arange(-60.0, 61.0, 10.0))
    covariance = ((0.02, 1e-4), (1e-4, 2e-6))
    root = np.linalg.cholesky(np.array(covariance)).T
    of_elevation = -(root @ np.stack([np.ones(len(nodes)), nodes]))
    steps = tuple(map(tuple, np.column_stack([root, of_elevation]).tolist()))
    line = found(0.1, nodes_deg=nodes, covariance=covariance)
    by_steps = found(0.1, nodes_deg=nodes, covariance=covariance, error_steps=steps)
    limits = {"max_error_deg": 0.4, "bias_deg": (-0.3, 0.3), "scale": (0.998, 1.003)}
    expected = probability(limits, line, FIXED)
    assert 0.5 < expected < 0.9
    assert probability(limits, by_steps, FIXED) == pytest.approx(expected, abs=0.01)
    hidden = tuple((*step[:2], *(0.0,) * len(nodes)) for step in steps)
    free = found(0.1, nodes_deg=nodes, covariance=covariance, error_steps=hidden)
    assert probability({"max_error_deg": 0.11}, free, FIXED) == 1.0


def test_a_common_error_is_the_same_over_the_whole_range():
    """Thirteen elevations run no more risk than one, for they err together."""
    asked = {"max_error_deg": 0.3}
    at_one = probability(asked, found(0.1, nodes_deg=(20.0,)), NORMAL)
    assert probability(asked, found(0.1), NORMAL) == at_one


def test_a_bias_is_within_its_limits_by_the_tails_of_its_own_uncertainty():
    one = found(bias_deg=0.1, scale=1.0)
    expected = norm.cdf(2.0) - norm.cdf(-1.0)
    assert probability({"bias_deg": (0.0, 0.3)}, one, NORMAL) == pytest.approx(expected, abs=5e-4)
    assert probability({"bias_deg": (0.0, 0.3)}, one, NORMAL, level_known=False) == 1.0


def test_a_scale_of_few_poses_has_students_tails():
    one = found(scale=1.002, covariance=((1e-6, 0.0), (0.0, 1e-6)), freedom=3)
    expected = t.cdf(1.0, 3) - t.cdf(-5.0, 3)
    assert probability({"scale": (0.997, 1.003)}, one, FIXED) == pytest.approx(expected, abs=2e-3)


def test_an_rms_has_the_tails_of_chi_squared():
    expected = chi2.sf(50 * (0.02 / 0.025) ** 2, 50)
    assert probability({"rms_deg": 0.025}, found(), FIXED, rms_deg=0.02) == pytest.approx(expected)


def test_the_mean_that_is_taken_off_is_over_the_range_however_the_elevations_are_spread():
    """Of a wrong scale over 0° to 60°: the mean is that at 30°, and the ends err by 30° of scale."""
    std = 0.002
    one = found(nodes_deg=(0.0, 5.0, 10.0, 60.0), covariance=((0.0, 0.0), (0.0, std**2)))
    expected = 2.0 * t.cdf(0.1 / (30.0 * std), 50) - 1.0
    said = probability({"max_error_deg": 0.1}, one, FIXED, level_known=False)
    assert said == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_an_error_of_the_stage_enters_the_bias_times_the_scale(scale):
    one = found(bias_deg=0.1, scale=scale)
    expected = norm.cdf(0.2 / (0.1 * scale)) - norm.cdf(-0.1 / (0.1 * scale))
    assert probability({"bias_deg": (0.0, 0.3)}, one, NORMAL) == pytest.approx(expected, abs=1e-3)


def test_without_the_level_a_common_error_is_no_error():
    asked = {"max_error_deg": 0.01}
    assert probability(asked, found(0.0), NORMAL, level_known=False) == 1.0
    assert probability(asked, found(0.0), NORMAL) < 0.1


@pytest.mark.parametrize("distribution", ["rectangular", "normal"])
@pytest.mark.parametrize("kind", ["common", "harmonic", "setting"])
def test_it_is_what_many_stages_and_units_alike_would_do(kind, distribution):
    """Drawn anew, by plain random numbers, of a line with correlated errors and a stage of each kind."""
    rng = np.random.default_rng(3)
    n, freedom, u_deg = 200_000, 24, 0.1
    theta_deg = np.array(NODES_DEG, dtype=float)
    covariance = np.array([[4e-4, 1e-5], [1e-5, 1e-6]])
    line = rng.multivariate_normal([0.0, 0.0], covariance, n)
    line *= np.sqrt(freedom / rng.chisquare(freedom, n))[:, None]
    error_deg = 0.05 - line[:, :1] - line[:, 1:] * theta_deg + _stage_deg(kind, distribution, u_deg, n, rng)
    expected = np.mean(np.abs(error_deg).max(axis=1) <= 0.2)

    one = found(0.05, covariance=tuple(map(tuple, covariance.tolist())), freedom=freedom)
    said = probability({"max_error_deg": 0.2}, one, Reference(u_deg, kind, distribution))
    assert said == pytest.approx(expected, abs=0.005)


def _stage_deg(kind, distribution, u_deg, n, rng):
    angle = np.radians(NODES_DEG)
    normal = distribution == "normal"
    if kind == "common":
        limit = math.sqrt(3.0)
        return u_deg * (rng.normal(size=(n, 1)) if normal else rng.uniform(-limit, limit, (n, 1)))
    if kind == "harmonic":
        points = rng.normal(size=(n, 3))
        if not normal:
            points *= math.sqrt(3.0) / np.linalg.norm(points, axis=1)[:, None]
        return u_deg * (points[:, :1] * np.sin(angle) + points[:, 1:2] * np.cos(angle))
    settings = u_deg * rng.normal(size=(n, 26))  # 24 degrees of freedom: as many poses as that
    design = np.column_stack([np.ones(26), np.linspace(-60.0, 60.0, 26)])
    return settings @ np.linalg.pinv(design).T @ np.array([np.ones(13), np.array(NODES_DEG)])


def test_the_same_result_has_the_same_risk():
    asked, one = {"max_error_deg": 0.2}, found(0.05)
    first = probability(asked, one, NORMAL)
    probability_of_conformity.cache_clear()
    assert probability(asked, one, NORMAL) == first
