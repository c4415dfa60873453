"""Control charts: NIST's worked example, known run lengths, and rates over short histories."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest, norm
from scipy.stats import t as student_t

from calrig.calibration.histories.charts import (
    RIG_CHART,
    Ewma,
    checks,
    control_chart,
    moving_average,
    normal_score,
    q_statistics,
)
from tests.studies.charts.rates import (
    EARLIER,
    LATER,
    STDS,
    detected,
    false_alarms,
    individuals,
    pooled_from,
    unit_chart,
)

NIST = [52.0, 47.0, 53.0, 49.3, 50.1, 47.0, 51.0, 50.1, 51.2, 50.5,
        49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1]  # fmt: skip
NIST_EWMA = [50.60, 49.52, 50.56, 50.18, 50.16, 49.21, 49.75, 49.85, 50.26, 50.33,
             50.11, 49.36, 49.52, 50.05, 49.38, 49.92, 50.73, 51.23, 51.94, 51.99]  # fmt: skip
"""NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.4: target 50, s = 2.0539, weight 0.3, factor 3."""


def test_the_average_and_its_limits_are_those_of_nists_example():
    z = moving_average((np.array(NIST) - 50.0) / 2.0539, 0.3)
    np.testing.assert_allclose(50.0 + 2.0539 * z, NIST_EWMA, atol=0.0051)
    limit = Ewma(0.3, 3.0, opens_narrow=False).limits(20)
    assert 50.0 + 2.0539 * limit[-1] == pytest.approx(52.5884, abs=1e-4)
    assert not (np.abs(z) > limit).any()


def run_length(ewma: Ewma, shift: float, states: int = 301) -> float:
    """Average run length by a Markov chain over the average's values (Brook & Evans, Biometrika 59, 1972)."""
    h = float(ewma.limits(10_000)[-1])
    width = 2 * h / states
    middle = -h + width * (np.arange(states) + 0.5)
    edges = np.append(middle - width / 2, h)
    steps = (edges[None, :] - (1 - ewma.weight) * middle[:, None]) / ewma.weight - shift
    transitions = np.diff(norm.cdf(steps), axis=1)
    return float(np.linalg.solve(np.eye(states) - transitions, np.ones(states))[states // 2])


def simulated(ewma: Ewma, shift: float, n: int, seed: int = 3) -> float:
    """Mean number of runs until a signal, of a chart whose mean and spread are known."""
    z = moving_average(np.random.default_rng(seed).normal(shift, 1.0, (1000, n)), ewma.weight)
    out = np.abs(z) > ewma.limits(n)
    assert out.any(axis=1).all()
    return float(out.argmax(axis=1).mean()) + 1


LENGTHS = ((0.0, 4000), (1.0, 600), (2.0, 150))


@pytest.mark.parametrize("ewma", [Ewma(1.0, 3.0, opens_narrow=False), Ewma(0.2, 2.86, opens_narrow=False)])
def test_run_lengths_are_those_of_a_markov_chain(ewma):
    for shift, n in LENGTHS:
        assert simulated(ewma, shift, n) == pytest.approx(run_length(ewma, shift), rel=0.1)


@pytest.mark.parametrize(
    ("ewma", "lengths"),
    [(Ewma(1.0, 3.0, opens_narrow=False), (370.4, 43.9, 6.30)), (RIG_CHART, (370.0, 9.0, 2.9))],
)
def test_known_limits_have_the_run_lengths_of_the_tables(ewma, lengths):
    """Montgomery, Introduction to Statistical Quality Control, 2013, 6.2.3; Steiner, Journal of Quality
    Technology 31, 1999, for limits that follow the average's own deviation."""
    for (shift, n), expected in zip(LENGTHS, lengths, strict=True):
        assert simulated(ewma, shift, n) == pytest.approx(expected, rel=0.1)


def test_with_equal_variances_q_is_quesenberrys():
    x = np.random.default_rng(0).normal(5.0, 0.3, 12)
    expected = [np.sqrt((n - 1) / n) * (x[n - 1] - x[: n - 1].mean()) / 0.3 for n in range(2, 13)]
    np.testing.assert_allclose(q_statistics(x, np.full(12, 0.09))[1:], expected)


def test_q_is_standard_normal_and_independent_whatever_the_uncertainties():
    rng = np.random.default_rng(1)
    std = rng.choice([0.1, 0.3], 9)
    q = q_statistics(7.0 + rng.normal(size=(20_000, 9)) * std, np.broadcast_to(std**2, (20_000, 9)))[:, 1:]
    assert kstest(q[:, 3], norm.cdf).pvalue > 0.01
    np.testing.assert_allclose(np.cov(q.T), np.eye(8), atol=0.04)


def test_no_chart_begins_before_the_second_run():
    for n in (0, 1):
        chart = control_chart(np.full(n, 9.0), np.ones(n), RIG_CHART)
        assert not chart.signals.any()


def test_a_rig_fails_from_a_jump_on_and_passes_once_it_is_put_right():
    value = np.array([0.0, 0.1, -0.1, 0.05, 0.0, 9.0, 9.1, 0.1, 0.0])
    found = checks(value, np.ones(9), judged_from=2)
    assert found.failed.tolist() == [False] * 5 + [True, True, False, False]
    assert found.known.tolist() == [False] + [True] * 8


def test_a_shift_that_lasts_does_not_become_the_mean_of_a_check():
    value = np.concatenate([np.zeros(10), np.full(40, 4.0)])
    found = checks(value, np.ones(50), judged_from=5)
    assert found.failed[12:].all()


def test_what_moved_before_a_unit_became_the_check_is_no_failure():
    value = np.concatenate([np.zeros(6), np.full(6, 20.0)])
    found = checks(value, np.ones(12), judged_from=8)
    assert not found.failed.any()


@pytest.mark.statistical
@pytest.mark.parametrize("earlier", EARLIER)
@pytest.mark.parametrize("stds", STDS)
def test_at_most_five_percent_of_units_raise_a_false_alarm(earlier, stds):
    assert false_alarms(unit_chart, earlier, STDS[stds](earlier + LATER), 4000) < 0.05 + 2 * 0.0035


@pytest.mark.statistical
@pytest.mark.parametrize(("earlier", "least"), [(3, 0.35), (5, 0.45), (10, 0.55)])
def test_a_shift_of_two_sigma_is_seen_within_four_runs(earlier, least):
    assert detected(unit_chart, earlier, 4000) > least


@pytest.mark.statistical
def test_a_spread_that_few_repeats_tell_makes_few_false_alarms_of_its_own():
    taken_for_known = false_alarms(pooled_from(6, scored=False), 5, np.ones(5 + LATER), 4000)
    assert taken_for_known > 0.15 > 0.075 > false_alarms(pooled_from(6), 5, np.ones(5 + LATER), 4000)


def test_the_score_of_a_value_is_as_likely_as_the_value():
    q = np.array([-40.0, -2.0, 0.0, 0.5, 3.0])
    np.testing.assert_allclose(norm.sf(normal_score(q, 7)), student_t.sf(q, 7), rtol=1e-9)
    assert np.isfinite(normal_score(np.array([1e9]), 500)).all()
    assert normal_score(3.0, None) == 3.0


@pytest.mark.statistical
def test_limits_from_five_runs_would_alarm_for_nothing():
    assert false_alarms(individuals, 5, np.ones(5 + LATER), 4000) > 0.2
