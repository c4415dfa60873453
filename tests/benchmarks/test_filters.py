"""Filter cost per sample beside filterpy's on the same data, in processor time: ratios stand in `extra_info`.

`pytest tests/benchmarks/test_filters.py --benchmark-json=FILE`. What else the machine does costs both alike,
but for its caches, which whole arrays need.
"""

from __future__ import annotations

import time

import filterpy.kalman
import numpy as np
import pytest

from calrig.estimation.gains import filter_uniform
from calrig.estimation.kalman import KalmanFilter
from calrig.estimation.reading import reading_stderr_deg

pytestmark = pytest.mark.benchmark(timer=time.process_time)

RNG = np.random.default_rng(0)
N = 1_000_000
ELEVATION_DEG = RNG.normal(0.0, 0.3, N)
RATE_DPS = RNG.normal(1.0, 0.1, N)
STEP_S = RNG.uniform(0.004, 0.006, N)
SHORT = 20_000


@pytest.fixture(scope="module")
def filterpy_us():
    """Best of three: microseconds a sample of filterpy, predict and update with each sample's own dt."""

    def once():
        peer = filterpy.kalman.KalmanFilter(dim_x=2, dim_z=1, dim_u=1)
        peer.P = np.diag([0.03, 1.0])
        peer.H = np.array([[1.0, 0.0]])
        peer.R = np.array([[0.03]])
        samples = list(zip(ELEVATION_DEG[:SHORT], RATE_DPS[:SHORT], STEP_S[:SHORT], strict=True))
        matrices = [
            (np.array([[dt], [0.0]]), np.array([[1.0, -dt], [0.0, 1.0]]), np.diag([0.001, 0.003]) * dt)
            for _, _, dt in samples
        ]
        before_s = time.process_time()
        for (elevation_deg, rate_dps, _), (b, f, q) in zip(samples, matrices, strict=True):
            peer.predict(u=rate_dps, B=b, F=f, Q=q)
            peer.update(elevation_deg)
        return (time.process_time() - before_s) / SHORT * 1e6

    return min(once() for _ in range(3))


def compare(benchmark, filterpy_us, n, at_least):
    us = benchmark.stats["min"] / n * 1e6
    benchmark.extra_info |= {
        "us_per_sample": round(us, 4),
        "filterpy_us_per_sample": round(filterpy_us, 2),
        "times_filterpy": round(filterpy_us / us, 1),
    }
    assert filterpy_us / us >= at_least


def test_streaming(benchmark, filterpy_us):
    samples = list(
        zip(ELEVATION_DEG[:SHORT].tolist(), RATE_DPS[:SHORT].tolist(), STEP_S[:SHORT].tolist(), strict=True)
    )

    def stream():
        update = KalmanFilter().update
        for elevation_deg, rate_dps, dt_s in samples:
            update(elevation_deg, rate_dps, dt_s)

    benchmark(stream)
    compare(benchmark, filterpy_us, SHORT, at_least=30)


def test_blocks_of_uneven_time(benchmark, filterpy_us):
    time_s = np.cumsum(STEP_S[:SHORT])
    benchmark(lambda: KalmanFilter().run(time_s, ELEVATION_DEG[:SHORT], RATE_DPS[:SHORT]))
    compare(benchmark, filterpy_us, SHORT, at_least=30)


def test_whole_array_of_uniform_time(benchmark, filterpy_us):
    benchmark(lambda: filter_uniform(ELEVATION_DEG, RATE_DPS, 0.005))
    compare(benchmark, filterpy_us, N, at_least=1000)


def test_whole_array_through_many_turns(benchmark, filterpy_us):
    elevation_deg = (ELEVATION_DEG + 90.0 * 0.005 * np.arange(N) + 180.0) % 360.0 - 180.0
    benchmark(lambda: filter_uniform(elevation_deg, RATE_DPS + 90.0, 0.005))
    compare(benchmark, filterpy_us, N, at_least=1000)


def test_standard_error_during_a_dwell(benchmark):
    """400 samples, evaluated several times a second while a dwell lasts."""
    arguments = (np.cumsum(STEP_S[:400]), ELEVATION_DEG[:400], RATE_DPS[:400], ELEVATION_DEG[:400])
    benchmark(reading_stderr_deg, *arguments)
    assert benchmark.stats["min"] < 0.005
