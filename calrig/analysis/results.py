"""A run's result, wherever one is needed: its poses, the effects in force, and what its stage is worth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from calrig.calibration.poses import Pose, of_first_mount
from calrig.calibration.results import FittedResult, build_result, residuals
from calrig.calibration.separation import beyond_in_words, dial_of, map_reference
from calrig.calibration.uncertainty import AS_PLANNED, Ending
from calrig.model.result import Gyro, Reference, Result
from calrig.store.records import AcceptedEffect, Document, Run, as_applied, doubt_of, map_of, reference_of

if TYPE_CHECKING:
    from calrig.store import Store


def fitted(
    poses: Sequence[Pose],
    accepted: Sequence[AcceptedEffect],
    provenance: Document,
    gyro: Gyro | None = None,
    ending: Ending = AS_PLANNED,
    run_id: str | None = None,
) -> FittedResult:
    """The result of poses of a unit on a rig.

    `poses` are those that count, at least one. `provenance` says what the stage was worth when the run was
    made, and what of a sweep was lost. `run_id` is None before an effect can have been accepted from it.
    """
    taken = accepted if not rest_on_map(poses) else [e for e in accepted if e.unit is not None]
    reference = reference_over(poses, provenance, bent=bool(taken))
    result = build_result(
        poses,
        gyro,
        as_applied(taken),
        reference,
        unused_map_says(poses, provenance),
        ending,
        doubt_of(taken, run_id),
    )
    return result.model_copy(update={"lost_says": (provenance.get("sweep") or {}).get("lost")})


def rest_on_map(poses: Sequence[Pose]) -> bool:
    """Whether elevations rest on the stage's map, which has all of the stage's errors in it.

    What was accepted of the rig (its play, its eccentricity) would be taken out twice.
    """
    return all(pose.map_deg is not None for pose in poses)


def reference_over(poses: Sequence[Pose], provenance: Document, *, bent: bool) -> Reference | None:
    """What a run's elevations rest on: the stage's map, else its certificate; None where there is neither.

    `poses` are those of the run that count, as the store gives them: with the map or, beyond it, without.
    `bent` tells whether effects are taken out beside bias and scale.
    """
    certificate, in_force = reference_of(provenance), map_of(provenance)
    if in_force is None or not rest_on_map(poses):
        return certificate
    poses = of_first_mount(poses)
    theta_deg = np.array([pose.theta_deg for pose in poses])
    return map_reference(in_force, theta_deg, *dial_of(poses), level=certificate, bent=bent)


def unused_map_says(poses: Sequence[Pose], provenance: Document) -> str | None:
    """Why the map in force was not used for a run, and what it rests on instead; None where it was."""
    in_force = map_of(provenance)
    if in_force is None or rest_on_map(poses):
        return None
    instead = (
        "The uncertainty is that of the stage's certificate."
        if reference_of(provenance) is not None
        else "No certificate says what the stage is worth beyond the map: the uncertainty is not known."
    )
    return f"{beyond_in_words(poses, in_force)} {instead}"


def refitted(
    store: Store, run: Run, poses: Sequence[Pose], accepted: Sequence[AcceptedEffect] | None = None
) -> Result:
    """The result of a run that has one, computed again from some of its poses.

    What it says of the gyro stays: that is from samples, which may have been pruned. `accepted` are the
    effects taken out; None for those in force.
    """
    if accepted is None:
        accepted = store.effects.in_force(run.unit, run.rig)
    result = fitted(poses, accepted, run.provenance, gyro_of(run), ending_of(run), run.id)
    if run.result is not None and "doubts" in run.result.model_fields_set:  # until the next draft says
        result = result.with_doubts(run.result.doubts)
    return result


def gyro_of(run: Run) -> Gyro | None:
    """What a stored run says of the gyro; None before it has a result."""
    return None if run.result is None else run.result.gyro


def ending_of(run: Run) -> Ending:
    """How a stored run came to its end; as planned before it has a result."""
    return Ending(
        may_be_early=(run.plan or {}).get("until") is not None,
        stopped_by="plan" if run.result is None else run.result.stopped_by,
    )


def pose_residuals_deg(run: Run, poses: Sequence[Pose]) -> list[float | None]:
    """What a run's bias and scale leave of each of its poses.

    None throughout before it has a result, and where the reading does not follow the stage.
    """
    if run.result is None or run.result.rms_calibrated_deg is None:
        return [None] * len(poses)
    return residuals(poses, run.result.bias_deg, run.result.scale)
