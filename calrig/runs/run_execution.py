"""A run on its rig, from opening to closing it: what is measured, and what is kept of that with the run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from calrig.analysis.results import ending_of, fitted
from calrig.analysis.revisions import Fitted, Issuer
from calrig.instruments.transcript import Tape, taped
from calrig.runs.acquisition import AcquisitionLoop
from calrig.runs.assignment import OpenBoardHandover, RunAssignment
from calrig.runs.control import Control, Ended
from calrig.runs.pose_acquisition import PoseAcquisition
from calrig.runs.procedures.continuous import ContinuousSweep
from calrig.runs.procedures.dwell import DwellSequence
from calrig.runs.procedures.static import keep_log
from calrig.runs.recorder import Recorder
from calrig.runs.resume import require_same_devices
from calrig.runs.rig import Rig, open_rig, require_suited
from calrig.runs.stage_position import StagePosition
from calrig.runs.stopping_rule import REACHED, StoppingRule
from calrig.store import RunChanges, Store, StoreError
from calrig.store.issued import Draft


class RunExecution:
    """Carries a run out and leaves its rig, whatever happens; how the run ended is for others to say.

    Attributes:
        fields: what has come of it, to be written with its end.
        warnings: what a person must know then, beside an error.
        draft: of a calibration, what it makes of its unit.
        has_reached_rig: whether both devices answered.
        is_under_way: whether a failure from here on is the run's own; else an interrupted run stays so.

    Args:
        task: the run.
        store: has what was accepted so far, and keeps the wires of a run that failed.
        issuer: makes the draft.
        recorder: is told what happens.
        control: says when it is to end.
        record: folder for transcripts of every byte on the wires; None for none.
    """

    def __init__(
        self,
        task: RunAssignment,
        store: Store,
        issuer: Issuer,
        recorder: Recorder,
        control: Control,
        record: Path | None,
    ) -> None:
        self.fields: RunChanges = {}
        self.warnings: list[str] = []
        self.draft: Draft | None = None
        self.has_reached_rig = False
        self.is_under_way = task.interruption is None
        self._task, self._store, self._issuer = task, store, issuer
        self._recorder, self._control, self._record = recorder, control, record
        self._origin = task.run.provenance

    def carry_out(self, left_open: OpenBoardHandover | None) -> None:
        """Does it, with the board that a look has left open; raises whatever ends it before its time."""
        task = self._task
        with (
            taped(self._record) as tapes,
            self._keeping(tapes.all),
            open_rig(
                task.rig,
                self._control,
                self.warnings.append,
                StagePosition(
                    self._store, task.rig, task.run, task.stage_at_deg, resumes=task.interruption is not None
                ),
                task.earlier.faults,
                None if left_open is None else left_open.taken_over(tapes),
            ) as rig,
        ):
            self.has_reached_rig = True
            require_suited(rig, task)
            self._note_origin(rig)
            if task.planned:
                rig.place.take_up(rig.axis, homes=rig.stage_identity.homes)
            self.is_under_way = True
            pace = AcquisitionLoop(rig, self._control, self._recorder, task.earlier.clock_s)
            taking = PoseAcquisition(task.plan, pace, task.earlier, self._stopping_rule())
            sweeping = ContinuousSweep(task.plan, pace, taking)
            try:
                if task.plan.kind == "static":
                    keep_log(task.plan, task.planned, pace, task.earlier.logged_s)
                elif task.plan.kind == "sweep":
                    sweeping.carry_out(task.planned)
                else:
                    DwellSequence(task.plan, pace, taking, task.follow_up).carry_out(task.planned)
            finally:
                self.fields["faults"] = rig.faults()
                self._note_return(taking)
                if sweeping.felt or sweeping.lost:
                    self._origin = {**self._origin, "sweep": sweeping.provenance()}
                    self.fields["provenance"] = self._origin
        if task.plan.kind != "static":
            self._note_result(taking)
        if task.follow_up is not None:
            self.fields["provenance"] = {**self._origin, "follow_up": task.follow_up.provenance()}
            self.fields["diagnosis"] = task.follow_up.diagnosis(self._task.run.id, taking.poses)

    @contextmanager
    def _keeping(self, tapes: list[Tape]) -> Iterator[None]:
        """Keeps the last minute of each wire where what is done meanwhile fails."""
        try:
            yield
        except Ended:
            raise
        except Exception:
            with suppress(StoreError):  # the run's own failure is what is told
                self._store.events.save_transcripts(
                    self._task.run.id, {tape.port: tape.last_minute() for tape in tapes}
                )
            raise

    def _stopping_rule(self) -> StoppingRule | None:
        """What tells whether the run may end before its plan does; None of one that may not."""
        task = self._task
        if task.plan.until is None:
            return None
        accepted = self._store.effects.in_force(task.run.unit, task.run.rig)
        return StoppingRule(task.plan.until, task.planned, accepted, self._origin)

    def _note_origin(self, rig: Rig) -> None:
        """Keeps what measures with the run; of a resumed one, that it was interrupted."""
        if self._task.interruption is None:
            self._origin = {**self._origin, **rig.provenance()}
        else:
            require_same_devices(self._task.run, rig)
            before = self._origin.get("interruptions", [])
            self._origin = {
                **rig.provenance(),
                **self._origin,
                "interruptions": [*before, self._task.interruption],
            }
        self._recorder.update(provenance=self._origin)

    def _note_return(self, taking: PoseAcquisition) -> None:
        """Says with the last interruption what the last pose before it gave once more."""
        if taking.returned is None:
            return
        *before, last = self._origin["interruptions"]
        last = {**last, "measured_again": taking.returned.document()}
        self._origin = {**self._origin, "interruptions": [*before, last]}
        self.fields["provenance"] = self._origin
        self.warnings.extend(taking.returned.warnings())

    def _note_result(self, taking: PoseAcquisition) -> None:
        """The result of the poses stored, and the draft that a calibration makes of its unit.

        Neither, where all of the poses were excluded meanwhile, or the unit turned about another axis than
        its x: what it read is no elevation, and for the joint solution alone.
        """
        run, gyro = self._task.run, taking.gyro.figures(taking.felt.moves)
        stored = self._store.poses.of(self._task.run.id)
        poses = [one.pose for one in stored if one.excluded is None]
        self.fields["result"] = None
        if not poses or self._task.plan.mount_axis != "x":
            return
        if self._task.verifies is not None:
            self.fields["result"] = self._task.verifies.result(poses, gyro)
            return
        accepted = self._store.effects.in_force(run.unit, run.rig)
        ending = REACHED if taking.is_enough else ending_of(run)
        result = fitted(poses, accepted, self._origin, gyro, ending)
        self.fields["result"] = result
        excluded = [one.index for one in stored if one.excluded is not None]
        now = run.model_copy(update={"provenance": self._origin, "faults": self.fields["faults"]})
        self.draft = self._issuer.completing(now, Fitted(poses, result, accepted, excluded))
