"""Filters on a log of a simulated stage that moves and stands; the tuned one knows what the log shows."""

from __future__ import annotations

import json

import numpy as np
import pytest

from calrig.estimation.kalman import KalmanNoise
from calrig.estimation.start import gain_schedule
from calrig.figures.filters import KALMAN, SMOOTHERS, at_rest, filters_figures, on_a_move
from calrig.noise.filters import filters_document, study_filters
from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings

RATE_HZ = 200.0
WHITE_ELEVATION_DEG, WHITE_GYRO_DPS = np.degrees(400e-6) / np.sqrt(2.0), 0.005 / np.sqrt(2.0)
"""The simulated chip's one-sided densities over √2, as an Allan deviation gives them."""


@pytest.fixture(scope="module")
def log():
    """Half a minute: 10 s of rest, then six moves of 10° with 2 s of rest after each."""
    bench = Bench(SimulatorSettings.from_options({"seed": 3}))
    begin_s = bench.mechanics.home(0.0, 20.0, 80.0).at_s
    now_s = begin_s + 10.0
    for target_deg in (10, 20, 30, 20, 10, 0):
        now_s = bench.mechanics.move(now_s, target_deg, 20.0, 80.0).at_s + 2.0
    time_s = begin_s + np.arange(int((now_s - begin_s) * RATE_HZ)) / RATE_HZ
    counts = bench.counts(time_s, RATE_HZ).astype(float)
    channels = {
        "accel_y_lsb": counts[:, 1],
        "accel_z_lsb": counts[:, 2],
        "gyro_x_dps": counts[:, 4] * 250.0 / 32768.0,
    }
    return channels, time_s


@pytest.fixture(scope="module")
def study(log):
    return study_filters(*log)


def test_the_tuned_filter_has_the_chips_own_noise_and_beats_the_papers_constants(study):
    assert study.tuned.q_angle == pytest.approx(WHITE_GYRO_DPS**2, rel=0.2)
    assert study.tuned.r_deg2 == pytest.approx(WHITE_ELEVATION_DEG**2 * RATE_HZ, rel=0.2)
    assert study.check.verdict == "consistent"
    rows = {row["name"]: row for row in filters_document(study)["filters"]}
    assert rows["kalman_tuned"]["jitter_deg"] < rows["kalman_paper"]["jitter_deg"] < rows["raw"]["jitter_deg"]
    assert abs(rows["kalman_tuned"]["lag_ms"]) < 1.0 < rows["moving_average"]["lag_ms"]


def test_the_document_gives_flight_code_its_start_and_its_steady_gain(study):
    document = filters_document(study)
    json.dumps(document, allow_nan=False)
    tuned = document["tuned"]
    noise = KalmanNoise(tuned["q_angle"], tuned["q_bias"], tuned["r_deg2"])
    start = tuned["start_gain"]
    k_angle, k_bias = gain_schedule(noise, 1.0 / RATE_HZ, start["sample"][-1])
    at = np.array(start["sample"]) - 1
    assert start["sample"][0] == 1
    assert start["angle"] == k_angle[at].tolist()
    assert start["bias_per_s"] == k_bias[at].tolist()
    assert start["angle"][-1] == pytest.approx(tuned["steady_gain"]["angle"], rel=0.05)


def test_a_clock_that_wraps_makes_no_difference(log, study):
    channels, time_s = log
    microseconds = np.rint((time_s - time_s[0]) * 1e6 + 2.0**32 - 15e6) % 2**32
    rows = filters_document(study_filters(channels, microseconds * 1e-6))["filters"]
    for wrapped, steady in zip(rows, filters_document(study)["filters"], strict=True):
        assert wrapped["jitter_deg"] == pytest.approx(steady["jitter_deg"], rel=1e-6)
        assert wrapped["lag_ms"] == pytest.approx(steady["lag_ms"], abs=1e-3)


def test_without_a_gyro_the_smoothers_are_compared_and_the_reason_said(log):
    channels, time_s = log
    without = {name: values for name, values in channels.items() if name != "gyro_x_dps"}
    document = filters_document(study_filters(without, time_s))
    rows = {row["name"]: row for row in document["filters"]}
    assert rows["kalman_paper"]["jitter_deg"] is None
    assert rows["moving_average"]["lag_ms"] > 10.0
    assert document["tuned"] is None
    assert any("--gyro-range" in sentence for sentence in document["summary"])


def test_a_log_without_elevation_says_what_it_needs():
    with pytest.raises(ValueError, match="accel_y and accel_z of one unit"):
        study_filters({"accel_y_g": np.zeros(10), "accel_z_lsb": np.ones(10)}, rate_hz=100.0)


def test_figures_show_each_filter_over_the_accelerometer_and_where_the_sensor_was(study):
    comparison = study.comparison
    smoothers, kalman = on_a_move(comparison, SMOOTHERS), on_a_move(comparison, KALMAN)
    assert [len(figure["data"]) for figure in (smoothers, kalman)] == [7, 4]
    true, tuned = kalman["data"][-1], kalman["data"][2]
    np.testing.assert_allclose(tuned["y"], np.interp(tuned["x"], true["x"], true["y"]), atol=0.1)
    assert all(abs(np.mean(trace["y"])) < 1e-9 for trace in at_rest(comparison)["data"])
    json.dumps(filters_figures(study), allow_nan=False)
