"""Figures of noise: what is drawn is what was found, in plotly's own terms."""

from __future__ import annotations

import json
import math

import numpy as np
import plotly.graph_objects as go
import pytest
from scipy.integrate import trapezoid

from calrig.figures.files import sheet_of
from calrig.figures.noise import allan_deviation, distribution, noise_figures, spectrum
from calrig.noise.analysis import analyse


@pytest.fixture(scope="module")
def noise():
    """White noise in three channels, the first with a tone at 12.5 Hz, and a gap."""
    rng = np.random.default_rng(2)
    time_s = np.arange(30_000) / 100.0
    time_s[20_000:] += 1.5
    channels = {name: rng.normal(0.0, 0.003, 30_000) for name in ("accel_x_g", "accel_y_g", "accel_z_g")}
    channels["accel_x_g"] += 0.001 * np.sin(2.0 * np.pi * 12.5 * time_s)
    channels["accel_z_g"] += 1.0
    return analyse(channels, time_s)


def test_plotly_itself_takes_every_property_and_no_number_is_nan(noise):
    sheet = sheet_of("log.csv", noise_figures(noise))
    go.Figure(sheet)  # raises on any property that plotly does not know
    json.dumps(sheet, allow_nan=False)


def test_the_deviation_lies_within_its_limits_and_on_the_fitted_sum(noise):
    one = noise.channels["elevation_deg"]
    band, line, fitted, *terms = allan_deviation([one])["data"]
    m = len(line["x"])
    high, low = np.array(band["y"][:m]), np.array(band["y"][m:])[::-1]
    assert (low < line["y"]).all()
    assert (line["y"] < high).all()
    np.testing.assert_allclose(fitted["y"][0], line["y"][0], rtol=0.05)
    np.testing.assert_allclose(np.square([term["y"] for term in terms]).sum(axis=0), np.square(fitted["y"]))


def test_a_tone_is_marked_where_it_stands(noise):
    marks = [
        trace for trace in spectrum([*noise.channels.values()][:3])["data"] if trace["mode"] == "markers"
    ]
    (tone,) = marks
    assert tone["x"] == pytest.approx([12.5], abs=0.01)
    assert tone["customdata"] == pytest.approx([0.001], rel=0.1)


def test_a_thinned_spectrum_keeps_its_power(noise):
    psd = noise.channels["accel_y_g"].psd
    line = spectrum([noise.channels["accel_y_g"]])["data"][0]
    assert len(line["x"]) < len(psd.frequency_hz)
    assert trapezoid(line["y"], line["x"]) == pytest.approx(
        trapezoid(psd.density, psd.frequency_hz), rel=0.02
    )


def test_the_gaussian_has_the_area_of_the_histogram(noise):
    bars, bell = distribution(noise.channels["accel_y_g"])["data"]
    assert sum(bars["y"]) == 30_000
    area = trapezoid(bell["y"], bell["x"])
    assert area == pytest.approx(float(np.dot(bars["y"], bars["width"])), rel=0.02)
    assert math.isclose(bell["x"][int(np.argmax(bell["y"]))], 0.0, abs_tol=0.001)
