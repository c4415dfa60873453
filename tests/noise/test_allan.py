"""Overlapping Allan deviation: against published values, allantools, its definition and measured logs."""

from __future__ import annotations

import math

import allantools
import numpy as np
import pytest
from scipy.stats import chi2
from support import DATA

from calrig.noise.allan import CONFIDENCE, KINDS, MIN_CLUSTERS, allan_curve, theory_of
from calrig.noise.resampling import UniformLog, uniform_log


def curve_of(values, rate_hz=1.0):
    return allan_curve(uniform_log({"x": np.asarray(values, dtype=float)}, None, rate_hz), "x")


def in_pieces(values, lengths, rate_hz=1.0):
    ends = np.cumsum(lengths)
    parts = tuple(slice(end - n, end) for end, n in zip(ends, lengths, strict=True))
    return UniformLog(rate_hz, len(values) / rate_hz, {"x": values}, parts, (0.0,) * len(parts), 0, 0, ())


def differences(values, m):
    means = np.convolve(values, np.ones(m) / m, "valid")
    return means[m:] - means[:-m]


@pytest.fixture(scope="module")
def published():
    """The 1000-point test set of NIST SP 1065 (Riley, 2008)."""
    x = [1234567890]
    while len(x) < 1000:
        x.append(16807 * x[-1] % 2147483647)
    return np.array(x) / 2147483647


@pytest.mark.parametrize(("tau_s", "deviation"), [(1, 2.922319e-01), (10, 9.159953e-02), (100, 3.241343e-02)])
def test_the_published_deviations(published, tau_s, deviation):
    curve = curve_of(published)
    at = np.flatnonzero(curve.tau_s == tau_s)
    assert curve.deviation[at] == pytest.approx(deviation, rel=1e-6)


def white(rng, count):
    return rng.standard_normal(count)


def flicker(rng, count):
    """Noise of density 1/f, made in the frequency domain."""
    spectrum = np.fft.rfft(rng.standard_normal(2 * count))
    spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))
    return np.fft.irfft(spectrum)[:count]


def walk(rng, count):
    return rng.standard_normal(count).cumsum()


@pytest.mark.parametrize("kind", [white, flicker, walk])
@pytest.mark.parametrize(("level", "count"), [(0.0, 5000), (16384.0, 100_003)])
def test_allantools_agrees(kind, level, count):
    values = level + kind(np.random.default_rng(1), count)
    curve = curve_of(values, rate_hz=200.0)
    _, deviation, _, _ = allantools.oadev(values, rate=200.0, data_type="freq", taus=curve.tau_s)
    np.testing.assert_allclose(curve.deviation, deviation, rtol=1e-9)


@pytest.mark.parametrize("kind", [white, flicker, walk])
def test_allantools_agrees_over_gaps_segment_by_segment(kind):
    values, lengths = kind(np.random.default_rng(2), 3000), [1700, 3, 800, 497]
    curve = allan_curve(in_pieces(values, lengths), "x")
    squares, counts = np.zeros(len(curve.factors)), np.zeros(len(curve.factors))
    for piece in np.split(values, np.cumsum(lengths)[:-1]):
        for at in np.flatnonzero(2 * curve.factors <= len(piece)):
            _, deviation, _, _ = allantools.oadev(piece, rate=1.0, data_type="freq", taus=[curve.factors[at]])
            count = len(piece) + 1 - 2 * curve.factors[at]
            squares[at] += deviation[0] ** 2 * count
            counts[at] += count
    np.testing.assert_allclose(curve.deviation, np.sqrt(squares / counts), rtol=1e-9)


