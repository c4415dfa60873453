"""Carry out one run in its own thread: open the rig, measure, close it, and record how the run ended."""

from __future__ import annotations

import logging
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from calrig import logs
from calrig.analysis.errors import Conflict, NotTheSame
from calrig.analysis.results import ending_of, fitted
from calrig.analysis.revisions import Fitted, Issuer
from calrig.instruments.cancellation import cancel_scope, deadline
from calrig.instruments.clock import WALL
from calrig.instruments.errors import InstrumentError
from calrig.instruments.ports import clock_of
from calrig.instruments.transcript import Tape, taped
from calrig.model.run import Status
from calrig.runs.acquisition import AcquisitionLoop
from calrig.runs.assignment import OpenBoardHandover, RunAssignment
from calrig.runs.control import Control, End, Ended, StopOutcome
from calrig.runs.plan_estimates import REACHED, StoppingRule
from calrig.runs.pose_acquisition import PoseAcquisition
from calrig.runs.procedures.continuous import ContinuousSweep
from calrig.runs.procedures.dwell import DwellSequence
from calrig.runs.procedures.static import keep_log
from calrig.runs.recorder import Bus, Recorder, ServiceMetrics
from calrig.runs.resume import require_same_devices
from calrig.runs.rig import Rig, StagePosition, open_rig, require_suited
from calrig.store import Run, RunChanges, Store, StoreError, StoreUnavailableError
from calrig.store.issued import Draft
from calrig.store.trail import Act


class RunExecution:
    """Carries a run out and leaves its rig, whatever happens; how the run ended is for others to say.

    Attributes:
        fields: what has come of it, to be written with its end.
        warnings: what a person must know then, beside an error.
        draft: of a calibration, what it makes of its unit.
        is_under_way: whether a failure from here on is the run's own; else an interrupted run stays so.

    Args:
        store: has what was accepted so far, and keeps the wires of a run that failed.
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
        run, gyro = self._task.run, taking.gyro.figures(taking.felt.turned_deg, taking.felt.felt_deg)
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


log = logging.getLogger(__name__)

LOOKS_S = 10.0
"""How long who says Go waits for what gravity says of the unit, s of the rig's clock."""
COUNTS = re.compile(r" \(faults so far: [^()]*\)")
"""As `instruments.stages.lines.unanswered` has them."""
TRY_AGAIN_S = 1.0
"""How often a store that refuses a run's end is asked again: a disk does not stay full for ever."""


