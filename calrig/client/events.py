"""A run's events over a line that may break: each once, in order (HTML standard, 9.2)."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from calrig.client.documents import AT_REST, RunEvent
from calrig.client.errors import Refused, ServiceError, Unreachable
from calrig.client.given_up import nap
from calrig.client.transport import Transport

AGAIN_S = 0.5
"""How soon a broken line is taken up again."""
AWAY = frozenset({None, 502, 503, 504})
"""No answer, or one of a proxy whose service is not there."""
PATIENCE_S = 120.0
"""How long a service may be away: it may be started anew meanwhile."""


Away = Callable[[ServiceError], None]


def unheard(_error: ServiceError) -> None:
    """For who does not want to be told that the service is away."""


def run_events(link: Transport, run_id: str, after: int = 0, away: Away = unheard) -> Iterator[RunEvent]:
    """What happened in a run since an event, then what happens, until nobody carries it out any more.

    Args:
        link: to the service.
        run_id: whole.
        after: `id` of the last event known; 0 for all.
        away: is told once each time that the service does not answer any more, and is waited for.

    Raises:
        Refused: there is no such run, or the service lets nobody look.
        Unreachable: the service has been away for `PATIENCE_S`.
    """
    known, path = after, f"/api/runs/{run_id}"
    away_since_s: float | None = None
    while True:
        latest: RunEvent | None = None
        try:
            with link.lines(f"{path}/events", {"Last-Event-ID": str(known)}) as lines:
                away_since_s = None
                for fields in parsed(lines):
                    latest = _event(fields)
                    if latest.id > known:
                        known = latest.id
                        yield latest
            # A service that is told to stop ends the stream too: only the run itself tells that it has ended.
            if (latest is None or latest.is_last) and link.get(path)["status"] in AT_REST:
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
        return RunEvent.of({"id": int(fields["id"]), "type": fields["event"], "data": data})
    except (KeyError, ValueError) as error:
        raise Unreachable("the service's events are not calrig's") from error