def test_over_gaps_only_differences_within_a_segment_count():
    values, lengths = np.random.default_rng(3).standard_normal(900).cumsum(), [500, 40, 360]
    curve = allan_curve(in_pieces(values, lengths), "x")
    pieces = np.split(values, np.cumsum(lengths)[:-1])
    for m, deviation, step in zip(curve.factors, curve.deviation, curve.mean_step, strict=True):
        within = np.concatenate([differences(piece, m) for piece in pieces if len(piece) >= 2 * m])
        assert deviation == pytest.approx(math.sqrt(np.mean(within**2) / 2.0), rel=1e-9)
        assert step == pytest.approx(within.mean(), rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 40, 1000])
def test_a_tau_that_the_log_is_too_short_for_has_no_value(count):
    curve = curve_of(np.random.default_rng(4).standard_normal(count), rate_hz=10.0)
    assert (curve.n_clusters >= MIN_CLUSTERS).all()
    assert (curve.factors * MIN_CLUSTERS <= count).all()
    assert len(curve.tau_s) == len(curve.deviation) == len(curve.low) == len(curve.high)
    assert np.isfinite(curve.deviation).all()


def test_one_second_and_its_decades_are_among_the_taus():
    tau_s = curve_of(np.random.default_rng(5).standard_normal(60_000), rate_hz=133.0).tau_s
    assert {1.0, 10.0, 100.0} <= set(tau_s)


@pytest.mark.parametrize(
    ("make", "slope"),
    [(lambda w: w, -0.5), (np.cumsum, 0.5), (np.diff, -1.0), (lambda w: np.arange(float(len(w))), 1.0)],
    ids=["white", "random walk", "quantisation", "ramp"],
)
def test_slopes_are_those_of_the_kind(make, slope):
    curve = curve_of(make(np.random.default_rng(6).standard_normal(60_000)), rate_hz=100.0)
    assert curve.adf_slope == pytest.approx(slope, abs=0.04)


def test_a_constant_has_no_slope():
    curve = curve_of(np.full(500, 0.3), rate_hz=100.0)
    assert (curve.deviation == 0.0).all()
    assert curve.adf_slope is None


@pytest.mark.statistical
@pytest.mark.parametrize("kind", ["white", "random walk"])
def test_the_limits_hold_the_true_deviation_as_often_as_they_say(kind):
    """500 logs, at every octave from 8 samples to a sixteenth of the log, on average over the octaves."""
    hits = []
    for seed in range(500):
        step = np.random.default_rng(seed).standard_normal(2048)
        curve = curve_of(step if kind == "white" else np.cumsum(step))
        used = np.isin(curve.factors, 2 ** np.arange(3, 8))
        m = curve.factors[used]
        true = 1.0 / np.sqrt(m) if kind == "white" else np.sqrt((2 * m**2 + 1) / (6 * m))
        hits.append((curve.low[used] <= true) & (true <= curve.high[used]))
    assert np.mean(hits) == pytest.approx(CONFIDENCE, abs=0.04)


@pytest.mark.parametrize(
    ("kind", "alpha"), [(lambda rng, n: np.diff(white(rng, n)), 2), (white, 0), (flicker, -1), (walk, -2)]
)
def test_the_limits_are_those_of_allantools_degrees_of_freedom(kind, alpha):
    values = kind(np.random.default_rng(7), 60_000)
    curve = curve_of(values)
    for at in np.flatnonzero(np.isin(curve.factors, [8, 32, 64])):
        edf = allantools.edf_simple(len(values) + 1, int(curve.factors[at]), alpha)
        low, high = allantools.confidence_interval(curve.deviation[at], edf, ci=CONFIDENCE)
        assert (curve.low[at], curve.high[at]) == pytest.approx((low, high), rel=1e-9)


