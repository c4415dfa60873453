"""A run at a service: its events, over a connection that may break (HTML standard, 9.2), result and jobs."""

import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from typing import Any, Literal

from calrig.client.documents import RunEvent, RunRecord, typed
from calrig.client.errors import INVALID, Invalid, Refused, RunFailed, ServiceError, Unreachable
from calrig.client.transport import Transport, nap
from calrig.model.diagnosis import Diagnosis
from calrig.model.noise import FiltersStudy, NoiseStudy
from calrig.model.result import Result
from calrig.model.run import AT_REST
from calrig.model.service import JobState

AGAIN_S = 0.5
"""How soon a broken line is taken up again."""
AWAY = frozenset({None, 502, 503, 504})
"""No answer, or one of a proxy whose service is not there."""
PATIENCE_S = 120.0
"""How long a service may be unreachable, such as during a restart."""


Away = Callable[[ServiceError], None]


def ignore_error(_error: ServiceError) -> None:
    """For who does not want to be told that the service is away."""


def parsed(lines: Iterable[bytes]) -> Iterator[dict[str, str]]:
    """The fields of each event that came whole; comments are passed over."""
    fields: dict[str, str] = {}
    for line in lines:
        text = line.decode(errors="replace").rstrip("\r\n")
        if not text:
            if fields:
                yield fields
            fields = {}
            continue
        name, _, value = text.partition(":")
        if name:
            value = value.removeprefix(" ")
            fields[name] = f"{fields[name]}\n{value}" if name == "data" and name in fields else value


def _event(fields: dict[str, str]) -> RunEvent:
    try:
        data: Any = json.loads(fields["data"])
        return typed(RunEvent, {"id": int(fields["id"]), "type": fields["event"], "data": data})
    except (KeyError, ValueError) as error:
        raise Unreachable("the service's events are not calrig's") from error


LOOK_S = 0.3
Told = Callable[[float], None]


def ignore_progress(_share: float) -> None:
    """For who does not want to be told how far work is."""


def outcome(link: Transport, answer: Any, told: Told = ignore_progress) -> Any:
    """What comes of a call with `wait=false`: its answer, or that of the job that it became.

    `told` is given the share that is done, where the work can say.

    Raises:
        Refused: the work failed or was cancelled, with the reason.
        Invalid: it cannot be done with what was given.
    """
    if not (isinstance(answer, dict) and {"state", "fraction", "result"} <= answer.keys()):
        return answer
    job = typed(JobState, answer)
    try:
        told(job.fraction or 0.0)
        while job.state in ("queued", "running"):
            nap(LOOK_S)
            job = typed(JobState, link.get(f"/api/jobs/{job.id}"))
            told(job.fraction or 0.0)
    except BaseException as left:  # a caller that stops waiting does not need the result
        with suppress(ServiceError):
            ended = typed(JobState, link.delete(f"/api/jobs/{job.id}"))
            if ended.state == "done":
                left.add_note(f"it was too late: what came of it is kept at {link.server}{ended.result}")
        raise
    if job.state != "done" or job.result is None:
        kind = Invalid if job.error_status == INVALID else Refused
        raise kind(f"{link.said_by}{job.error or f'the work was {job.state}'}", job.error_status)
    return link.get(job.result)


