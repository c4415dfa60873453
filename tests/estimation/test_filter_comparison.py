"""The filters side by side on the simulated stage, and on the logs that people have."""

from __future__ import annotations

import json

import numpy as np
import pytest
from simulated_moves import RATE_HZ, WHITE_ELEVATION, WHITE_GYRO, moves_log

from calrig.estimation.filter_comparison import compare_filters
from calrig.estimation.filter_verdict import tuned_against_paper
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
