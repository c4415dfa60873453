"""The command line: composes rigs, store and service, and says in one line what went wrong.

Exit status 0: done; 1: the work failed; 2: wrong usage or unreadable input. Imports stand where they are
used: `calrig --help` needs none of them.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

import calrig
from calrig.cli import analysis, store
from calrig.cli.store import Rig, UnitSerial
from calrig.errors import InputError, WorkError, printable

if TYPE_CHECKING:
    import socket

    from calrig.api.access import Access
    from calrig.runs.service import RunService
    from calrig.settings import RigSettings, Settings

app = typer.Typer(
    name="calrig",
    help="Calibrates IMU attitude sensors on a rotary stage.",
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.add_typer(store.app)
app.add_typer(analysis.app)

Db = Annotated[str | None, typer.Option(metavar="FILE", help="Store: a path or a URL [CALRIG_DB].")]
Config = Annotated[str | None, typer.Option(metavar="FILE", help="Configuration [CALRIG_CONFIG].")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
LogFormat = Annotated[
    str | None, typer.Option(metavar="text|json", help="Form of the log on standard error [CALRIG_LOG].")
]
Record = Annotated[
    Path | None, typer.Option("--record", metavar="DIR", help="Write every byte on the wires down there.")
]


STATUS = {
    "calrig.errors.WorkError": 1,
    "calrig.errors.InputError": 2,
    "calrig.plan_file.PlanFileError": 2,
    "calrig.settings.SettingsError": 2,
    "calrig.store.errors.StoreError": 1,
    "calrig.analysis.errors.RunsError": 1,
    "calrig.analysis.errors.Invalid": 2,
    "calrig.api.address.AddressError": 1,
    "calrig.api.access.AccessError": 2,
}
"""Exit status by kind of error; by name, for importing them all would take a second to say one line."""


def main() -> None:
    """Runs the command line and leaves with its exit status."""
    # numpy's products here are small: threads that wait for each other make them several times slower
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends in order, as Ctrl-C does
    try:
        app()
    except SystemExit as leave:
        if leave.code != 130:  # typer's own after a Ctrl-C that no command has taken for itself
            raise
        _leave("interrupted", 1)
    except Exception as error:
        status = _exit_status(error)
        if status is None:
            raise
        _leave(str(error), status)


def _leave(reason: str, status: int) -> NoReturn:
    typer.echo(f"calrig: {printable(' '.join(reason.split()))}", err=True)
    sys.exit(status)


def _exit_status(error: Exception) -> int | None:
    """The exit status that an error a user can cause stands for; None for a defect of calrig's own."""
    names = (f"{kind.__module__}.{kind.__name__}" for kind in type(error).__mro__)
    return next((STATUS[name] for name in names if name in STATUS), None)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"calrig {calrig.__version__}")
        raise typer.Exit


