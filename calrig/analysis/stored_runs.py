"""Stored runs as an analysis takes them: their clamping, included poses, and runs that belong together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from calrig.analysis.errors import Conflict, Invalid, Unknown
from calrig.calibration.diagnosis import MOST_POSES, Findings, diagnose
from calrig.calibration.poses import MOUNT_DEG, DiagnosisError, Pose
from calrig.calibration.regression import ASSUMED, AssumedReference, DiagnosisRequest
from calrig.export.poses_csv import Labels
from calrig.model.run import AT_REST, mount_axis
from calrig.processes.pool import run_in_subprocess
from calrig.store.records import Run, Unit

if TYPE_CHECKING:
    from calrig.settings import RigSettings
    from calrig.store import Store


def mount_columns(run_id: str, axis: str, pose: Pose) -> dict[str, str | float]:
    """How the unit was clamped for a pose; `mount` is what it shares with those of the same clamping."""
    return {"mount": f"{run_id} {pose.mount_deg:g}°", MOUNT_DEG: pose.mount_deg, "mount_axis": axis}


def labels_of(run: Run) -> Callable[[Pose], Labels] | None:
    """What a table of a run's poses says of each in words; None where nothing was asked of mounts."""
    plan, axis = run.plan or {}, mount_axis(run.plan, run.provenance)
    if plan.get("mounts_deg", [0.0]) == [0.0] and axis == "x":
        return None

    def labels(pose: Pose) -> Labels:
        columns = mount_columns(run.id, axis, pose)
        return {name: str(columns[name]) for name in ("mount", "mount_axis")}

    return labels


LONGEST_REASON = 1000


def stored_run(store: Store, run_id: str) -> Run:
    """The run.

    Raises:
        Unknown: there is none.
    """
    run = store.runs.get(run_id)
    if run is None:
        raise Unknown(f"there is no run {run_id}")
    return run


def known_unit(store: Store, serial: str) -> Unit:
    """The unit.

    Raises:
        Unknown: there is none.
    """
    unit = store.units.get(serial)
    if unit is None:
        raise Unknown(f"there is no unit {serial!r}")
    return unit


def ended_run(store: Store, run_id: str) -> Run:
    """The run, of which nothing is being measured any more.

    Raises:
        Unknown: there is none.
        Conflict: it is going on.
    """
    run = stored_run(store, run_id)
    if run.status not in AT_REST:
        raise Conflict(f"run {run_id} is {run.status}: end it first")
    return run


def checked_reason(reason: str) -> str:
    """A reason without blanks at its ends; Invalid where there is none, or too much of it."""
    if not reason.strip():
        raise Invalid("a reason is needed: it stays with the run", ["reason"])
    if len(reason) > LONGEST_REASON:
        said = f"a reason has at most {LONGEST_REASON} characters, not {len(reason)}"
        raise Invalid(said, ["reason"])
    return reason.strip()


def limits_of(run: Run) -> tuple[float, float] | None:
    """The soft limits that a run was made under; None of an imported one."""
    limits = (run.provenance.get("rig") or {}).get("limits_deg")
    return None if limits is None else (float(limits[0]), float(limits[1]))


def request_of(
    run: Run,
    rig: RigSettings | None,
    reference: AssumedReference | None = None,
    periods_deg: Sequence[float] = (),
) -> DiagnosisRequest:
    """What a diagnosis of a run assumes: as asked, else as its import stated, else as its rig says.

    `rig` is as configured; None where it is not known here, and what it was counts. `reference` and
    `periods_deg` are as asked, the periods beside the rig's own.

    Raises:
        DiagnosisError: a period is out of its limits.
    """
    stated = rig.model_dump(include={"reference", "periods_deg"}) if rig else run.provenance.get("rig") or {}
    of_stage = stated.get("reference") or {}
    usual: AssumedReference = "good" if of_stage.get("good") else "stage"
    known_deg = (*stated.get("periods_deg", ()), *periods_deg)
    return DiagnosisRequest(
        reference or run.provenance.get(ASSUMED) or usual, known_deg, of_stage.get("std_deg")
    )


