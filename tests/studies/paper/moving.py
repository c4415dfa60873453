"""The figures of filters: the paper's sensor on a stage that rests and turns."""

from __future__ import annotations

import numpy as np

from calrig.estimation.kalman import KalmanFilter
from calrig.noise.filters import FilterStudy, study_filters

from .sensor import benches, log_of

PAPER_RAW_DEG, PAPER_FUSED_DEG = 0.330, 0.143
RATES_HZ = (50.0, 100.0, 200.0)
VELOCITY_DPS, ACCELERATION_DPS2 = 20.0, 80.0
TARGETS_DEG = (30.0, 60.0, 20.0, -30.0, 0.0)
FIRST_REST_S, REST_S = 60.0, 10.0
HOME_S = 2.0


def study(rate_hz: float, seed: int = 2) -> FilterStudy:
    """Every filter on a log of rest and moves; what is measured at one place by one axis is so by all."""
    rig = benches(rate_hz, seed)
    for bench in rig:
        begin_s = bench.mechanics.home(0.0, VELOCITY_DPS, ACCELERATION_DPS2).at_s + HOME_S
        now_s = begin_s + FIRST_REST_S
        for target_deg in TARGETS_DEG:
            now_s = bench.mechanics.move(now_s, target_deg, VELOCITY_DPS, ACCELERATION_DPS2).at_s + REST_S
    time_s = begin_s + np.arange(int((now_s - begin_s) * rate_hz)) / rate_hz
    return study_filters(log_of(rig, time_s, rate_hz), time_s)


def jitter_table(studies: dict[float, FilterStudy], logged: FilterStudy | None) -> str:
    """Jitter per 100 ms at rest, raw and of the paper's filter, and of the one tuned to the noise."""
    of_log = [] if logged is None else [_jitters(f"public log, {logged.rate_hz:.0f} Hz", logged)]
    rows = [
        "| | accelerometer alone | the paper's Kalman filter | tuned to this noise |",
        "| --- | --- | --- | --- |",
        f"| paper | {PAPER_RAW_DEG:.3f}° | {PAPER_FUSED_DEG:.3f}° | |",
        *(_jitters(f"simulated, {rate_hz:g} Hz", one) for rate_hz, one in studies.items()),
        *of_log,
    ]
    return "\n".join(rows)


def other_jitters(one: FilterStudy) -> str:
    """The paper's filter by what else jitter per 100 ms might mean."""
    (jitter,) = (row.jitter for row in one.comparison.rows if row.name == "kalman_paper")
    if jitter is None or jitter.step_deg is None:
        return "not known"
    within, between = jitter.peak_to_peak_deg, jitter.step_deg
    return f"{within:.3f}° peak to peak within 100 ms, {between:.3f}° from one mean to the next"


def _jitters(name: str, one: FilterStudy) -> str:
    rows = {row.name: row for row in one.comparison.rows}
    cells = []
    for filter_name in ("raw", "kalman_paper", "kalman_tuned"):
        jitter = rows[filter_name].jitter
        cells.append("–" if jitter is None else f"{jitter.std_deg:.3f}°")
    return f"| {name} | {' | '.join(cells)} |"


def moves_table(one: FilterStudy) -> str:
    """What each filter does while the stage turns."""
    rows = ["| filter | jitter at rest | lag | largest offset |", "| --- | --- | --- | --- |"]
    for row in one.comparison.rows:
        if row.jitter is None or row.transient is None:
            continue
        lag = f"{row.transient.lag_ms:.0f} ± {2 * row.transient.lag_std_ms:.0f} ms"
        offset = f"{row.transient.largest_offset_deg:.2f}°"
        rows.append(f"| {row.label} | {row.jitter.std_deg:.3f}° | {lag} | {offset} |")
    return "\n".join(rows)


def slow_reading(seed: int = 5) -> tuple[float, float]:
    """Spread of the angle at rest, raw and by the paper's filter, where a loop takes one sample in 100 ms."""
    rate_hz = 10.0
    time_s = HOME_S + np.arange(int(600.0 * rate_hz)) / rate_hz
    log = log_of(benches(rate_hz, seed), time_s, rate_hz)
    angle_deg = np.degrees(np.arctan2(log["accel_y_g"], log["accel_z_g"]))
    fused_deg = KalmanFilter().run(time_s, angle_deg, log["gyro_x_dps"])
    at_rest = time_s > FIRST_REST_S
    return float(angle_deg[at_rest].std()), float(fused_deg[at_rest].std())
