"""Progress on standard error, where that is a terminal: of a run, or of a long analysis.

A run of several mounts asks there for the unit to be rotated.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from calrig.errors import WorkError, printable

if TYPE_CHECKING:
    from calrig.cli.followed_run import FollowedRun
    from calrig.cli.watch import RunElsewhere
    from calrig.client import RunEvent
    from calrig.model.run import Mount
    from calrig.store import Event

PATIENCE_S = 2.0
"""What takes no longer needs no bar."""
PLAIN: dict[str, Any] = {"markup": False, "highlight": False}
"""Text as it is."""
PERCENT = 100
"""Of a static log, which has no poses to be counted."""


NEARLY = 0.9999
"""Shown as 100 %; at 1 the clock beside it would stop, and there may be a step to come."""
SHORT = 24
"""Characters of a serial number that leave room for the bar beside it."""


@contextmanager
def run_bar(run: FollowedRun | RunElsewhere, unit: str) -> Iterator[Callable[[Happened], None]]:
    """A run's progress: poses, elevation, time left. Gives what is to be told each of the run's events."""
    console = Console(stderr=True)
    named, is_long = printable(unit), len(unit) > SHORT
    if console.is_terminal:  # whose window may be closed: `calrig watch` needs the id then
        console.print(f"run {run.id}" + (f" of unit {named}" if is_long else ""), soft_wrap=True, **PLAIN)
    columns = (
        TextColumn("" if is_long else f"unit {named}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[elevation]}", markup=False),
        TextColumn("{task.fields[left]}", markup=False),
    )
    with Bar(*columns, console=console, disable=not console.is_terminal) as progress:
        total = run.progress.poses_total or PERCENT
        bar = progress.add_task("", total=total, elevation="", left="")

        def show(event: Happened) -> None:
            data = event.data
            if event.type == "progress":
                completed = data["poses_done"] if data["poses_total"] else PERCENT * data["fraction"]
                progress.update(bar, completed=completed, left=_left(data["remaining_s"]))
                if data.get("waiting_for"):
                    progress.stop()  # a person is asked, and types below it
                elif console.is_terminal:
                    progress.start()
            elif event.type == "reading" and data["stage_deg"] is not None:
                progress.update(bar, elevation=f"{data['stage_deg']:+.1f}°")
            elif event.type == "state":
                progress.update(bar, left=data["status"])
            elif event.type == "notice":
                console.print(
                    f"calrig: {printable(data['says'])}", soft_wrap=not console.is_terminal, **PLAIN
                )

        yield show


def _left(remaining_s: float | None) -> str:
    return "" if remaining_s is None else f"{int(remaining_s) // 60}:{int(remaining_s) % 60:02d} left"


@contextmanager
def late_bar(what: str, patience_s: float = PATIENCE_S) -> Iterator[Callable[[float], None]]:
    """Gives what is to be told the share done, 0 to 1; on a terminal a bar shows it once that takes long.

    Until a share is told the bar runs to and fro.
    """
    with late_bars(patience_s) as step:
        yield step(what)


@contextmanager
def late_bars(patience_s: float = PATIENCE_S) -> Iterator[Callable[[str], Callable[[float], None]]]:
    """The same for work of several steps, one bar: gives what makes of the name of each what it is told."""
    console = Console(stderr=True)
    begun_s = time.monotonic()
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn())
    progress = Bar(*columns, TimeElapsedColumn(), console=console, transient=True)
    bar = progress.add_task("", total=None)
    late = threading.Timer(patience_s, progress.start)  # also where the work can tell nothing

    def step(what: str) -> Callable[[float], None]:
        described = printable(what)
        if not progress.tasks[bar].description:
            progress.update(bar, description=described)

        def show(share: float) -> None:
            total = 1.0 if share > 0.0 else None
            progress.update(bar, description=described, total=total, completed=min(share, NEARLY))
            if console.is_terminal and time.monotonic() - begun_s > patience_s:
                progress.start()

        return show

    if console.is_terminal:
        late.start()
    try:
        yield step
    finally:
        late.cancel()
        if late.ident is not None:
            late.join()
        if progress.live.is_started:
            progress.stop()


LOOK_S = 0.1
"""How often a run is looked at when nothing is heard of it, and how soon a Ctrl-C is seen."""


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


if TYPE_CHECKING:
    Happened = RunEvent | Event | Notice
    """An event of the run's log, `state`, `progress`, `pose`, `reading`, or something to be said beside."""


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
    run: FollowedRun,
    asked: StopRequest,
    show: Callable[[Happened], None],
    look: Callable[[FollowedRun], None],
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