def exact_freedom_of_flicker(count):
    """Degrees of freedom of a mean square of `count` − 1 neighbouring differences of flicker noise.

    tr(R)²/tr(R²) of their covariance R, by the structure τ²·ln τ of its phase (Percival & Walden, 8.3).
    """
    lag = np.abs(np.subtract.outer(np.arange(count - 1), np.arange(count - 1)))
    structure = {k: k**2 * math.log(k) if k else 0.0 for k in map(abs, range(-2, count + 2))}
    weights = {-2: 1.0, -1: -4.0, 0: 6.0, 1: -4.0, 2: 1.0}
    by_lag = [sum(w * structure[abs(k + at)] for at, w in weights.items()) for k in range(count)]
    covariance = np.array(by_lag)[lag]
    return np.trace(covariance) ** 2 / (covariance**2).sum()


@pytest.mark.parametrize("count", [8, 16, 24])
def test_the_limits_of_a_short_flicker_log_rest_on_its_exact_freedom(count):
    """allantools has no square in this formula of SP 1065, so it is no oracle at one sample."""
    rng = np.random.default_rng(7)
    tail = (1.0 - CONFIDENCE) / 2.0
    freedom = exact_freedom_of_flicker(count)
    expected = math.sqrt(freedom / chi2.ppf(tail, freedom))
    ratios = [
        curve.high[0] / curve.deviation[0] for curve in (curve_of(flicker(rng, count)) for _ in range(60))
    ]
    assert min(abs(ratio / expected - 1.0) for ratio in ratios) < 0.01, (
        "of the logs that are seen to be flicker"
    )


def test_the_slope_of_the_log_is_the_least_squares_one():
    values = np.random.default_rng(8).standard_normal(700) + 0.01 * np.arange(700)
    assert curve_of(values, 50.0).slope_per_s == pytest.approx(
        50.0 * np.polyfit(np.arange(700), values, 1)[0]
    )


@pytest.mark.parametrize(("sensor", "least", "most"), [("accel", 5.0, 7.4), ("gyro", 0.98, 1.47)])
def test_an_mpu6050_lying_still(sensor, least, most):
    file = DATA / "mpu6050_static_100hz.csv"
    if not file.exists():
        pytest.skip(f"{file} is not here: set CALRIG_DATA to the folder of measured data")
    table = np.genfromtxt(file, delimiter=",", names=True)
    log = uniform_log(
        {f"{sensor}_{axis}_lsb": table[f"{sensor}_{axis}_lsb"] for axis in "xyz"}, table["time_s"], None
    )
    for name in log.channels:
        curve = allan_curve(log, name)
        assert least <= curve.deviation[curve.tau_s == 1.0] <= most
        assert -0.51 <= curve.adf_slope <= -0.49


def test_a_log_with_378_gaps():
    file = DATA / "mpu6050_warmup_log.csv"
    if not file.exists():
        pytest.skip(f"{file} is not here: set CALRIG_DATA to the folder of measured data")
    table = np.genfromtxt(file, delimiter=",", names=True)
    log = uniform_log({"accel_z_lsb": table["accel_z_lsb"]}, table["time_s"], None)
    curve = allan_curve(log, "accel_z_lsb")
    assert curve.tau_s[-1] <= max(part.stop - part.start for part in log.segments) / log.rate_hz / 2.0
    assert curve.adf_slope == pytest.approx(-0.5, abs=0.02)


@pytest.mark.parametrize(("kind", "is_summed"), [("white", False), ("random_walk", True)])
def test_the_slope_that_noise_leaves_varies_as_straight_lines_through_it_do(kind, is_summed):
    """Of 2,000 logs of coefficient 1 at 10 Hz, simulated; for the slope, noise in steps of 0.1 s."""
    drawn = np.random.default_rng(9).standard_normal((256, 2000)) * math.sqrt(10.0)
    if is_summed:
        drawn = np.cumsum(drawn, axis=0) / 10.0
    slopes = np.polyfit(np.arange(256) / 10.0, drawn, 1)[0]
    curve = allan_curve(uniform_log({"x": drawn[:, 0]}, None, 10.0), "x")
    assert theory_of(curve, np.arange(4)).slope[KINDS.index(kind)] == pytest.approx(slopes.var(), rel=0.15)
