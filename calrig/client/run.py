"""A run at a service: followed, waited for, aborted, diagnosed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import quote

from calrig.client.documents import AT_REST, Diagnosis, Result, RunEvent, RunRecord
from calrig.client.errors import RunFailed
from calrig.client.events import Away, run_events
from calrig.client.events import unheard as unheard_away
from calrig.client.jobs import Told, outcome, unheard

if TYPE_CHECKING:
    from calrig.client.log_documents import FiltersStudy, NoiseStudy
    from calrig.client.transport import Transport


class Run:
    """A run; what it is now is asked for each time.

    Attributes:
        id: its id.
        unit: the serial number of its unit.
    """

    def __init__(self, link: Transport, record: RunRecord) -> None:
        self._link, self._record = link, record
        self.id, self.unit = record.id, record.unit
        self._path = f"/api/runs/{record.id}"

    @classmethod
    def of_id(cls, link: Transport, run_id: str) -> Self:
        """The run of a whole id."""
        return cls(link, RunRecord.of(link.get(f"/api/runs/{quote(run_id, safe='')}")))

    def __repr__(self) -> str:
        return f"<calrig run {self.id} of {self.unit!r}, {self._record.status}>"

    @property
    def record(self) -> RunRecord:
        """The run as it was when it was last looked at."""
        return self._record

    def look(self) -> RunRecord:
        """The run as it is now."""
        self._record = RunRecord.of(self._link.get(self._path))
        return self._record

    def events(self, after: int = 0, *, away: Away = unheard_away) -> Iterator[RunEvent]:
        """What happened since an event, then what happens, until the run has ended; each once, in order.

        A line that breaks is taken up again. A run of several mounts is `paused` where its `progress` has
        `waiting_for`: it goes on by `resume`.

        Args:
            after: `id` of the last event known; 0 for all.
            away: is told why, once, each time that the service does not answer and is waited for.

        Raises:
            Unreachable: it has been away for two minutes.
        """
        return run_events(self._link, self.id, after, away)

    def wait(self) -> RunRecord:
        """The run once it has ended, however."""
        if self._record.status not in AT_REST:
            for _ in self.events():
                pass
        return self.look()

    @property
    def result(self) -> Result:
        """What came out; waits for the run's end.

        Raises:
            RunFailed: it was not completed, or measures nothing that is fitted (a static log).
        """
        return result_of(self._record if self._record.status == "completed" else self.wait())

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

    def diagnose(self, *more: str, told: Told = unheard) -> Diagnosis:
        """Traces what bias and scale leave, with more runs of the unit; the service keeps it with the run.

        Args:
            more: ids of runs.
            told: is told the share that is done.
        """
        asked = self._link.post(f"{self._path}/diagnosis?wait=false", {"runs": list(more)})
        return Diagnosis.of(outcome(self._link, asked, told))

    def noise(self, *, told: Told = unheard) -> NoiseStudy:
        """The noise in the log of a static run.

        Args:
            told: is told the share that is done, where the service can say.
        """
        from calrig.client.log_documents import NoiseStudy

        return NoiseStudy.of(outcome(self._link, self._link.get(f"{self._path}/noise?wait=false"), told))

    def filters(self, *, told: Told = unheard) -> FiltersStudy:
        """The filters side by side on its samples; `told` as of `noise`."""
        from calrig.client.log_documents import FiltersStudy

        return FiltersStudy.of(outcome(self._link, self._link.get(f"{self._path}/filters?wait=false"), told))

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
        self._record = RunRecord.of(self._link.post(f"{self._path}/{what}", body or {}))
        return self._record


def result_of(record: RunRecord) -> Result:
    """What came out of a run that has ended; RunFailed as of `Run.result`."""
    if record.status != "completed" or record.result is None:
        raise RunFailed(record)
    return record.result
