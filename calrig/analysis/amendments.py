"""What is done to runs after they were measured, or instead: import, void, exclude. Nothing is deleted."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from calrig.analysis.errors import Conflict, Invalid, Unknown, checked_reason
from calrig.analysis.imported import Imported, read_and_fit
from calrig.analysis.issuing import Issuer
from calrig.analysis.origin import check_serial, provenance
from calrig.analysis.results import refitted
from calrig.analysis.stored_runs import stored_run
from calrig.export.poses_csv import CsvError
from calrig.store import AT_REST, Run, Store


class Records:
    """Imports and amendments in a store."""

    def __init__(self, store: Store, issuer: Issuer | None = None) -> None:
        self._store = store
        self._issuer = issuer or Issuer(store)

    def import_poses(
        self, *, unit: str, rig: str | None, file_name: str, content: bytes, operator: str | None = None
    ) -> Run:
        """Makes a completed run of a CSV of poses (CONTRACT section 4).

        Raises:
            Invalid: the serial is out of bounds or the file is bad; the message names line and column, and
                nothing is stored.
        """
        try:
            imported = self.question(unit, rig, content)()
        except CsvError as error:
            raise Invalid(f"{file_name}: {error}") from error
        return self.keep_imported(imported, unit=unit, rig=rig, file_name=file_name, operator=operator)

    def question(self, unit: str, rig: str | None, content: bytes | Path) -> Callable[[], Imported]:
        """What reads and fits a file of poses, here or in another process, or raises CsvError.

        Raises:
            Invalid: the serial is out of bounds.
        """
        check_serial(unit)
        return partial(read_and_fit, content, unit, rig, self._store.effects_in_force(unit, rig))

    def keep_imported(
        self, imported: Imported, *, unit: str, rig: str | None, file_name: str, operator: str | None
    ) -> Run:
        """Makes a completed run of what was read; all of it is stored, or nothing."""
        return self._store.create_run(
            unit=unit,
            rig=rig,
            plan=None,
            status="completed",
            poses=imported.poses,
            operator=operator,
            provenance={
                **provenance(operator),
                "imported_from": file_name,
                "warnings": imported.warnings,
            },
            result=imported.result,
            draft=self._issuer.importing(imported, by=operator),
        )

    def void(self, run_id: str, reason: str) -> Run:
        """Takes an ended run out of every comparison; it stays, with the reason."""
        self._ended(run_id)
        run = self._store.void_run(run_id, checked_reason(reason))
        self._issuer.redraft(run, by=None, reason=f"run {run_id} was voided: {reason.strip()}")
        return run

    def exclude_pose(self, run_id: str, index: int, reason: str) -> Run:
        """Takes one pose out of an ended run's result, which is computed again; the pose stays."""
        run = self._ended(run_id)
        poses = self._store.poses(run_id)
        if index not in {stored.index for stored in poses}:
            raise Unknown(f"run {run_id} has no pose {index}")
        left = [p.pose for p in poses if p.excluded is None and p.index != index]
        result = run.result
        kind = (run.plan or {}).get("kind", "calibration")
        if result is not None and kind != "calibration":
            raise Conflict(f"run {run_id} is a {kind}: it fits nothing that a pose could be taken out of")
        if result is not None:
            if not left:
                raise Conflict(
                    f"pose {index} is the last one that run {run_id} rests on: void the run instead"
                )
            result = refitted(self._store, run, left)
        run = self._store.exclude_pose(run_id, index, checked_reason(reason), result=result)
        why = f"pose {index} of run {run_id} was excluded: {reason.strip()}"
        self._issuer.redraft(run, by=None, reason=why)
        return run

    def _ended(self, run_id: str) -> Run:
        run = stored_run(self._store, run_id)
        if run.status not in AT_REST:
            raise Conflict(f"run {run_id} is {run.status}: end it first")
        return run
