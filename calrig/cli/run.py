"""`run` and `resume`: a calibration from the terminal, which Ctrl-C aborts, here or at a running service."""

from __future__ import annotations

from contextlib import AbstractContextManager, ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calrig.cli.input_files import read_plan_file
from calrig.cli.options import Config, Db, Json, Record, Rig, Server, StageAt, UnitSerial, whole_id
from calrig.cli.running_service import open_store, running_service, whole_id_there
from calrig.cli.watch import RunId
from calrig.errors import InputError

if TYPE_CHECKING:
    from calrig.client import Client
    from calrig.settings import RigSettings, Settings


def run(
    unit: UnitSerial,
    rig: Rig = None,
    plan: Annotated[
        Path | None, typer.Option(metavar="FILE.json", help="Plan; else the default one.")
    ] = None,
    as_json: Json = False,
    operator: Annotated[str | None, typer.Option(help="Who runs it; kept with the run.")] = None,
    note: Annotated[str | None, typer.Option(help="Kept with the run.")] = None,
    stage_at: StageAt = None,
    record: Record = None,
    db: Db = None,
    config: Config = None,
    server: Server = None,
) -> None:
    """Run one calibration; Ctrl-C aborts it and keeps the poses measured so far.

    Where `calrig serve` holds the store the run is its, on its rigs, and is followed here.
    """
    from calrig.cli.followed_run import FollowedRun
    from calrig.cli.progress import carry_out
    from calrig.model.plan import Plan

    the_plan = read_plan_file(plan) if plan else Plan()
    with ExitStack() as stack:
        client = running_service(server, db)
        if client is not None:
            refuse_own_rigs("run", client, config, record)
            require_rig(client, rig)
        else:
            from calrig.cli.local_service import local_client
            from calrig.settings import load_settings, store_url

            settings = load_settings(config)
            rigs = (rig_named(settings, rig),)
            client = stack.enter_context(local_client(store_url(db), "run", rigs, settings, record))
        for warning in client.estimate(the_plan, rig=rig, unit=unit).warnings:
            typer.echo(f"warning: {warning}", err=True)
        start = partial(client.calibrate, unit, rig=rig, plan=the_plan, operator=operator, note=note)
        carry_out(lambda: FollowedRun(client, start(stage_at_deg=stage_at)), unit, as_json=as_json)


def rig_named(settings: Settings, name: str | None) -> RigSettings:
    """The rig of a name, the first without one."""
    if name is None:
        return settings.rig[0]
    for rig in settings.rig:
        if rig.name == name:
            return rig
    raise InputError(
        f"--rig: there is no rig {name!r}; configured: {', '.join(r.name for r in settings.rig)}"
    )


def require_rig(there: Client, name: str | None) -> None:
    """Raises InputError, as `rig_named` does, where a service has no rig of a name."""
    if name is not None and name not in (known := [rig.name for rig in there.rigs()]):
        raise InputError(f"{there.server}: --rig: there is no rig {name!r}; configured: {', '.join(known)}")


def refuse_own_rigs(command: str, there: Client, config: str | None, record: Path | None) -> None:
    """Refuses what only a process with the ports can do; a service has been told its own."""
    for option, given in (("--config", config), ("--record", record)):
        if given is not None:
            raise InputError(
                f"{command}: {option} is for `calrig serve`: the service at {there.server} holds the store, "
                "and its rigs and wires are its own"
            )


def resume(
    run_id: RunId,
    stage_at: StageAt = None,
    as_json: Json = False,
    record: Record = None,
    db: Db = None,
    config: Config = None,
    server: Server = None,
) -> None:
    """Resume an interrupted run, or one that is paused at the service; Ctrl-C aborts it.

    Rig, board and stage have to be the same, and the unit untouched: the last pose is measured once more.
    Of a stage without homing that was on its way, say where it stands (`--stage-at`).
    """
    from calrig.cli.followed_run import FollowedRun
    from calrig.cli.progress import carry_out

    with ExitStack() as stack:
        client = running_service(server, db)
        if client is not None:
            refuse_own_rigs("resume", client, config, record)
        else:
            client = stack.enter_context(_local_client(run_id, record, db, config))
        found = client.run(whole_id_there(client, run_id))

        def resumed() -> FollowedRun:
            found.resume(stage_at_deg=stage_at)
            return FollowedRun(client, found)

        carry_out(resumed, found.unit, as_json=as_json)


def _local_client(
    run_id: str, record: Path | None, db: str | None, config: str | None
) -> AbstractContextManager[Client]:
    from calrig.analysis.stored_runs import stored_run
    from calrig.cli.local_service import local_client
    from calrig.settings import load_settings

    settings = load_settings(config)
    with open_store(db) as store:
        run = stored_run(store, whole_id(store, run_id))
    rigs = () if run.rig is None else (rig_named(settings, run.rig),)  # an imported one is refused in words
    return local_client(store.url, "resume", rigs, settings, record)
