"""A run's result, wherever one is needed: its poses, the effects in force, and what its stage is worth."""

from __future__ import annotations

from collections.abc import Sequence

from calrig.calibration.correction import numbers_of
from calrig.calibration.pose import Pose
from calrig.calibration.result import AppliedEffect, GyroFigures, Result, build_result, residuals
from calrig.store import Run, Store
from calrig.store.records import Document, reference_of


def effects_in_force(store: Store, unit: str, rig: str | None) -> list[AppliedEffect]:
    """The effects accepted for a unit and a rig, as they are applied."""
    return [(e.name, numbers_of(e.parameters)) for e in store.effects_in_force(unit, rig)]


def fitted(
    store: Store,
    *,
    unit: str,
    rig: str | None,
    provenance: Document,
    poses: Sequence[Pose],
    gyro: GyroFigures | None = None,
) -> Result:
    """The result of poses of a unit on a rig.

    Args:
        store: where accepted effects are kept.
        unit: whose effects are in force.
        rig: the same; None where none is known.
        provenance: of the run; says what the stage was worth when it was made.
        poses: those that count, at least one.
        gyro: what the run's samples say of the gyro.
    """
    return build_result(poses, gyro, effects_in_force(store, unit, rig), reference_of(provenance))


def refitted(store: Store, run: Run, poses: Sequence[Pose]) -> Document:
    """The result of a run that has one, computed again from some of its poses.

    What it says of the gyro stays: that is from samples, which may have been pruned.
    """
    assert run.result is not None  # noqa: S101 (the callers look)
    again = fitted(store, unit=run.unit, rig=run.rig, provenance=run.provenance, poses=poses)
    return {**again.to_dict(), "gyro": run.result["gyro"]}


def pose_residuals_deg(run: Run, poses: Sequence[Pose]) -> list[float | None]:
    """What a run's bias and scale leave of each of its poses; None throughout before it has a result."""
    if run.result is None:
        return [None] * len(poses)
    return residuals(poses, run.result["bias_deg"], run.result["scale"])
