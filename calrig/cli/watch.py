"""`watch`: a run that a service or another program carries out, followed from this terminal."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from calrig.cli import options
from calrig.cli.options import SHORTENED, Db, Json, Server, whole_id
from calrig.cli.progress import LOOK_S
from calrig.cli.running_service import open_store, running_service, whole_id_there
from calrig.errors import WorkError

if TYPE_CHECKING:
    from calrig.cli.followed_run import FollowedRun
    from calrig.cli.progress import Happened
    from calrig.store import Event, Run, Store

RunId = Annotated[
    str, typer.Argument(metavar="RUN_ID", help=f"The run{SHORTENED}.", autocompletion=options.runs)
]


def watch(run_id: RunId, as_json: Json = False, db: Db = None, server: Server = None) -> None:
    """Follow a run and print how it ended; Ctrl-C stops watching, and the run goes on."""
    there = running_service(server, db)
    if there is not None:
        from calrig.cli.followed_run import FollowedRun

        found = there.run(whole_id_there(there, run_id))
        _watch(FollowedRun(there, found), found.unit, as_json=as_json)
        return

    from calrig.analysis.stored_runs import stored_run

    with open_store(db) as store:
        run = stored_run(store, whole_id(store, run_id))
        is_written = _is_written(store.url)
        _watch(RunElsewhere(store, run, is_written), run.unit, as_json=as_json)


class RunElsewhere:
    """A run that another program carries out into the same file; attributes as of a `FollowedRun`.

    `is_written` tells whether a program writes to that file.
    """

    def __init__(self, store: Store, run: Run, is_written: Callable[[], bool]) -> None:
        self.id, self.is_over = run.id, False
        self.status, self.progress = str(run.status), run.progress
        self._store, self._seen, self._is_written = store, 0, is_written

    def news(self) -> Sequence[Event]:
        """Events since the last look.

        Raises:
            WorkError: nobody carries it out any more.
        """
        from calrig.analysis.stored_runs import stored_run
        from calrig.model.run import AT_REST

        is_written = self._is_written()  # before the run is read: who has ended it may be gone
        run = stored_run(self._store, self.id)
        if run.status not in AT_REST and not is_written:
            raise WorkError(
                f"run {self.id} is {run.status} in the store, but no process executes it; continue it with "
                f"`calrig resume {self.id}`"
            )
        events = self._store.events.after(self.id, self._seen)
        self._seen = events[-1].seq if events else self._seen
        self.status, self.progress = str(run.status), run.progress
        self.is_over = run.status in AT_REST
        if not events and not self.is_over:
            time.sleep(LOOK_S)
        return events

    def document(self) -> object:
        """As the API gives it."""
        from calrig.analysis.stored_runs import stored_run
        from calrig.api.models import RunAnswer

        return RunAnswer.model_validate(stored_run(self._store, self.id)).model_dump(mode="json")


def _is_written(url: str) -> Callable[[], bool]:
    """What tells whether a program writes to a store; to a centre's any number may."""
    from calrig.store.engines import is_centre
    from calrig.store.sqlite.database import database_path
    from calrig.store.sqlite.lock import living_writer

    return lambda: is_centre(url) or living_writer(database_path(url)) is not None


def _watch(run: FollowedRun | RunElsewhere, unit: str, *, as_json: bool) -> None:
    from calrig.cli.progress import print_end, run_bar

    try:
        with run_bar(run, unit) as show:
            while not run.is_over:
                for event in run.news():
                    show(event)
                    _say_what_it_waits_for(run.id, event)
    except KeyboardInterrupt as left:
        left.add_note(f"run {run.id} was not touched: `calrig watch {run.id[:8]}` follows it again")
        raise
    print_end(run.document(), as_json=as_json)


def _say_what_it_waits_for(run_id: str, event: Happened) -> None:
    wanted = event.data.get("waiting_for") if event.type == "progress" else None
    if wanted is not None:
        to = f"{wanted['mount_deg']:g}°, its {wanted['mount_axis']} along the stage's axis"
        typer.echo(f"the run waits for the unit to be turned to {to}: calrig resume {run_id}", err=True)
