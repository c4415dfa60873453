"""Compute the covariance of a least-squares fit whose noise may be correlated from pose to pose.

Ordinary least squares states its errors for white noise. At a lag-1 correlation of 0.6, two of its standard
errors cover 63 to 71 % instead of 95 %. With one estimate of the correlation, which is biased and uncertain,
they cover 88 % of 26 poses. The covariance is therefore integrated over the correlation ρ, with the
restricted likelihood as weight (Harville, JASA 72, 1977; Zellner & Tiao, JASA 59, 1964).
`python -m tests.studies.correlated_poses` counts what is covered.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from calrig.estimation.angles import FloatArray

LEAST_CORRELATION, LARGEST_CORRELATION = -0.6, 0.96
GRID_POINTS = 64
"""Of ρ, evenly spaced in artanh ρ, in which an estimate from n poses scatters by 1/√n throughout."""
PRIOR_POWER = 0.75
"""The prior of ρ falls as (1 − ρ)^0.75: at 1 it covers 0.89 of 26 poses with ρ = 0.6, at 0.5 white noise of
26 poses is stated 17 % too large."""


def covariance_over_correlations(design: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return covariance of the coefficients and variance of the noise, integrated over its correlation.

    The noise is a first-order autoregression of correlation ρ, with R its correlation matrix. Given ρ, the
    coefficients have the generalised least-squares estimate b(ρ) and the covariance σ²(ρ)·(XᵀR⁻¹X)⁻¹, with
    σ² = Q/(n − p) and Q the weighted squares that are left. The weight of ρ is its prior times

        |R|^(−1/2) · |XᵀR⁻¹X|^(−1/2) · Q^(−(n − p)/2)

    The stated covariance is the mean square error about the ordinary least-squares estimate b₀, which is the
    point estimate everywhere: the mean over ρ of σ²·(XᵀR⁻¹X)⁻¹ + (b(ρ) − b₀)(b(ρ) − b₀)ᵀ. An error over its
    standard error is then Student's t of n − p degrees of freedom in white noise. R⁻¹ is tridiagonal, so that
    all products are sums of squares and lagged products.

    Args:
        design: (n, p) columns X in the order measured, of full rank and similar magnitude, n > p.
        residual: (..., n) what ordinary least squares leaves of the readings.

    Returns:
        (..., p, p) covariance and (...) variance, both 0 where the residual is.
    """
    n, p = design.shape
    rho, log_prior = _grid()
    size = np.sqrt((residual**2).mean(axis=-1))
    unit = residual / np.where(size > 0.0, size, 1.0)[..., None]
    inverse, shift, squares, log_likelihood = _given_correlation(design, unit, rho)
    weight = _normalised(log_prior + log_likelihood)
    variance = squares / (n - p)
    given_rho = variance[..., None, None] * inverse + shift[..., :, None] * shift[..., None, :]
    scale = size * size
    covariance = scale[..., None, None] * (weight[..., None, None] * given_rho).sum(axis=-3)
    return covariance, scale * (weight * variance).sum(axis=-1)


def correlation_weights(
    runs: Sequence[tuple[FloatArray, FloatArray]],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return correlations ρ, their weights by several runs together, and (runs, ρ) weighted squares Q.

    Args:
        runs: of each a design as above and (n,) readings, less anything that the design spans or nothing; of
            each the scatter is its own, and the correlation common to all. No run: the prior's weights.
    """
    rho, log_weight = _grid()
    squares = np.zeros((len(runs), len(rho)))
    for k, (design, reading) in enumerate(runs):
        size = float(np.sqrt((reading**2).mean())) or 1.0
        _, _, of_run, log_likelihood = _given_correlation(design, reading / size, rho)
        log_weight = log_weight + log_likelihood
        squares[k] = size * size * of_run
    return rho, _normalised(log_weight), squares


def _given_correlation(
    design: FloatArray, unit: FloatArray, rho: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return (XᵀR⁻¹X)⁻¹, b(ρ), Q and the log of the restricted likelihood, each with an axis of ρ."""
    n, p = design.shape
    z = np.concatenate([np.broadcast_to(design, (*unit.shape, p)), unit[..., None]], axis=-1)
    zt = np.swapaxes(z, -1, -2)
    lagged = zt[..., :-1] @ z[..., 1:, :]
    ends = zt[..., [0, -1]] @ z[..., [0, -1], :]
    r = rho[:, None, None]
    products = (
        (1.0 + r * r) * (zt @ z)[..., None, :, :]
        - r * r * ends[..., None, :, :]
        - r * (lagged + np.swapaxes(lagged, -1, -2))[..., None, :, :]
    ) / (1.0 - r * r)
    information, beside = products[..., :p, :p], products[..., :p, p]
    inverse = np.linalg.inv(information)
    shift = (inverse @ beside[..., None])[..., 0]
    squares = np.maximum(products[..., p, p] - (beside * shift).sum(axis=-1), np.finfo(np.float64).tiny)
    log_likelihood = -0.5 * (
        (n - 1) * np.log1p(-rho * rho) + np.linalg.slogdet(information)[1] + (n - p) * np.log(squares)
    )
    return inverse, shift, squares, log_likelihood


def _normalised(log_weight: FloatArray) -> FloatArray:
    weight = np.exp(log_weight - log_weight.max(axis=-1, keepdims=True))
    return np.asarray(weight / weight.sum(axis=-1, keepdims=True), dtype=np.float64)


@lru_cache(maxsize=1)
def _grid() -> tuple[FloatArray, FloatArray]:
    """Return ρ at the points of the grid and the log of each one's prior weight, by the trapezoidal rule."""
    rho = np.tanh(np.linspace(np.arctanh(LEAST_CORRELATION), np.arctanh(LARGEST_CORRELATION), GRID_POINTS))
    log_prior = PRIOR_POWER * np.log1p(-rho) + np.log1p(-rho * rho)  # the latter is dρ/d(artanh ρ)
    log_prior[[0, -1]] -= np.log(2.0)
    return rho, log_prior


EXPECTED_WIDENING = (
    (4, 1.145, 1.428, 0.976),
    (6, 1.165, 1.556, 1.013),
    (8, 1.158, 1.553, 1.076),
    (10, 1.148, 1.525, 1.122),
    (13, 1.121, 1.421, 1.139),
    (17, 1.093, 1.304, 1.139),
    (22, 1.068, 1.190, 1.113),
    (28, 1.050, 1.114, 1.084),
    (36, 1.036, 1.066, 1.057),
    (52, 1.023, 1.035, 1.033),
    (80, 1.014, 1.020, 1.019),
    (120, 1.009, 1.010, 1.010),
    (200, 1.005, 1.007, 1.007),
)
"""Poses up and down a range; factors as of `expected_widening`, medians of 10,000 runs
(`python -m tests.studies.correlated_poses widening`)."""


def expected_widening(n_poses: int) -> tuple[float, float, float]:
    """Return by how much white noise of so many poses is stated larger than by ordinary least squares.

    Factors of the scatter and of the standard errors of bias and scale, for a plan's expected uncertainty.
    """
    counts, *factors = zip(*EXPECTED_WIDENING, strict=True)
    at = np.log(counts)
    scatter, bias, scale = (float(np.interp(np.log(n_poses), at, column)) for column in factors)
    return scatter, bias, scale
