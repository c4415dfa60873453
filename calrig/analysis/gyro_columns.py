"""A run's poses with what its samples say of the gyro's three axes, as a file of poses has it in columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime

import numpy as np

from calrig.calibration.joint.gyro_dwells import MEANS
from calrig.calibration.joint.gyro_turns import MOVES
from calrig.calibration.joint.three_axis_gyro import HOST
from calrig.calibration.pose import Pose
from calrig.estimation.angles import FloatArray
from calrig.estimation.gyro import MISSING_PERIODS, moves_about_axes
from calrig.store import Store
from calrig.store.records import RawSamples


def poses_with_gyro(store: Store, run_id: str) -> list[Pose]:
    """The poses that count, with the means of each dwell and the turns of each move where samples are.

    A move is told where neither of its two poses was excluded, and none of its samples is missing.
    """
    stored = store.poses(run_id, include_excluded=True)
    whole = store.samples(run_id)
    dwells = [store.samples(run_id, one.index) for one in stored]
    poses = [one.pose for one in stored]
    if len(whole.time_s) > 1 and (np.diff(whole.time_s) > 0.0).all() and all(len(d.time_s) for d in dwells):
        turned = _turned(whole, dwells)
        after_a_gap = [True] + [before.excluded is not None for before in stored[:-1]]
        poses = [
            _with(pose, dwell.gyro_dps.mean(axis=0), None if lost else move)
            for pose, dwell, move, lost in zip(poses, dwells, turned, after_a_gap, strict=True)
        ]
    announced = store.poses_announced_at(run_id)
    return [
        _told(pose, announced.get(one.index))
        for pose, one in zip(poses, stored, strict=True)
        if one.excluded is None
    ]


def _told(pose: Pose, at: datetime | None) -> Pose:
    """The pose with the host's time, s: as it was announced, the same while after each dwell's middle."""
    if at is None:
        return pose
    return replace(pose, covariates={**pose.covariates, HOST: at.timestamp()})


def _turned(whole: RawSamples, dwells: Sequence[RawSamples]) -> list[FloatArray | None]:
    gap_s = MISSING_PERIODS * float(np.median(np.diff(whole.time_s)))
    spans = [(float(dwell.time_s[0]), float(dwell.time_s[-1])) for dwell in dwells]
    return moves_about_axes(whole.time_s, whole.gyro_dps, spans, gap_s)


def _with(pose: Pose, mean_dps: FloatArray, turned_deg: FloatArray | None) -> Pose:
    columns = dict(zip(MEANS, mean_dps.tolist(), strict=True)) if np.isfinite(mean_dps).all() else {}
    if turned_deg is not None:
        columns |= dict(zip(MOVES, turned_deg.tolist(), strict=True))
    return replace(pose, covariates={**pose.covariates, **columns})
