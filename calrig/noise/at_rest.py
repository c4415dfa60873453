"""Whether a log is of a sensor at rest: gravity keeps its direction in one that is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calrig.estimation.angles import FloatArray

LEAST_TURN_DEG = 5.0
"""Of gravity in the sensor: 87 mg, more than offsets drift by."""
MEAN_OVER_S = 1.0


def turn_deg(channels: Mapping[str, FloatArray], rate_hz: float, segments: Sequence[slice]) -> float | None:
    """How far gravity turns in the sensor, from means of a second, about its mean direction over all.

    Args:
        channels: (N,) each, by name with its unit.
        rate_hz: of the samples.
        segments: without gaps.

    Returns:
        The largest angle; None without three axes of an accelerometer in one unit, or without a whole second.
    """
    for unit in ("g", "lsb"):
        axes = [channels.get(f"accel_{axis}_{unit}") for axis in "xyz"]
        known = [axis for axis in axes if axis is not None]
        if len(known) == len(axes):
            break
    else:
        return None
    count = max(1, round(MEAN_OVER_S * rate_hz))
    means = np.column_stack([np.concatenate([_means(axis[s], count) for s in segments]) for axis in known])
    if not len(means):
        return None
    size = np.linalg.norm(means, axis=1)
    if not (size > 0.0).all():
        return None
    units = means / size[:, None]
    middle = units.mean(axis=0)
    along = units @ middle / max(float(np.linalg.norm(middle)), np.finfo(np.float64).tiny)
    return float(np.degrees(np.arccos(np.clip(along, -1.0, 1.0)).max()))


def _means(values: FloatArray, count: int) -> FloatArray:
    """Means of so many values each, one after the other."""
    whole = len(values) // count
    return np.asarray(values[: whole * count].reshape(whole, count).mean(axis=1), dtype=np.float64)