class Run:
    """A run; what it is now is asked for each time.

    Attributes:
        record: the run as it was when it was last looked at.
    """

    def __init__(self, link: Transport, record: RunRecord) -> None:
        self._link, self.record = link, record
        self.id, self.unit = record.id, record.unit
        self._path = f"/api/runs/{record.id}"

    def __repr__(self) -> str:
        return f"<calrig run {self.id} of {self.unit!r}, {self.record.status}>"

    def look(self) -> RunRecord:
        """The run as it is now."""
        self.record = typed(RunRecord, self._link.get(self._path))
        return self.record

    def events(self, after: int = 0, *, away: Away = ignore_error) -> Iterator[RunEvent]:
        """What happened since an event, then what happens, until the run has ended; each once, in order.

        A line that breaks is taken up again. A run of several mounts is `paused` where its `progress` has
        `waiting_for`: it goes on by `resume`.

        Args:
            after: `id` of the last event known; 0 for all.
            away: is told why, once, each time that the service does not answer and is waited for.

        Raises:
            Refused: there is no such run, or the service lets nobody look.
            Unreachable: the service has been away for `PATIENCE_S`.
        """
        known = after
        away_since_s: float | None = None
        while True:
            latest: RunEvent | None = None
            try:
                with self._link.lines(f"{self._path}/events", {"Last-Event-ID": str(known)}) as lines:
                    away_since_s = None
                    for fields in parsed(lines):
                        latest = _event(fields)
                        if latest.id > known:
                            known = latest.id
                            yield latest
                # A service that is told to stop ends the stream too: only the run tells that it has ended.
                if (latest is None or latest.is_last) and self._link.get(self._path)["status"] in AT_REST:
                    return
            except (Unreachable, Refused) as error:
                if error.status not in AWAY:
                    raise
                if away_since_s is None:
                    away_since_s = time.monotonic()
                    away(error)
                if time.monotonic() - away_since_s > PATIENCE_S:
                    raise
            if latest is None:
                nap(AGAIN_S)

    def wait(self) -> RunRecord:
        """The run once it has ended, however."""
        if self.record.status not in AT_REST:
            for _ in self.events():
                pass
        return self.look()

    @property
    def result(self) -> Result:
        """What came out; waits for the run's end.

        Raises:
            RunFailed: it was not completed, or measures nothing that is fitted (a static log).
        """
        return result_of(self.record if self.record.status == "completed" else self.wait())

    def abort(self) -> RunRecord:
        """Stops the stage and ends the run; the poses measured so far stay.

        Raises:
            Refused: it has ended, or the stage was not seen to stand.
        """
        return self._ask("abort")

    def pause(self) -> RunRecord:
        """Holds the run once the pose in hand is done."""
        return self._ask("pause")

    def resume(self, *, stage_at_deg: float | None = None) -> RunRecord:
        """Goes on with a run that is paused, waits for its unit to be turned, or was interrupted.

        Args:
            stage_at_deg: elevation at which the stage of an interrupted run stands, if it has no homing.

        Raises:
            Refused: it is neither, its rig is busy or not as it was, or its stage has homing.
        """
        return self._ask("resume", {} if stage_at_deg is None else {"stage_at_deg": stage_at_deg})

    def diagnose(
        self,
        *more: str,
        reference: Literal["stage", "good"] | None = None,
        periods_deg: Sequence[float] = (),
        told: Told = ignore_progress,
    ) -> Diagnosis:
        """Traces what bias and scale leave, with more runs of the unit; the service keeps it with the run.

        Args:
            more: ids of runs.
            reference: `good` if the stage does not err: curves of the angle are the sensor's. None: as the
                rig says.
            periods_deg: known periods of the axis, beside those of the rig.
            told: is told the share that is done.
        """
        body: dict[str, Any] = {"runs": list(more)}
        if reference is not None:  # an older service knows neither key
            body["reference"] = reference
        if periods_deg:
            body["periods"] = list(periods_deg)
        asked = self._link.post(f"{self._path}/diagnosis?wait=false", body)
        return typed(Diagnosis, outcome(self._link, asked, told))

    def noise(self, *, told: Told = ignore_progress) -> NoiseStudy:
        """The noise in the log of a static run.

        Args:
            told: is told the share that is done, where the service can say.
        """
        asked = self._link.get(f"{self._path}/noise?wait=false")
        return typed(NoiseStudy, outcome(self._link, asked, told))

    def filters(self, *, told: Told = ignore_progress) -> FiltersStudy:
        """The filters side by side on its samples; `told` as of `noise`."""
        return typed(
            FiltersStudy, outcome(self._link, self._link.get(f"{self._path}/filters?wait=false"), told)
        )

    def poses(self) -> list[dict[str, Any]]:
        """Its poses, in the columns of docs/reference/file-formats.md."""
        poses: list[dict[str, Any]] = self._link.get(f"{self._path}/poses")
        return poses

    def figure(self, name: str) -> dict[str, Any]:
        """A picture for `plotly.graph_objects.Figure`.

        Args:
            name: `timeline`, `residual`, `diagnosis`, or `effect-0` and on.
        """
        figure: dict[str, Any] = self._link.get(f"{self._path}/figures/{name}")
        return figure

    def _ask(self, what: str, body: dict[str, Any] | None = None) -> RunRecord:
        self.record = typed(RunRecord, self._link.post(f"{self._path}/{what}", body or {}))
        return self.record


def result_of(record: RunRecord) -> Result:
    """What came out of a run that has ended; RunFailed as of `Run.result`."""
    if record.status != "completed" or record.result is None:
        raise RunFailed(record)
    return record.result
