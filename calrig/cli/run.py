"""`run`: one calibration from the terminal, which Ctrl-C aborts."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calrig.cli.input_files import read_plan_file
from calrig.cli.options import Config, Db, Json, Record, Rig, UnitSerial
from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    from calrig.runs.service import RunService
    from calrig.settings import RigSettings, Settings
    from calrig.store import Event, Run

LOOK_S = 0.1
"""How often a run is looked at when nothing is heard of it, and how soon a Ctrl-C is seen."""


def run(
    unit: UnitSerial,
    rig: Rig = None,
    plan: Annotated[
        Path | None, typer.Option(metavar="FILE.json", help="Plan; else the default one.")
    ] = None,
    as_json: Json = False,
    operator: Annotated[str | None, typer.Option(help="Who runs it; kept with the run.")] = None,
    note: Annotated[str | None, typer.Option(help="Kept with the run.")] = None,
    stage_at: Annotated[
        float | None,
        typer.Option(
            min=-360, max=360, metavar="DEG", help="Elevation at which a stage without homing stands now."
        ),
    ] = None,
    record: Record = None,
    db: Db = None,
    config: Config = None,
) -> None:
    """Run one calibration; Ctrl-C aborts it and keeps the poses measured so far."""
    from calrig.analysis.limits import cannot_pass_on
    from calrig.cli import output
    from calrig.cli.local_service import local_service
    from calrig.cli.mount_prompt import MountPrompt
    from calrig.cli.progress import run_bar
    from calrig.plan import Plan
    from calrig.settings import load_settings, store_url

    the_plan = read_plan_file(plan) if plan else Plan()
    settings = load_settings(config)
    chosen = _rig_named(settings, rig)
    with local_service(store_url(db), "run", (chosen,), settings, record) as service:
        for warning in cannot_pass_on(chosen, unit, the_plan, service.store, service.maps):
            typer.echo(f"warning: {warning}", err=True)
        begun = service.start(
            unit=unit, rig=chosen.name, plan=the_plan, operator=operator, note=note, stage_at_deg=stage_at
        )
        prompt = MountPrompt(service, chosen.name, has_clamp=_has_clamp(service, chosen.name))
        with run_bar(begun) as show, _stop_request() as asked:
            ended = _until_ended(service, begun.id, asked, show, prompt.look)
    if as_json:
        from calrig.api.models import RunAnswer

        typer.echo(RunAnswer.model_validate(ended).model_dump_json(indent=2))
    else:
        output.print_result(ended)
    if ended.status != "completed":
        raise WorkError(f"run {ended.id} {ended.status}" + (f": {ended.error}" if ended.error else ""))


def _rig_named(settings: Settings, name: str | None) -> RigSettings:
    if name is None:
        return settings.rig[0]
    for rig in settings.rig:
        if rig.name == name:
            return rig
    raise InputError(
        f"--rig: there is no rig {name!r}; configured: {', '.join(r.name for r in settings.rig)}"
    )


def _has_clamp(service: RunService, rig: str) -> bool:
    return any(state.clamp for state in service.rigs() if state.name == rig)


class _StopRequest:
    """Whether a signal has asked for the end. A flag, for an exception can get lost in a finaliser."""

    def __init__(self) -> None:
        self.is_made = False

    def __call__(self, number: int, _frame: object) -> None:
        self.is_made = True
        signal.signal(number, signal.default_int_handler)  # the second one is not asked but told


@contextmanager
def _stop_request() -> Iterator[_StopRequest]:
    """Takes SIGINT and SIGTERM for as long as it lasts."""
    asked = _StopRequest()
    before = {number: signal.signal(number, asked) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _until_ended(
    service: RunService,
    run_id: str,
    asked: _StopRequest,
    show: Callable[[Event], None],
    look: Callable[[Run], None],
) -> Run:
    """Shows the run's events until it has ended, aborting it once that is asked for; the run as it ended.

    `look` is given the run again and again, for what it may wait for.
    """
    from calrig.analysis.errors import Conflict
    from calrig.store import AT_REST

    news = threading.Event()
    unsubscribe = service.bus.subscribe(run_id, news.set)
    seen = 0
    aborted = False
    try:
        while True:
            news.clear()
            run = service.run(run_id)
            for event in service.store.events_after(run_id, seen):
                seen = event.seq
                show(event)
            if run.status in AT_REST:
                return run
            if asked.is_made and not aborted:
                aborted = True
                with suppress(Conflict):  # it has just ended, or its error says what became of the stage
                    service.abort(run_id)
                continue
            look(run)
            news.wait(LOOK_S)
    finally:
        unsubscribe()
