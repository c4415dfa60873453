"""`solve`: a joint solution of stage map, mounts and units, of files or stored runs, and its tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast
from urllib.parse import quote

import typer

from calrig.cli import options
from calrig.cli.input_files import names_a_file, read_bytes, told_of
from calrig.cli.options import COLUMNS, SHORTENED, Db, Json, Plot, Server, whole_id
from calrig.cli.output import number, print_line, print_parameter, print_table, print_warnings
from calrig.cli.progress import late_bar
from calrig.cli.running_service import open_store, running_service, whole_id_there
from calrig.errors import InputError, writable
from calrig.estimation.angle_text import angle_text

if TYPE_CHECKING:
    from calrig.analysis.solutions import SolutionInputs, SolutionRequest
    from calrig.calibration.separation import MountedPoses
    from calrig.client import Client
    from calrig.model.solution import Frame, SolutionDocument, SolvedUnit
    from calrig.store.records import Solved


NOT_DRAWN = "solve: --plot is of units clamped by one face: leave it out, nothing was solved"
Units = Annotated[
    list[str] | None,
    typer.Option(
        "--unit", metavar="SERIAL", help="Of files without a column unit: one for all, or one each."
    ),
]
Periods = Annotated[
    list[float] | None,
    typer.Option(
        "--period", metavar="DEG", min=0.5, max=360.0, help="Known period of a gear, degrees of the dial."
    ),
]
Out = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Write each unit's calibration and the stage's map there.")
]
FrameOf = Annotated[
    str,
    typer.Option(
        "--frame",
        metavar="sensor|faces",
        help="Of units clamped by several faces: the matrix in the sensor's own frame, upper triangular, or "
        "in that of the faces.",
    ),
]
Linear = Annotated[
    bool, typer.Option("--linear", help="State that the units have no quadratic and cubic terms.")
]
SeatStd = Annotated[
    float | None,
    typer.Option(
        "--seat-std",
        metavar="DEG",
        min=0.0,
        help="Repeatability (standard deviation) of clamping the same face on the same seat: the level of a "
        "unit that was reversed (mount_axis -x) rests on it.",
    ),
]
Limits = Annotated[
    tuple[float, float] | None,
    typer.Option(
        "--limits", metavar="LOW HIGH", help="Of the stage, degrees: what is advised may use all of it."
    ),
]


def solve(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE.csv|RUN_ID...",
            autocompletion=options.runs,
            help=f"Poses of one rig, units clamped at several angles, or its runs' ids{SHORTENED}. {COLUMNS}",
        ),
    ],
    unit: Units = None,
    linear: Linear = False,
    period: Periods = None,
    frame: FrameOf = "sensor",
    seat_std: SeatStd = None,
    limits: Limits = None,
    out: Out = None,
    plot: Plot = None,
    as_json: Json = False,
    db: Db = None,
    server: Server = None,
) -> None:
    """Solve the stage's map, the mounts and the units together, against gravity.

    A service that holds the store of the runs solves them, and keeps the solution; files are solved here.
    """
    from calrig.analysis.solutions import SolutionInputs, SolutionRequest
    from calrig.cli import output
    from calrig.figures.files import writer_of
    from calrig.model.solution import SolutionDocument

    draw = None if plot is None else writer_of(plot)
    files = [source for source in sources if names_a_file(source)]
    if files and len(files) < len(sources):
        raise InputError("solve: name files or run ids, not both")
    if unit and not files:
        raise InputError("solve: runs have their units; --unit is for files")
    _check_options(frame, limits)
    wanted = SolutionRequest(
        sources,
        linear=linear,
        periods_deg=tuple(period or ()),
        seat_std_deg=seat_std,
        frame=cast("Frame", frame),
        limits_deg=limits,
    )
    said: list[str] = []
    if files:
        lots, said = _of_files(files, unit or [])
        units = list(dict.fromkeys(lot.unit for lot in lots))
        asked = SolutionInputs(None, wanted.basis([], units), lots, wanted.limits_deg)
        found = _answer(asked, is_drawn=draw is not None)
    elif (there := running_service(server, db)) is not None:
        found = _solved_there(there, wanted, with_files=out is not None, with_poses=draw is not None)
    else:
        found = _answer(_of_runs(wanted, db), is_drawn=draw is not None)
    document = {**found.document, "warnings": [*said, *found.document["warnings"]]}
    if out is not None:
        _write(out, found)
    if draw is not None:
        from calrig.figures.joint import joint_figures

        draw("Stage and units solved together", joint_figures(document, found.poses))
    if as_json:
        output.print_json(document)
    else:
        _print_solution(SolutionDocument.model_validate(document), is_whole=found.is_whole)


def _check_options(frame: str, limits: tuple[float, float] | None) -> None:
    if frame not in {"sensor", "faces"}:
        raise InputError(f"solve: --frame is {frame!r}: it is sensor or faces")
    if limits is not None and not -math.inf < limits[0] < limits[1] < math.inf:
        raise InputError(f"solve: --limits {limits[0]:g} {limits[1]:g}: the lower comes first")


def _answer(asked: SolutionInputs, *, is_drawn: bool) -> Solved:
    from calrig.analysis.solutions import answer
    from calrig.calibration.poses import DiagnosisError
    from calrig.calibration.separation import are_whole

    if is_drawn and are_whole(asked.lots):
        raise InputError(NOT_DRAWN)
    try:
        with late_bar("solving") as show:
            return answer(asked, show)
    except DiagnosisError as error:
        raise InputError(str(error)) from error


def _of_runs(wanted: SolutionRequest, db: str | None) -> SolutionInputs:
    from dataclasses import replace

    from calrig.analysis.solutions import question

    with open_store(db) as store:
        return question(store, replace(wanted, runs=[whole_id(store, typed) for typed in wanted.runs]))


def _of_files(files: Sequence[str], units: Sequence[str]) -> tuple[list[MountedPoses], list[str]]:
    """Poses of each clamping, and what is to be said of how they were read."""
    if len(units) > 1 and len(units) != len(files):
        raise InputError(
            f"solve: {len(units)} times --unit for {len(files)} files: give one for all, or one each"
        )
    serials: list[str | None] = list(units) or [None]
    serials = serials * (len(files) // len(serials))
    read = [_of_file(Path(file), serial) for file, serial in zip(files, serials, strict=True)]
    return [lot for lots, _ in read for lot in lots], [sentence for _, said in read for sentence in said]


def _of_file(file: Path, serial: str | None) -> tuple[list[MountedPoses], list[str]]:
    from calrig.export.csv_errors import CsvError
    from calrig.export.poses_csv import read_mounted

    with told_of(file, CsvError):
        lots, said = read_mounted(read_bytes(file), str(file), serial)
    if serial is not None and (others := sorted({lot.unit for lot in lots} - {serial})):
        said = [*said, f"--unit {serial} is not theirs whose unit the file says: {', '.join(others)}"]
    return lots, [f"{file}: {sentence}" for sentence in said]


def _write(folder: Path, found: Solved) -> None:
    from calrig.export.solution_documents import joint_files

    with writable(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in joint_files(found.calibrations, found.stage_map).items():
            (folder / name).write_text(text, encoding="utf-8")


def _print_solution(found: SolutionDocument, *, is_whole: bool) -> None:
    """Print a joint solution: units, mounts, stage map, errors before and after, warnings.

    `is_whole` is of units clamped by several faces, whose accelerometers and gyros are printed.
    """
    verdict = f"stage and units are {'' if found.separable else 'not '}separable"
    print_line(f"{verdict}; a pose's noise is {number(found.noise['std_deg'], '°')}", style="bold")
    for unit in found.units:
        worst, (low, high) = max(unit.elevation_std_deg.std_deg), unit.range_deg
        elevation = f"elevation ± {worst:.2g}° at most, {low:g}° to {high:g}°"
        print_line("")
        if is_whole:
            _print_accelerometer(unit)
            if unit.gyro is not None:
                _print_gyro(unit.gyro)
            print_line(f"{elevation}, less its mean")
        else:
            print_line(f"unit {unit.unit}: {elevation}{_measurand(unit)}")
            for name, parameter in unit.parameters.items():
                print_parameter(name, parameter)
    print_line("")
    headings = ("mount", "unit", *(["axis"] if is_whole else []), "stated", "found", "±")
    mounts = (
        (
            one.mount,
            one.unit,
            *([one["mount_axis"]] if is_whole else []),
            f"{one.mount_deg:g}°",
            number(one.angle_deg.value, "°"),
            number(one.angle_deg.std, "°"),
        )
        for one in found.mounts
    )
    print_table(headings, mounts)
    error = [value for value in found.stage.map.error_deg if value is not None]
    orders = len(found.stage.harmonics)
    print_line(f"map of the stage: {_signed(min(error))} to {_signed(max(error))}, {orders} orders")
    for name in ("axis_dip_deg", "backlash_deg"):
        print_parameter(name, getattr(found.stage, name, None))
    before, after = (number(one.held_out_rms_deg, "°") for one in (found.before, found.final))
    print_line(f"held-out RMS: {before} without the map, {after} with the map")
    print_warnings(found.warnings)
    if found.advice is not None and not is_whole:
        print_line(f"recommended: {found.advice.says}")


def _measurand(unit: SolvedUnit) -> str:
    level = (unit["level"] or {"deg": {"std": None}})["deg"]
    if level["std"] is None:
        return ", less its mean"
    return f"; its level {_signed(level['value'], level['std'])} is in it"


def _signed(value_deg: float, std_deg: float | None = None) -> str:
    return ("+" if value_deg > 0.0 else "") + angle_text(value_deg, std_deg=std_deg)


AXES = "xyz"


def _print_accelerometer(unit: SolvedUnit) -> None:
    found = unit.accelerometer
    if found is None:
        print_line(f"unit {unit.unit}: its accelerometer is not known")
        return
    stds = [found["covariance"][k][k] ** 0.5 for k in range(12)]
    rows = (
        (
            axis,
            _with(1e3 * found["bias_g"][k], 1e3 * stds[k], 2),
            *(_with(found["matrix"][k][m], stds[3 + 3 * k + m], 5) for m in range(3)),
            f"{unit['noise_mg'][k]:.3g}",
        )
        for k, axis in enumerate(AXES)
    )
    headings = ("", "offset, mg", *(f"matrix {axis}" for axis in AXES), "noise, mg")
    frame = "the sensor's own frame" if found["frame"] == "sensor" else "the frame of its faces"
    title = f"unit {unit.unit}: accelerometer, in {frame}"
    print_table(headings, rows, title=title, caption="true = matrix·(raw − offset)")


def _print_gyro(found: dict[str, Any]) -> None:
    unknown = [[None] * 3] * 3
    matrix, stds = found["matrix"] or unknown, found["matrix_std"] or unknown
    per_g, per_g_std = found["dps_per_g"] or unknown, found["dps_per_g_std"] or unknown
    bias, bias_std = found["bias_dps"] or [None] * 3, found["bias_std_dps"] or [None] * 3
    rows = (
        (
            axis,
            _with(bias[k], bias_std[k], 4),
            *(_with(matrix[k][m], stds[k][m], 6) for m in range(3)),
            *(_with(per_g[k][m], per_g_std[k][m], 4) for m in range(3)),
        )
        for k, axis in enumerate(AXES)
    )
    headings = (
        "",
        "bias, °/s",
        *(f"matrix {axis}" for axis in AXES),
        *(f"°/s per g {axis}" for axis in AXES),
    )
    caption = "true = matrix·(raw − bias − per g·a), against the board's clock"
    print_table(headings, rows, title="gyro", caption=caption)


def _with(value: float | None, std: float | None, decimals: int) -> str:
    """Return a value with two digits of its standard error, or with some decimals where it has none."""
    if value is None:
        return "not known"
    if std:
        decimals = max(0, 1 - math.floor(math.log10(std)))
    return f"{value:.{decimals}f}" + ("" if not std else f" ± {std:.2g}")


KEPT_BESIDE = ("id", "created_at", "by", "rig", "runs", "linear", "periods_deg", "seat_std_deg", "frame")
"""What an answer has beside the document of CONTRACT section 8."""


def _solved_there(client: Client, wanted: SolutionRequest, *, with_files: bool, with_poses: bool) -> Solved:
    """Return the solution that a service has made and stored; say on standard error where.

    `with_files` adds calibrations and stage map, `with_poses` the pose residuals.
    """
    from calrig.model.run import mount_axis
    from calrig.store.records import Solved

    runs = [whole_id_there(client, typed) for typed in wanted.runs]
    records = (client.run(run_id).record for run_id in runs)
    if with_poses and any(mount_axis(one.plan, one.provenance)[-1] != "x" for one in records):
        raise InputError(NOT_DRAWN)
    with late_bar("solving") as show:
        found = client.solve(
            *runs,
            linear=wanted.linear,
            periods_deg=wanted.periods_deg,
            seat_std_deg=wanted.seat_std_deg,
            frame=wanted.frame,
            limits_deg=wanted.limits_deg,
            told=show,
        )
    path = f"/api/solve/{found.id}"
    document = client.get(path)
    beside = {name: document.pop(name) for name in KEPT_BESIDE}
    serials = [unit["unit"] for unit in document["units"]]
    typer.echo(f"calrig solve: kept as solution {found.id} at {client.server}", err=True)
    return Solved(
        rig=beside["rig"],
        basis=wanted.basis(beside["runs"], serials),
        document=document,
        calibrations={
            serial: client.get(f"{path}/units/{quote(serial, safe='')}") for serial in serials if with_files
        },
        stage_map=client.get(f"{path}/map") if with_files else {},
        poses=client.get(f"{path}/poses") if with_poses else {},
    )
