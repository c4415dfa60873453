"""The entry point: which commands there are."""

import os
import signal
from collections.abc import Callable
from typing import Annotated

import typer

import calrig
from calrig.cli import (
    agent,
    apply,
    benches,
    diagnosis,
    export,
    fleet,
    noise,
    plan,
    records,
    rigs,
    run,
    runs,
    serve,
    solve,
    users,
    verify,
    watch,
)
from calrig.cli import benches as enroll
from calrig.cli.exit_status import Commands

app = typer.Typer(
    cls=Commands,
    name="calrig",
    help="Calibrates IMU attitude sensors on a rotary stage.",
    add_completion=True,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
COMMANDS: dict[str, Callable[..., None]] = {
    "serve": serve.serve,
    "run": run.run,
    "runs": runs.runs,
    "watch": watch.watch,
    "resume": run.resume,
    "rigs": rigs.rigs,
    "import": records.import_,
    "export": export.export,
    "verify": verify.verify,
    "backup": records.backup,
    "move-store": records.move_store,
    "diagnose": diagnosis.diagnose,
    "gravity": diagnosis.gravity,
    "solve": solve.solve,
    "apply": apply.apply,
    "plan": plan.plan,
    "noise": noise.noise,
    "filters": noise.filters,
    "fleet": fleet.fleet,
}
for name, command in COMMANDS.items():
    app.command(name)(command)
app.add_typer(users.app, name="users")
app.add_typer(benches.app, name="bench")
agent.app.command("enroll")(enroll.enroll)
app.add_typer(agent.app, name="agent")


def main() -> None:
    """Runs the command line and leaves with its exit status."""
    # numpy's products here are small: threads that wait for each other make them several times slower
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends in order, as Ctrl-C does
    app()


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