@app.callback()
def _calrig(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command()
def serve(
    host: Annotated[str, typer.Option(metavar="H", help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(metavar="N", min=0, max=65535, help="Port; 0: any free one.")] = 8000,
    record: Record = None,
    log_format: LogFormat = None,
    db: Db = None,
    config: Config = None,
) -> None:
    """Serve the web page and the API, with a simulated rig when none is configured.

    CALRIG_TOKEN is the token that whoever comes in has to show; without one, only this machine may.
    """
    from calrig.api.access import access_here
    from calrig.api.address import address_of, listen
    from calrig.logs import configure_log
    from calrig.settings import load_settings, store_url

    settings = load_settings(config)
    configure_log(log_format)
    access = access_here(host, address_of(host, port), settings.hosts)
    with closing(listen(host, port)) as listener:
        _serve_on(listener, access, settings, store_url(db), record)


def _serve_on(
    listener: socket.socket, access: Access, settings: Settings, url: str, record: Path | None
) -> None:
    from calrig.api.access import TOKEN
    from calrig.api.app import create_app
    from calrig.api.server import Server

    with _service(url, "serve", settings.rig, settings, record) as service, suppress(KeyboardInterrupt):
        if settings.keep_samples_days is not None:
            service.store.prune_samples(datetime.now(UTC) - timedelta(days=settings.keep_samples_days))

        def say_ready() -> None:
            rigs = ", ".join(f"{r.name} (simulated)" if r.simulated else r.name for r in service.rigs())
            host, port = listener.getsockname()[:2]
            where = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
            asks = "" if access.token is None else f"; it asks for the token of {TOKEN}"
            typer.echo(f"calrig {calrig.__version__} at {where}, store {url}, rigs: {rigs}{asks}")

        # On SIGINT and SIGTERM uvicorn stops in order, then raises what it was told by.
        Server(create_app(service, access=access), say_ready).run(sockets=[listener])


@app.command()
def run(
    unit: UnitSerial,
    rig: Rig = None,
    plan: Annotated[
        Path | None, typer.Option(metavar="FILE.json", help="Plan; else the default one.")
    ] = None,
    as_json: Json = False,
    operator: Annotated[str | None, typer.Option(help="Who runs it; kept with the run.")] = None,
    note: Annotated[str | None, typer.Option(help="Kept with the run.")] = None,
    record: Record = None,
    db: Db = None,
    config: Config = None,
) -> None:
    """Run one calibration; Ctrl-C aborts it and keeps the poses measured so far."""
    from calrig.cli import terminal
    from calrig.plan import Plan
    from calrig.plan_file import read_plan
    from calrig.settings import load_settings, store_url

    the_plan = read_plan(plan) if plan else Plan()
    settings = load_settings(config)
    chosen = _rig_named(settings, rig)
    with _service(store_url(db), "run", (chosen,), settings, record) as service:
        begun = service.start(unit=unit, rig=chosen.name, plan=the_plan, operator=operator, note=note)
        ended = terminal.follow(service, begun)
    if as_json:
        from calrig.api.models import RunAnswer

        typer.echo(RunAnswer.model_validate(ended).model_dump_json(indent=2))
    else:
        terminal.print_result(ended)
    if ended.status != "completed":
        raise WorkError(f"run {ended.id} {ended.status}" + (f": {ended.error}" if ended.error else ""))


@app.command()
def rigs(
    scan: Annotated[
        bool, typer.Option("--scan", help="Also look who answers on every port; boards are reset by it.")
    ] = False,
    config: Config = None,
) -> None:
    """List the rigs that are configured and, with --scan, what answers on the ports; nothing is moved."""
    from calrig.cli import terminal
    from calrig.settings import load_settings

    settings = load_settings(config)
    terminal.print_rigs(settings.rig)
    if scan:
        from calrig.instruments import scan as ports
        from calrig.instruments.scan_stanza import stanza

        found = ports.scan(settings.ports())
        terminal.print_ports(found, stanza(found, {rig.name for rig in settings.rig}))


@contextmanager
def _service(
    url: str, what: str, rigs: Sequence[RigSettings], settings: Settings, record: Path | None
) -> Iterator[RunService]:
    """The run service over the store; its simulated rigs start beside, for a process takes its time.

    Stages that a dead program may have left moving, of whichever rig is configured, are told to stop first.
    """
    with ExitStack() as stack:
        with ThreadPoolExecutor(1) as beside:
            starting = beside.submit(lambda: [stack.enter_context(_with_ports(rig)) for rig in rigs])
            from calrig.runs.recovery import mark_interrupted, stop_stages
            from calrig.runs.service import RunService
            from calrig.store import Store

            configured, troubles = {rig.name: rig for rig in settings.rig}, dict[str, str]()

            def stop(rig_names: Sequence[str]) -> None:
                troubles.update(stop_stages(rig_names, configured))

            store = stack.enter_context(Store.open(url, writer=what, left_by_the_dead=stop))
            mark_interrupted(store, troubles)
            powered = starting.result()
        service = RunService(store, powered, record)
        stack.callback(service.close)
        yield service


@contextmanager
def _with_ports(rig: RigSettings) -> Iterator[RigSettings]:
    """The rig; a simulated one runs in a process of its own meanwhile, and has that one's ports."""
    if rig.simulated is None:
        yield rig
        return
    from calrig.settings import BoardSettings, StageSettings
    from calrig.simulator.launch import LaunchError, launch

    try:
        process = launch(rig.simulated)
    except ValueError as error:
        raise InputError(f"rig {rig.name!r}, simulated: {error}") from error
    except LaunchError as error:
        raise WorkError(f"rig {rig.name!r}: {error}") from error
    with process:
        speaks = (rig.simulated.get("stage") or {}).get("driver", "smc100")
        stage = rig.stage or StageSettings(driver=speaks, port="")
        prints = (rig.simulated.get("board") or {}).get("sketch") or "calrig"
        imu = rig.imu or BoardSettings(driver=prints.removesuffix("-fast"), port="")
        ports = {
            "stage": stage.model_copy(update={"port": process.stage_port}),
            "imu": imu.model_copy(update={"port": process.imu_port}),
        }
        yield rig.model_copy(update=ports)


def _rig_named(settings: Settings, name: str | None) -> RigSettings:
    if name is None:
        return settings.rig[0]
    for rig in settings.rig:
        if rig.name == name:
            return rig
    raise InputError(
        f"--rig: there is no rig {name!r}; configured: {', '.join(r.name for r in settings.rig)}"
    )
