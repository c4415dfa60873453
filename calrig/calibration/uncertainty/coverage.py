"""The coverage factor: by how much a standard uncertainty is multiplied so that U covers 95 %.

k = 2 is for a normal distribution, and no more than about 95 % there. A stage known by a limit, ±a, has a
rectangular one: k = 0.95·√3 = 1.65, U = 0.95·a, where 2u = 1.15·a would exceed what cannot be exceeded
(JCGM 100:2008, G.1.3 and 4.3.7). Few poses make it Student's t.
"""

from __future__ import annotations

import math
from functools import lru_cache

from calrig.model.result import Distribution

COVERAGE = 0.95
"""The probability that is covered (section 6's `coverage`)."""


_AS_GOOD_AS_NORMAL = 1e5
"""Degrees of freedom from which Student's t is taken for normal."""
_HALVINGS = 48
"""Of an interval, down to the last digits of a float."""


@lru_cache(maxsize=4096)
def coverage_factor(
    type_a: float, freedom: float, type_b: float, distribution: Distribution, coverage: float = COVERAGE
) -> float:
    """The k with P(|A + B| ≤ k·√(a² + b²)) = coverage, for two independent errors A and B.

    A/a is Student's t of `freedom`: a is an estimate, and everything in it comes from the same scatter. B is
    stated, and known without degrees of freedom. A rectangular B, of half-width R = √3·b, is
    convolved with A: with H an antiderivative of t's distribution function,

        P(|A + B| ≤ U) = (a/R)·(H((U + R)/a) − H((U − R)/a)) − 1

    A normal B adds to the degrees of freedom by Welch and Satterthwaite, which is for independent
    contributions like these (JCGM 100:2008, G.4.2).

    Args:
        type_a: standard uncertainty a ≥ 0 of type A.
        freedom: its degrees of freedom, at least 1.
        type_b: standard uncertainty b ≥ 0 of type B, in the same unit.
        distribution: of B.
        coverage: the probability, below 1.
    """
    combined = math.hypot(type_a, type_b)
    if type_b == 0.0 or distribution == "normal":
        ratio = (type_a / combined) ** 4 if combined else 1.0
        return _quantile(freedom / ratio if ratio else math.inf, coverage)
    half_width = math.sqrt(3.0) * type_b
    if type_a <= 1e-9 * type_b:
        return coverage * half_width / combined
    low, high = 0.0, half_width + type_a * _quantile(freedom, coverage)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _within(middle / type_a, half_width / type_a, freedom) < coverage:
            low = middle
        else:
            high = middle
    return high / combined


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
