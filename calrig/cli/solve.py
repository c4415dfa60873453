"""`solve`: stage map, mounts and units together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from calrig.cli import names
from calrig.cli.input_files import names_a_file, read_bytes
from calrig.cli.options import COLUMNS, SHORTENED, Db, Json, Plot, Server
from calrig.cli.running_service import running_service
from calrig.cli.typed_ids import whole_id
from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    from calrig.analysis.joint_solutions import Question, Wanted
    from calrig.calibration.separation import MountedPoses
    from calrig.store.solved import Frame, Solved

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
            autocompletion=names.runs,
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
    from calrig.analysis.joint_solutions import Wanted
    from calrig.cli import output
    from calrig.cli.solve_output import print_solution
    from calrig.figures.files import writer_of

    draw = None if plot is None else writer_of(plot)
    files = [source for source in sources if names_a_file(source)]
    if files and len(files) < len(sources):
        raise InputError("solve: name files or run ids, not both")
    if unit and not files:
        raise InputError("solve: runs have their units; --unit is for files")
    _check_options(frame, limits)
    wanted = Wanted(
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
        found = _answer(_of_lots(lots, wanted), is_drawn=draw is not None)
    elif (there := running_service(server, db)) is not None:
        from calrig.cli.solve_there import solved_there

        found = solved_there(there, wanted, with_files=out is not None, with_poses=draw is not None)
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
    elif found.is_whole:
        from calrig.cli.three_axis_output import print_whole

        print_whole(document)
    else:
        print_solution(document)


def _check_options(frame: str, limits: tuple[float, float] | None) -> None:
    if frame not in {"sensor", "faces"}:
        raise InputError(f"solve: --frame is {frame!r}: it is sensor or faces")
    if limits is not None and not -math.inf < limits[0] < limits[1] < math.inf:
        raise InputError(f"solve: --limits {limits[0]:g} {limits[1]:g}: the lower comes first")


def _answer(asked: Question, *, is_drawn: bool) -> Solved:
    from calrig.analysis.joint_solutions import answer
    from calrig.calibration.poses import DiagnosisError
    from calrig.calibration.separation import whole_units
    from calrig.cli.progress import late_bar

    if is_drawn and whole_units(asked.lots):
        raise InputError(NOT_DRAWN)
    try:
        with late_bar("solving") as show:
            return answer(asked, show)
    except DiagnosisError as error:
        raise InputError(str(error)) from error


def _of_lots(lots: Sequence[MountedPoses], wanted: Wanted) -> Question:
    from calrig.analysis.joint_solutions import Question

    units = list(dict.fromkeys(lot.unit for lot in lots))
    return Question(None, wanted.basis([], units), lots, wanted.limits_deg)


def _of_runs(wanted: Wanted, db: str | None) -> Question:
    from dataclasses import replace

    from calrig.analysis.joint_solutions import question
    from calrig.settings import store_url
    from calrig.store import Store

    with Store.open(store_url(db), writer=None) as store:
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
    from calrig.export.mounted_csv import read_mounted
    from calrig.export.poses_csv import CsvError

    try:
        lots, said = read_mounted(read_bytes(file), str(file), serial)
    except CsvError as error:
        raise InputError(f"{file}: {error}") from error
    if serial is not None and (others := sorted({lot.unit for lot in lots} - {serial})):
        said = [*said, f"--unit {serial} is not theirs whose unit the file says: {', '.join(others)}"]
    return lots, [f"{file}: {sentence}" for sentence in said]


def _write(folder: Path, found: Solved) -> None:
    from calrig.export.joint_files import joint_files

    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in joint_files(found.calibrations, found.stage_map).items():
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise WorkError(f"{folder}: cannot be written ({error.strerror})") from error
