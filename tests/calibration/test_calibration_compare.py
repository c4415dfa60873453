"""Units side by side: drift of one, spread between units against repeatability within."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from scipy.stats import linregress

from calrig.calibration.histories.between_runs import components, drift_deg_per_day

START = datetime(2024, 1, 1, tzinfo=UTC)


def test_drift_equals_an_independent_regression():
    rng = np.random.default_rng(0)
    days = np.sort(rng.uniform(0.0, 90.0, 12))
    bias_deg = 0.3 + 0.002 * days + rng.normal(0.0, 0.01, 12)

    found = drift_deg_per_day([START + timedelta(days=day) for day in days], bias_deg.tolist())

    assert found == pytest.approx(linregress(days, bias_deg).slope, rel=1e-6)


@pytest.mark.parametrize("finished_at", [[], [START], [START, START]])
def test_drift_needs_two_runs_at_two_times(finished_at):
    assert drift_deg_per_day(finished_at, [0.1] * len(finished_at)) is None


def test_components_recover_what_units_and_runs_were_drawn_with():
    """2000 units of one to nine runs: 0.4 between, 0.1 within."""
    rng = np.random.default_rng(1)
    runs = rng.integers(1, 10, 2000)
    unit = np.repeat(np.arange(2000), runs)
    value = 100.0 + np.repeat(rng.normal(0.0, 0.4, 2000), runs) + rng.normal(0.0, 0.1, len(unit))

    found = components(unit.tolist(), value.tolist())

    assert found.between == pytest.approx(0.4, rel=0.06)
    assert found.within == pytest.approx(0.1, rel=0.06)


def test_components_of_a_small_table_worked_by_hand():
    """Means 1 and 4, within (2+2)/2 = 2, MSB = 9, n₀ = 2: between² = (9 − 2)/2."""
    found = components([0, 0, 1, 1], [0.0, 2.0, 3.0, 5.0])
    assert (found.between, found.within) == (pytest.approx(3.5**0.5), pytest.approx(2.0**0.5))


@pytest.mark.parametrize(
    ("unit", "value", "between", "within"),
    [
        ([], [], None, None),
        ([0], [1.0], None, None),
        ([0, 1], [1.0, 2.0], None, None),
        ([7, 7], [1.0, 1.0], None, 0.0),
        ([0, 0, 1], [1.0, 1.0, None], None, 0.0),
        ([0, 0, 1, 1], [1.0, 2.0, 1.0, 2.0], 0.0, 0.5**0.5),
    ],
)
def test_what_the_runs_cannot_tell_is_none(unit, value, between, within):
    found = components(unit, value)
    assert found.between == between
    assert found.within == (None if within is None else pytest.approx(within))
