"""Tones are found, with frequency and amplitude, and noise of any colour shows none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from support import DATA

from calrig.export.static_csv import read_static
from calrig.noise.resampling import uniform_log
from calrig.noise.spectral_lines import Line, find_lines

RATE_HZ, TEN_MINUTES_S = 100.0, 600.0
N = int(RATE_HZ * TEN_MINUTES_S)
T_S = np.arange(N) / RATE_HZ


def lines_of(x: np.ndarray, rate_hz: float = RATE_HZ) -> tuple[Line, ...]:
    return find_lines(x, rate_hz, [slice(0, len(x))], [0.0])


def tone(frequency_hz: float, amplitude: float = 1.0, phase: float = 0.3) -> np.ndarray:
    return amplitude * np.sin(2 * np.pi * frequency_hz * T_S + phase)


def white(rng: np.random.Generator) -> np.ndarray:
    return rng.standard_normal(N)


def pink(rng: np.random.Generator) -> np.ndarray:
    spectrum = np.fft.rfft(rng.standard_normal(2 * N))
    return np.fft.irfft(spectrum / np.sqrt(np.maximum(np.arange(len(spectrum)), 1.0)))[:N] * 100.0


def walk_in_white(rng: np.random.Generator) -> np.ndarray:
    return 0.03 * np.cumsum(rng.standard_normal(N)) + rng.standard_normal(N)


def autoregression(rng: np.random.Generator, rho: float = 0.99) -> np.ndarray:
    return lfilter([1.0], [1.0, -rho], rng.standard_normal(N))


def resonance(rng: np.random.Generator, radius: float = 0.99) -> np.ndarray:
    """A peak of 0.3 Hz width at 16 Hz: broad beside a line."""
    return lfilter([1.0], np.poly(radius * np.exp([1j, -1j])).real, rng.standard_normal(N))


NOISES = {
    "white": white,
    "pink": pink,
    "a random walk": lambda rng: np.cumsum(rng.standard_normal(N)),
    "a walk in white": walk_in_white,
    "autoregression": autoregression,
    "a resonance": resonance,
    "steps of two sigma": lambda rng: np.round(0.5 * white(rng)),
    "steps of five sigma": lambda rng: np.round(0.2 * white(rng) + 0.3),
    "a walk in steps": lambda rng: np.round(0.01 * np.cumsum(white(rng)) + 0.3 * white(rng)),
    "a warm-up": lambda rng: 500.0 * np.exp(-T_S / 120.0) + white(rng),
}


def found_alone(frequency_hz: float, rate_hz: float, seed: int) -> bool:
    """A tone of 0.2 mg in 0.5 mg/√Hz (one-sided) over ten minutes is found, and nothing else."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(int(rate_hz * TEN_MINUTES_S)) / rate_hz
    x = 0.5e-3 * np.sqrt(rate_hz / 2.0) * rng.standard_normal(len(t_s))
    x += 0.2e-3 * np.sin(2 * np.pi * frequency_hz * t_s + rng.uniform(0.0, 2 * np.pi))
    found = lines_of(x, rate_hz)
    return len(found) == 1 and abs(found[0].frequency_hz - frequency_hz) < 1.0 / TEN_MINUTES_S


def test_a_weak_tone_is_found_in_white_noise():
    assert found_alone(0.5, RATE_HZ, seed=0)


@pytest.mark.statistical
def test_a_weak_tone_is_found_in_nearly_every_log():
    assert sum(found_alone(0.5, RATE_HZ, seed) for seed in range(20)) >= 19


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("rate_hz", [100.0, 200.0])
@pytest.mark.parametrize(
    "frequency_hz", [0.5, 0.50083, 13.71234], ids=["on a bin", "between bins", "anywhere"]
)
def test_a_weak_tone_is_found_in_99_of_100_logs(frequency_hz, rate_hz):
    assert sum(found_alone(frequency_hz, rate_hz, seed) for seed in range(200)) >= 198


@pytest.mark.parametrize("kind", NOISES)
def test_noise_shows_no_line(kind):
    assert lines_of(NOISES[kind](np.random.default_rng(0))) == ()


