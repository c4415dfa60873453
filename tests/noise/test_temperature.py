"""Dependence on temperature, and its error where the noise wanders by itself."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.signal import lfilter
from scipy.stats import multivariate_normal
from support import DATA

from calrig.export.static_csv import read_static
from calrig.noise.resampling import uniform_log
from calrig.noise.temperature import temperature_of

N = 60_000
WHOLE = 100.0, [slice(0, N)], [0.0]


def warm_up(span_c: float = 10.0) -> np.ndarray:
    return 20.0 + span_c * (1.0 - np.exp(-np.linspace(0.0, 3.0, N)))


@pytest.mark.statistical
def test_the_slope_lies_within_its_error_in_white_noise():
    off = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        warmth = warm_up()
        told = temperature_of(0.3 * warmth + rng.standard_normal(N), warmth + rng.normal(0, 0.05, N), *WHOLE)
        off.append((told.per_c - 0.3) / told.std)
    assert 0.7 < np.std(off) < 1.4


@pytest.mark.statistical
def test_noise_that_wanders_by_itself_is_not_taken_for_warmth():
    false = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        told = temperature_of(np.cumsum(rng.standard_normal(N)) / 200, warm_up(), *WHOLE)
        false += abs(told.per_c) > 5 * told.std
    assert false <= 6


def test_a_temperature_that_hardly_changes_tells_nothing():
    rng = np.random.default_rng(1)
    assert temperature_of(rng.standard_normal(N), warm_up(0.5), *WHOLE) is None


def test_the_warm_up_of_a_real_chip():
    file = DATA / "mpu6050_warmup_log.csv"
    if not file.is_file():
        pytest.skip(f"no measured data at {file}")
    log = read_static(file.read_bytes())
    told = uniform_log(log.channels, log.time_s, None)
    for name, per_c in {"accel_z_lsb": -28.2, "accel_x_lsb": 4.6, "accel_y_lsb": -1.5}.items():
        slope = temperature_of(
            told.channels[name], told.channels["temperature_c"], told.rate_hz, told.segments, told.start_s
        )
        assert slope.per_c == pytest.approx(per_c, abs=0.06)
        assert abs(slope.per_c - per_c) < 3 * slope.std


def off_in_errors(kind, seed):
    """How many of its stated errors the slope found under cycles of temperature is off."""
    warmth = 25.0 + 3.0 * np.sin(np.linspace(0.0, 40.0, N))
    rng = np.random.default_rng(seed)
    white, walk = rng.standard_normal(N), np.cumsum(rng.standard_normal(N))
    noise = {
        "white": white,
        "correlated": lfilter([1.0], [1.0, -0.999], white),
        "a random walk": walk,
        "both": white + 0.003 * walk,
    }[kind]
    told = temperature_of(0.7 * warmth + noise, warmth, *WHOLE)
    return (told.per_c - 0.7) / told.std


KINDS = ["white", "correlated", "a random walk", "both"]


@pytest.mark.parametrize("kind", KINDS)
def test_under_cycles_of_temperature_the_slope_lies_within_its_error(kind):
    assert abs(off_in_errors(kind, 0)) < 3


@pytest.mark.statistical
@pytest.mark.parametrize("kind", KINDS)
def test_the_slope_lies_within_twice_its_error_as_often_as_that_means(kind):
    assert sum(abs(off_in_errors(kind, seed)) < 2 for seed in range(40)) >= 34


def test_the_error_is_that_of_the_noise_however_steep_the_slope():
    """What the temperature explains is no noise: a channel that follows it as well has the same error."""
    rng = np.random.default_rng(3)
    noise, warmth = np.cumsum(rng.standard_normal(N)) / 200 + rng.standard_normal(N), warm_up()
    alone, sloping = (temperature_of(noise + slope * warmth, warmth, *WHOLE) for slope in (0.0, 30.0))
    assert sloping.std == pytest.approx(alone.std, rel=1e-6)
    assert sloping.per_c - alone.per_c == pytest.approx(30.0)


def test_the_error_is_that_of_the_likelihood_of_error_contrasts():
    """What no slope and no offset changes tells the noise (Patterson & Thompson, Biometrika 58, 1971)."""
    rng, n = np.random.default_rng(6), 64 * 900
    noise = lfilter([1.0], [1.0, -0.9999], rng.standard_normal(n)) + rng.normal(0.0, 20.0, n)
    celsius = 25.0 + 3.0 * np.sin(np.linspace(0.0, 12.0, n))
    mean, warmth = (x.reshape(64, 900).mean(axis=1) for x in (noise, celsius))
    fitted = np.stack([np.ones(64), warmth], axis=1)
    contrasts, weights = null_space(fitted.T), np.linalg.pinv(fitted)[1]
    apart = np.abs(np.subtract.outer(np.arange(64), np.arange(64)))
    likelihood, variance = [], []
    for share, time in product(10.0 ** np.arange(-6, 5), 2.0 ** np.arange(0.0, 11.0, 1.5)):
        covariance = np.eye(64) + share * time * np.exp(-apart / time)
        of_contrasts, seen = contrasts.T @ covariance @ contrasts, contrasts.T @ mean
        scale = seen @ np.linalg.solve(of_contrasts, seen) / 62
        likelihood.append(multivariate_normal(cov=scale * of_contrasts).logpdf(seen))
        variance.append(scale * weights @ covariance @ weights)
    expected = np.average(variance, weights=np.exp(np.array(likelihood) - max(likelihood)))
    told = temperature_of(noise, celsius, 100.0, [slice(0, n)], [0.0])
    assert told.std == pytest.approx(np.sqrt(expected), rel=1e-9)


def test_a_log_told_in_pieces_has_the_error_of_the_whole_and_a_gap_counts_as_time():
    """Noise that wanders correlates by when it was measured, not by the sample's number."""
    rng = np.random.default_rng(4)
    wandering, warmth = np.cumsum(rng.standard_normal(N)) / 200, 25.0 + 3.0 * np.sin(np.linspace(0, 40, N))
    halves, half_s = [slice(0, N // 2), slice(N // 2, N)], N / 2 / 100.0
    whole = temperature_of(wandering, warmth, *WHOLE)
    in_two = temperature_of(wandering, warmth, 100.0, halves, [0.0, half_s])
    hours_later = temperature_of(wandering, warmth, 100.0, halves, [0.0, half_s + 36_000.0])
    assert in_two.std == pytest.approx(whole.std, rel=1e-9)
    assert hours_later.std != pytest.approx(whole.std, rel=0.05)


def test_the_noise_of_a_thermometer_is_no_temperature():
    rng = np.random.default_rng(2)
    assert temperature_of(rng.standard_normal(N), 25.0 + 40.0 * rng.standard_normal(N), *WHOLE) is None


def test_without_a_thermometer_or_with_a_handful_of_samples_there_is_no_slope():
    assert temperature_of(np.arange(float(N)), None, *WHOLE) is None
    few = np.arange(40.0)
    assert temperature_of(few, few, 100.0, [slice(0, 40)], [0.0]) is None
