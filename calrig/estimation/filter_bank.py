"""The filters that are compared: the paper's smoothers and Kalman filter, and the Kalman filter tuned."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.estimation.gains import filter_uniform
from calrig.estimation.kalman import KalmanFilter, KalmanNoise
from calrig.estimation.smoothers import (
    MOVING_AVERAGE_WINDOW,
    SAVITZKY_GOLAY_ORDERS,
    SAVITZKY_GOLAY_WINDOW,
    moving_average,
    savitzky_golay,
)
from calrig.estimation.tuning import midpoint_rate_dps

EVEN = 0.01
"""Intervals that differ from their mean by less than this share of it count as one."""
NO_GYRO = "the log has no rate about the axis of elevation, which this filter needs"
NOT_TUNED = "the noise of this unit's gyro and elevation is not known, from which it would be tuned"

Smoother = Callable[[FloatArray], FloatArray]
Run = Callable[[FloatArray, FloatArray, FloatArray | None], FloatArray]
"""Time, elevation and rate (or None) of one segment without a gap to the filtered angle."""


@dataclass(frozen=True, slots=True)
class Filter:
    """One filter.

    Attributes:
        name: for programs: `raw`, `moving_average`, `savitzky_golay_2`, `kalman_paper`, `kalman_tuned`;
            `_centred` at the end where it looks ahead.
        label: for people.
        causal: whether a controller can run it.
        run: what it does to a segment; None where it cannot be run on this log.
        reason: why not.
    """

    name: str
    label: str
    causal: bool
    run: Run | None
    reason: str = ""


def filter_bank(*, with_gyro: bool, tuned: KalmanNoise | None, gyro_scale: float = 1.0) -> list[Filter]:
    """Every filter, in the order in which tables and figures show them.

    Args:
        with_gyro: whether the log has a rate.
        tuned: noise of the tuned filter, which is driven by `midpoint_rate_dps`.
        gyro_scale: what the rate is multiplied by for it.
    """
    return [
        Filter("raw", "accelerometer alone", True, lambda _time, elevation, _rate: elevation),
        *_smoothers(),
        _kalman("kalman_paper", "Kalman, the paper's constants", with_gyro, KalmanNoise(), None),
        _kalman("kalman_tuned", "Kalman, tuned from the noise", with_gyro, tuned, gyro_scale),
    ]


def _smoothers() -> Iterator[Filter]:
    golay = f"Savitzky-Golay of {SAVITZKY_GOLAY_WINDOW}, order"
    kinds: list[tuple[str, str, Callable[..., FloatArray]]] = [
        ("moving_average", f"moving average of {MOVING_AVERAGE_WINDOW}", moving_average),
        *(
            (f"savitzky_golay_{order}", f"{golay} {order}", partial(savitzky_golay, order=order))
            for order in SAVITZKY_GOLAY_ORDERS
        ),
    ]
    for name, label, smooth in kinds:
        for centred in (False, True):
            yield Filter(
                name + "_centred" * centred,
                label + ", centred" * centred,
                not centred,
                _of_elevation(partial(smooth, centred=centred)),
            )


def _of_elevation(smooth: Smoother) -> Run:
    return lambda _time, elevation, _rate: smooth(elevation)


def _kalman(
    name: str, label: str, with_gyro: bool, noise: KalmanNoise | None, gyro_scale: float | None
) -> Filter:
    """A Kalman filter; with a `gyro_scale` it is driven by the scaled rate between samples."""
    if not with_gyro:
        return Filter(name, label, True, None, NO_GYRO)
    if noise is None:
        return Filter(name, label, True, None, NOT_TUNED)

    def run(time_s: FloatArray, elevation_deg: FloatArray, rate_dps: FloatArray | None) -> FloatArray:
        if rate_dps is None:
            raise ValueError(NO_GYRO)
        rate = rate_dps if gyro_scale is None else gyro_scale * midpoint_rate_dps(rate_dps)
        return kalman_filtered(time_s, elevation_deg, rate, noise)

    return Filter(name, label, True, run)


def kalman_filtered(
    time_s: FloatArray, elevation_deg: FloatArray, rate_dps: FloatArray, noise: KalmanNoise
) -> FloatArray:
    """The filtered angle of one segment, by the fast path where its intervals are `EVEN`."""
    steps = np.diff(time_s)
    if len(steps) and np.ptp(steps) <= EVEN * steps.mean():
        return filter_uniform(elevation_deg, rate_dps, float(steps.mean()), noise)
    return KalmanFilter(noise).run(time_s, elevation_deg, rate_dps)
