"""Asks on the terminal for the unit to be turned, while the run that waits for it is looked after."""

from __future__ import annotations

import sys
import threading
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

import typer

from calrig.cli.followed import Refusal
from calrig.errors import WorkError

if TYPE_CHECKING:
    from calrig.cli.followed import Followed

BY_CLAMP = "c"


class MountPrompt:
    """What is asked on standard error and answered by a line of standard input, a person's or a program's.

    Somebody else may answer first, on the page of the service: then the line still to come says nothing.
    """

    def __init__(self) -> None:
        self._lines: SimpleQueue[str] = SimpleQueue()
        self._asked: dict[str, Any] | None = None
        self._is_reading = False

    def look(self, run: Followed) -> None:
        """Asks where the run waits and has not been asked about; passes an answer on that has come.

        Raises:
            WorkError: standard input has ended: nobody can say that the unit was turned.
        """
        wanted = run.progress.get("waiting_for") if run.status == "paused" else None
        if wanted is None:
            self._asked = None
            return
        to = f"the unit to {wanted['mount_deg']:g}°, its {wanted['mount_axis']} along the stage's axis"
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

    def _go(self, run: Followed, wanted: dict[str, Any], line: str) -> None:
        try:
            if line == BY_CLAMP and run.has_clamp:
                run.turn(wanted["mount_deg"], wanted["mount_axis"])
            run.resume()
        except Refusal as refusal:
            typer.echo(str(refusal), err=True)
            self._asked = None
