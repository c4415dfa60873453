"""A run's poses with what its samples say of the gyro's three axes, as a file of poses has it in columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from typing import TYPE_CHECKING

import numpy as np

from calrig.calibration.poses import GYRO_MEANS, GYRO_MOVES, HOST_TIME, Pose
from calrig.estimation.angles import FloatArray
from calrig.estimation.gyro import MISSING_PERIODS, moves_about_axes

if TYPE_CHECKING:
    from calrig.store import Store


def poses_with_gyro(store: Store, run_id: str) -> list[Pose]:
    """The poses that count, each with its dwell's means, its move's turns, and the host's time.

    A run with mounts has the turns in its poses; of one without they are made of its samples while these are
    kept.
    A move is told where neither of its two poses was excluded, and none of its samples is missing.
    """
    stored = store.poses(run_id, include_excluded=True)
    poses = [one.pose for one in stored]
    if not any(GYRO_MOVES[0] in pose.covariates for pose in poses):
        poses = _of_samples(store, run_id, poses, [one.index for one in stored])
    announced = store.poses_announced_at(run_id)
    after = [None, *stored[:-1]]
    return [
        _told(pose, announced.get(one.index), lost=before is not None and before.excluded is not None)
        for pose, one, before in zip(poses, stored, after, strict=True)
        if one.excluded is None
    ]


def _of_samples(store: Store, run_id: str, poses: list[Pose], indices: Sequence[int]) -> list[Pose]:
    """The poses as they are, where their samples are not stored or their clock began anew."""
    whole = store.samples(run_id)
    dwells = [store.samples(run_id, index) for index in indices]
    if (
        len(whole.time_s) < 2
        or not (np.diff(whole.time_s) > 0.0).all()
        or any(not len(d.time_s) for d in dwells)
    ):
        return poses
    gap_s = MISSING_PERIODS * float(np.median(np.diff(whole.time_s)))
    spans = [(float(dwell.time_s[0]), float(dwell.time_s[-1])) for dwell in dwells]
    turned = moves_about_axes(whole.time_s, whole.gyro_dps, spans, gap_s)
    means = [dwell.gyro_dps.mean(axis=0) for dwell in dwells]
    return [_with(pose, mean, move) for pose, mean, move in zip(poses, means, turned, strict=True)]


def _with(pose: Pose, mean_dps: FloatArray, turned_deg: FloatArray | None) -> Pose:
    columns = dict(zip(GYRO_MEANS, mean_dps.tolist(), strict=True)) if np.isfinite(mean_dps).all() else {}
    if turned_deg is not None:
        columns |= dict(zip(GYRO_MOVES, turned_deg.tolist(), strict=True))
    return replace(pose, covariates={**pose.covariates, **columns})


def _told(pose: Pose, at: datetime | None, *, lost: bool) -> Pose:
    """The pose with the host's time, s: as it was announced, the same while after each dwell's middle."""
    host = {} if at is None else {HOST_TIME: at.timestamp()}
    kept = {k: v for k, v in pose.covariates.items() if not (lost and k in GYRO_MOVES)}
    return replace(pose, covariates={**kept, **host})
