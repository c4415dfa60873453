"""Diagnoses of stored runs: made, kept, drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.stored_runs import counted_poses, limits_of, poses_together, runs_together, stored_run
from calrig.calibration.diagnosis import PartialResidual, partial_residuals, trace
from calrig.calibration.poses import DiagnosisError
from calrig.store.records import Run

if TYPE_CHECKING:
    from calrig.store import Store


class Diagnoses:
    """Traces what calibration left of stored runs, and remembers what was found."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def question(self, run_id: str, more: Sequence[str] = ()) -> Callable[..., dict[str, Any]]:
        """What a run's poses, with more runs of its unit and those it follows on, are to be asked.

        Returns:
            What gives the diagnosis, here or in another process, or raises DiagnosisError; its `progress` as
            of `trace`.

        Raises:
            Unknown: there is no such run.
            Conflict: a run is of another unit, or has not ended.
            Invalid: the poses are too many.
        """
        runs = runs_together(self._store, run_id, more)
        latest = runs[-1]
        return partial(
            trace,
            poses_together(self._store, runs),
            [run.id for run in runs],
            plan=latest.plan,
            limits_deg=limits_of(latest),
            deciding=self._deciding(latest) if len(runs) > 1 else None,
        )

    def keep(self, run_id: str, found: dict[str, Any]) -> dict[str, Any]:
        """Keeps the answer with the run."""
        _keep_accepted(stored_run(self._store, run_id).diagnosis, found)
        self._store.update_run(run_id, diagnosis=found)
        return found

    def last(self, run_id: str) -> dict[str, Any]:
        """The last diagnosis of a run (Unknown where it has none)."""
        found = stored_run(self._store, run_id).diagnosis
        if found is None:
            raise Unknown(f"run {run_id} has not been diagnosed")
        return found

    def partial_residuals(self, run_id: str) -> list[PartialResidual]:
        """Each effect of a run's last diagnosis in the poses it rests on, those of them that still count.

        Raises:
            Unknown: there is no such run, or it has not been diagnosed.
            Conflict: what counts now cannot show an effect any more; says what to do.
        """
        run, found = stored_run(self._store, run_id), self.last(run_id)
        runs = [counted_poses(self._store, earlier) for earlier in found["runs"][:-1]]
        decided_on = _decided_on(run) if runs else None
        latest = self._store.poses(run_id, include_excluded=False)
        runs.append([s.pose for s in latest if decided_on is None or s.index in decided_on])
        try:
            return partial_residuals(runs, found["effects"], found["runs"])
        except DiagnosisError as error:
            raise Conflict(f"run {run_id}: {error}") from error

    def _deciding(self, run: Run) -> list[int] | None:
        """Places, among the poses of a follow-up that count, of those that served to decide."""
        decided_on = _decided_on(run)
        if decided_on is None:
            return None
        counting = self._store.poses(run.id, include_excluded=False)
        return [place for place, stored in enumerate(counting) if stored.index in decided_on]


def _decided_on(run: Run) -> list[int] | None:
    """Indices of the poses of a follow-up that served to decide; None for any other run."""
    return (run.provenance.get("follow_up") or {}).get("decided_on")


def _keep_accepted(before: dict[str, Any] | None, found: dict[str, Any]) -> None:
    """An effect found once more with the very same values has been accepted; with others it has not."""
    for earlier in [] if before is None else before["effects"]:
        for effect in found["effects"]:
            if all(effect[key] == earlier[key] for key in ("name", "parameters")):
                effect["accepted_at"] = earlier.get("accepted_at")