def carry_out(begin: Callable[[], FollowedRun], unit: str, *, as_json: bool) -> None:
    """Follows a run on the terminal, asks for what it waits for, and prints how it ended.

    `begin` starts it; a Ctrl-C during the start aborts the run once it has started. With `as_json` its
    document is printed.

    Raises:
        WorkError: it was not completed.
    """
    with stop_request() as asked:
        run = begin()
        with run_bar(run, unit) as show:
            follow(run, asked, show, MountPrompt().look)
    print_end(run.document(), as_json=as_json)


def print_end(ended: object, *, as_json: bool) -> None:
    """Prints a run that has ended: its document, or its figures and its verdict.

    Raises:
        WorkError: it was not completed.
    """
    from calrig.cli import output
    from calrig.client.documents import RunRecord, typed

    if as_json:
        output.print_json(ended)
    run = typed(RunRecord, ended)
    if not as_json:
        output.print_result(run)
    if run.status != "completed":
        why = f": {run.error}" if run.error else ""
        is_told = f"`calrig resume {run.id}" in why  # with what it needs to be told
        is_resumable = run.status == "interrupted" and not is_told
        on = f"; `calrig resume {run.id}` continues it" if is_resumable else ""
        raise WorkError(f"run {run.id} {run.status}{why}{on}")


BY_CLAMP = "c"


class MountPrompt:
    """What is asked on standard error and answered by a line of standard input, a person's or a program's.

    Somebody else may answer first, on the page of the service: then the line still to come says nothing.
    """

    def __init__(self) -> None:
        self._lines: SimpleQueue[str] = SimpleQueue()
        self._asked: Mount | None = None
        self._is_reading = False

    def look(self, run: FollowedRun) -> None:
        """Asks where the run waits and has not been asked about; passes an answer on that has come.

        Raises:
            WorkError: standard input has ended: nobody can say that the unit was turned.
        """
        wanted = run.progress.waiting_for if run.status == "paused" else None
        if wanted is None:
            self._asked = None
            return
        to = f"the unit to {wanted.mount_deg:g}°, its {wanted.mount_axis} along the stage's axis"
        if self._asked != wanted:
            self._ask(f"Turn {to}, then press Enter", has_clamp=run.has_clamp)
            self._asked = wanted
            return
        try:
            line = self._lines.get_nowait()
        except Empty:
            return
        self._is_reading = False
        if not line:
            run.abort()
            raise WorkError(
                f"run {run.id} aborted: it waited for somebody to turn {to}, and standard input has ended: "
                "run it on a terminal, or start it on the page of `calrig serve`"
            )
        self._go(run, wanted, line.strip().lower())

    def _ask(self, what: str, *, has_clamp: bool) -> None:
        by_clamp = f" ({BY_CLAMP} and Enter: the rig's clamp turns it)" if has_clamp else ""
        typer.echo(f"{what}{by_clamp}", err=True)
        if not self._is_reading:
            self._is_reading = True
            threading.Thread(target=lambda: self._lines.put(sys.stdin.readline()), daemon=True).start()

    def _go(self, run: FollowedRun, wanted: Mount, line: str) -> None:
        try:
            if line == BY_CLAMP and run.has_clamp:
                run.turn(wanted)
            run.resume()
        except Refusal as refusal:
            typer.echo(str(refusal), err=True)
            self._asked = None