@pytest.mark.statistical
@pytest.mark.parametrize("kind", NOISES)
def test_noise_shows_no_line_over_a_few_seeds(kind):
    assert sum(bool(lines_of(NOISES[kind](np.random.default_rng(seed)))) for seed in range(12)) == 0


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("kind", NOISES)
def test_noise_shows_a_line_in_one_log_of_100_at_most(kind):
    assert sum(bool(lines_of(NOISES[kind](np.random.default_rng([seed, 1])))) for seed in range(1000)) <= 10


@pytest.mark.statistical
def test_the_frequency_and_the_amplitude_are_those_of_the_tone():
    rng = np.random.default_rng(1)
    off = []
    for _ in range(20):
        frequency_hz, amplitude = rng.uniform(0.3, 49.7), 10.0 ** rng.uniform(-1.0, 3.0)
        (line,) = lines_of(white(rng) + tone(frequency_hz, amplitude))
        # in standard errors of the best estimate there is (Cramér and Rao)
        off.append(
            (line.frequency_hz - frequency_hz) / (np.sqrt(6.0 / N) / (np.pi * TEN_MINUTES_S * amplitude))
        )
        off.append((line.amplitude - amplitude) / np.sqrt(2.0 / N))
    assert np.sqrt(np.mean(np.square(off))) < 1.6


@pytest.mark.parametrize("frequency_hz", [0.02, 0.1, 49.9, 49.99])
def test_a_tone_near_zero_or_half_the_rate_is_one_line(frequency_hz):
    (line,) = lines_of(white(np.random.default_rng(2)) + tone(frequency_hz))
    assert line.frequency_hz == pytest.approx(frequency_hz, abs=2e-4)
    assert line.amplitude == pytest.approx(1.0, abs=0.05)


def test_a_tone_is_found_where_the_noise_rises_towards_zero():
    (line,) = lines_of(walk_in_white(np.random.default_rng(3)) + tone(0.5, 0.3))
    assert line.frequency_hz == pytest.approx(0.5, abs=1e-3)


def test_harmonics_are_lines_of_their_own():
    found = lines_of(white(np.random.default_rng(4)) + np.sign(tone(1.2345)))
    for line, order in zip(found, (1, 3, 5, 7, 9), strict=False):
        assert line.frequency_hz == pytest.approx(1.2345 * order, abs=5e-3)
        assert line.amplitude == pytest.approx(4.0 / np.pi / order, abs=0.03)


def test_a_tone_however_strong_has_no_neighbours():
    for amplitude in (10.0, 1e8):
        assert len(lines_of(white(np.random.default_rng(5)) + tone(7.7777, amplitude))) == 1


def test_two_tones_close_together_are_two():
    found = lines_of(white(np.random.default_rng(6)) + tone(10.0) + tone(10.05, 0.5))
    assert [line.frequency_hz for line in found] == pytest.approx([10.0, 10.05], abs=1e-3)
    assert [line.amplitude for line in found] == pytest.approx([1.0, 0.5], abs=0.03)


@pytest.mark.parametrize("amplitude", [0.3, 1.0, 30.0])
def test_a_tone_that_wanders_is_one_line_of_its_whole_power(amplitude):
    rng = np.random.default_rng(7)
    wander_hz = 2e-4 * np.cumsum(rng.standard_normal(N))
    phase = 2 * np.pi * np.cumsum(12.0 + wander_hz - wander_hz.mean()) / RATE_HZ
    (line,) = lines_of(white(rng) + amplitude * np.sin(phase))
    assert line.frequency_hz == pytest.approx(12.0, abs=0.03)
    assert line.amplitude == pytest.approx(amplitude, rel=0.15)


def test_a_tone_whose_amplitude_varies_is_one_line():
    (line,) = lines_of(white(np.random.default_rng(8)) + tone(12.0) * (1.0 + 0.5 * np.sin(0.02 * T_S)))
    assert line.frequency_hz == pytest.approx(12.0, abs=1e-3)


@pytest.mark.parametrize("x", [np.zeros(1000), np.ones(100), np.arange(255.0), np.arange(5000.0)])
def test_what_has_no_noise_or_is_too_short_has_no_line(x):
    assert lines_of(x) == ()


def test_a_tone_alone_is_one_line():
    (line,) = lines_of(tone(7.0))
    assert (line.frequency_hz, line.amplitude) == pytest.approx((7.0, 1.0))


