"""Determine the settling time: until gyro and filter show nothing of the move any more."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.poses import Filtering, Pose
from calrig.calibration.regression.motion import filter_share
from calrig.estimation.angles import FloatArray

WINDOW_S = 0.05
"""Over which a rate is averaged before it is compared with the noise: a ringing table has some 10 Hz."""
QUIET_STD = 5.0
"""Of the averaged rate within the dwell: one in a million of windows is beyond it by chance."""
MOST_MOVES = 0.95
"""Share of the moves that have come to rest by then."""
LEAST_S = 0.2
LONGEST_S, STEP_S = 5.0, 0.05
SHARE = 0.1
"""Of the uncertainty wanted: as much may the filter still show of a move."""
GAIN_ERROR = 0.03
"""Of an MPU-6050's gyro that was not calibrated: the tolerance of its data sheet."""


@dataclass(frozen=True, slots=True)
class Gyro:
    """What a filter still shows of a move depends on: its constants, and by how much its gyro is wrong."""

    filtering: Filtering
    gain_error: float = GAIN_ERROR


def ring_down_s(
    time_s: FloatArray, rate_dps: FloatArray, dwells: Sequence[tuple[float, float, float]]
) -> float | None:
    """Return how long after the stage's arrival the gyro still measures a move, in 19 of 20 moves.

    Args:
        time_s: (n,) of samples, increasing.
        rate_dps: (n,) rate about the stage's axis.
        dwells: of each pose when the stage was known to stand, and when its dwell began and ended.

    Returns:
        None where no pose has samples from before its dwell; the settling as it was where that was too short.
    """
    found = []
    for arrived_s, begin_s, end_s in dwells:
        first, dwell, last = np.searchsorted(time_s, (arrived_s, begin_s, end_s))
        width = round(WINDOW_S * (last - dwell) / (end_s - begin_s))
        if width < 1 or dwell - first < width or not np.isfinite(rate_dps[first:last]).all():
            continue
        averaged = np.convolve(rate_dps[first:last], np.full(width, 1.0 / width), "valid")
        still = averaged[dwell - first :]
        moving = np.flatnonzero(np.abs(averaged - still.mean()) > QUIET_STD * still.std())
        before = moving[moving < dwell - first]
        found.append(float(time_s[first + before[-1] + width - 1] - arrived_s) if len(before) else 0.0)
    return float(np.quantile(found, MOST_MOVES, method="higher")) if found else None


def forgotten_s(
    elevations_deg: Sequence[float], moves_s: Sequence[float], dwell_s: float, gyro: Gyro, allowed_deg: float
) -> float:
    """The shortest settling after which the filter shows no more of a gyro's wrong gain than is allowed.

    The RMS over the poses of κ·gain error·move (`filter_share`); `LONGEST_S` where none is long enough.

    Poses are in the order of visiting; `moves_s` are how long the move to each takes, and `dwell_s` is of
    each.
    """
    moves_deg = np.diff(np.asarray(elevations_deg), prepend=elevations_deg[0])
    least_s = LONGEST_S
    filtering = replace(gyro.filtering, dwell_s=dwell_s)
    for settle_s in np.arange(LONGEST_S, LEAST_S - 1e-9, -STEP_S):
        ends_s = np.cumsum(np.asarray(moves_s) + settle_s + dwell_s)
        poses = [
            Pose(
                target_deg=elevation,
                reading_deg=elevation,
                time_s=float(end_s) - 0.5 * dwell_s,
                settle_s=float(settle_s),
                filtering=filtering,
            )
            for elevation, end_s in zip(elevations_deg, ends_s, strict=True)
        ]
        shown_deg = gyro.gain_error * filter_share(poses) * moves_deg
        if math.sqrt(float(np.mean(shown_deg**2))) > allowed_deg:
            break
        least_s = float(settle_s)
    return round(least_s, 2)
