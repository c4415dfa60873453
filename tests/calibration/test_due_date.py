"""Due dates: the forecast of a drift against its limits, by search and by simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calrig.calibration.histories.charts import COVERAGE, forecast

YEAR = 365.0


def searched(day, value, variance, limits, until):
    """The first day on a fine grid on which a weighted line's 95 % bound leaves the limits."""
    design = np.column_stack([np.ones_like(day), day])
    information = design.T @ (design / variance[:, None])
    line = np.linalg.solve(information, design.T @ (value / variance))
    birge = max(float((value - design @ line) ** 2 @ (1 / variance)) / (len(day) - 2), 1.0)
    t = np.linspace(day.max(), until, 400_001)
    at = np.column_stack([np.ones_like(t), t])
    std = np.sqrt(np.einsum("ij,jk,ik->i", at, np.linalg.inv(information) * birge, at))
    middle = at @ line
    out = np.flatnonzero((middle - COVERAGE * std <= limits[0]) | (middle + COVERAGE * std >= limits[1]))
    return float(t[out[0]]) if len(out) else math.inf


@pytest.mark.parametrize("seed", range(20))
def test_the_due_day_is_where_the_forecast_leaves_the_limits(seed):
    rng = np.random.default_rng(seed)
    day = np.sort(rng.uniform(0, 1500, rng.integers(3, 9)))
    variance = rng.choice([0.01, 0.03], len(day)) ** 2
    value = 0.8 + rng.normal(0, 2e-4) * day + np.sqrt(variance) * rng.normal(size=len(day))
    limits = (0.8 - 0.5, 0.8 + 0.5)
    found = forecast(day, value, variance, limits, YEAR)
    longest = day.max() + max(2 * YEAR, np.ptp(day))
    if found.due_day is not None:
        assert found.due_day == pytest.approx(
            min(searched(day, value, variance, limits, longest), longest), abs=0.02
        )


def test_until_it_is_due_a_unit_is_in_tolerance_with_95_percent():
    """400 units that drift by 0.15° a year: at their due day at most one in twenty is beyond 0.4°."""
    rng = np.random.default_rng(2)
    day, std = np.array([0.0, 200.0, 400.0, 600.0]), np.full(4, 0.02)
    beyond = []
    for _ in range(400):
        value = 0.15 / YEAR * day + std * rng.normal(size=4)
        due = forecast(day, value, std**2, (-0.4, 0.4), YEAR).due_day
        beyond.append(0.15 / YEAR * due > 0.4)
    assert 0.02 < np.mean(beyond) < 0.08


def test_three_runs_of_one_week_do_not_tell_about_a_year():
    found = forecast(
        np.array([0.0, 3.0, 6.0]), np.array([0.8, 0.81, 0.8]), np.full(3, 4e-4), (0.3, 1.3), YEAR
    )
    assert found.due_day is None


def test_a_drift_beyond_doubt_counts_however_short_the_history():
    day = np.array([0.0, 5.0, 10.0])
    found = forecast(day, 0.03 * day, np.full(3, 1e-4), (-0.5, 0.5), YEAR)
    assert 14.0 < found.due_day < 17.0


def test_a_steady_unit_may_wait_for_twice_the_interval_and_no_longer():
    day = np.array([0.0, 300.0, 600.0, 700.0])
    found = forecast(day, np.full(4, 0.8), np.full(4, 1e-6), (0.3, 1.3), YEAR)
    assert found.due_day == pytest.approx(700.0 + 2 * YEAR)


def test_a_unit_beyond_its_limit_is_due_at_once():
    day = np.array([0.0, 100.0, 200.0])
    assert forecast(day, np.array([0.1, 0.3, 0.5]), np.full(3, 1e-6), (-0.4, 0.4), YEAR).due_day == 200.0


def test_two_runs_say_nothing():
    assert forecast(np.array([0.0, 9.0, 9.0]), np.zeros(3), np.ones(3), (-1.0, 1.0), YEAR) is None
