"""Wild poses: a reading so far from all others that no effect and no noise explains it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calrig.calibration.fit import reading_error_deg
from calrig.calibration.pose import Pose
from calrig.estimation.angles import FloatArray

WILD = 12.0
"""Robust standard deviations from what the neighbours in elevation and time say."""
MOST_SHARE = 0.03
NEIGHBOURS = 6


def without_outliers(runs: Sequence[Sequence[Pose]]) -> tuple[list[list[Pose]], list[str]]:
    """The runs less their wild poses, and a sentence for each of those.

    A pose is wild where its reading lies more than `WILD` robust standard deviations (1.4826 times the median
    absolute deviation) from the median of the neighbours in order and from that of those in elevation, both
    about a robust line: a slip moves all poses after it, an error of angle all near it, a wild pose is alone.
    """
    kept: list[list[Pose]] = []
    said: list[str] = []
    for number, run in enumerate(runs):
        wild = _wild(run)
        if len(wild) > max(1, int(MOST_SHARE * len(run))):
            wild = []
        kept.append([pose for k, pose in enumerate(run) if k not in wild])
        where = f" of run {number}" if len(runs) > 1 else ""
        said += [
            f"pose {k}{where} at {run[k].target_deg:g}° reads {run[k].reading_deg:g}°, far from all others: "
            "left out"
            for k in wild
        ]
    return kept, said


def _wild(run: Sequence[Pose]) -> list[int]:
    if len(run) < 2 * NEIGHBOURS:
        return []
    theta = np.array([pose.theta_deg for pose in run])
    error = reading_error_deg(theta, np.array([pose.reading_deg for pose in run]))
    error = error - _robust_line(theta, error)
    by_order = np.abs(error - _median_of_neighbours(error, np.arange(len(run))))
    by_angle = np.abs(error - _median_of_neighbours(error, np.argsort(theta, kind="stable")))
    distance = np.minimum(by_order, by_angle)
    scale = 1.4826 * float(np.median(distance))
    return [int(k) for k in np.flatnonzero(distance > WILD * max(scale, 1e-9))]


def _robust_line(theta: FloatArray, error: FloatArray) -> FloatArray:
    """A line through the medians of the lower, middle and upper third of θ (Tukey's resistant line)."""
    if np.ptp(theta) < 1.0:
        return np.full(len(theta), float(np.median(error)))
    low, high = np.quantile(theta, [1.0 / 3.0, 2.0 / 3.0])
    left, right = theta <= low, theta >= high
    run = float(np.median(theta[right]) - np.median(theta[left]))
    slope = float(np.median(error[right]) - np.median(error[left])) / run if run > 0.0 else 0.0
    return np.asarray(np.median(error - slope * theta) + slope * theta, dtype=np.float64)


def _median_of_neighbours(error: FloatArray, order: np.ndarray[tuple[int], np.dtype[np.intp]]) -> FloatArray:
    median = np.empty(len(error))
    half = NEIGHBOURS // 2
    for place, k in enumerate(order):
        first = min(max(place - half, 0), len(order) - NEIGHBOURS - 1)
        around = [j for j in order[first : first + NEIGHBOURS + 1] if j != k]
        median[k] = np.median(error[around])
    return median
