"""How far the stage turned while a pose was read: of a dwell not at all, of a sweep's stretch a part of its way.

A stretch is the mean over its way. What is a function of the elevation alone and bends little over 10° is
there as in a dwell; a wave of period P keeps sin(πL/P)/(πL/P) of its amplitude over a way L, and may change
its sign. The gyro's account goes from middle to middle and keeps the whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

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


def _lasts_s(pose: Pose) -> float:
    return (pose.n_samples or 0) / pose.filtering.rate_hz if pose.filtering else 0.0
