"""The report of a log: CONTRACT section 7's document, and what its sentences say."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from calrig.noise.analysis import analyse, static_elevation_deg
from calrig.noise.report import noise_document
from calrig.noise.units import bias_instability, white_density, white_random_walk

RATE_HZ = 100.0
WHITE_G, WHITE_DPS = 3e-4, 4e-3
"""N of the synthetic sensor's accelerometer (g·√s) and gyro (°/√s)."""
CHANNEL = {
    *("mean", "std", "adf_slope", "psd_slope", "colour", "allan", "coefficients", "lines", "distribution"),
    "temperature",
}


def still_log(n=20_000, seed=1, down=False):
    """White noise of a known level on a sensor tilted by 30°, or lying upside down."""
    rng = np.random.default_rng(seed)
    y, z = (0.0, -1.0) if down else (math.sin(math.radians(30)), math.cos(math.radians(30)))
    means = {"accel_x_g": 0.0, "accel_y_g": y, "accel_z_g": z}
    means |= {"gyro_x_dps": 1.0, "gyro_y_dps": -2.0, "gyro_z_dps": 0.5}
    return {
        name: mean + rng.normal(0.0, (WHITE_G if name.endswith("_g") else WHITE_DPS) * math.sqrt(RATE_HZ), n)
        for name, mean in means.items()
    }


@pytest.fixture(scope="module")
def document():
    return noise_document(analyse(still_log(), np.arange(20_000) / RATE_HZ))


def test_the_document_has_every_key_of_the_contract_and_no_other(document):
    json.dumps(document, allow_nan=False)
    assert set(document) == {"rate_hz", "duration_s", "dropped", "channels", "summary"}
    assert (document["rate_hz"], document["duration_s"]) == pytest.approx((RATE_HZ, 200.0))
    assert document["dropped"] == {"gaps": 0, "not_finite": 0}
    assert list(document["channels"]) == [*still_log(10), "elevation_deg"]
    for channel in document["channels"].values():
        assert set(channel) == CHANNEL
        assert set(channel["allan"]) == {"tau_s", "deviation", "low", "high"}
        assert set(channel["coefficients"]) == {"quantisation", "white", "flicker", "random_walk", "ramp"}
        assert set(channel["distribution"]) == {"gaussian", "p_value", "skewness", "kurtosis", "outliers"}


def test_white_noise_is_called_white_with_its_level(document):
    for name, channel in document["channels"].items():
        assert channel["colour"] == "white"
        assert channel["adf_slope"] == pytest.approx(-0.5, abs=0.03)
        assert channel["psd_slope"] == pytest.approx(0.0, abs=0.1)
        white = channel["coefficients"]["white"]
        sigma = {"g": WHITE_G, "dps": WHITE_DPS, "deg": math.degrees(WHITE_G)}[name.rpartition("_")[2]]
        assert abs(white["value"] - sigma) < 4.0 * white["std"]
        assert channel["std"] == pytest.approx(sigma * math.sqrt(RATE_HZ), rel=0.03)
    assert document["channels"]["elevation_deg"]["mean"] == pytest.approx(30.0, abs=0.01)
    assert document["channels"]["accel_x_g"]["coefficients"]["white"]["unit"] == "g·√s"


def test_the_summary_gives_a_data_sheets_figures(document):
    text = "\n".join(document["summary"])
    assert "Accelerometer: the noise is white" in text
    assert "µg/√Hz" in text
    assert "°/√h" in text
    assert "°/s/√Hz" in text
    assert "spectral line" not in text


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (white_density("accel_x_g", 400e-6 / math.sqrt(2.0)), "400 µg/√Hz"),
        (white_density("gyro_x_dps", 0.005 / math.sqrt(2.0)), "0.005 °/s/√Hz"),
        (white_random_walk("gyro_x_dps", 0.005), "0.3 °/√h"),
        (white_random_walk("accel_x_g", 1e-3), "0.588 m/s/√h"),
        (bias_instability("gyro_z_dps", 0.01), "36 °/h"),
        (bias_instability("accel_z_g", 50e-6), "50 µg"),
        (white_density("accel_z_lsb", 5.0), "7.07 LSB/√Hz"),
    ],
)
def test_units_are_those_of_data_sheets(words, says):
    assert words == says


