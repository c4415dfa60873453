"""How far the stage turned while a pose was read: in a dwell not at all, in a stretch by its length.

A stretch is the mean over its way. What is a function of the elevation alone and bends little over 10° is
there as in a dwell; a wave of period P keeps sin(πL/P)/(πL/P) of its amplitude over a way L, and may change
its sign. The gyro's account goes from middle to middle and keeps the whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np

from calrig.calibration.channels import BoolArray
from calrig.calibration.pose import Pose
from calrig.estimation.angles import FloatArray


def stretches_deg(poses: Sequence[Pose]) -> FloatArray:
    """(n,) way of the stage during each pose of a run, degrees; 0 where it stood, or nothing tells.

    A stretch lasts as long as its samples, and turns as its pass does from the first to the last middle.
    """
    way_deg = np.zeros(len(poses))
    for is_dwell, group in groupby(range(len(poses)), key=lambda k: poses[k].settled):
        places = list(group)
        first, last = poses[places[0]], poses[places[-1]]
        if is_dwell or first.time_s is None or last.time_s is None or last.time_s <= first.time_s:
            continue
        velocity_dps = abs(last.theta_deg - first.theta_deg) / (last.time_s - first.time_s)
        way_deg[places] = [velocity_dps * _lasts_s(poses[k]) for k in places]
    return way_deg


def kept_in_mean(stretch_deg: FloatArray, period_deg: float) -> FloatArray:
    """(n,) share of a wave's amplitude that is left in the mean over each way (n,)."""
    return np.asarray(np.sinc(stretch_deg / period_deg), dtype=np.float64)


class Behind(NamedTuple):
    """How far what follows the stage through a first-order lag is behind it, each (n,), degrees.

    `mean_deg` over each pose, and `grown_deg` from the middle of the stretch before, or the end of the dwell,
    to the middle of the stretch, or the begin of the dwell: what a gyro feels less of.
    """

    mean_deg: FloatArray
    grown_deg: FloatArray


def behind(
    time_s: FloatArray, theta_deg: FloatArray, stretch_deg: FloatArray, starts: BoolArray, lag_s: float
) -> Behind:
    """What follows the stage through a lag, in a sweep whose first pose had settled.

    Between two stretches the stage turns evenly, before one it stood and behind one it comes to a stand, all
    at one velocity; dwells are as long as stretches are.

    Args:
        time_s: (n,) of the poses' middles.
        theta_deg: (n,) elevations.
        stretch_deg: (n,) as `stretches_deg` has them.
        starts: (n,) whether a pose is the first of its run.
        lag_s: time constant.
    """
    turning = stretch_deg > 0.0
    way_deg, took_s = np.diff(theta_deg, prepend=theta_deg[:1]), np.diff(time_s, prepend=time_s[:1])
    evenly = turning & np.roll(turning, 1) & ~starts & (took_s > 0.0)
    if not evenly.any():
        return Behind(np.zeros(len(time_s)), np.zeros(len(time_s)))
    pace_dps = float(np.median(np.abs(way_deg[evenly] / took_s[evenly])))
    half = 0.5 * float(np.median(stretch_deg[turning])) / pace_dps / lag_s
    steady_deg = np.where(turning, np.sign(way_deg) * pace_dps * lag_s, 0.0)
    middle_deg = np.zeros(len(time_s))
    for k in np.flatnonzero(~starts).tolist():
        moved_s = min(abs(way_deg[k]) / pace_dps, took_s[k])
        stood, kept = np.exp(-(took_s[k] - moved_s) / lag_s), np.exp(-moved_s / lag_s)
        driven_deg = np.sign(way_deg[k]) * pace_dps * lag_s * (1.0 - kept)
        before_deg = middle_deg[k - 1] * (stood if turning[k] else 1.0)
        middle_deg[k] = (before_deg * kept + driven_deg) * (1.0 if turning[k] else stood)
    mean_deg = steady_deg + (middle_deg - steady_deg) * np.sinh(half) / half
    from_deg = np.roll(np.where(turning, middle_deg, middle_deg * np.exp(-half)), 1)
    to_deg = np.where(turning, middle_deg, middle_deg * np.exp(half))
    return Behind(mean_deg, np.where(starts, 0.0, to_deg - from_deg))


def _lasts_s(pose: Pose) -> float:
    return (pose.n_samples or 0) / pose.filtering.rate_hz if pose.filtering else 0.0
