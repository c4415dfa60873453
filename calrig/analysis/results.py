"""A run's result, wherever one is needed: its poses, the effects in force, and what its stage is worth."""

from __future__ import annotations

from collections.abc import Sequence

from calrig.calibration.correction import numbers_of
from calrig.calibration.early_end import AS_PLANNED, Ending
from calrig.calibration.pose import Pose
from calrig.calibration.result import AppliedEffect, GyroFigures, Result, build_result, residuals
from calrig.store import AcceptedEffect, Run, Store
from calrig.store.records import Document, reference_of


def as_applied(accepted: Sequence[AcceptedEffect]) -> list[AppliedEffect]:
    """Accepted effects as arithmetic takes them."""
    return [(effect.name, numbers_of(effect.parameters)) for effect in accepted]


def fitted(
    poses: Sequence[Pose],
    accepted: Sequence[AcceptedEffect],
    provenance: Document,
    gyro: GyroFigures | None = None,
    ending: Ending = AS_PLANNED,
) -> Result:
    """The result of poses of a unit on a rig.

    Args:
        poses: those that count, at least one.
        accepted: effects in force for the unit and the rig.
        provenance: of the run; says what the stage was worth when it was made.
        gyro: what the run's samples say of the gyro.
        ending: how it came to its end.
    """
    return build_result(poses, gyro, as_applied(accepted), reference_of(provenance), ending)


def refitted(store: Store, run: Run, poses: Sequence[Pose]) -> Document:
    """The result of a run that has one, computed again from some of its poses.

    What it says of the gyro stays: that is from samples, which may have been pruned.
    """
    accepted = store.effects_in_force(run.unit, run.rig)
    return fitted(poses, accepted, run.provenance, gyro_of(run), ending_of(run)).to_dict()


def gyro_of(run: Run) -> GyroFigures | None:
    """What a stored run says of the gyro; None before it has a result."""
    known = None if run.result is None else run.result.get("gyro")
    if known is None:
        return None
    return GyroFigures(
        bias_dps=tuple(known["bias_dps"]),
        bias_std_dps=tuple(known["bias_std_dps"]),
        scale=known["scale"],
        scale_std=known["scale_std"],
    )


def ending_of(run: Run) -> Ending:
    """How a stored run came to its end; as planned before it has a result."""
    return Ending(
        may_be_early=(run.plan or {}).get("until") is not None,
        stopped_by=(run.result or {}).get("stopped_by", "plan"),
    )


def pose_residuals_deg(run: Run, poses: Sequence[Pose]) -> list[float | None]:
    """What a run's bias and scale leave of each of its poses; None throughout before it has a result."""
    if run.result is None:
        return [None] * len(poses)
    return residuals(poses, run.result["bias_deg"], run.result["scale"])
