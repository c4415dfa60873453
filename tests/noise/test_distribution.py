"""The distribution of samples: its shape is judged with correlation and rounding allowed for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from calrig.noise.distribution import distribution_of

N = 20_000
SEEDS = 60


def gaussian(rng, n=N, rho=0.0):
    white = rng.standard_normal(n + 2000)
    return lfilter([np.sqrt(1 - rho**2)], [1, -rho], white)[2000:]


def rounded(rng, step):
    return step * np.round(rng.standard_normal(N) / step + rng.uniform())


NULLS = {
    "white": gaussian,
    "correlated 0.9": lambda rng: gaussian(rng, rho=0.9),
    "correlated 0.99": lambda rng: gaussian(rng, rho=0.99),
    "rounded to half a sigma": lambda rng: rounded(rng, 0.5),
    "rounded to a sigma": lambda rng: rounded(rng, 1.0),
    "rounded to two sigma": lambda rng: rounded(rng, 1.9),
}


found = distribution_of


@pytest.mark.parametrize("kind", NULLS)
def test_gaussian_noise_is_not_refused(kind):
    assert found(NULLS[kind](np.random.default_rng(1))).gaussian is not False


@pytest.mark.statistical
@pytest.mark.parametrize("kind", NULLS)
def test_gaussian_noise_is_refused_in_about_one_log_in_a_hundred(kind):
    refused = sum(found(NULLS[kind](np.random.default_rng(seed))).gaussian is False for seed in range(SEEDS))
    assert stats.binomtest(refused, SEEDS, 0.02, alternative="greater").pvalue > 1e-4


@pytest.mark.parametrize("draw", ["t5", "uniform", "two heaps"])
def test_what_is_not_gaussian_is_said_not_to_be(draw):
    rng = np.random.default_rng(4)
    x = {
        "t5": rng.standard_t(5, N),
        "uniform": rng.uniform(-1, 1, N),
        "two heaps": rng.choice([-1.5, 1.5], N) + rng.standard_normal(N),
    }[draw]
    assert found(x).gaussian is False


@pytest.mark.parametrize("seed", range(4))
def test_of_independent_samples_the_p_value_is_scipys(seed):
    x = np.random.default_rng(seed).standard_t(8, 200)
    assert np.log(found(x).p_value) == pytest.approx(np.log(stats.normaltest(x).pvalue), rel=0.01)


def test_steps_larger_than_the_noise_leave_it_open():
    told = found(rounded(np.random.default_rng(5), 5.0))
    assert (told.gaussian, told.p_value, told.step) == (None, None, pytest.approx(5.0))


def test_few_independent_samples_leave_it_open():
    assert found(np.cumsum(np.random.default_rng(6).standard_normal(5000))).gaussian is None


def test_moments_and_outliers():
    rng = np.random.default_rng(7)
    x = rng.gamma(4.0, size=N)
    told = found(x)
    assert told.skewness == pytest.approx(stats.skew(x))
    assert told.kurtosis == pytest.approx(stats.kurtosis(x))
    x = rng.standard_normal(N)
    assert found(x).outliers == 0
    x[[100, 200]] = 20.0, -20.0
    assert found(x).outliers == 2


def test_the_histogram_holds_every_sample_and_its_bins_whole_steps():
    x = rounded(np.random.default_rng(8), 0.25)
    told = found(x)
    assert told.counts.sum() == len(x)
    widths = np.diff(told.edges)[:-1] / 0.25
    assert widths == pytest.approx(np.rint(widths))
    assert (np.abs((told.edges[0] - x.min()) / 0.25) % 1) == pytest.approx(0.5)


def test_samples_that_never_change_have_no_shape():
    told = found(np.full(1000, 3.0))
    assert (told.std, told.gaussian, told.skewness, told.outliers) == (0.0, None, 0.0, 0)
