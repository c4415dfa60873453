"""The filters side by side on the simulated stage and on people's logs; their jitter per 100 ms."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.stats import chi2
from simulated_moves import RATE_HZ, WHITE_ELEVATION, WHITE_GYRO, moves_log

from calrig.estimation.filter_comparison import (
    SAVITZKY_GOLAY_ORDERS,
    compare_filters,
    jitter,
    moving_average,
    savitzky_golay,
    tuned_against_paper,
)
from calrig.estimation.tuning import tuned_noise

NAMES = [
    "raw",
    "moving_average",
    "moving_average_centred",
    *(f"savitzky_golay_{order}{where}" for order in (1, 2, 4, 6) for where in ("", "_centred")),
    "kalman_paper",
    "kalman_tuned",
]
COEFFICIENTS = {
    "white_elevation_deg_sqrt_s": WHITE_ELEVATION,
    "white_gyro_dps_sqrt_s": WHITE_GYRO,
    "rate_hz": RATE_HZ,
}
TUNED = tuned_noise(**COEFFICIENTS)
UNCERTAIN_SCALE = tuned_noise(**COEFFICIENTS, gyro_scale_std=0.01, turning_deg_per_sqrt_s=5.0)
ORDINARY = {"gyro_bias_dps": [1.4, 0, 0], "gyro_scale_error_pct": [0.8, 0, 0]}
"""A chip as it comes: its gyro's scale is not yet calibrated."""


def rows(comparison):
    return {row.name: row for row in comparison.rows}


def figures(imu, seed, tuned=TUNED, gyro_scale=1.0):
    """Jitter (°), |lag| (ms) and largest offset (°) of the paper's filter and the tuned one on one rig."""
    log = moves_log(seed=seed, imu=imu)
    found = rows(
        compare_filters(
            log.time_s,
            log.elevation_deg,
            log.rate_dps,
            tuned=tuned,
            gyro_scale=gyro_scale,
            true_deg=log.true_deg,
        )
    )
    return [
        (row.jitter.std_deg, abs(row.transient.lag_ms), row.transient.largest_offset_deg)
        for row in (found["kalman_paper"], found["kalman_tuned"])
    ]


def rigs(imu, seeds, **options):
    """The figures of the paper's filter and of the tuned one on so many rigs, (seeds, 3) each."""
    return np.array([figures(imu, seed, **options) for seed in seeds]).swapaxes(0, 1)


def won_both(paper, tuned):
    """Share of rigs on which the tuned filter has less jitter and less lag at once."""
    return (tuned < paper)[:, :2].all(axis=1).mean()


SEEDS = [
    range(2),
    pytest.param(range(6), marks=pytest.mark.statistical),
    pytest.param(range(50), marks=pytest.mark.slow),
]


@pytest.mark.parametrize("seeds", SEEDS, ids=len)
def test_tuned_beats_the_paper_on_jitter_and_lag_at_once_on_the_simulated_rig(seeds):
    paper, tuned = rigs({}, seeds)

    assert won_both(paper, tuned) >= 0.95
    jitter, lag, offset = np.sqrt((tuned**2).mean(axis=0) / (paper**2).mean(axis=0))
    assert jitter < 0.2
    assert lag < 0.33
    assert offset < 0.33


@pytest.mark.parametrize("seeds", SEEDS, ids=len)
def test_tuned_beats_it_with_an_ordinary_gyro_once_its_scale_is_calibrated(seeds):
    """Known to 0.05 %, as 52 moves of 10° give it."""
    paper, tuned = rigs(ORDINARY, seeds, gyro_scale=1.0005 / 1.008)

    assert won_both(paper, tuned) >= 0.95
    assert tuned[:, 2].mean() < 0.33 * paper[:, 2].mean()


@pytest.mark.parametrize("seeds", SEEDS, ids=len)
def test_tuned_beats_it_with_a_gyro_whose_scale_is_said_to_be_uncertain(seeds):
    paper, tuned = rigs(ORDINARY, seeds, tuned=UNCERTAIN_SCALE)

    assert won_both(paper, tuned) >= 0.95
    assert tuned[:, 2].mean() < paper[:, 2].mean()


