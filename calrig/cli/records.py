"""`import`, `export` and `backup`: runs into a store, out of it, or a copy of all of it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from calrig.cli.input_files import in_utf8, read_bytes
from calrig.cli.options import COLUMNS, SHORTENED, Db, Rig, Server, UnitSerial
from calrig.cli.running_service import running_service
from calrig.cli.typed_ids import whole_id
from calrig.errors import InputError

if TYPE_CHECKING:
    from calrig.calibration.packed_poses import PackedPoses
    from calrig.client import Client
    from calrig.store import Store
    from calrig.store.issued import Revision


class Format(StrEnum):
    """What `export` writes."""

    json = "json"
    csv = "csv"
    c_header = "c-header"
    px4 = "px4"
    ardupilot = "ardupilot"
    kalibr = "kalibr"
    vins = "vins"
    imu_tk = "imu-tk"
    imucal = "imucal"
    pdf = "pdf"
    dcc = "dcc"
    archive = "archive"


def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE.csv", help=f"Poses, one row each. {COLUMNS}")],
    unit: UnitSerial,
    rig: Rig = None,
    db: Db = None,
    server: Server = None,
) -> None:
    """Import a CSV of poses as a run and print its id; standard error says whether it is good."""
    there = running_service(server, db)
    if there is not None:
        from calrig.cli.output import print_says
        from calrig.cli.records_there import imported_there

        record = imported_there(there, file, unit, rig).record
        typer.echo(record.id)
        print_says(record.verdict.says if record.verdict else ())
        return

    from calrig.analysis.amendments import Records
    from calrig.analysis.issuing import Issuer, Releases
    from calrig.analysis.limits import keep_configured
    from calrig.cli.output import print_says
    from calrig.settings import load_settings, store_url
    from calrig.store import Store

    content = read_bytes(file)
    name = in_utf8(file.name)
    with Store.open(store_url(db), writer="import") as store:
        settings = load_settings()
        keep_configured(settings, store)
        issuer = Issuer(store, Releases.of(settings.rig))
        issuer.bring_over()
        made = Records(store, issuer).import_poses(unit=unit, rig=rig, file_name=name, content=content)
    typer.echo(made.id)
    if made.verdict is not None:
        print_says(made.verdict.says)


def export(
    run_id: Annotated[
        str | None,
        typer.Argument(
            metavar="RUN_ID|CALIBRATION.json",
            help=f"The run to export{SHORTENED}, or a calibration of `calrig solve --out`.",
        ),
    ] = None,
    unit: Annotated[str | None, typer.Option(metavar="SERIAL", help="The unit, by its run in force.")] = None,
    format_: Annotated[
        Format,
        typer.Option(
            "--format",
            help="The calibration, its poses (csv), its certificate (pdf, dcc), all of a unit (archive); "
            "for other programs: calrig/docs/calibrations.md.",
        ),
    ] = Format.json,
    parquet: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write the poses of all completed runs there.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="Where a certificate or an archive goes."),
    ] = None,
    sign: Annotated[
        Path | None, typer.Option(metavar="KEY.pem", help="Sign the DCC with this key, and --cert.")
    ] = None,
    cert: Annotated[
        Path | None, typer.Option(metavar="CERT.pem", help="The certificate of the key that signs.")
    ] = None,
    db: Db = None,
    server: Server = None,
) -> None:
    """Print a calibration as JSON or for another program, or its poses as CSV.

    Standard error has its verdict. `--format pdf` is its certificate, into a file or a pipe; `dcc` the same
    for programs, in PTB's XML. `--format archive --out FILE.zip` is everything that stands behind a unit:
    `calrig verify` checks it. With --parquet: the poses of all completed runs into files.
    """
    from calrig.cli.certificate import write_certificate
    from calrig.cli.output import print_says
    from calrig.cli.verify import export_archive
    from calrig.settings import store_url
    from calrig.store import Store

    if parquet is not None:
        if run_id is not None or unit is not None:
            raise InputError("export: --parquet writes the poses of all runs: name no run or unit beside it")
        _export_all(parquet, db)
        return
    if format_ is Format.archive:
        _refuse_elsewhere(format_, running_service(server, db), server)
        export_archive(unit, out, db)
        return
    if (run_id is None) == (unit is None):
        raise InputError("export: name either a RUN_ID or --unit SERIAL")
    if out is not None and format_ not in {Format.pdf, Format.dcc}:
        raise InputError(f"export: --format {format_.value} goes to standard output, not to --out")
    if run_id is not None and (run_id.endswith(".json") or Path(run_id).is_file()):
        sys.stdout.write(_of_file(run_id, format_))
        return
    there = running_service(server, db)
    if format_ is Format.pdf or format_ is Format.dcc:
        _refuse_elsewhere(format_, there, server)
        form: Literal["pdf", "dcc"] = "pdf" if format_ is Format.pdf else "dcc"
        with Store.open(store_url(db), writer=None) as store:
            found = _revision_asked_for(store, run_id and whole_id(store, run_id), unit)
            print_says(found.verdict["says"])
            write_certificate(store, found, form, out, sign, cert)
    elif there is not None:
        from calrig.cli.records_there import exported_there

        text, said = exported_there(there, run_id, unit, format_.value)
        print_says(said)
        sys.stdout.write(text)
    else:
        with Store.open(store_url(db), writer=None) as store:
            sys.stdout.write(_text(store, run_id and whole_id(store, run_id), unit, format_))


def _refuse_elsewhere(format_: Format, there: Client | None, server: str | None) -> None:
    """Refuses what is made of the store's file, by the settings beside it, where a service was named."""
    if there is not None and there.server == (server or "").rstrip("/"):
        raise InputError(
            f"export: --format {format_.value} is made of the store itself: run it where that is, or fetch "
            f"{there.server}/api/units/SERIAL/"
            + ("archive" if format_ is Format.archive else f"calibration?format={format_.value}")
        )


