"""Moves found in a log, where the sensor was in them, and how late and how far off a filter is."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_moves import moves_log

from calrig.estimation.intervals import find_intervals, segments_of
from calrig.estimation.transient_response import MoveReference, move_reference, transient

TARGETS_DEG = (10, 30, 28, -5)


def whole(log):
    return slice(0, len(log.time_s))


def references(log, with_gyro=True):
    rate_dps = log.rate_dps if with_gyro else None
    moves = find_intervals(log.time_s, log.elevation_deg, rate_dps, whole(log)).moves
    edges = [0, *(one.stop for one in moves)], [*(one.start for one in moves), len(log.time_s)]
    return [
        move_reference(
            log.time_s, log.elevation_deg, rate_dps, move, slice(edges[0][index], edges[1][index + 1])
        )
        for index, move in enumerate(moves)
    ]


@pytest.mark.parametrize("with_gyro", [True, False])
def test_moves_of_the_stage_are_found_and_the_rest_between_them(with_gyro):
    log = moves_log(TARGETS_DEG, imu={"gyro_bias_dps": [3.0, 0, 0]})

    seen = find_intervals(log.time_s, log.elevation_deg, log.rate_dps if with_gyro else None, whole(log))

    found_s = np.array([(log.time_s[one.start], log.time_s[one.stop]) for one in seen.moves])
    np.testing.assert_allclose(found_s, log.moves_s, atol=0.12)
    assert len(seen.static) == 5
    for still in seen.static:
        assert np.ptp(log.true_deg[still]) < (1e-6 if with_gyro else 0.02)


@pytest.mark.parametrize("seed", range(5))
def test_nothing_moves_in_a_log_at_rest(seed):
    log = moves_log((), seed=seed)

    seen = find_intervals(log.time_s, log.elevation_deg, log.rate_dps, whole(log))

    assert seen.dynamic == ()
    assert seen.static == (slice(200, len(log.time_s)),)
    assert find_intervals(log.time_s, log.elevation_deg, None, whole(log)).moves == ()


def test_a_knock_is_no_move_but_no_rest_either():
    log = moves_log(())
    log.rate_dps[400:410] += 30.0

    seen = find_intervals(log.time_s, log.elevation_deg, log.rate_dps, whole(log))

    assert seen.moves == ()
    (knock,) = seen.dynamic
    assert knock.start < 400
    assert knock.stop > 410
    assert seen.static == (slice(200, knock.start), slice(knock.stop + 200, len(log.time_s)))


def test_gaps_break_a_log_and_a_lost_sample_does_not():
    time_s = np.delete(np.arange(100) * 0.01, [20, 50, 51, 52])

    assert segments_of(time_s) == [slice(0, 49), slice(49, 96)]
    assert segments_of(time_s[:1]) == [slice(0, 1)]
    assert segments_of(time_s[:0]) == []


@pytest.mark.parametrize(("with_gyro", "within_deg"), [(True, 0.01), (False, 0.15)])
def test_reference_is_where_the_sensor_was_whatever_the_gyros_bias_and_scale(with_gyro, within_deg):
    """Quantisation and the rounded corners of a low-pass are all that is left without noise."""
    log = moves_log(
        TARGETS_DEG,
        preset="ideal",
        imu={"gyro_bias_dps": [-4.0, 0, 0], "gyro_scale_error_pct": [3.0, 0, 0]},
    )

    found = references(log, with_gyro)

    assert len(found) == 4
    for move in found:
        true_deg = np.interp(move.time_s, log.time_s, log.true_deg)
        np.testing.assert_allclose(move.angle_deg, true_deg, atol=within_deg)


def test_without_rest_before_it_or_with_a_gyro_that_turns_otherwise_there_is_no_reference():
    log = moves_log((10,))
    (move,) = find_intervals(log.time_s, log.elevation_deg, log.rate_dps, whole(log)).moves
    series = log.time_s, log.elevation_deg

    assert move_reference(*series, log.rate_dps, move, slice(move.start - 20, len(log.time_s))) is None
    assert move_reference(*series, -log.rate_dps, move, whole(log)) is None


def test_a_log_too_slow_for_a_low_pass_has_no_reference_without_a_gyro():
    time_s = np.arange(100) * 0.1
    elevation_deg = np.where(time_s < 5.0, 0.0, 10.0)

    assert move_reference(time_s, elevation_deg, None, slice(48, 52), slice(0, 100)) is None


@pytest.mark.parametrize("delay_s", [-0.004, 0.0, 0.0225, 0.12])
def test_lag_of_a_delayed_copy_is_its_delay(delay_s):
    log = moves_log(TARGETS_DEG, preset="ideal")
    moves = [MoveReference(one.judged, log.time_s, log.true_deg) for one in references(log)]

    found = transient(log.time_s, np.interp(log.time_s - delay_s, log.time_s, log.true_deg), moves)

    assert found.n_moves == 4
    assert found.lag_ms == pytest.approx(1e3 * delay_s, abs=0.05)
    assert found.lag_std_ms < 0.05
    assert found.largest_offset_deg == pytest.approx(20.0 * abs(delay_s), abs=0.02)


@pytest.mark.statistical
def test_lag_scatters_by_its_stated_error():
    off, stated = [], []
    for seed in range(40):
        log = moves_log((10, 20, 30, 40, 30, 20), seed=seed)
        moves = [MoveReference(one.judged, log.time_s, log.true_deg) for one in references(log)]
        found = transient(log.time_s, log.elevation_deg, moves)
        off.append(found.lag_ms)
        stated.append(found.lag_std_ms)

    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(np.sqrt(np.mean(np.square(stated))), rel=0.35)


def test_without_a_move_or_a_filter_in_it_nothing_is_known():
    log = moves_log((10,))
    assert transient(log.time_s, log.true_deg, []) is None
    assert transient(log.time_s, np.full(len(log.time_s), np.nan), references(log)) is None


def test_one_move_has_a_lag_without_an_error():
    log = moves_log((10,))
    found = transient(log.time_s, log.true_deg, references(log))
    assert found.n_moves == 1
    assert found.lag_std_ms is None


def test_the_error_of_the_lag_is_that_of_the_mean_over_the_moves():
    """Three equal moves, followed 10, 20 and 60 ms late."""
    time_s = np.arange(0.0, 12.0, 0.005)
    delays_s, moves, angle_deg = [0.01, 0.02, 0.06], [], np.zeros(len(time_s))
    for k, delay_s in enumerate(delays_s):
        begin, end = 800 * k, 800 * (k + 1)
        own_s = time_s[begin:end] - time_s[begin]
        moves.append(MoveReference(slice(begin, end), time_s[begin:end], 10.0 * smooth_step(own_s - 1.0)))
        angle_deg[begin:end] = 10.0 * smooth_step(own_s - 1.0 - delay_s)
    found = transient(time_s, angle_deg, moves)
    assert found.lag_ms == pytest.approx(30.0, abs=0.1)
    assert found.lag_std_ms == pytest.approx(1e3 * np.std(delays_s, ddof=1) / np.sqrt(3.0), rel=0.01)


def smooth_step(time_s):
    """From 0 to 1 within one second, with a level begin and end."""
    share = np.clip(time_s, 0.0, 1.0)
    return share - np.sin(2.0 * np.pi * share) / (2.0 * np.pi)