@pytest.mark.parametrize("seeds", SEEDS, ids=len)
def test_with_an_uncalibrated_gyro_that_it_trusts_it_trades_lag_for_jitter(seeds):
    paper, tuned = rigs(ORDINARY, seeds)

    assert (tuned[:, 0] < 0.25 * paper[:, 0]).all()
    assert (tuned[:, 1] > paper[:, 1]).all()


def test_the_verdict_says_which_it_trades():
    verdicts = {}
    for name, imu, tuned in (("ideal", {}, TUNED), ("trade", ORDINARY, TUNED), ("static", None, TUNED)):
        log = moves_log(imu=imu) if imu is not None else moves_log(())
        verdicts[name] = tuned_against_paper(
            compare_filters(log.time_s, log.elevation_deg, log.rate_dps, tuned=tuned)
        )

    assert "beats the paper's constants on jitter (0.00" in verdicts["ideal"]
    assert verdicts["ideal"].endswith("at once.")
    assert "better than the paper's constants on jitter" in verdicts["trade"]
    assert "worse on lag (-3." in verdicts["trade"]
    assert "no move shows their lag" in verdicts["static"]


def test_the_papers_smoothers_are_what_their_windows_make_them():
    """Ten samples at 200 Hz come 22.5 ms late; centred or of an order, a window comes on time."""
    log = moves_log(seed=1)

    found = compare_filters(log.time_s, log.elevation_deg, log.rate_dps, tuned=TUNED, true_deg=log.true_deg)

    assert [row.name for row in found.rows] == NAMES
    lag_ms = {row.name: row.transient.lag_ms for row in found.rows}
    assert lag_ms["moving_average"] - lag_ms["raw"] == pytest.approx(22.5, abs=0.1)
    for name in NAMES[2:-2]:
        assert lag_ms[name] == pytest.approx(lag_ms["raw"], abs=0.3)
    jitter_deg = [
        rows(found)[name].jitter.std_deg for name in ("raw", "savitzky_golay_4", "savitzky_golay_1")
    ]
    assert jitter_deg == sorted(jitter_deg, reverse=True)
    assert jitter_deg[0] == pytest.approx(WHITE_ELEVATION * RATE_HZ**0.5, rel=0.03)


def test_the_logs_own_reference_gives_what_the_truth_gives():
    log = moves_log(imu=ORDINARY)
    series = log.time_s, log.elevation_deg, log.rate_dps

    own, true = (rows(compare_filters(*series, tuned=TUNED, true_deg=true)) for true in (None, log.true_deg))

    for name in ("moving_average", "kalman_paper", "kalman_tuned"):
        assert own[name].transient.lag_ms == pytest.approx(true[name].transient.lag_ms, abs=0.5)


@pytest.mark.parametrize("rate_dps", [None, np.full(4000, np.nan)])
def test_without_a_gyro_the_kalman_rows_say_why_they_are_empty(rate_dps):
    log = moves_log((10, 20, 30))

    found = compare_filters(
        log.time_s[:4000],
        log.elevation_deg[:4000],
        rate_dps,
        tuned=TUNED,
    )

    assert rows(found)["kalman_paper"].as_dict()["jitter_deg"] is None
    assert "no rate" in rows(found)["kalman_tuned"].reasons[0]
    assert rows(found)["moving_average"].transient.lag_ms == pytest.approx(22.5, abs=0.2)
    assert "kalman_paper" not in found.filtered_deg


def test_a_log_at_rest_has_jitter_and_no_lag():
    log = moves_log(())

    found = compare_filters(log.time_s, log.elevation_deg, log.rate_dps)

    (raw, *_, tuned) = [row.as_dict() for row in found.rows]
    assert raw["jitter_deg"] > 0.2
    assert (raw["lag_ms"], raw["largest_offset_deg"]) == (None, None)
    assert "no move" in raw["reasons"][0]
    assert "is not known" in tuned["reasons"][0]
    assert found.reference == ""
    assert tuned_against_paper(found) is None
    json.dumps([row.as_dict() for row in found.rows], allow_nan=False)


