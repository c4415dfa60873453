"""`plan`: the shortest plan for an uncertainty on a rig."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calrig.cli import options
from calrig.cli.input_files import read_plan_file
from calrig.cli.options import Config, Db, Json, Rig, Server
from calrig.cli.running_service import open_store, running_service
from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    from calrig.client import Client, PlanDesign
    from calrig.model.plan import Plan

DOING = "designing the plan"


def plan(
    target_u: Annotated[
        float | None, typer.Option("--target-u", metavar="DEG", min=1e-6, help="Expanded uncertainty wanted.")
    ] = None,
    time: Annotated[float | None, typer.Option(metavar="S", min=1.0, help="Or: time available.")] = None,
    rig: Rig = None,
    unit: Annotated[
        str,
        typer.Option(
            metavar="SERIAL",
            autocompletion=options.units,
            help="Unit whose noise is taken from its earlier runs on the rig.",
        ),
    ] = "",
    trace: Annotated[
        bool,
        typer.Option("--trace/--no-trace", help="Poses enough to trace effects."),
    ] = True,
    sweep: Annotated[
        bool, typer.Option("--sweep/--no-sweep", help="Sweep without stopping where that is shorter.")
    ] = True,
    until: Annotated[
        bool,
        typer.Option("--until", help="Sequential stopping: end the run once the uncertainty is reached."),
    ] = False,
    keep: Annotated[
        Path | None,
        typer.Option("--plan", metavar="FILE.json", help="Plan whose range, settling and rate are kept."),
    ] = None,
    as_json: Json = False,
    db: Db = None,
    config: Config = None,
    server: Server = None,
) -> None:
    """Design the shortest plan for an uncertainty, or the best one for a time; nothing moves."""
    from calrig.cli import output
    from calrig.model.plan import Plan

    if (target_u is None) == (time is None):
        raise InputError("plan: give --target-u DEG, or --time S")
    if until and target_u is None:
        raise InputError("plan: --until goes with --target-u, which the run is to end at")
    kept = read_plan_file(keep) if keep else Plan()
    asked = _Asked(target_u, time, rig, unit, trace, sweep, until, kept)
    there = None if config else running_service(server, db)
    found = _designed_here(asked, db, config) if there is None else _designed_there(there, asked)
    if as_json:
        output.print_json(found.model_dump(mode="json"))
    else:
        _print(found)


@dataclass(frozen=True, slots=True)
class _Asked:
    target_u_deg: float | None
    time_s: float | None
    rig: str | None
    unit: str
    trace: bool
    sweep: bool
    until: bool
    kept: Plan


def _designed_there(there: Client, asked: _Asked) -> PlanDesign:
    from calrig.cli.progress import late_bar
    from calrig.cli.run import require_rig
    from calrig.client import Invalid

    require_rig(there, asked.rig)
    try:
        with late_bar(DOING) as show:
            return there.plan(
                target_u_deg=asked.target_u_deg,
                time_s=asked.time_s,
                rig=asked.rig,
                unit=asked.unit,
                until={"expanded_uncertainty_deg": asked.target_u_deg or 0.0} if asked.until else None,
                trace=asked.trace,
                sweep=asked.sweep,
                keep=asked.kept,
                told=show,
            )
    except Invalid as error:
        raise WorkError(str(error)) from error


def _designed_here(asked: _Asked, db: str | None, config: str | None) -> PlanDesign:
    from calrig.analysis.errors import Invalid
    from calrig.analysis.stage_maps import configured_maps
    from calrig.calibration.plan_design import Goals
    from calrig.cli.progress import late_bar
    from calrig.cli.run import rig_named
    from calrig.client import PlanDesign
    from calrig.model.plan import Until
    from calrig.runs.plan_designs import DesignRequest, answer, question
    from calrig.settings import load_settings
    from calrig.store.errors import NoStore

    settings = load_settings(config)
    chosen = rig_named(settings, asked.rig)
    ends_at = Until(expanded_uncertainty_deg=asked.target_u_deg) if asked.until else None
    wanted = DesignRequest(
        Goals(expanded_deg=asked.target_u_deg), asked.time_s, asked.trace, ends_at, asked.sweep
    )
    with ExitStack() as stack:
        store = None
        with suppress(NoStore):  # nothing has run yet: noise and pace are assumed, and said to be
            store = stack.enter_context(open_store(db))
        try:
            known = question(wanted, asked.kept, chosen, asked.unit, store, configured_maps(settings))
            with late_bar(DOING) as show:
                return PlanDesign.model_validate(answer(known, show).document())
        except Invalid as error:
            raise WorkError(str(error)) from error


def _poses(plan: dict[str, Any]) -> str:
    if plan["kind"] == "sweep":
        return f"{plan['sweeps']} passes at {plan['velocity_dps']:.3g}°/s, stretches of {plan['dwell_s']:g} s"
    return f"{len(plan['elevations_deg'])} of {plan['dwell_s']:g} s"


def _print(found: PlanDesign) -> None:
    from calrig.cli.output import number, print_sentence, print_table

    expected = found.expected
    rows = [
        ("poses", _poses(found.plan)),
        ("duration", f"{expected.duration_s:.0f} s"),
        ("lower bound of duration", f"{found.limit.duration_s:.0f} s"),
        ("expanded uncertainty", number(expected.expanded_uncertainty_deg, "°")),
        ("bias, standard error", number(expected.bias_std_deg, "°")),
        ("scale, standard error", number(expected.scale_std, "", 6)),
    ]
    print_table(("expected", ""), rows)
    shown = [
        (
            one.title,
            "not shown" if one.rms_deg is None else f"{one.rms_deg:.2g}°",
            "" if one.value is None else f"{one.parameter} {one.value:.2g} {one.unit or ''}".strip(),
        )
        for one in found.suspects
    ]
    if shown:
        print_table(("detected with power 80 %", "residual, RMS", "parameter"), shown)
    for sentence in found.says:
        print_sentence(f"· {sentence}")
    print_sentence("To run it: calrig plan … --json > plan.json; calrig run --unit SERIAL --plan plan.json")
