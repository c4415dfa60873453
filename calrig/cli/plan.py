"""`plan`: the plan that gets there soonest on a rig."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calrig.cli.input_files import read_plan_file
from calrig.cli.options import Config, Db, Json, Rig, Server
from calrig.cli.running_service import running_service
from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    from calrig.client import Client
    from calrig.plan import Plan


def plan(
    target_u: Annotated[
        float | None, typer.Option("--target-u", metavar="DEG", min=1e-6, help="Expanded uncertainty wanted.")
    ] = None,
    time: Annotated[float | None, typer.Option(metavar="S", min=1.0, help="Or: the time there is.")] = None,
    rig: Rig = None,
    unit: Annotated[
        str, typer.Option(metavar="SERIAL", help="Unit whose earlier runs on the rig tell its noise.")
    ] = "",
    trace: Annotated[
        bool, typer.Option(" /--no-trace", help="Without variety for the tracing of effects: sooner.")
    ] = True,
    keep: Annotated[
        Path | None,
        typer.Option("--plan", metavar="FILE.json", help="Plan whose range, settling and rate are kept."),
    ] = None,
    as_json: Json = False,
    db: Db = None,
    config: Config = None,
    server: Server = None,
) -> None:
    """Design the plan that reaches an uncertainty soonest, or the best one for a time; nothing moves."""
    from calrig.cli import output
    from calrig.plan import Plan

    if (target_u is None) == (time is None):
        raise InputError("plan: give --target-u DEG, or --time S")
    kept = read_plan_file(keep) if keep else Plan()
    there = None if config else running_service(server, db)
    if there is not None:
        document = _designed_there(there, target_u, time, rig, unit, trace, kept)
    else:
        document = _designed_here(target_u, time, rig, unit, trace, kept, db, config)
    if as_json:
        output.print_json(document)
    else:
        _print(document)


def _designed_there(
    there: Client,
    target_u: float | None,
    time: float | None,
    rig: str | None,
    unit: str,
    trace: bool,
    kept: Plan,
) -> dict[str, Any]:
    from calrig.client import Invalid

    try:
        found = there.plan(target_u_deg=target_u, time_s=time, rig=rig, unit=unit, trace=trace, keep=kept)
    except Invalid as error:
        raise WorkError(str(error)) from error
    return found.model_dump(mode="json")


def _designed_here(
    target_u: float | None,
    time: float | None,
    rig: str | None,
    unit: str,
    trace: bool,
    kept: Plan,
    db: str | None,
    config: str | None,
) -> dict[str, Any]:
    from calrig.analysis.errors import Invalid
    from calrig.calibration.plan_design.goals import Goals
    from calrig.runs.plan_designs import Wanted, designed
    from calrig.settings import load_settings, store_url
    from calrig.store import Store
    from calrig.store.errors import NoStore

    settings = load_settings(config)
    chosen = next((one for one in settings.rig if rig in (None, one.name)), None)
    if chosen is None:
        raise InputError(
            f"--rig: there is no rig {rig!r}; configured: {', '.join(r.name for r in settings.rig)}"
        )
    wanted = Wanted(Goals(expanded_deg=target_u), time, trace)
    with ExitStack() as stack:
        store = None
        with suppress(NoStore):  # nothing has run yet: noise and pace are assumed, and said to be
            store = stack.enter_context(Store.open(store_url(db), writer=None))
        try:
            return designed(wanted, kept, chosen, unit, store).document()
        except Invalid as error:
            raise WorkError(str(error)) from error


def _print(document: dict[str, Any]) -> None:
    from calrig.cli.printing import number, print_line, print_table

    expected: dict[str, Any] = document["expected"]
    limit: dict[str, Any] | None = document["limit"]
    rows = [
        ("poses", f"{len(document['plan']['elevations_deg'])} of {document['plan']['dwell_s']:g} s"),
        ("duration", f"{expected['duration_s']:.0f} s"),
        ("no plan of dwells is under", "–" if limit is None else f"{limit['duration_s']:.0f} s"),
        ("expanded uncertainty", number(expected["expanded_uncertainty_deg"], "°")),
        ("bias, standard error", number(expected["bias_std_deg"], "°")),
        ("scale, standard error", number(expected["scale_std"], "", 6)),
    ]
    print_table(("expected", ""), rows)
    shown = [
        (
            one["title"],
            "not shown" if one["rms_deg"] is None else f"{one['rms_deg']:.2g}°",
            ""
            if one["value"] is None
            else f"{one['parameter']} {one['value']:.2g} {one['unit'] or ''}".strip(),
        )
        for one in document["suspects"]
    ]
    if shown:
        print_table(("found four times in five", "left in readings, RMS", "as a parameter"), shown)
    for sentence in document["says"]:
        print_line(f"· {sentence}")
    print_line("calrig plan … --json has the plan; calrig run --plan FILE.json takes its `plan`.")
