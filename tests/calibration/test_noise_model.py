"""The noise model beside the normal density of its own autoregressions, run by run."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from posed import posed
from scipy.linalg import block_diag
from scipy.signal import lfilter
from scipy.stats import multivariate_normal

from calrig.calibration.regression.noise_model import PRIOR_RHO_STD, NoiseModel, distance_of, fit, noise_of
from calrig.calibration.regression.responses import Responses, responses_of

RHO = 0.6
LENGTHS = (30, 50, 20)


def runs_of_correlated_noise(lengths: tuple[int, ...] = LENGTHS, seed: int = 0) -> Responses:
    """Readings with noise that each run begins anew: a first-order autoregression of 0.03°."""
    rng = np.random.default_rng(seed)
    runs = []
    for length in lengths:
        innovations = rng.normal(0.0, math.sqrt(1.0 - RHO**2), length)
        innovations[0] = rng.normal()
        noise_deg = 0.03 * lfilter([1.0], [1.0, -RHO], innovations)
        targets_deg = rng.uniform(-60.0, 60.0, length)
        readings_deg = 0.8 + targets_deg + noise_deg
        runs.append(posed(target_deg=targets_deg, reading_deg=readings_deg, time_s=4.0 * np.arange(length)))
    return responses_of(runs)


def test_the_criterion_is_the_density_of_autoregressions_that_begin_anew_with_each_run() -> None:
    r = runs_of_correlated_noise()
    fitted = fit(r, r.base)
    (rho,) = fitted.noise.rho
    residuals = fitted.residuals[:, 0]
    correlation = block_diag(*(rho ** np.abs(np.subtract.outer(range(n), range(n))) for n in LENGTHS))
    n = len(residuals)
    variance = residuals @ np.linalg.solve(correlation, residuals) / n  # where the density is largest
    log_density = multivariate_normal(cov=variance * correlation).logpdf(residuals)
    expected = -2.0 * log_density - n * (1.0 + math.log(2.0 * math.pi)) + (rho / PRIOR_RHO_STD) ** 2
    assert fitted.criterion == pytest.approx(expected, rel=1e-9)


def test_the_coefficients_are_those_of_generalised_least_squares() -> None:
    r = runs_of_correlated_noise()
    columns, y = r.base[:, 0, :], r.values[:, 0]
    fitted = fit(r, r.base)
    (rho,) = fitted.noise.rho
    correlation = block_diag(*(rho ** np.abs(np.subtract.outer(range(n), range(n))) for n in LENGTHS))
    whitened = np.linalg.solve(correlation, columns)
    beta = np.linalg.solve(columns.T @ whitened, whitened.T @ y)
    assert fitted.beta == pytest.approx(beta, abs=1e-4)  # it goes on until they hardly change


def test_the_correlation_found_is_that_within_the_runs() -> None:
    """Three hundred short runs: across their ends there is none, and a third of all steps goes across."""
    r = runs_of_correlated_noise((3,) * 300, seed=1)
    (rho,) = noise_of(r.values - r.values.mean(axis=0), r, 1.0).rho
    assert rho == pytest.approx(RHO, abs=0.1)


def test_a_correlation_for_a_bootstrap_is_unbiased_in_short_runs() -> None:
    """The mean of 40 poses, taken off, lowers the correlation by about (1 + 3ρ)/n (Kendall, 1954)."""
    r = runs_of_correlated_noise((40,))
    innovations = np.random.default_rng(2).standard_normal((1000, 240))
    series = lfilter([1.0], [1.0, -RHO], innovations)[:, 200:]
    series = series - series.mean(axis=1, keepdims=True)
    found = [noise_of(one[:, None], r, 1.0).rho[0] for one in series]
    assert np.mean(found) == pytest.approx(RHO, abs=0.02)


def test_a_distance_from_nothing_is_the_same_in_any_units():
    beta, covariance = np.array([1.0, 3.0]), np.array([[0.25, 0.1], [0.1, 0.5]])
    small = np.diag([1.0, 1e-12])
    assert distance_of(small @ beta, small @ covariance @ small) == pytest.approx(
        distance_of(beta, covariance)
    )
    assert distance_of(beta, covariance) == pytest.approx(beta @ np.linalg.solve(covariance, beta))


@pytest.mark.parametrize("starts_at", [[0], [0, 30, 31, 80], range(100)])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_products_of_innovations_need_no_whitened_columns(starts_at: Sequence[int], share: float) -> None:
    rng = np.random.default_rng(5)
    noise = NoiseModel(np.eye(2), np.array([0.9, -0.4]))
    starts = np.isin(np.arange(100), list(starts_at))
    columns, values = rng.normal(size=(2, 7, 3, 100)), rng.normal(size=(2, 4, 100))
    white_columns = noise.innovations(columns, starts, share)
    white_values = noise.innovations(values, starts, share)
    unwhitened = noise.unwhitened(white_values, starts, share)
    products = np.einsum("jckn,jbn->jckb", white_columns, white_values)
    assert np.einsum("jckn,jbn->jckb", columns, unwhitened) == pytest.approx(products, abs=1e-10)
    (gram,) = noise.gram_of_innovations(columns, starts, [share])
    assert gram == pytest.approx(np.einsum("jckn,jcmn->jckm", white_columns, white_columns), abs=1e-10)