def last_request(run: Run) -> DiagnosisRequest:
    """What the last diagnosis of a run assumed; without one, what its rig said when it was made."""
    return request_of(run, None) if run.diagnosis is None else DiagnosisRequest.of_document(run.diagnosis)


def counted_poses(store: Store, run_id: str) -> list[Pose]:
    """The poses of a run that nobody has excluded."""
    return [stored.pose for stored in store.poses.of(run_id, include_excluded=False)]


def poses_together(store: Store, runs: Sequence[Run]) -> list[list[Pose]]:
    """The poses of each run that count, as a diagnosis takes them.

    Raises:
        Invalid: they are more than one diagnosis takes. None are left out: an effect shows in how a pose
            follows on the one before, and which of them may be missed is for the person to say.
    """
    n = sum(store.poses.count(run.id) for run in runs)
    if n > MOST_POSES:
        raise Invalid(
            f"run {', '.join(run.id for run in runs)}: a diagnosis takes at most {MOST_POSES:,} poses, and "
            f"these are {n:,}: import a part of them as a run, best one sweep after the other"
        )
    return [counted_poses(store, run.id) for run in runs]


def runs_together(store: Store, run_id: str, more: Sequence[str] = ()) -> list[Run]:
    """A run with those it follows on and further ones of its unit, in the order measured, itself last.

    Raises:
        Unknown: there is no such run.
        Conflict: a run is of another unit, or has not ended.
    """
    run = stored_run(store, run_id)
    wanted = {other: stored_run(store, other) for other in more if other != run_id}
    follows = run.follows
    while follows is not None:
        wanted[follows] = stored_run(store, follows)
        follows = wanted[follows].follows
    for other in wanted.values():
        if other.unit != run.unit:
            raise Conflict(f"run {other.id} is of unit {other.unit!r}, run {run_id} of unit {run.unit!r}")
    runs = [*sorted(wanted.values(), key=lambda r: r.created_at), run]
    for one in runs:
        if one.status not in AT_REST:
            raise Conflict(f"run {one.id} is {one.status}: wait until it has ended")
        if (axis := mount_axis(one.plan, one.provenance)) != "x":
            raise Conflict(
                f"run {one.id} had the unit's {axis} along the stage's axis: a diagnosis is of elevations "
                "about x; `solve` takes it"
            )
    return runs


@dataclass(frozen=True, slots=True)
class AmbiguousRuns:
    """Runs of one unit in the order measured, the poses of each that count, and what was found in them."""

    run_ids: list[str]
    poses: list[list[Pose]]
    findings: Findings

    @classmethod
    def of(cls, run_ids: list[str], poses: list[list[Pose]], request: DiagnosisRequest) -> AmbiguousRuns:
        """Runs whose poses are diagnosed quickly: without errors on held-out poses; as `unresolved`."""
        try:
            return cls(run_ids, poses, run_in_subprocess(partial(found_in, poses, request)))
        except DiagnosisError as error:
            raise Conflict(f"run {run_ids[-1]}: {error}") from error


def unresolved(store: Store, run_id: str) -> AmbiguousRuns:
    """A run with those it follows on, diagnosed quickly.

    Raises:
        Unknown: there is no such run.
        Conflict: one of them has not ended, or its poses cannot be diagnosed; says why.
        Invalid: they are too many.
    """
    runs = runs_together(store, run_id)
    request = last_request(runs[-1])
    return AmbiguousRuns.of([run.id for run in runs], poses_together(store, runs), request)


def found_in(poses: list[list[Pose]], request: DiagnosisRequest) -> Findings:
    """What a quick diagnosis of them finds; or DiagnosisError."""
    return diagnose(poses, request=request, cross_fit=False).findings
