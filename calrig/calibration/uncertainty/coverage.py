"""The coverage factor: by how much a standard uncertainty is multiplied so that U covers 95 %.

k = 2 is for a normal distribution, and no more than about 95 % there. A stage known by a limit, ±a, has a
rectangular one: k = 0.95·√3 = 1.65, U = 0.95·a, where 2u = 1.15·a would exceed what cannot be exceeded
(JCGM 100:2008, G.1.3 and 4.3.7). Few poses make it Student's t.
"""

import math
from functools import lru_cache

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.model.result import Distribution

COVERAGE = 0.95
"""The probability that is covered (section 6's `coverage`)."""


_AS_GOOD_AS_NORMAL = 1e5
"""Degrees of freedom from which Student's t is taken for normal."""
_HALVINGS = 48
"""Of an interval, down to the last digits of a float."""
_NODES = 64
"""Of the integral over χ²: what k covers is right to 0.003 % from one degree of freedom on."""


@lru_cache(maxsize=4096)
def coverage_factor(
    type_a: float, freedom: float, type_b: float, distribution: Distribution, coverage: float = COVERAGE
) -> float:
    """The k with P(|A + B| ≤ k·√(a² + b²)) = coverage, for two independent errors A and B.

    A/a is Student's t of `freedom`: a is an estimate, and everything in it comes from the same scatter. B is
    stated, and known without degrees of freedom. Their distributions are convolved (JCGM 101:2008). A
    rectangular B has the half-width R = √3·b; with H an antiderivative of t's distribution function,

        P(|A + B| ≤ U) = (a/R)·(H((U + R)/a) − H((U − R)/a)) − 1

    A normal B: given the χ² in t, A + B is normal, and w = χ²/ν is averaged over, E over w of

        P(|A + B| ≤ U) = E[2Φ(U/√(a²/w + b²)) − 1]

    Student's t for the effective degrees of freedom of Welch and Satterthwaite (JCGM 100:2008, G.4.2) covers
    87 to 95 % instead where a rests on one or two.

    Args:
        type_a: standard uncertainty a ≥ 0 of type A.
        freedom: its degrees of freedom, at least 1.
        type_b: standard uncertainty b ≥ 0 of type B, in the same unit.
        distribution: of B.
        coverage: the probability, below 1.
    """
    combined = math.hypot(type_a, type_b)
    is_normal = distribution == "normal"
    if type_b == 0.0 or (is_normal and freedom >= _AS_GOOD_AS_NORMAL):
        return _quantile(freedom, coverage)
    half_width = math.sqrt(3.0) * type_b
    if type_a <= 1e-9 * type_b:
        return _quantile(math.inf, coverage) if is_normal else coverage * half_width / combined
    beside = _quantile(math.inf, coverage) * type_b if is_normal else half_width
    low, high = 0.0, beside + type_a * _quantile(freedom, coverage)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        share = (
            _within_normal(middle / type_a, type_b / type_a, freedom)
            if is_normal
            else _within(middle / type_a, half_width / type_a, freedom)
        )
        low, high = (middle, high) if share < coverage else (low, middle)
    return high / combined


def _within_normal(bound: float, std: float, freedom: float) -> float:
    """P(|T + X| ≤ bound) for Student's t and X normal with standard deviation `std`."""
    from scipy.special import ndtr

    variance_ratio, weight = _variance_ratios(freedom)
    return float(weight @ (2.0 * ndtr(bound / np.sqrt(1.0 / variance_ratio + std * std)) - 1.0))


@lru_cache(maxsize=256)
def _variance_ratios(freedom: float) -> tuple[FloatArray, FloatArray]:
    """Return nodes χ²/ν and weights of Gauss and Legendre's rule in the distribution function of χ²."""
    from scipy.special import chdtri

    node, weight = np.polynomial.legendre.leggauss(_NODES)
    return np.maximum(chdtri(freedom, 0.5 * (1.0 - node)) / freedom, np.finfo(np.float64).tiny), 0.5 * weight


def _within(bound: float, half_width: float, freedom: float) -> float:
    """P(|T + X| ≤ bound) for Student's t and X rectangular on ± half_width."""
    above = _antiderivative(bound + half_width, freedom) - _antiderivative(bound - half_width, freedom)
    return above / half_width - 1.0


def _antiderivative(z: float, freedom: float) -> float:
    """Of the distribution function F of Student's t: z·F + f·(ν + z²)/(ν − 1), f the density."""
    from scipy.special import ndtr, stdtr

    if freedom >= _AS_GOOD_AS_NORMAL:
        return float(z * ndtr(z) + math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi))
    of_t = float(z * stdtr(freedom, z))
    if freedom == 1.0:
        return of_t - math.log1p(z * z) / (2.0 * math.pi)
    log_density = (
        math.lgamma(0.5 * (freedom + 1.0))
        - math.lgamma(0.5 * freedom)
        - 0.5 * math.log(freedom * math.pi)
        - 0.5 * (freedom + 1.0) * math.log1p(z * z / freedom)
    )
    return of_t + math.exp(log_density) * (freedom + z * z) / (freedom - 1.0)


def _quantile(freedom: float, coverage: float) -> float:
    """What Student's t stays within, on both sides, with the probability."""
    from scipy.special import ndtri, stdtrit

    upper = 0.5 * (1.0 + coverage)
    return float(ndtri(upper) if freedom >= _AS_GOOD_AS_NORMAL else stdtrit(freedom, upper))
