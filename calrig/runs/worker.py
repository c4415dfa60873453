"""The thread that carries one run from `queued` to its end, and sees that every end is written down.

What is measured meanwhile is `measuring`'s.
"""

from __future__ import annotations

import logging
import re
import threading
from collections.abc import Callable
from pathlib import Path

from calrig import logs
from calrig.analysis.errors import Conflict, NotTheSame
from calrig.analysis.revisions import Issuer
from calrig.instruments.cancellation import cancel_scope, deadline
from calrig.instruments.clock import WALL
from calrig.instruments.errors import InstrumentError
from calrig.instruments.ports import clock_of
from calrig.model.run import Status
from calrig.runs.assignment import OpenBoardHandover, RunAssignment
from calrig.runs.control import Control, End, Ended, StopOutcome
from calrig.runs.recorder import Bus, Recorder, ServiceMetrics
from calrig.runs.run_execution import RunExecution
from calrig.store import Run, RunChanges, Store, StoreError, StoreUnavailableError

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

    def go_on(self) -> None:
        """Ends a pause, or what the run waits for a person to do, or takes a wish for a pause back.

        Raises:
            Conflict: it is not paused; or the unit is not clamped as the run asks, by gravity.
        """
        if (go := self.control.say_go()) is not None:
            if (refusal := go.refusal(LOOKS_S)) is not None:
                raise Conflict(refusal)
        elif self.control.holding:
            self.control.resume()
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
        while not self._once(fields, lambda: self._recorder.state(status, fields, done.draft)):
            if self._given_up.wait(TRY_AGAIN_S):
                break
        self._ended(self)

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
        self._once(told, lambda: store.runs.update(self.run_id, draft=self._measuring.draft, **told))

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
