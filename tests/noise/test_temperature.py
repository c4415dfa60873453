"""How a channel depends on temperature, and how well that is known."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import calrig
from calrig.noise.even import even
from calrig.noise.temperature import temperature_of

DATA = Path(os.environ.get("CALRIG_DATA", Path(calrig.__file__).parents[2] / "shared" / "data"))
N, RATE_HZ, PER_C = 36_000, 100.0, 0.7
WHOLE, START_S = (slice(0, N),), (0.0,)
SHARE = np.arange(N) / N
WARM_UP_C = 10.0 + 19.0 * (1.0 - np.exp(-3.0 * SHARE))
CYCLES_C = 25.0 + 3.0 * np.sin(40.0 * SHARE)


def white(r: np.random.Generator) -> np.ndarray:
    return r.normal(size=N)


def correlated(r: np.random.Generator) -> np.ndarray:
    return lfilter([1.0], [1.0, -0.999], r.normal(size=N))


def random_walk(r: np.random.Generator) -> np.ndarray:
    return np.cumsum(r.normal(size=N))


def walk_in_white(r: np.random.Generator) -> np.ndarray:
    return 0.003 * random_walk(r) + white(r)


@pytest.mark.parametrize("temperature_c", [WARM_UP_C, CYCLES_C], ids=["warm-up", "cycles"])
@pytest.mark.parametrize("noise", [white, correlated, random_walk, walk_in_white])
def test_the_slope_lies_within_twice_its_error(
    noise: Callable[[np.random.Generator], np.ndarray], temperature_c: np.ndarray
) -> None:
    scores = []
    for seed in range(25):
        x = PER_C * temperature_c + noise(np.random.default_rng(seed))
        found = temperature_of(x, temperature_c, RATE_HZ, WHOLE, START_S)
        assert found is not None
        scores.append((found.per_c - PER_C) / found.std)
    assert np.mean(np.abs(scores) < 2.0) >= 0.84


def test_drift_makes_the_error_larger_than_independent_samples_would() -> None:
    r = np.random.default_rng(1)
    steady, drifting = (
        temperature_of(PER_C * WARM_UP_C + noise, WARM_UP_C, RATE_HZ, WHOLE, START_S)
        for noise in (white(r), white(r) + 0.02 * random_walk(r))
    )
    assert steady is not None
    assert drifting is not None
    assert steady.std < 0.005
    assert drifting.std > 20.0 * steady.std


@pytest.mark.parametrize(
    "temperature_c",
    [
        None,
        np.full(N, 25.0),
        25.0 + 0.4 * SHARE,
        25.0 + 40.0 * np.random.default_rng(2).normal(size=N),
    ],
    ids=["no thermometer", "constant", "0.4 °C", "a thermometer of noise"],
)
def test_no_slope_where_the_temperature_tells_nothing(temperature_c: np.ndarray | None) -> None:
    assert temperature_of(white(np.random.default_rng(3)), temperature_c, RATE_HZ, WHOLE, START_S) is None


def test_no_slope_from_a_handful_of_samples() -> None:
    x = np.arange(40.0)
    assert temperature_of(x, x, RATE_HZ, (slice(0, 40),), START_S) is None


def test_a_channel_that_follows_temperature_alone_has_the_slope_without_an_error() -> None:
    found = temperature_of(PER_C * WARM_UP_C, WARM_UP_C, RATE_HZ, WHOLE, START_S)
    assert found is not None
    assert found.per_c == pytest.approx(PER_C)
    assert found.std < 1e-9


@pytest.mark.parametrize(("axis", "lsb_per_c"), [("x", 4.6), ("y", -1.5), ("z", -28.2)])
def test_the_warm_up_log_has_the_slopes_known_of_it(axis: str, lsb_per_c: float) -> None:
    """378 gaps; published slopes of this board, to the digits given."""
    file = DATA / "mpu6050_warmup_log.csv"
    if not file.exists():
        pytest.skip(f"{file} is not here: set CALRIG_DATA to the folder of measured data")
    table = np.genfromtxt(file, delimiter=",", names=True)
    names = (f"accel_{axis}_lsb", "temperature_c")
    log = even({name: np.ascontiguousarray(table[name]) for name in names}, table["time_s"], None)
    x, temperature_c = (log.channels[name] for name in names)
    found = temperature_of(x, temperature_c, log.rate_hz, log.segments, log.start_s)
    assert found is not None
    assert found.per_c == pytest.approx(lsb_per_c, abs=0.06)
    assert abs(found.per_c) > 5.0 * found.std
