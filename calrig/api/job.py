"""Long work by the name that its answer gave it: how far it is, what became of it, and its end on request."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, Literal, TypeVar

from pydantic_core import to_json

from calrig.api.errors import DEFECT, reason_of, status_of
from calrig.processes.pool import Processes

T = TypeVar("T")
State = Literal["queued", "running", "done", "failed", "cancelled"]

MOST_FINISHED = 100
"""Jobs whose end is remembered; the oldest are forgotten first."""
MOST_BYTES = 30_000_000
"""Of all results that are kept only here; the oldest are forgotten first."""
ID_BYTES = 12
"""Random: an id of another service's life, or of another service, is nobody's here."""

log = logging.getLogger(__name__)


class Job:
    """One piece of long work, from its question to its answer.

    Args:
        user: whose share of the processes it takes.
        work: makes the question, has it answered by `run`, and keeps what came of it.
        kept_at: the path where the answer of `work` is then found; without it, it is kept here.
    """

    def __init__(
        self,
        processes: Processes,
        user: str,
        work: Callable[[Job], Awaitable[Any]],
        kept_at: Callable[[Any], str] | None = None,
    ) -> None:
        self.id = secrets.token_urlsafe(ID_BYTES)
        self.state: State = "queued"
        self.fraction: float | None = None
        self.result: str | None = None
        self.error: str | None = None
        self.error_status: int | None = None
        self.content = b""
        self.asked = asyncio.Event()
        self._processes, self._user = processes, user
        self._kept_at = kept_at
        self._is_answered = False
        self._answer: Any = None
        self._failure: Exception | None = None
        self.ended: Callable[[], None] = lambda: None
        self._began_s = time.monotonic()
        self.task: asyncio.Task[None] = asyncio.create_task(self._carry_out(work))

    async def run(
        self, function: Callable[..., T], *, tells_progress: bool = False, longest_s: float | None = None
    ) -> T:
        """As `Processes.run`; from here on the client may leave."""
        self.asked.set()
        self.fraction = 0.0 if tells_progress else None
        told = self._told if tells_progress else None
        answer = await self._processes.run(
            function, user=self._user, longest_s=longest_s, begun=self._begun, progress=told
        )
        self._is_answered = True
        return answer

    async def cancel(self) -> None:
        """Ends it, the process too; returns when it has ended. What is being kept already is kept."""
        if not self._is_answered:
            self.task.cancel()
        await asyncio.wait({self.task})

    def outcome(self) -> Any:
        """What it gave, or raises what it raised, once it has ended."""
        if self._failure is not None:
            raise self._failure
        return self._answer

    @property
    def has_ended(self) -> bool:
        """Whether it is neither waiting nor running."""
        return self.state not in ("queued", "running")

    def keep(self, what: str) -> None:
        """Keeps what is asked for later of what came of it, and says in the log how what was asked ended."""
        duration_s = round(time.monotonic() - self._began_s, 4)
        fields = {"job": self.id, "state": self.state, "duration_s": duration_s}
        why = f": {self.error}" if self.error else ""
        is_defect = self.error == DEFECT
        log.log(
            logging.ERROR if is_defect else logging.INFO,
            *("job %s (%s): %s%s", self.id, what, self.state, why),
            exc_info=self._failure if is_defect else None,
            extra={"fields": fields},
        )
        if self.state == "done" and self._kept_at is not None:
            self.result = self._kept_at(self._answer)
        elif self.state == "done":
            self.result = f"/api/jobs/{self.id}/result"
            self.content = to_json(self._answer, inf_nan_mode="null")
        self._answer = self._failure = None

    def _begun(self) -> None:
        self.state = "running"

    def _told(self, fraction: float) -> None:
        self.fraction = fraction

    async def _carry_out(self, work: Callable[[Job], Awaitable[Any]]) -> None:
        try:
            self._answer = await work(self)
            self.state, self.fraction = "done", 1.0
        except asyncio.CancelledError:
            self.state = "cancelled"
            raise
        except Exception as error:  # noqa: BLE001 (it is raised again for who waits, or logged)
            self.state, self.error, self._failure = "failed", reason_of(error), error
            self.error_status = status_of(error)
        finally:
            self.ended()


class Jobs:
    """The jobs that somebody was told of. Used in one event loop."""

    def __init__(self) -> None:
        self._jobs: dict[str, Job] = {}

    def add(self, job: Job, what: str) -> None:
        """Takes a job whose answer nobody waits for.

        `job` is under way, or ended when its answer was due; `what` was asked is for the log.
        """
        self._jobs[job.id] = job
        job.ended = partial(self._ended, job, what)
        if job.task.done():
            job.ended()

    def get(self, job_id: str) -> Job | None:
        """A job that is under way or has ended not long ago."""
        return self._jobs.get(job_id)

    async def close(self) -> None:
        """Ends all of them."""
        for job in list(self._jobs.values()):
            await job.cancel()

    def _ended(self, job: Job, what: str) -> None:
        job.keep(what)
        del self._jobs[job.id]
        self._jobs[job.id] = job  # behind those that ended before
        ended = [one for one in self._jobs.values() if one.has_ended]
        n_bytes = sum(len(one.content) for one in ended)
        for n_later, oldest in zip(range(len(ended) - 1, 0, -1), ended, strict=False):
            if n_later < MOST_FINISHED and n_bytes <= MOST_BYTES:
                break
            n_bytes -= len(oldest.content)
            del self._jobs[oldest.id]
