"""Asks on the terminal for the unit to be turned, while the run that waits for it is looked after."""

from __future__ import annotations

import sys
import threading
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

import typer

from calrig.errors import WorkError

if TYPE_CHECKING:
    from calrig.runs.service import RunService
    from calrig.store import Run

BY_CLAMP = "c"


class MountPrompt:
    """What is asked on standard error and answered by a line of standard input, a person's or a program's.

    Args:
        service: carries the run out in this process, so that nobody else can resume it.
        rig: its name; whether it has a clamp of its own.
    """

    def __init__(self, service: RunService, rig: str, *, has_clamp: bool) -> None:
        self._service, self._rig, self._has_clamp = service, rig, has_clamp
        self._lines: SimpleQueue[str] = SimpleQueue()
        self._is_asking = False

    def look(self, run: Run) -> None:
        """Asks where the run waits and has not been asked about; passes an answer on that has come.

        Raises:
            WorkError: standard input has ended: nobody can say that the unit was turned.
        """
        asked = run.progress.get("waiting_for")
        if run.status != "paused" or asked is None:
            return
        to = f"the unit to {asked['mount_deg']:g}°, its {asked['mount_axis']} along the stage's axis"
        if not self._is_asking:
            self._ask(f"Turn {to}, then press Enter")
            return
        try:
            line = self._lines.get_nowait()
        except Empty:
            return
        self._is_asking = False
        if not line:
            self._service.abort(run.id)
            raise WorkError(
                f"run {run.id} aborted: it waited for somebody to turn {to}, and standard input has ended: "
                "run it on a terminal, or start it on the page of `calrig serve`"
            )
        self._go(run.id, asked["mount_deg"], asked["mount_axis"], line.strip().lower())

    def _ask(self, what: str) -> None:
        by_clamp = f" ({BY_CLAMP} and Enter: the rig's clamp turns it)" if self._has_clamp else ""
        typer.echo(f"{what}{by_clamp}", err=True)
        self._is_asking = True
        threading.Thread(target=lambda: self._lines.put(sys.stdin.readline()), daemon=True).start()

    def _go(self, run_id: str, mount_deg: float, axis: str, line: str) -> None:
        from calrig.analysis.errors import Conflict

        try:
            if line == BY_CLAMP and self._has_clamp:
                self._service.begin_clamp(self._rig, mount_deg, axis).result()  # type: ignore[arg-type]
            self._service.resume(run_id)
        except Conflict as refusal:
            typer.echo(str(refusal), err=True)
