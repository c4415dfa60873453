"""How far something is, on standard error where that is a terminal: a run, or a long analysis."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)

from calrig.errors import printable

if TYPE_CHECKING:
    from calrig.cli.followed import Happened

PATIENCE_S = 2.0
"""What takes no longer needs no bar."""
PERCENT = 100
"""Of a static log, which has no poses to be counted."""


@contextmanager
def run_bar(unit: str, poses_total: int) -> Iterator[Callable[[Happened], None]]:
    """A run's progress: poses, elevation, time left. Gives what is to be told each of the run's events."""
    columns = (
        TextColumn("unit {task.fields[unit]}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[elevation]}", markup=False),
        TextColumn("{task.fields[left]}", markup=False),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        total = poses_total or PERCENT
        bar = progress.add_task("", total=total, unit=printable(unit), elevation="", left="")

        def show(event: Happened) -> None:
            data = event.data
            if event.type == "progress":
                left_s = data["remaining_s"]
                left = "" if left_s is None else f"{int(left_s) // 60}:{int(left_s) % 60:02d} left"
                completed = data["poses_done"] if data["poses_total"] else PERCENT * data["fraction"]
                progress.update(bar, completed=completed, left=left)
                if data.get("waiting_for"):
                    progress.stop()  # a person is asked, and types below it
                elif console.is_terminal:
                    progress.start()
            elif event.type == "reading" and data["stage_deg"] is not None:
                progress.update(bar, elevation=f"{data['stage_deg']:+.1f}°")

        yield show


@contextmanager
def late_bar(what: str, patience_s: float = PATIENCE_S) -> Iterator[Callable[[float], None]]:
    """Gives what is to be told the share done, 0 to 1; on a terminal a bar shows it once that takes long."""
    console = Console(stderr=True)
    begun_s = time.monotonic()
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn())
    progress = Progress(*columns, TimeRemainingColumn(), console=console, transient=True)
    bar = progress.add_task(printable(what), total=1.0)

    def show(share: float) -> None:
        progress.update(bar, completed=share)
        if console.is_terminal and not progress.live.is_started and time.monotonic() - begun_s > patience_s:
            progress.start()

    try:
        yield show
    finally:
        if progress.live.is_started:
            progress.stop()
