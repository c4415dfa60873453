"""The thread that carries one run from `queued` to its end, and sees that every end is written down."""

from __future__ import annotations

import logging
import math
import platform
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import calrig
from calrig.calibration.result import Result
from calrig.estimation.spectrum import MIN_SAMPLES
from calrig.instruments.errors import BoardError, InstrumentError, LimitError
from calrig.instruments.transcript import Tape, taped
from calrig.plan import Plan, PlannedPose
from calrig.runs.bus import Bus
from calrig.runs.control import Control, End, Ended
from calrig.runs.execution import Execution
from calrig.runs.follow_up import FollowUpRun
from calrig.runs.in_force import InForce
from calrig.runs.pace import Pace
from calrig.runs.recorder import Recorder
from calrig.runs.results import fitted
from calrig.runs.rig import Rig, open_rig
from calrig.runs.static_log import keep_log
from calrig.settings import RigSettings
from calrig.store import Run, RunChanges, Status, Store, StoreError

log = logging.getLogger(__name__)


def provenance(operator: str | None) -> dict[str, Any]:
    """What is known of a run's origin before any device has been asked."""
    return {
        "calrig": calrig.__version__,
        "python": platform.python_version(),
        "host": platform.node(),
        "operator": operator,
    }


class Worker(threading.Thread):
    """Carries one run out. `control` takes requests; `reached_rig` tells whether both devices answered."""

    def __init__(
        self,
        run: Run,
        rig: RigSettings,
        plan: Plan,
        planned: list[PlannedPose],
        store: Store,
        bus: Bus,
        left_rig: Callable[[Worker], None],
        ended: Callable[[Worker], None],
        follow_up: FollowUpRun | None = None,
        verifies: InForce | None = None,
        record: Path | None = None,
    ) -> None:
        super().__init__(name=f"run-{run.id}")
        self.run_id = run.id
        self.rig = rig
        self.control = Control()
        self.reached_rig = False
        self._asked = run
        self._plan = plan
        self._planned = planned
        self._recorder = Recorder(store, bus, run.id, len(planned))
        self._left_rig = left_rig
        self._ended = ended
        self._follow_up = follow_up
        self._verifies = verifies
        self._store = store
        self._record = record
        self._fields: RunChanges = {}
        self._warnings: list[str] = []
        self._concluding = threading.Lock()
        self._concluded = False

    def run(self) -> None:
        """Carries the run out; whatever happens, the run ends in a state that says what happened."""
        status: Status = "failed"
        error: str | None = None
        try:
            self._recorder.state("running")
            self._carry_out()
            status = "completed"
        except Ended as ended:
            status, error = ended.end.status, ended.end.reason
        except (InstrumentError, StoreError) as problem:
            status, error = self._as_asked_or("failed", str(problem))
        except Exception as problem:
            log.exception("run %s failed inside calrig", self.run_id)
            status, error = "failed", f"internal error ({type(problem).__name__}: {problem}); see the log"
        finally:
            self._conclude(status, error)

    @contextmanager
    def _keeping(self, tapes: list[Tape]) -> Iterator[None]:
        """Keeps the last minute of each wire where what is done meanwhile fails."""
        try:
            yield
        except Ended:
            raise
        except Exception:
            with suppress(StoreError):  # the run's own failure is what is told
                self._store.keep_transcripts(self.run_id, {tape.port: tape.last_minute() for tape in tapes})
            raise

    def _as_asked_or(self, status: Status, error: str) -> tuple[Status, str | None]:
        """A stage halted by request refuses its next move: the request is the reason, not the refusal."""
        try:
            self.control.check()
        except Ended as ended:
            return ended.end.status, ended.end.reason
        return status, error

    def _conclude(self, status: Status, error: str | None) -> None:
        """Frees the rig, then says how the run ended: who hears of the end may start the next run."""
        self._left_rig(self)
        told = [error, *self._warnings] if error else self._warnings
        fields: RunChanges = {**self._fields, "error": "; ".join(told) or None}
        self._once(status, lambda: self._recorder.state(status, fields))
        self._ended(self)

    def give_up(self, store: Store, end: End) -> None:
        """Writes the end down in place of a run whose devices keep it from doing so in time."""
        self._once(end.status, lambda: store.update_run(self.run_id, status=end.status, error=end.reason))

    def _once(self, status: Status, write: Callable[[], object]) -> None:
        """Writes the run's end unless that has been done."""
        with self._concluding:
            if self._concluded:
                return
            self._concluded = True
            try:
                write()
            except StoreError:
                log.exception("run %s ended as %s, and the store cannot be told", self.run_id, status)

    def _carry_out(self) -> None:
        with (
            taped(self._record) as tapes,
            self._keeping(tapes.all),
            open_rig(self.rig, self.control.arm, self._warnings.append) as rig,
        ):
            self.reached_rig = True
            self._check_board(rig)
            self._check_limits(rig)
            origin = {**self._asked.provenance, **rig.provenance()}
            self._recorder.update(provenance=origin)
            pace = Pace(rig, self.control, self._recorder)
            execution = Execution(self._plan, pace, self._follow_up)
            try:
                if self._plan.kind == "static":
                    keep_log(self._plan, self._planned, pace)
                else:
                    execution.carry_out(self._planned)
            finally:
                self._fields["faults"] = rig.faults()
        if self._plan.kind == "static":
            return
        self._fields["result"] = self._result(execution, origin).to_dict()
        if self._follow_up is not None:
            self._fields["provenance"] = {**origin, "follow_up": self._follow_up.provenance()}
            self._fields["diagnosis"] = self._follow_up.diagnosis(self.run_id, execution.poses)

    def _result(self, execution: Execution, origin: dict[str, Any]) -> Result:
        gyro = execution.gyro_figures()
        if self._verifies is not None:
            return self._verifies.result(execution.poses, gyro)
        return fitted(
            self._store,
            unit=self._asked.unit,
            rig=self._asked.rig,
            provenance=origin,
            poses=execution.poses,
            gyro=gyro,
        )

    def _check_board(self, rig: Rig) -> None:
        board, unit = rig.board_identity, self._asked.unit
        if board.serial and board.serial != unit:
            raise BoardError(
                f"rig {self.rig.name!r}: the board says it is unit {board.serial!r}, the run is for unit "
                f"{unit!r}; nothing was moved: mount the right unit or correct the serial number"
            )
        if board.rate_hz is not None:
            self._check_dwell(board.rate_hz)
        elif board.max_rate_hz is not None and self._plan.rate_hz > board.max_rate_hz:
            raise BoardError(
                f"rig {self.rig.name!r}: the plan asks for {self._plan.rate_hz} Hz and the board gives "
                f"{board.max_rate_hz} Hz at most; nothing was moved: lower rate_hz"
            )

    def _check_dwell(self, rate_hz: float) -> None:
        """A board that has one rate only may be too slow for the plan's dwell."""
        count = self._plan.dwell_s * rate_hz
        if count < MIN_SAMPLES:
            enough_s = math.ceil(2 * (MIN_SAMPLES + 1) / rate_hz) / 2
            raise BoardError(
                f"rig {self.rig.name!r}: the board gives {rate_hz:.1f} samples a second and no other rate: a "
                f"dwell of {self._plan.dwell_s:g} s holds about {count:.0f}, a reading needs {MIN_SAMPLES}; "
                f"nothing was moved: dwell longer (dwell_s at least {enough_s:g})"
            )

    def _check_limits(self, rig: Rig) -> None:
        """The controller's own limits, known only now, may be narrower than those the plan was checked by."""
        low, high = rig.axis.limits_deg
        for pose in self._planned:
            if not low <= pose.target_deg <= high:
                raise LimitError(
                    f"rig {self.rig.name!r}: elevation {pose.target_deg:g}° is beyond the limits of rig and "
                    f"controller together, {low:g}° to {high:g}°; nothing was moved: change the plan, or the "
                    "controller's limits"
                )
