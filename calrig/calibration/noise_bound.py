"""How much more than it should noise alone leaves: the one bound for runs, revisions and diagnoses."""

from __future__ import annotations

import math

CONFIDENCE = 0.99
"""Noise alone is accused of leaving more than noise in one run of a hundred, as by the diagnosis' gate."""


def upper_limit(freedom: float) -> float:
    """What a residual over its noise stays under with probability `CONFIDENCE`, by its degrees of freedom.

    With the noise known, Σr²/s² is χ² with ν degrees of freedom (Draper & Smith, Applied Regression Analysis,
    1998, section 2.1), so that √(χ²(0.99; ν)/ν) bounds the ratio: 1.34 of 24, 1.08 of 498.
    """
    from scipy.special import chdtri

    return math.sqrt(float(chdtri(freedom, 1.0 - CONFIDENCE)) / freedom)
