"""`plan`: the shortest plan for an uncertainty on a rig."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calrig.cli import options
from calrig.cli.input_files import read_plan_file
from calrig.cli.options import Config, Db, Json, Rig, Server
from calrig.cli.running_service import open_store, running_service
from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    from calrig.client import PlanDesign
    from calrig.model.plan import Plan
    from calrig.runs.plan_designs import DesignRequest

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
    from calrig.analysis.errors import Invalid
    from calrig.cli import output
    from calrig.cli.progress import late_bar
    from calrig.cli.run import require_rig
    from calrig.client import Invalid as InvalidThere
    from calrig.model.plan import Plan, Until

    if (target_u is None) == (time is None):
        raise InputError("plan: give --target-u DEG, or --time S")
    if until and target_u is None:
        raise InputError("plan: --until goes with --target-u, which the run is to end at")
    kept = read_plan_file(keep) if keep else Plan()
    there = None if config else running_service(server, db)
    try:
        if there is None:
            from calrig.calibration.plan_design import Goals
            from calrig.runs.plan_designs import DesignRequest

            ends_at = Until(expanded_uncertainty_deg=target_u) if until else None
            wanted = DesignRequest(Goals(expanded_deg=target_u), time, trace, ends_at, sweep)
            found = _designed_here(wanted, kept, rig, unit, db, config)
        else:
            require_rig(there, rig)
            with late_bar(DOING) as show:
                found = there.plan(
                    target_u_deg=target_u,
                    time_s=time,
                    rig=rig,
                    unit=unit,
                    until={"expanded_uncertainty_deg": target_u or 0.0} if until else None,
                    trace=trace,
                    sweep=sweep,
                    keep=kept,
                    told=show,
                )
    except (Invalid, InvalidThere) as error:
        raise WorkError(str(error)) from error
    output.show(found, _print, as_json=as_json)


def _designed_here(
    wanted: DesignRequest, kept: Plan, rig: str | None, unit: str, db: str | None, config: str | None
) -> PlanDesign:
    from calrig.analysis.stage_maps import configured_maps
    from calrig.cli.progress import late_bar
    from calrig.cli.run import rig_named
    from calrig.client import PlanDesign
    from calrig.runs.plan_designs import answer, question
    from calrig.settings import load_settings
    from calrig.store.errors import NoStore

    settings = load_settings(config)
    chosen = rig_named(settings, rig)
    with ExitStack() as stack:
        store = None
        with suppress(NoStore):  # nothing has run yet: noise and pace are assumed, and said to be
            store = stack.enter_context(open_store(db))
        known = question(wanted, kept, chosen, unit, store, configured_maps(settings))
        with late_bar(DOING) as show:
            return PlanDesign.model_validate(answer(known, show).document())


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