def in_pieces(x: np.ndarray, kind: str) -> tuple[np.ndarray, float, list[slice], list[float]]:
    """What is left of a log with gaps: bursts of 0.9 s every 3.7 s, 378 gaps anywhere, or its ends."""
    place = np.arange(N)
    kept = np.ones(N, dtype=bool)
    if kind == "bursts":
        kept = place % 370 < 90
    elif kind == "378 gaps":
        rng = np.random.default_rng(9)
        for begin in rng.integers(100, N - 300, 378):
            kept[begin : begin + rng.integers(20, 120)] = False
    else:
        kept = (place < N // 3) | (place > N - N // 3)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], kept.astype(int), [0])))).reshape(-1, 2)
    stops = np.cumsum(edges[:, 1] - edges[:, 0])
    segments = [slice(int(b - (t - s)), int(b)) for (s, t), b in zip(edges, stops, strict=True)]
    return x[kept], RATE_HZ, segments, (edges[:, 0] / RATE_HZ).tolist()


GAPS = ["bursts", "378 gaps", "the middle"]


@pytest.mark.parametrize("gaps", GAPS)
@pytest.mark.parametrize("kind", ["white", "pink", "a random walk", "a walk in white", "a warm-up"])
def test_gaps_make_no_line_of_noise(kind, gaps):
    assert find_lines(*in_pieces(NOISES[kind](np.random.default_rng(0)), gaps)) == ()


@pytest.mark.statistical
@pytest.mark.parametrize("gaps", GAPS)
@pytest.mark.parametrize("kind", ["white", "pink", "a random walk", "a walk in white", "a warm-up"])
def test_gaps_make_no_line_of_noise_over_a_few_seeds(kind, gaps):
    for seed in range(1, 5):
        assert find_lines(*in_pieces(NOISES[kind](np.random.default_rng(seed)), gaps)) == ()


@pytest.mark.parametrize(
    ("amplitude", "gaps"),
    [
        (0.3, "378 gaps"),
        (30.0, "bursts"),
        *[
            pytest.param(amplitude, gaps, marks=pytest.mark.statistical)
            for amplitude, gaps in (
                (0.3, "bursts"),
                (0.3, "the middle"),
                (30.0, "378 gaps"),
                (30.0, "the middle"),
            )
        ],
    ],
)
def test_over_gaps_tones_are_found_and_no_sidelobe_of_them(amplitude, gaps):
    tones_hz = [0.5, 3.3, 17.123, 49.2]
    x = white(np.random.default_rng(10)) + sum(tone(f, amplitude, k) for k, f in enumerate(tones_hz))
    found = sorted(find_lines(*in_pieces(x, gaps)), key=lambda line: line.frequency_hz)
    assert [line.frequency_hz for line in found] == pytest.approx(tones_hz, abs=1e-3)
    assert [line.amplitude for line in found] == pytest.approx([amplitude] * 4, abs=0.05, rel=0.02)


@pytest.fixture(scope="module", params=["mpu6050_static_100hz", "mpu6050_warmup_log"])
def measured(request):
    file = DATA / f"{request.param}.csv"
    if not file.is_file():
        pytest.skip(f"{file} is not here: set CALRIG_DATA to the folder of measured data")
    log = read_static(file.read_bytes())
    return request.param, uniform_log(log.channels, log.time_s, None)


def test_the_lines_of_real_logs(measured):
    """38 Hz in one gyro axis and 31 Hz in another stand out in each quarter of the static log by itself."""
    name, log = measured
    expected = {"gyro_y_lsb": 37.99, "gyro_z_lsb": 31.01} if "static" in name else {}
    found = {
        channel: [line.frequency_hz for line in find_lines(x, log.rate_hz, log.segments, log.start_s)]
        for channel, x in log.channels.items()
    }
    assert {channel: lines for channel, lines in found.items() if lines} == {
        channel: [pytest.approx(frequency_hz, abs=0.02)] for channel, frequency_hz in expected.items()
    }


def test_a_tone_put_into_a_real_log_is_found(measured):
    _, log = measured
    x = log.channels["accel_x_lsb"].copy()
    for segment, start_s in zip(log.segments, log.start_s, strict=True):
        t_s = start_s + np.arange(segment.stop - segment.start) / log.rate_hz
        x[segment] += 10.0 * np.sin(2 * np.pi * 7.654 * t_s)
    (line,) = find_lines(x, log.rate_hz, log.segments, log.start_s)
    assert line.frequency_hz == pytest.approx(7.654, abs=2e-3)
    assert line.amplitude == pytest.approx(10.0, abs=1.5)
