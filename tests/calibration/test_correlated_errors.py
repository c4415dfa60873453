"""Standard errors allow for noise that is correlated from pose to pose."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.linalg import toeplitz
from scipy.stats import multivariate_normal

from calrig.calibration.correlated_errors import (
    EXPECTED_WIDENING,
    LARGEST_CORRELATION,
    LEAST_CORRELATION,
    PRIOR_POWER,
    covariance_over_correlations,
)
from calrig.calibration.line import fit_line
from tests.studies.correlated_poses import PLANS, covered, noise_of, widening


@pytest.mark.parametrize(("rho", "seed"), [(-0.3, 0), (0.0, 1), (0.5, 2), (0.9, 3)])
def test_the_covariance_equals_one_by_whole_matrices_and_a_fine_quadrature(rho, seed):
    """The restricted likelihood is the normal density of contrasts, integrated over σ with a prior of 1/σ."""
    n = 14
    design = np.column_stack([np.ones(n), np.linspace(-1.0, 1.0, n)])
    noise = noise_of(np.random.default_rng(seed), 1, n, rho, 0.0)[0]
    residual = noise - design @ np.linalg.lstsq(design, noise, rcond=None)[0]
    contrasts = np.linalg.svd(design)[0][:, 2:].T  # orthonormal, and blind to the line
    sigma = np.geomspace(0.05, 30.0, 200)
    correlations = np.linspace(LEAST_CORRELATION, LARGEST_CORRELATION, 400)
    weights, squares, variances = [], [], []
    for one in correlations:
        matrix = toeplitz(one ** np.arange(n))
        inverse = np.linalg.inv(matrix)
        of_line = np.linalg.inv(design.T @ inverse @ design)
        shift = of_line @ design.T @ inverse @ residual
        left = residual - design @ shift
        density = multivariate_normal(cov=contrasts @ matrix @ contrasts.T)
        at = density.logpdf(contrasts @ residual / sigma[:, None]) - (n - 2) * np.log(sigma)
        weights.append((1.0 - one) ** PRIOR_POWER * trapezoid(np.exp(at), np.log(sigma)))
        variances.append(left @ inverse @ left / (n - 2))
        squares.append(variances[-1] * of_line + np.outer(shift, shift))
    weights = np.array(weights) / trapezoid(weights, correlations)
    expected = trapezoid(weights[:, None, None] * np.array(squares), correlations, axis=0)

    covariance, variance = covariance_over_correlations(design, residual)

    np.testing.assert_allclose(covariance, expected, rtol=5e-3, atol=1e-3 * expected.max())
    assert variance == pytest.approx(trapezoid(weights * variances, correlations), rel=5e-3)


def test_many_runs_at_once_have_what_each_has_alone():
    design = np.column_stack([np.ones(26), PLANS[26] / 60.0])
    residual = np.random.default_rng(0).standard_normal((2, 3, 26))
    residual -= residual @ np.linalg.pinv(design).T @ design.T
    together = covariance_over_correlations(design, residual)
    for at in np.ndindex(2, 3):
        for one, alone in zip(together, covariance_over_correlations(design, residual[at]), strict=True):
            np.testing.assert_allclose(one[at], alone, rtol=1e-12)


def test_the_order_of_poses_tells_correlated_noise_from_white():
    """The same errors at the same angles: drawn out of their order, they state a bias 2 times as certain."""
    rng = np.random.default_rng(0)
    theta_deg = PLANS[52]
    noise_deg = noise_of(rng, 1, 52, 0.8, 0.0)[0]
    drawn = rng.permutation(52)
    in_order = fit_line(theta_deg, theta_deg + noise_deg)
    drawn_at_random = fit_line(theta_deg[drawn], theta_deg[drawn] + noise_deg[drawn])
    assert (in_order.bias_deg, in_order.scale) == pytest.approx(
        (drawn_at_random.bias_deg, drawn_at_random.scale)
    )
    assert in_order.bias_std_deg > 2.0 * drawn_at_random.bias_std_deg


@pytest.mark.parametrize("factor", [1e-6, 1e-3, 1.0])
def test_standard_errors_are_in_the_readings_unit(factor):
    noise_deg = np.random.default_rng(1).standard_normal(26)
    one = fit_line(PLANS[26], noise_deg)
    other = fit_line(factor * PLANS[26], np.zeros(26) + 1e-3 * noise_deg)
    assert other.scale_std * factor == pytest.approx(1e-3 * one.scale_std, rel=1e-4)


def test_exact_readings_have_no_error():
    line = fit_line(np.arange(5.0), np.arange(5.0))
    assert (line.bias_std_deg, line.scale_std, line.residual_std_deg) == (0.0, 0.0, 0.0)


@pytest.mark.statistical
def test_a_design_expects_what_white_noise_is_stated_as():
    for n_poses, *expected in EXPECTED_WIDENING[3:9:2]:
        assert widening(n_poses, 600) == pytest.approx(expected, rel=0.06)


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("n_poses", "noise"), [(n, noise) for n in (26, 52) for noise in ("white", "AR 0.3", "AR 0.6")]
)
def test_two_standard_errors_cover_what_they_should(n_poses, noise):
    """400 runs are known to 0.011; least squares covers 0.64 and 0.70 at a correlation of 0.6."""
    c = covered(n_poses, noise, 400)
    least = 0.92 if n_poses == 52 else 0.90
    for share in (c.bias, c.scale, c.elevation):
        assert least - 0.02 <= share <= 0.99
    if noise == "white":
        most = 1.05 if n_poses == 52 else 1.14
        assert max(c.bias_width, c.scale_width) <= most
    if noise == "AR 0.6":
        assert max(c.bias_before, c.scale_before) < 0.8, "what makes it worth the while"
