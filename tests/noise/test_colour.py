"""The noise in one word."""

from __future__ import annotations

import numpy as np
import pytest
from test_coefficients import RATE_HZ, TIME_S, flicker, quantisation, ramp, random_walk, white

from calrig.noise.allan import allan_curve
from calrig.noise.analysis import colour_of
from calrig.noise.coefficients import coefficients
from calrig.noise.resampling import uniform_log
from calrig.noise.spectral_lines import Line
from calrig.noise.spectrum import psd_of, psd_slope


def word(values, lines=()):
    log = uniform_log({"x": values}, None, RATE_HZ)
    curve = allan_curve(log, "x")
    found = coefficients(curve, "g", [(line.frequency_hz, line.amplitude) for line in lines])
    slope = psd_slope(psd_of(values, RATE_HZ, log.segments))
    return colour_of(curve, found, slope.slope if slope else None, lines)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("make", "colour"),
    [(white, "white"), (flicker, "pink"), (random_walk, "brown"), (quantisation, "quantisation-limited")],
)
def test_pure_noise_has_the_name_of_its_kind(make, colour, seed):
    assert word(make(np.random.default_rng(seed), 1.0)) == colour


def test_a_weak_floor_leaves_white_noise_white():
    rng = np.random.default_rng(1)
    assert word(white(rng, 1.0) + random_walk(rng, 0.05)) == "white"


def test_noise_that_is_half_of_one_kind_and_half_of_another_is_mixed():
    rng = np.random.default_rng(2)
    assert word(white(rng, 1.0) + random_walk(rng, 1.5)) == "mixed"


def test_noise_behind_a_strong_filter_is_not_white():
    drawn = white(np.random.default_rng(3), 1.0)
    assert word(np.convolve(drawn, np.ones(10) / 10, "same")) == "mixed"


@pytest.mark.parametrize(("make", "colour"), [(white, "lines"), (random_walk, "mixed")])
def test_a_log_with_a_tone_is_not_white(make, colour):
    tone = Line(frequency_hz=0.53, amplitude=1.0, p_value=1e-6)
    values = make(np.random.default_rng(4), 1.0) + np.sin(2.0 * np.pi * 0.53 * TIME_S)
    assert word(values, [tone]) == colour


def test_a_ramp_is_no_colour():
    rng = np.random.default_rng(5)
    assert word(white(rng, 1.0) + ramp(rng, 0.01)) == "white"


def test_a_channel_that_does_not_move_has_none():
    assert word(np.full(1000, 9.81)) is None
