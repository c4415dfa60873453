"""Jitter per 100 ms: what it is of noise, and what it is deaf to."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from calrig.estimation.filter_comparison import jitter

TIME_S = np.arange(20_000) * 0.005
WHOLE = [slice(0, 20_000)]


def noise(sigma_deg=0.3, n=20_000, seed=0):
    return np.random.default_rng(seed).normal(0.0, sigma_deg, n)


def test_jitter_of_white_noise_is_its_standard_deviation():
    found = jitter(TIME_S, 60.0 + noise(), WHOLE)

    assert found.n_bins == 1000
    in_variances = found.std_deg**2 / 0.3**2 * 19_000
    assert chi2.ppf(1e-4, 19_000) < in_variances < chi2.ppf(1.0 - 1e-4, 19_000)
    assert found.step_deg == pytest.approx(0.3 * math.sqrt(2.0 / 20.0), rel=0.1)


def test_each_bin_is_measured_about_its_own_mean_on_an_uneven_clock():
    rng = np.random.default_rng(2)
    time_s = np.cumsum(rng.uniform(0.004, 0.006, 5000))
    angle_deg = noise(n=5000)
    stretches = [slice(10, 2000), slice(2500, 5000)]

    found = jitter(time_s, angle_deg, stretches)

    bins = []
    for stretch in stretches:
        time, angle = time_s[stretch] - time_s[stretch.start], angle_deg[stretch]
        count = int(time[-1] / 0.1)
        bins += [angle[(time >= 0.1 * k) & (time < 0.1 * (k + 1))] for k in range(count)]
    assert found.n_bins in (len(bins), len(bins) + 1, len(bins) + 2)  # a last bin may be nearly full
    assert found.std_deg == pytest.approx(math.sqrt(np.mean([b.var(ddof=1) for b in bins])), rel=0.01)
    assert found.peak_to_peak_deg == pytest.approx(
        math.sqrt(np.mean([np.ptp(b) ** 2 for b in bins])), rel=0.01
    )


def test_samples_on_the_border_of_a_bin_belong_to_the_next_whatever_their_decimals():
    found = jitter(np.round(1700.0 + TIME_S, 3), np.tile([0.0] * 20 + [1.0] * 20, 500), WHOLE)

    assert found.std_deg == 0.0
    assert found.step_deg == 1.0


def test_a_slow_wander_is_in_the_step_from_bin_to_bin():
    walk, white = (jitter(TIME_S, angle_deg, WHOLE) for angle_deg in (np.cumsum(noise()), noise()))

    assert walk.std_deg < 0.6 * walk.step_deg
    assert white.std_deg > 3.0 * white.step_deg


def test_samples_without_a_value_are_passed_over():
    angle_deg = noise()
    with_gaps = angle_deg.copy()
    with_gaps[:500] = np.nan

    assert jitter(TIME_S, with_gaps, WHOLE) == jitter(TIME_S, angle_deg, [slice(500, 20_000)])


@pytest.mark.parametrize(
    ("interval_s", "stretches"),
    [(0.05, WHOLE), (0.005, []), (0.005, [slice(0, 10)]), (0.005, [slice(0, 0), slice(3, 4)])],
)
def test_without_a_full_bin_there_is_no_jitter(interval_s, stretches):
    assert jitter(TIME_S / 0.005 * interval_s, noise(), stretches) is None


def test_a_signal_without_any_value_has_no_jitter():
    assert jitter(TIME_S, np.full(20_000, np.nan), WHOLE) is None