def test_gaps_uneven_time_and_lost_samples_leave_the_figures_as_they_are():
    log = moves_log()
    whole = rows(compare_filters(log.time_s, log.elevation_deg, log.rate_dps, tuned=TUNED))
    rng = np.random.default_rng(0)
    time_s = log.time_s + rng.uniform(-2e-4, 2e-4, len(log.time_s))
    elevation_deg, rate_dps = log.elevation_deg.copy(), log.rate_dps.copy()
    elevation_deg[::97], rate_dps[50::97] = np.nan, np.inf
    kept = (log.time_s < log.time_s[3000]) | (log.time_s > log.time_s[3100])

    found = compare_filters(time_s[kept], elevation_deg[kept], rate_dps[kept], tuned=TUNED)

    assert found.dropped == pytest.approx(2 * kept.sum() / 97, abs=3)
    for name in ("raw", "moving_average", "kalman_paper", "kalman_tuned"):
        assert rows(found)[name].jitter.std_deg == pytest.approx(whole[name].jitter.std_deg, rel=0.15)
        assert rows(found)[name].transient.lag_ms == pytest.approx(whole[name].transient.lag_ms, abs=1.0)


def test_an_elevation_about_half_a_turn_is_no_leap():
    log = moves_log(seed=2)
    turned_deg = (log.elevation_deg + 175.0 + 180.0) % 360.0 - 180.0

    here, there = (
        rows(compare_filters(log.time_s, elevation_deg, log.rate_dps, tuned=TUNED, true_deg=true_deg))
        for elevation_deg, true_deg in (
            (log.elevation_deg, log.true_deg),
            (turned_deg, log.true_deg + 175.0 - 720.0),
        )
    )

    for name in NAMES:
        assert there[name].jitter.std_deg == pytest.approx(here[name].jitter.std_deg, rel=1e-6)
        assert there[name].transient.largest_offset_deg == pytest.approx(
            here[name].transient.largest_offset_deg, rel=1e-6
        )


@pytest.mark.parametrize(
    ("time_s", "elevation_deg", "complaint"),
    [
        ([0.0, 0.1, 0.1, 0.2], [1.0] * 4, "0.1 s is followed by 0.1 s"),
        ([0.0, 0.1], [1.0] * 3, "equally long"),
        ([0.0, np.nan], [np.nan, 1.0], "not one sample"),
        ([], [], "not one sample"),
    ],
)
def test_a_log_that_means_nothing_is_refused(time_s, elevation_deg, complaint):
    with pytest.raises(ValueError, match=complaint):
        compare_filters(time_s, elevation_deg)


TIME_S = np.arange(20_000) * 0.005
WHOLE = [slice(0, 20_000)]


def noise(sigma_deg=0.3, n=20_000, seed=0):
    return np.random.default_rng(seed).normal(0.0, sigma_deg, n)


def test_jitter_of_white_noise_is_its_standard_deviation():
    found = jitter(TIME_S, 60.0 + noise(), WHOLE)

    assert found.n_bins == 1000
    in_variances = found.std_deg**2 / 0.3**2 * 19_000
    assert chi2.ppf(1e-4, 19_000) < in_variances < chi2.ppf(1.0 - 1e-4, 19_000)
    assert found.step_deg == pytest.approx(0.3 * math.sqrt(2.0 / 20.0), rel=0.1)


def test_each_bin_is_measured_about_its_own_mean_on_an_uneven_clock():
    rng = np.random.default_rng(2)
    time_s = np.cumsum(rng.uniform(0.004, 0.006, 5000))
    angle_deg = noise(n=5000)
    stretches = [slice(10, 2000), slice(2500, 5000)]

    found = jitter(time_s, angle_deg, stretches)

    bins = []
    for stretch in stretches:
        time, angle = time_s[stretch] - time_s[stretch.start], angle_deg[stretch]
        count = int(time[-1] / 0.1)
        bins += [angle[(time >= 0.1 * k) & (time < 0.1 * (k + 1))] for k in range(count)]
    assert found.n_bins in (len(bins), len(bins) + 1, len(bins) + 2)  # a last bin may be nearly full
    assert found.std_deg == pytest.approx(math.sqrt(np.mean([b.var(ddof=1) for b in bins])), rel=0.01)
    assert found.peak_to_peak_deg == pytest.approx(
        math.sqrt(np.mean([np.ptp(b) ** 2 for b in bins])), rel=0.01
    )


