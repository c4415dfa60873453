"""Dependence on temperature, and its error where the noise wanders by itself."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from calrig.export.static_csv import read_static
from calrig.noise.even import even
from calrig.noise.temperature import temperature_of

DATA = Path(os.environ.get("CALRIG_DATA", Path(__file__).parents[3] / "shared" / "data"))
N = 60_000
WHOLE = 100.0, [slice(0, N)], [0.0]


def warm_up(span_c: float = 10.0) -> np.ndarray:
    return 20.0 + span_c * (1.0 - np.exp(-np.linspace(0.0, 3.0, N)))


def test_the_slope_lies_within_its_error_in_white_noise():
    off = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        warmth = warm_up()
        told = temperature_of(0.3 * warmth + rng.standard_normal(N), warmth + rng.normal(0, 0.05, N), *WHOLE)
        off.append((told.per_c - 0.3) / told.std)
    assert 0.7 < np.std(off) < 1.4


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
    told = even(log.channels, log.time_s, None)
    for name, per_c in {"accel_z_lsb": -28.2, "accel_x_lsb": 4.6, "accel_y_lsb": -1.5}.items():
        slope = temperature_of(
            told.channels[name], told.channels["temperature_c"], told.rate_hz, told.segments, told.start_s
        )
        assert slope.per_c == pytest.approx(per_c, abs=0.06)
        assert abs(slope.per_c - per_c) < 3 * slope.std
