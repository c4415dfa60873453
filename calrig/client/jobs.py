"""Long work at a service: its answer however long it takes, its progress meanwhile, its end on Ctrl-C."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from calrig.client.documents import JobState
from calrig.client.errors import INVALID, Invalid, Refused, ServiceError
from calrig.client.given_up import nap
from calrig.client.transport import Transport

LOOK_S = 0.3
Told = Callable[[float], None]


def unheard(_share: float) -> None:
    """For who does not want to be told how far work is."""


def outcome(link: Transport, answer: Any, told: Told = unheard) -> Any:
    """What comes of a call with `wait=false`: its answer, or that of the job that it became.

    Args:
        link: to the service.
        answer: as it came.
        told: the share that is done, where the work can say.

    Raises:
        Refused: the work failed or was cancelled, with the reason.
        Invalid: it cannot be done with what was given.
    """
    if not (isinstance(answer, dict) and {"state", "fraction", "result"} <= answer.keys()):
        return answer
    job = JobState.of(answer)
    try:
        told(job.fraction or 0.0)
        while job.state in ("queued", "running"):
            nap(LOOK_S)
            job = JobState.of(link.get(f"/api/jobs/{job.id}"))
            told(job.fraction or 0.0)
    except BaseException as left:  # whoever does not wait any more does not want it done
        with suppress(ServiceError):
            ended = JobState.of(link.delete(f"/api/jobs/{job.id}"))
            if ended.state == "done":
                left.add_note(f"it was too late: what came of it is kept at {link.server}{ended.result}")
        raise
    if job.state != "done" or job.result is None:
        kind = Invalid if job.error_status == INVALID else Refused
        raise kind(f"{link.server}: {job.error or f'the work was {job.state}'}", job.error_status)
    return link.get(job.result)