def test_samples_on_the_border_of_a_bin_belong_to_the_next_whatever_their_decimals():
    found = jitter(np.round(1700.0 + TIME_S, 3), np.tile([0.0] * 20 + [1.0] * 20, 500), WHOLE)

    assert found.std_deg == 0.0
    assert found.step_deg == 1.0


def test_a_slow_wander_is_in_the_step_from_bin_to_bin():
    walk, white = (jitter(TIME_S, angle_deg, WHOLE) for angle_deg in (np.cumsum(noise()), noise()))

    assert walk.std_deg < 0.6 * walk.step_deg
    assert white.std_deg > 3.0 * white.step_deg


def test_samples_without_a_value_are_passed_over():
    angle_deg = noise()
    with_gaps = angle_deg.copy()
    with_gaps[:500] = np.nan

    assert jitter(TIME_S, with_gaps, WHOLE) == jitter(TIME_S, angle_deg, [slice(500, 20_000)])


@pytest.mark.parametrize(
    ("interval_s", "stretches"),
    [(0.05, WHOLE), (0.005, []), (0.005, [slice(0, 10)]), (0.005, [slice(0, 0), slice(3, 4)])],
)
def test_without_a_full_bin_there_is_no_jitter(interval_s, stretches):
    assert jitter(TIME_S / 0.005 * interval_s, noise(), stretches) is None


def test_a_signal_without_any_value_has_no_jitter():
    assert jitter(TIME_S, np.full(20_000, np.nan), WHOLE) is None


NOISE = np.random.default_rng(0).normal(40.0, 0.3, 60)


def test_moving_average_is_the_mean_of_the_last_ten():
    smoothed = moving_average(NOISE)

    assert np.isnan(smoothed[:9]).all()
    np.testing.assert_allclose(smoothed[9:], [NOISE[i - 9 : i + 1].mean() for i in range(9, 60)], rtol=1e-13)


@pytest.mark.parametrize("order", SAVITZKY_GOLAY_ORDERS)
@pytest.mark.parametrize(("centred", "at"), [(False, 10), (True, 5)])
def test_savitzky_golay_is_a_polynomial_through_each_eleven(order, centred, at):
    smoothed = savitzky_golay(NOISE, order, centred=centred)

    x = np.arange(11.0) - at
    fitted = [np.polynomial.Polynomial.fit(x, NOISE[i : i + 11], order)(0.0) for i in range(50)]
    np.testing.assert_allclose(smoothed[at : at + 50], fitted, rtol=1e-10)
    assert np.isnan(smoothed[:at]).all()
    assert np.isnan(smoothed[at + 50 :]).all()


@pytest.mark.parametrize(
    ("smooth", "late_samples"),
    [
        (moving_average, 4.5),
        (lambda x: moving_average(x, centred=True), 0.0),
        (lambda x: savitzky_golay(x, 1), 0.0),
        (lambda x: savitzky_golay(x, 1, centred=True), 0.0),
    ],
)
def test_only_the_causal_moving_average_comes_late_on_a_straight_line(smooth, late_samples):
    line = 100.0 + 0.1 * np.arange(40.0)

    smoothed = smooth(line)

    known = np.isfinite(smoothed)
    np.testing.assert_allclose(smoothed[known], line[known] - 0.1 * late_samples, atol=1e-12)


def test_a_stretch_shorter_than_the_window_has_no_value():
    for smoothed in (moving_average(NOISE[:9]), savitzky_golay(NOISE[:10], 2), moving_average(NOISE[:0])):
        assert np.isnan(smoothed).all()


@pytest.mark.parametrize(("order", "window"), [(2, 10), (11, 11), (-1, 11)])
def test_a_window_that_cannot_hold_the_order_is_refused(order, window):
    with pytest.raises(ValueError, match=f"order {order} over {window} samples"):
        savitzky_golay(NOISE, order, window)


def test_a_moving_average_of_nothing_is_refused():
    with pytest.raises(ValueError, match="holds none"):
        moving_average(NOISE, 0)
