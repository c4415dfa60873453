"""The stage's map that a run was made by, put upon its poses as they are read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from sqlmodel import Session, col, select

from calrig.calibration.separation import StageMap, with_map
from calrig.store.errors import Unreadable
from calrig.store.records import StoredPose, map_of
from calrig.store.tables import PoseTable, RunTable


def map_in_use(session: Session, run: RunTable) -> StageMap | None:
    """The map of a run; None where it has none, or a pose that counts stands beyond it.

    Half a run by a map and half by a certificate would have a step in it that is neither's.

    Raises:
        Unreadable: what the run keeps of it is damaged.
    """
    try:
        kept = map_of(run.provenance)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise Unreadable(f"the stage's map of run {run.uid} is not what was stored: {error}") from error
    if kept is None:
        return None
    wanted = select(PoseTable.stage_deg, PoseTable.target_deg).where(
        PoseTable.run_id == run.id, col(PoseTable.excluded_reason).is_(None)
    )
    dial = [target if stage is None else stage for stage, target in session.exec(wanted)]
    return kept if kept.covers(np.array(dial, dtype=np.float64)).all() else None


def put_upon(poses: Sequence[StoredPose], stage_map: StageMap | None) -> list[StoredPose]:
    """The poses with what the map adds to the dial."""
    if stage_map is None or not poses:
        return list(poses)
    mapped = with_map([one.pose for one in poses], stage_map)
    return [replace(one, pose=pose) for one, pose in zip(poses, mapped, strict=True)]