def _text(store: Store, run_id: str | None, unit: str | None, format_: Format) -> str:
    """What is printed; standard error has the verdict of a calibration."""
    from calrig.analysis.exports import NOISE_FORMATS, exported, exported_noise
    from calrig.analysis.mounts import labels_of
    from calrig.analysis.stored_runs import counted_poses, stored_run
    from calrig.cli.output import print_says
    from calrig.export.poses_csv import write_poses

    if run_id is not None and format_ is Format.csv:
        run = stored_run(store, run_id)
        return write_poses(counted_poses(store, run.id), labels_of(run))
    if format_.value in NOISE_FORMATS:
        of_unit = unit or stored_run(store, run_id or "").unit
        return exported_noise(store, of_unit, format_.value)
    found = _revision_asked_for(store, run_id, unit)
    if format_ is Format.csv:
        return write_poses(counted_poses(store, found.run_id))
    print_says(found.verdict["says"])
    return found.text + "\n" if format_ is Format.json else exported(found, format_.value)


def _of_file(file: str, format_: Format) -> str:
    from calrig.analysis.exports import REVISION_FORMATS, exported_document
    from calrig.export.calibration_file import read_document

    if format_.value not in REVISION_FORMATS:
        raise InputError(f"export: {file}: a calibration in a file is given as {', '.join(REVISION_FORMATS)}")
    return exported_document(read_document(file), format_.value, file)


def _revision_asked_for(store: Store, run_id: str | None, unit: str | None) -> Revision:
    from calrig.analysis.active_calibration import newest_of_run, wanted_revision

    if unit is not None:
        found = store.in_force(unit) or wanted_revision(store, unit, "latest")
    else:
        found = newest_of_run(store, run_id or "")
    if found.status != "in_force":
        words = f"revision {found.revision} of unit {found.unit!r} is {found.status}, not in force"
        typer.echo(f"calrig export: {words}", err=True)
    return found


def _export_all(folder: Path, db: str | None) -> None:
    from calrig.cli.progress import late_bar
    from calrig.export.poses_parquet import write_poses
    from calrig.settings import store_url
    from calrig.store import Store

    with Store.open(store_url(db), writer=None) as store, late_bar("exporting") as show:
        runs = [run for part in store.completed_runs() for run in part]
        n_poses = 0

        def pieces() -> Iterator[PackedPoses]:
            nonlocal n_poses
            n_runs = 0
            for piece in store.packed_poses(runs):
                yield piece
                n_runs, n_poses = n_runs + len(piece), n_poses + int(piece.first[-1])
                show(n_runs / len(runs))

        files = write_poses(folder, pieces())
    typer.echo(f"{folder}: {len(runs)} runs, {n_poses} poses in {len(files)} files")


def backup(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The copy to make; never overwritten.")],
    db: Db = None,
) -> None:
    """Copy the whole store, also while a service writes to it; the copy is a store itself."""
    from calrig.settings import store_url
    from calrig.store import back_up

    if file.is_dir() or not file.parent.is_dir():
        raise InputError(f"backup: {file}: is a folder, or in one that is not there: name a file to make")
    if file.exists():
        raise InputError(f"backup: {file}: exists and is not overwritten: name another file")
    made = back_up(store_url(db), file)
    size_mb = made.size_bytes / 1e6
    typer.echo(f"{file}: {made.runs} runs, {made.poses} poses, {size_mb:.1f} MB")