def test_upside_down_the_elevation_does_not_jump():
    log = still_log(2000, down=True)
    elevation_deg = static_elevation_deg(log["accel_y_g"], log["accel_z_g"])
    assert np.ptp(elevation_deg) < 2.0
    np.testing.assert_allclose(
        np.cos(np.radians(elevation_deg)), log["accel_z_g"] / np.hypot(log["accel_y_g"], log["accel_z_g"])
    )


@pytest.mark.parametrize("n", [2, 3, 10, 50])
def test_a_log_too_short_for_a_figure_has_null_there(n):
    document = noise_document(analyse(still_log(n), rate_hz=RATE_HZ))
    json.dumps(document, allow_nan=False)
    assert document["channels"]["gyro_x_dps"]["temperature"] is None


def test_a_dead_channel_is_reported_like_any_other():
    document = noise_document(analyse({"accel_x_lsb": np.full(5000, 17.0)}, rate_hz=RATE_HZ))
    json.dumps(document, allow_nan=False)
    channel = document["channels"]["accel_x_lsb"]
    assert (channel["mean"], channel["std"], channel["lines"]) == (17.0, 0.0, [])
    assert channel["coefficients"]["white"] is None


def test_it_says_how_far_it_is_and_what_was_left_out():
    log = still_log(2000)
    log["accel_x_g"][700] = np.nan
    shares = []
    document = noise_document(analyse(log, np.arange(2000) / RATE_HZ, progress=shares.append))
    assert shares == pytest.approx(np.arange(1, 8) / 7)
    assert document["dropped"]["not_finite"] == 1
    assert any("1 of 2000 samples" in sentence for sentence in document["summary"])


def test_a_log_of_a_sensor_that_was_turned_is_said_to_be_no_log_of_noise():
    turned = still_log(4000)
    for axis, now in (("y", 0.0), ("z", 1.0)):
        name = f"accel_{axis}_g"
        turned[name][2000:] += now - turned[name][2000:].mean()
    time_s = np.arange(4000) / RATE_HZ
    assert any("no sensor at rest" in said for said in noise_document(analyse(turned, time_s))["summary"])
    assert not any(
        "no sensor at rest" in said for said in noise_document(analyse(still_log(4000), time_s))["summary"]
    )


@pytest.mark.parametrize(
    ("knock", "left_out"),
    [
        (slice(9_000, 9_050), "samples 8951 to 9100"),
        (slice(9_000, 9_001), "samples 9000 to 9002"),
        (slice(19_900, 20_000), "samples 19801 to 20000"),
        (slice(0, 50), "samples 1 to 100"),
    ],
)
def test_a_knock_is_left_out_and_the_noise_is_that_of_the_rest(knock, left_out):
    channels = still_log()
    channels["gyro_x_dps"][knock] += 30.0
    found = noise_document(analyse(channels, np.arange(20_000) / RATE_HZ))
    for name, limit in (("gyro_x_dps", WHITE_DPS), ("accel_x_g", WHITE_G)):
        assert found["channels"][name]["coefficients"]["white"]["value"] == pytest.approx(limit, rel=0.03)
        assert found["channels"][name]["colour"] == "white"
    (said,) = (sentence for sentence in found["summary"] if "knock" in sentence)
    assert said.startswith("gyro_x_dps") and left_out in said


@pytest.mark.parametrize("kind", ["heavy tails", "recurring knocks", "a walk", "a warm-up", "a level"])
def test_what_may_be_the_sensors_own_noise_stays_in(kind):
    rng, n = np.random.default_rng(4), 20_000
    own = {
        "heavy tails": rng.standard_t(3, n),
        "recurring knocks": 600.0 * np.isin(np.arange(n) % 3000, range(50)),
        "a walk": np.cumsum(rng.standard_normal(n)),
        "a warm-up": 30.0 * np.exp(-np.arange(n) / 200.0),
        "a level": 30.0 * (np.arange(n) // 2000 == 4),
    }[kind]
    white = rng.standard_normal(n)
    found = noise_document(analyse({"gyro_x_dps": white + own}, None, RATE_HZ))
    assert found["channels"]["gyro_x_dps"]["mean"] == pytest.approx((white + own).mean(), rel=1e-9)
    assert found["summary"][0] == "200 s at 100 Hz."
    assert not any("left out" in sentence for sentence in found["summary"])
