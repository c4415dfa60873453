"""`solve`: stage map, mounts and units together."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from calrig.cli.input_files import names_a_file, read_bytes
from calrig.cli.options import COLUMNS, SHORTENED, Db, Json, Plot
from calrig.cli.typed_ids import whole_id
from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    from calrig.calibration.joint.table import Mounted
    from calrig.calibration.joint.three_axis_frame import Frame as WholeFrame

Units = Annotated[
    list[str] | None,
    typer.Option(
        "--unit", metavar="SERIAL", help="Of files without a column unit: one for all, or one each."
    ),
]
Periods = Annotated[
    list[float] | None,
    typer.Option("--period", metavar="DEG", min=0.5, help="Known period of a gear, degrees of the dial."),
]
Out = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Write each unit's calibration and the stage's map there.")
]
Frame = Annotated[
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
        help="How far one clamping of the same face on the same seat scatters from the next: the level of a "
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
            help=f"Poses of one rig, units clamped at several angles, or its runs' ids{SHORTENED}. {COLUMNS}",
        ),
    ],
    unit: Units = None,
    linear: Linear = False,
    period: Periods = None,
    frame: Frame = "sensor",
    seat_std: SeatStd = None,
    limits: Limits = None,
    out: Out = None,
    plot: Plot = None,
    as_json: Json = False,
    db: Db = None,
) -> None:
    """Solve the stage's map, the mounts and the units together, against gravity."""
    from calrig.calibration.joint.report import solution_document
    from calrig.calibration.joint.solution import solve as solve_together
    from calrig.calibration.joint.three_axis_table import whole_units
    from calrig.calibration.pose import DiagnosisError
    from calrig.cli import output
    from calrig.cli.solve_output import print_solution
    from calrig.figures.files import writer_of

    draw = None if plot is None else writer_of(plot)
    if frame not in {"sensor", "faces"}:
        raise InputError(f"solve: --frame is {frame!r}: it is sensor or faces")
    lots, said = _lots(sources, unit or [], db)
    try:
        if whole_units(lots):
            if draw is not None:
                raise InputError("solve: --plot is of units clamped by one face")
            _solve_whole(lots, said, linear, period or [], cast("WholeFrame", frame), out, as_json)
            return
        solution = solve_together(lots, linear=linear, periods_deg=period or [], seat_std_deg=seat_std)
    except DiagnosisError as error:
        raise InputError(str(error)) from error
    document = solution_document(solution, limits)
    document["warnings"] = [*said, *document["warnings"]]
    if out is not None:
        from calrig.export.joint_documents import joint_documents

        _write(out, joint_documents(solution))
    if draw is not None:
        from calrig.figures.joint import joint_figures

        draw("Stage and units solved together", joint_figures(solution))
    if as_json:
        output.print_json(document)
    else:
        print_solution(document)


def _solve_whole(
    lots: list[Mounted],
    said: list[str],
    linear: bool,
    periods_deg: list[float],
    frame: WholeFrame,
    out: Path | None,
    as_json: bool,
) -> None:
    """Units clamped by several faces."""
    from calrig.calibration.joint.three_axis_report import three_axis_document
    from calrig.calibration.joint.three_axis_solution import solve_whole
    from calrig.cli import output
    from calrig.cli.three_axis_output import print_whole
    from calrig.export.three_axis_documents import three_axis_documents

    solution = solve_whole(lots, linear=linear, periods_deg=periods_deg)
    document = three_axis_document(solution, frame)
    document["warnings"] = [*said, *document["warnings"]]
    if out is not None:
        from calrig.export.joint_documents import files_of

        _write(out, files_of(*three_axis_documents(solution, frame)))
    if as_json:
        output.print_json(document)
    else:
        print_whole(document)


def _lots(sources: Sequence[str], units: Sequence[str], db: str | None) -> tuple[list[Mounted], list[str]]:
    """Poses of each clamping, and what is to be said of how they were read."""
    files = [source for source in sources if names_a_file(source)]
    if files and len(files) < len(sources):
        raise InputError("solve: name files or run ids, not both")
    if not files:
        if units:
            raise InputError("solve: runs have their units; --unit is for files")
        return _of_runs(sources, db), []
    if len(units) > 1 and len(units) != len(files):
        raise InputError(
            f"solve: {len(units)} times --unit for {len(files)} files: give one for all, or one each"
        )
    serials: list[str | None] = list(units) or [None]
    serials = serials * (len(files) // len(serials))
    read = [_of_file(Path(file), serial) for file, serial in zip(files, serials, strict=True)]
    return [lot for lots, _ in read for lot in lots], [sentence for _, said in read for sentence in said]


def _of_file(file: Path, serial: str | None) -> tuple[list[Mounted], list[str]]:
    from calrig.export.mounted_csv import read_mounted
    from calrig.export.poses_csv import CsvError

    try:
        lots, said = read_mounted(read_bytes(file), str(file), serial)
    except CsvError as error:
        raise InputError(f"{file}: {error}") from error
    return lots, [f"{file}: {sentence}" for sentence in said]


def _of_runs(run_ids: Sequence[str], db: str | None) -> list[Mounted]:
    from calrig.analysis.joint_solutions import mounted_runs
    from calrig.settings import store_url
    from calrig.store import Store

    with Store.open(store_url(db), writer=None) as store:
        return mounted_runs(store, [whole_id(store, typed) for typed in run_ids])


def _write(folder: Path, files: dict[str, str]) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise WorkError(f"{folder}: cannot be written ({error.strerror})") from error
