"""Many tests at once: which of them count, so that few of those that do are chance."""

from __future__ import annotations

import numpy as np

from calrig.estimation.angles import FloatArray


def rejection_level(p_value: FloatArray, rate: float) -> float:
    """The p-value up to which hypotheses are rejected, so that the false discovery rate is at most `rate`.

    Of m ordered p-values the largest p₍ₖ₎ ≤ rate·k/m, and rate·k/m is given (Benjamini & Hochberg, Journal of
    the Royal Statistical Society B 57, 1995, procedure (1)); it holds for independent tests and for those
    that depend positively.

    Args:
        p_value: (m,) of as many tests.
        rate: expected share of true hypotheses among those rejected.

    Returns:
        0 where none is rejected.
    """
    m = len(p_value)
    steps = rate * np.arange(1, m + 1) / max(m, 1)
    passing = np.flatnonzero(np.sort(p_value) <= steps)
    return float(steps[passing[-1]]) if len(passing) else 0.0
