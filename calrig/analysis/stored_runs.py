"""What every analysis begins with: stored runs, those that belong together, and the poses that count."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from calrig.analysis.errors import Conflict, Invalid, Unknown
from calrig.analysis.mounts import axis_of
from calrig.calibration.poses import Pose
from calrig.store.records import AT_REST, Run

if TYPE_CHECKING:
    from calrig.store import Store

LONGEST_REASON = 1000
MOST_POSES = 4_000
"""Of one diagnosis: a hundred name an effect of the size of the noise. Each thousand takes 10–20 s of a core
and 140 MB, a few times as long on a small machine: these fit what a piece of heavy work may take.
"""


def stored_run(store: Store, run_id: str) -> Run:
    """The run.

    Raises:
        Unknown: there is none.
    """
    run = store.run(run_id)
    if run is None:
        raise Unknown(f"there is no run {run_id}")
    return run


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


def counted_poses(store: Store, run_id: str) -> list[Pose]:
    """The poses of a run that nobody has excluded."""
    return [stored.pose for stored in store.poses(run_id, include_excluded=False)]


def poses_together(store: Store, runs: Sequence[Run]) -> list[list[Pose]]:
    """The poses of each run that count, as a diagnosis takes them.

    Raises:
        Invalid: they are more than one diagnosis takes. None are left out: an effect shows in how a pose
            follows on the one before, and which of them may be missed is for the person to say.
    """
    n = sum(store.count_poses(run.id) for run in runs)
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
        if (axis := axis_of(one)) != "x":
            raise Conflict(
                f"run {one.id} had the unit's {axis} along the stage's axis: a diagnosis is of elevations "
                "about x; `solve` takes it"
            )
    return runs
