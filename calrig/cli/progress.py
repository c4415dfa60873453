"""How far something is, on standard error where that is a terminal: a run, or a long analysis."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
)

from calrig.errors import printable

if TYPE_CHECKING:
    from calrig.cli.followed import Happened, Watched

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
def run_bar(run: Watched, unit: str) -> Iterator[Callable[[Happened], None]]:
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
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        total = run.progress["poses_total"] or PERCENT
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
    progress = Progress(*columns, TimeElapsedColumn(), console=console, transient=True)
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
