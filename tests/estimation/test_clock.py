"""The rate of one clock by another, against ordinary least squares with a constant for each run."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.estimation.turning import clock_rate


def runs_of(rng, counts, rate_error=0.004, late_s=0.01):
    """Times of a clock and of its reference in runs of so many events."""
    reference = [np.sort(rng.uniform(0.0, 60.0, count)) + 1000.0 * k for k, count in enumerate(counts)]
    clock = [
        (1.0 + rate_error) * times + 7.0 * k + rng.normal(0.0, late_s, len(times))
        for k, times in enumerate(reference)
    ]
    return clock, reference


@pytest.mark.parametrize("counts", [(12,), (5, 4), (3, 3, 3, 3)])
def test_rate_and_standard_error_are_those_of_a_regression_with_a_constant_for_each_run(counts):
    clock, reference = runs_of(np.random.default_rng(4), counts)
    of_run = np.repeat(np.arange(len(counts)), counts)
    design = np.column_stack([np.concatenate(reference), np.eye(len(counts))[of_run]])
    measured = np.concatenate(clock)
    beta, power, rank, _ = np.linalg.lstsq(design, measured, rcond=None)
    variance = power[0] / (len(measured) - rank) * np.linalg.inv(design.T @ design)[0, 0]

    found = clock_rate(clock, reference)

    assert found.error == pytest.approx(beta[0] - 1.0, abs=1e-9)
    assert found.std == pytest.approx(np.sqrt(variance), rel=1e-6)


@pytest.mark.parametrize(
    ("counts", "rate_error"), [((4,), 0.004), ((12,), 0.2)], ids=["few events", "not one time"]
)
def test_what_tells_no_rate_is_not_known(counts, rate_error):
    assert clock_rate(*runs_of(np.random.default_rng(5), counts, rate_error)) is None
