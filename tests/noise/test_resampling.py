"""Logs as they are: gaps, jitter, clumps, wrapped clocks, a wrong rate, values that are no numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import DATA

from calrig.noise.resampling import uniform_log

N, RATE_HZ = 2000, 100.0
TIME_S = np.arange(N) / RATE_HZ


def numbers(n=N):
    """A channel whose every value tells which sample it is."""
    return {"accel_x_g": np.arange(n, dtype=float)}


def test_a_clean_log_comes_back_as_it_is():
    channels = numbers()
    log = uniform_log(channels, TIME_S, None)
    assert log.channels["accel_x_g"] is channels["accel_x_g"]
    assert (log.segments, log.start_s, log.gaps, log.not_finite, log.notes) == (
        (slice(0, N),),
        (0.0,),
        0,
        0,
        (),
    )
    assert log.rate_hz == pytest.approx(RATE_HZ)
    assert log.duration_s == pytest.approx(N / RATE_HZ)


def test_a_rate_alone_is_enough():
    log = uniform_log(numbers(), None, 250.0)
    assert (log.rate_hz, log.duration_s, log.notes) == (250.0, N / 250.0, ())


@pytest.mark.parametrize(
    "time_s", [None, np.full(N, np.nan), np.zeros(N)], ids=["none", "no values", "stands"]
)
def test_without_a_rate_to_be_had_it_says_how_to_give_one(time_s):
    with pytest.raises(ValueError, match="give it with --rate"):
        uniform_log(numbers(), time_s, None)


def test_stamps_that_stand_still_do_not_matter_beside_a_rate():
    log = uniform_log(numbers(), np.zeros(N), 50.0)
    assert log.rate_hz == 50.0
    assert log.notes == ("The rate given stands alone, since time_s does not advance.",)


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_refused(rate_hz):
    with pytest.raises(ValueError, match="must be above 0"):
        uniform_log(numbers(), TIME_S, rate_hz)


def test_the_rate_given_wins_and_a_disagreement_is_said():
    log = uniform_log(numbers(), TIME_S, 102.0)
    assert log.rate_hz == 102.0
    assert log.notes == (
        "The rate given, 102 Hz, is not the 100 Hz that time_s tells; the one given is used.",
    )
    assert uniform_log(numbers(), TIME_S, 100.9).notes == ()


def test_a_long_gap_parts_the_log():
    time_s = TIME_S + np.where(np.arange(N) >= 700, 3.0, 0.0)
    log = uniform_log(numbers(), time_s, None)
    assert log.segments == (slice(0, 700), slice(700, N))
    assert log.start_s == pytest.approx((0.0, 10.0))
    assert log.gaps == 1
    assert log.duration_s == pytest.approx(23.0)
    assert log.notes == ("The log is in 2 pieces, the longest of 13 s; nothing joins them.",)


def test_a_few_missing_samples_are_on_a_line_and_the_log_stays_whole():
    kept = np.setdiff1d(np.arange(N), [300, 301, 302, 1500])
    log = uniform_log({"accel_x_g": kept.astype(float)}, TIME_S[kept], None)
    assert log.segments == (slice(0, N),)
    np.testing.assert_allclose(log.channels["accel_x_g"], np.arange(N), atol=1e-9)
    assert log.gaps == 2
    assert log.notes == ("4 missing samples, in 2 short gaps, are taken as on straight lines.",)


def test_stamps_that_jitter_change_no_value():
    jitter_s = np.random.default_rng(1).normal(0.0, 0.0015, N)
    channels = numbers()
    log = uniform_log(channels, TIME_S + jitter_s, None)
    assert log.channels["accel_x_g"] is channels["accel_x_g"]
    assert log.gaps == 0
    assert log.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    assert log.notes == (
        f"Stamps jitter by 1.51 ms; the samples are taken as evenly spaced at {log.rate_hz:.6g} Hz.",
    )


def test_one_late_stamp_is_not_a_gap():
    time_s = TIME_S.copy()
    time_s[900] += 0.009  # the next one comes when it should
    log = uniform_log(numbers(), time_s, None)
    assert (log.gaps, log.segments) == (0, (slice(0, N),))


@pytest.mark.parametrize("spread_s", [0.0, 1e-4])
def test_clumps_are_taken_apart(spread_s):
    """A host that reads 16 samples at once stamps them all when it reads them."""
    read_at = TIME_S[np.minimum(np.arange(N) // 16 * 16 + 15, N - 1)]
    log = uniform_log(numbers(), read_at + spread_s * (np.arange(N) % 16), None)
    assert (log.gaps, log.segments) == (0, (slice(0, N),))
    assert log.rate_hz == pytest.approx(RATE_HZ, rel=0.01)
    assert log.notes[0].startswith("Stamps come in clumps; the samples are taken as evenly spaced at ")


def test_a_gap_between_clumps_is_found():
    taken_at = TIME_S + np.where(np.arange(N) >= 800, 5.0, 0.0)
    log = uniform_log(numbers(), taken_at[np.minimum(np.arange(N) // 16 * 16 + 15, N - 1)], None)
    assert log.gaps == 1
    assert log.segments == (slice(0, 800), slice(800, N))
    assert log.duration_s == pytest.approx(25.0, abs=0.3)


@pytest.mark.parametrize(
    ("clock_s", "unit"), [(2**32 * 1e-6, "microseconds"), (2**32 * 1e-3, "milliseconds")]
)
def test_a_clock_of_32_bits_is_unwrapped(clock_s, unit):
    log = uniform_log(numbers(), (TIME_S + clock_s - 7.0) % clock_s, None)
    assert (log.gaps, log.segments) == (0, (slice(0, N),))
    assert log.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    assert log.notes == (f"time_s wraps 1 time(s) like a clock of 32 bits in {unit}; unwrapped.",)


def test_a_clock_that_starts_anew_parts_the_log():
    log = uniform_log(numbers(), np.concatenate((TIME_S[:1200], TIME_S[: N - 1200])), None)
    assert log.segments == (slice(0, 1200), slice(1200, N))
    assert log.notes[0] == "time_s starts anew 1 time(s); how long each pause was is not known."


def test_values_that_are_no_numbers_are_counted_and_bridged():
    channels = {"accel_x_g": np.arange(N, dtype=float), "gyro_x_dps": np.zeros(N)}
    channels["accel_x_g"][[40, 41]] = np.nan
    channels["gyro_x_dps"][41] = np.inf
    log = uniform_log(channels, None, RATE_HZ)
    assert (log.not_finite, log.gaps, log.segments) == (2, 0, (slice(0, N),))
    np.testing.assert_allclose(log.channels["accel_x_g"], np.arange(N))
    assert log.notes[0] == f"2 of {N} samples have a value that is no number; left out."


def test_a_channel_without_numbers_is_left_out():
    log = uniform_log(numbers() | {"gyro_x_dps": np.full(N, np.nan)}, TIME_S, None)
    assert list(log.channels) == ["accel_x_g"]
    assert log.not_finite == 0
    assert log.notes == ("gyro_x_dps has no number; left out.",)


def test_a_temperature_measured_now_and_then_costs_no_samples():
    temperature_c = np.where(np.arange(N) % 100 == 0, 20.0 + TIME_S, np.nan)
    log = uniform_log(numbers() | {"temperature_c": temperature_c}, TIME_S, None)
    np.testing.assert_allclose(log.channels["temperature_c"][:1901], 20.0 + TIME_S[:1901])
    assert log.segments == (slice(0, N),)


def test_stamps_that_are_no_numbers_lie_between_their_neighbours():
    time_s = TIME_S.copy()
    time_s[[5, 600]] = np.nan
    log = uniform_log(numbers(), time_s, None)
    assert (log.gaps, log.segments) == (0, (slice(0, N),))
    assert log.notes == ("2 stamps are no numbers; taken as between their neighbours.",)


def test_a_log_in_shreds_is_taken_at_its_mean_rate():
    time_s = TIME_S[np.random.default_rng(3).random(N) < 0.75]
    log = uniform_log(numbers(len(time_s)), time_s, None)
    assert log.segments == (slice(0, len(time_s)),)
    assert log.rate_hz == pytest.approx((len(time_s) - 1) / (time_s[-1] - time_s[0]), rel=1e-3)
    assert log.notes[-1].startswith("time_s is too uneven to tell a gap from jitter (")


def test_channels_of_different_lengths_are_refused():
    with pytest.raises(ValueError, match="one length"):
        uniform_log({"accel_x_g": np.zeros(5), "accel_y_g": np.zeros(4)}, None, RATE_HZ)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(40, 200), st.integers(11, 400)), min_size=1, max_size=12),
    st.floats(0.0, 0.1),
    st.integers(0, 99),
)
def test_no_sample_is_lost_or_moved_whatever_the_gaps(pieces, jitter, seed):
    """Pieces of uniform samples, each followed by so many that are missing; jitter is a share of a period."""
    place, at = np.zeros(0), 0
    for samples, missing in pieces:
        place = np.append(place, at + np.arange(samples))
        at += samples + missing
    stamps = place / RATE_HZ + jitter / RATE_HZ * np.random.default_rng(seed).uniform(-1.0, 1.0, len(place))
    log = uniform_log(numbers(len(place)), stamps, None)
    assert [part.stop - part.start for part in log.segments] == [samples for samples, _ in pieces]
    assert log.gaps == len(pieces) - 1
    np.testing.assert_array_equal(log.channels["accel_x_g"], np.arange(len(place)))
    starts = np.cumsum([0] + [samples + missing for samples, missing in pieces])[:-1] / RATE_HZ
    np.testing.assert_allclose(log.start_s, starts, rtol=0.02, atol=0.02)


def test_the_warm_up_log_is_in_pieces():
    file = DATA / "mpu6050_warmup_log.csv"
    if not file.exists():
        pytest.skip(f"{file} is not here: set CALRIG_DATA to the folder of measured data")
    table = np.genfromtxt(file, delimiter=",", names=True)
    log = uniform_log({"accel_x_lsb": table["accel_x_lsb"]}, table["time_s"], None)
    assert log.gaps == 378
    assert len(log.segments) == 379
    assert log.duration_s == pytest.approx(table["time_s"][-1], rel=0.01)