class Worker:
    """Carries one run out, in a daemon thread: a device that keeps it from ending keeps no program from it.

    `control` takes requests; `reached_rig` tells whether both devices answered, None where it
    was asked to end before that was known; `clock` is the rig's;
    `untold` is how the run ended, while the store cannot be told of it.
    """

    def __init__(
        self,
        task: RunAssignment,
        store: Store,
        issuer: Issuer,
        bus: Bus,
        meter: ServiceMetrics,
        left_rig: Callable[[Worker], None],
        ended: Callable[[Worker], None],
        record: Path | None = None,
    ) -> None:
        self.run_id = task.run.id
        self.rig = task.rig
        self.clock = WALL if task.rig.stage is None else clock_of(task.rig.stage.port)
        self._thread = self.clock.thread(self._carry_through, f"run-{task.run.id}")
        self.control = Control(self.clock)
        self.reached_rig: bool | None = False
        self._task = task
        self._recorder = Recorder(
            store,
            bus,
            task.run.id,
            meter.of_run(task.rig.name, task.earlier.faults),
            self.clock,
            len(task.planned),
            len(task.earlier.poses),
            task.plan.mount_axis,
        )
        self._left_rig = left_rig
        self._ended = ended
        self._measuring = RunExecution(task, store, issuer, self._recorder, self.control, record)
        self._concluding = threading.Lock()
        self._concluded = False
        self._given_up = self.clock.event()
        self.untold: RunChanges | None = None
        self._left_open: OpenBoardHandover | None = None

    def start(self, left_open: OpenBoardHandover | None) -> None:
        """Begins to carry the run out, with the board that a look has left open."""
        self._left_open = left_open
        self._thread.start()

    def join(self, timeout_s: float | None = None) -> None:
        """Waits until it has ended, or for so many seconds of its rig's time."""
        self._thread.join(timeout_s)

    def go_on(self, who: str | None = None) -> None:
        """Ends a pause, or what the run waits for a person to do, or takes a wish for a pause back.

        Raises:
            Conflict: it is not paused; or the unit is not clamped as the run asks, by gravity.
        """
        if (go := self.control.say_go(who)) is not None:
            if (refusal := go.refusal(LOOKS_S)) is not None:
                raise Conflict(refusal)
        elif self.control.holding:
            self.control.resume(who)
        else:
            raise Conflict(f"run {self.run_id} is not paused")

    def _carry_through(self) -> None:
        """Carries the run out; what is logged meanwhile says which run it is about."""
        with logs.about(run_id=self.run_id, rig=self.rig.name, unit=self._task.run.unit):
            self._run()

    def _run(self) -> None:
        """Whatever happens, the run ends in a state that says what happened."""
        status: Status = "failed"
        error: str | None = None
        try:
            self._recorder.state("running")
            self._measuring.carry_out(self._left_open)
            status = "completed"
        except Ended as ended:
            self.reached_rig = None  # unless it has
            status, error = ended.end.status, ended.end.reason
        except NotTheSame as problem:
            status, error = "interrupted", str(problem)
        except (InstrumentError, StoreError) as problem:
            left: Status = "failed" if self._measuring.is_under_way else "interrupted"
            status, error = self._as_asked_or(left, str(problem))
        except Exception as problem:
            log.exception("run %s failed inside calrig", self.run_id)
            status, error = "failed", f"internal error ({type(problem).__name__}: {problem}); see the log"
        finally:
            self._conclude(status, error)

    def _as_asked_or(self, status: Status, error: str) -> tuple[Status, str | None]:
        """A stage halted by request refuses its next move: the request is the reason, not the refusal."""
        try:
            self.control.check()
        except Ended as ended:
            return ended.end.status, ended.end.reason
        return status, error

    def _conclude(self, status: Status, error: str | None) -> None:
        """Frees the rig, then says how the run ended: who hears of the end may start the next run."""
        if self._left_open is not None:
            self._left_open.board.close()  # once more, but for a run that did not get to its rig
        self.reached_rig = self._measuring.has_reached_rig or self.reached_rig
        self._left_rig(self)
        self.control.leave(StopOutcome(seen=False))
        done = self._measuring
        told = [error, *(_not_again(one, error) for one in done.warnings)] if error else done.warnings
        fields: RunChanges = {**done.fields, "error": "; ".join(told) or None}
        fields["status"] = status
        if status != "completed":
            done.draft = None
        asked = self._asked(status)
        while not self._once(fields, lambda: self._recorder.state(status, fields, done.draft, asked)):
            if self._given_up.wait(TRY_AGAIN_S):
                break
        self._ended(self)

    def _asked(self, status: Status) -> Act | None:
        """What somebody asked for, where that is how the run ended."""
        end = self.control.asked
        return None if end is None or end.status != status else end.asked

    @property
    def as_known(self) -> Run:
        """The run, without asking the store: as it began, and how it ended if that is known."""
        ended: RunChanges = self.untold or {"status": "aborted"}
        return self._task.run.model_copy(update=ended)

    def give_up(self, store: Store, end: End) -> None:
        """Writes the end down in place of a run whose devices, or store, keep it from doing so in time."""
        self._given_up.set()
        fields: RunChanges = {"status": end.status, "error": end.reason}
        told = self.untold or fields
        draft, asked = self._measuring.draft, self._asked(told["status"])
        self._once(told, lambda: store.runs.update(self.run_id, draft=draft, asked=asked, **told))

    def _once(self, fields: RunChanges, write: Callable[[], object]) -> bool:
        """Writes the run's end unless that has been done; returns False where the store cannot be told."""
        with self._concluding:
            if self._concluded:
                return True
            try:
                with cancel_scope(deadline(TRY_AGAIN_S, StoreUnavailableError("it is locked"))):
                    write()
            except StoreError as error:
                if self.untold is None:
                    ended = f"run {self.run_id} ended as {fields['status']}: {fields['error'] or 'no error'}"
                    log.error("%s; the store cannot be told, and is asked again: %s", ended, error)
                self.untold = self.untold or fields
                return False
            self._concluded, self.untold = True, None
            return True


def _not_again(warning: str, error: str) -> str:
    """A warning without the reason that it quotes, where that is what ended the run, but for its counts."""
    quoted = f" ({COUNTS.sub('', error)})"
    bare = COUNTS.sub("", warning)
    return bare.replace(quoted, "") if quoted in bare else warning
