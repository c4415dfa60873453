"""A run as a terminal follows it, whether this process carries it out, a service does, or another program."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

from calrig.errors import WorkError

LOOK_S = 0.1
"""How often a run is looked at when nothing is heard of it, and how soon a Ctrl-C is seen."""


class Happened(Protocol):
    """An event of the run's log: `state`, `progress`, `pose`, `reading`."""

    @property
    def type(self) -> str:
        """What kind of."""

    @property
    def data(self) -> dict[str, Any]:
        """CONTRACT section 2."""


@dataclass(frozen=True, slots=True)
class Notice:
    """Something to be said beside the run's own events."""

    says: str
    type: str = "notice"

    @property
    def data(self) -> dict[str, Any]:
        """As of an event."""
        return {"says": self.says}


class Refusal(Exception):  # noqa: N818 (read as words: raise Refusal)
    """The run cannot do what was asked of it now; says why."""


class Watched(Protocol):
    """A run that is looked at.

    Attributes:
        id: its id.
        status: as last heard.
        progress: likewise.
        is_over: whether nobody carries it out any more and all that happened was told.
    """

    id: str
    status: str
    progress: dict[str, Any]
    is_over: bool

    def news(self) -> Sequence[Happened]:
        """What happened since the last look; waits for `LOOK_S` at most."""

    def document(self) -> dict[str, Any]:
        """The run as the API gives it."""


class Followed(Watched, Protocol):
    """A run that this terminal has begun, and answers for.

    Attributes:
        has_clamp: whether the rig can turn the unit by itself.
    """

    has_clamp: bool

    def abort(self) -> None:
        """Ends it; Refusal where it has just ended, or its stage was not seen to stand."""

    def resume(self) -> None:
        """Goes on; Refusal where the unit is not turned as it should be."""

    def turn(self, mount_deg: float, mount_axis: str) -> None:
        """Has the rig's clamp turn the unit; Refusal where it cannot."""


class StopRequest:
    """Whether a signal has asked for the end. A flag, for an exception can get lost in a finaliser."""

    def __init__(self) -> None:
        self.is_made = False

    def __call__(self, number: int, _frame: object) -> None:
        """Takes the signal."""
        self.is_made = True
        signal.signal(number, signal.default_int_handler)  # the second one is not asked but told


@contextmanager
def stop_request() -> Iterator[StopRequest]:
    """Takes SIGINT and SIGTERM for as long as it lasts."""
    asked = StopRequest()
    before = {number: signal.signal(number, asked) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def follow(
    run: Followed,
    asked: StopRequest,
    show: Callable[[Happened], None],
    look: Callable[[Followed], None],
) -> None:
    """Shows what happens in a run until it has ended, aborting it once that is asked for.

    `look` is given the run again and again, for what it may wait for.
    """
    is_aborted = False
    while True:
        for event in run.news():
            show(event)
        if run.is_over:
            return
        if asked.is_made and not is_aborted:
            is_aborted = True
            show(Notice("stopping the stage and ending the run; the poses measured so far are kept"))
            try:
                run.abort()
            except Refusal:
                continue  # it has just ended, or its error says what became of the stage
        elif not is_aborted:
            look(run)


def carry_out(begin: Callable[[], Followed], unit: str, *, as_json: bool) -> None:
    """Follows a run on the terminal, asks for what it waits for, and prints how it ended.

    Args:
        begin: begins it; a Ctrl-C meanwhile is not lost, but aborts it then.
        unit: its serial number.
        as_json: whether its document is printed.

    Raises:
        WorkError: it was not completed.
    """
    from calrig.cli.mount_prompt import MountPrompt
    from calrig.cli.progress import run_bar

    with stop_request() as asked:
        run = begin()
        with run_bar(run, unit) as show:
            follow(run, asked, show, MountPrompt().look)
    print_end(run.document(), as_json=as_json)


def print_end(ended: dict[str, Any], *, as_json: bool) -> None:
    """Prints a run that has ended: its document, or its figures and its verdict.

    Raises:
        WorkError: it was not completed.
    """
    from calrig.cli import output

    if as_json:
        output.print_json(ended)
    else:
        output.print_result(ended)
    if ended["status"] != "completed":
        why = f": {ended['error']}" if ended["error"] else ""
        is_told = f"`calrig resume {ended['id']}" in why  # with what it needs to be told
        is_resumable = ended["status"] == "interrupted" and not is_told
        on = f"; `calrig resume {ended['id']}` goes on with it" if is_resumable else ""
        raise WorkError(f"run {ended['id']} {ended['status']}{why}{on}")
