"""What calrig/docs/validation/paper.md rests on, in short."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.noise.analysis import analyse

from . import moving, stage
from .sensor import GYRO_STD_DPS, RATE_HZ, benches, log_of


def test_a_sensor_of_the_papers_standard_deviations_has_the_papers_slopes():
    time_s = np.arange(6000) / RATE_HZ
    log = log_of(benches(RATE_HZ, seed=1), time_s)
    gyro = analyse({"gyro_x_dps": log["gyro_x_dps"]}, time_s).channels["gyro_x_dps"]
    assert gyro.distribution.std == pytest.approx(GYRO_STD_DPS[0], rel=0.05)
    assert gyro.allan.adf_slope == pytest.approx(-0.5, abs=0.05)
    assert gyro.psd_slope is not None
    assert gyro.psd_slope.slope == pytest.approx(0.0, abs=0.1)


def test_a_loop_of_ten_hertz_gives_the_papers_jitter_before_and_after_fusion():
    raw_deg, fused_deg = moving.slow_reading()
    assert raw_deg == pytest.approx(moving.PAPER_RAW_DEG, rel=0.15)
    assert fused_deg / raw_deg == pytest.approx(moving.PAPER_FUSED_DEG / moving.PAPER_RAW_DEG, rel=0.15)


def test_readings_as_they_come_are_the_stages_before_a_line_takes_most_of_it():
    (run,) = stage.runs(1)
    assert run.calibrated_deg < 0.5 * run.raw_deg
