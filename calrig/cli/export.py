"""`export`: a unit's calibration, poses, certificate or archive; or the poses of all runs."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal
from urllib.parse import quote

import typer

from calrig.cli import options
from calrig.cli.options import SHORTENED, Db, Server, whole_id
from calrig.cli.progress import late_bar
from calrig.cli.running_service import is_named, open_store, running_service, whole_id_there
from calrig.errors import InputError, WorkError, writable

if TYPE_CHECKING:
    from calrig.calibration.packed_poses import PackedPoses
    from calrig.client import Client
    from calrig.client import Revision as RevisionThere
    from calrig.export.formats import CalibrationExporter
    from calrig.store import Store
    from calrig.store.issued import Revision


ISSUED = ("json", "csv", "pdf", "dcc", "archive")
"""What `export` writes beside the formats of other programs: calibration, poses, certificates, record."""


def _choices() -> list[str]:
    from calrig.export.formats import format_names

    return [*ISSUED, *format_names()]


def _format(name: str) -> str:
    if name not in _choices():
        raise typer.BadParameter(f"{name!r} is none of {', '.join(_choices())}")
    return name


def _completed(incomplete: str) -> list[str]:
    return [name for name in _choices() if name.startswith(incomplete)]


Form = Literal["pdf", "dcc"]
FORMS: dict[str, Form] = {"pdf": "pdf", "dcc": "dcc"}
"""Of a certificate."""


def export(
    run_id: Annotated[
        str | None,
        typer.Argument(
            metavar="RUN_ID|CALIBRATION.json",
            autocompletion=options.runs,
            help=f"The run to export{SHORTENED}, or a calibration of `calrig solve --out`.",
        ),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(metavar="SERIAL", help="The unit, by its run in force.", autocompletion=options.units),
    ] = None,
    format_: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="FORMAT",
            parser=_format,
            autocompletion=_completed,
            help="json: the calibration; csv: its poses; pdf, dcc: its certificate; archive: all of a unit; "
            f"for other programs: {', '.join(_choices()[len(ISSUED) :])}; "
            "calrig/docs/reference/export-formats.md.",
        ),
    ] = "json",
    parquet: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write the poses of all completed runs there.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="Where a certificate or an archive goes."),
    ] = None,
    step: Annotated[
        float | None, typer.Option(metavar="DEG", help="Of a table: from row to row of the reading [1].")
    ] = None,
    lsb: Annotated[
        float | None, typer.Option(metavar="DEG", help="Of a table: write integers of this step.")
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
    for programs, in PTB's XML. `--format archive --out FILE.zip` is the complete record of a unit, which
    `calrig verify` checks. With --parquet: the poses of all completed runs into files.

    A service that holds the store makes them, by its own settings, where it is not told a key to sign with.
    """
    if parquet is not None:
        if run_id is not None or unit is not None:
            raise InputError("export: --parquet writes the poses of all runs: name no run or unit beside it")
        _refuse_elsewhere("--parquet", server, db)
        _export_all(parquet, db)
        return
    if format_ == "archive":
        if run_id is not None:
            raise InputError("export: an archive is of a unit, not of a run: --unit SERIAL --out FILE.zip")
        _export_archive(running_service(server, db), unit, out, db)
        return
    if (run_id is None) == (unit is None):
        raise InputError("export: name either a RUN_ID or --unit SERIAL")
    if format_ != "table" and (step, lsb) != (None, None):
        raise InputError("export: --step and --lsb are of --format table")
    table = None if (step, lsb) == (None, None) else _table(step, lsb)
    form = FORMS.get(format_)
    if out is not None and form is None:
        raise InputError(f"export: --format {format_} goes to standard output, not to --out")
    if run_id is not None and (run_id.endswith(".json") or Path(run_id).is_file()):
        sys.stdout.write(_of_file(run_id, format_, table))
    elif form is not None:
        _export_certificate(form, run_id, unit, out, (sign, cert), db, server)
    else:
        _export_text(format_, run_id, unit, db, server, table)


def _table(step_deg: float | None, lsb_deg: float | None) -> CalibrationExporter:
    from calrig.export.formats.table import EXPORTER, STEP_DEG, correction_table, refuse_steps

    step_deg = STEP_DEG if step_deg is None else step_deg
    try:
        refuse_steps(step_deg, lsb_deg)
    except ValueError as error:
        raise InputError(f"export: {error}") from error
    write = partial(correction_table, step_deg=step_deg, lsb_deg=lsb_deg)
    return replace(EXPORTER, write=write)


def _export_text(
    format_: str,
    run_id: str | None,
    unit: str | None,
    db: str | None,
    server: str | None,
    table: CalibrationExporter | None,
) -> None:
    there = running_service(server, db)
    if there is not None:
        text, of_unit, found = _exported_there(there, run_id, unit, format_, table)
        if found is not None:
            says = () if format_ == "csv" else found.verdict.says
            _say_which(of_unit, found.revision, found.status, says)
        sys.stdout.write(text)
        return

    with open_store(db) as store:
        sys.stdout.write(_text(store, run_id and whole_id(store, run_id), unit, format_, table))


def _export_certificate(
    form: Form,
    run_id: str | None,
    unit: str | None,
    out: Path | None,
    signing: tuple[Path | None, Path | None],
    db: str | None,
    server: str | None,
) -> None:

    _check_target(form, out)
    is_signed = signing != (None, None)
    if is_signed:
        _refuse_elsewhere("--sign", server, db)
    there = None if is_signed else running_service(server, db)
    if there is not None:
        of_unit, found = _revision_there(there, run_id, unit)
        _say_which(of_unit, found.revision, found.status, found.verdict.says)
        _put(there.certificate(of_unit, form, found.revision), out)
        return

    with open_store(db) as store:
        kept = _revision_asked_for(store, run_id and whole_id(store, run_id), unit)
        _say_which(kept.unit, kept.revision, kept.status, kept.verdict["says"])
        _put(_certificate_of(store, kept, form, *signing), out)


def _exported_there(
    client: Client,
    run_id: str | None,
    unit: str | None,
    format_: str,
    table: CalibrationExporter | None,
) -> tuple[str, str, RevisionThere | None]:
    """Return the text that a service exports, its unit and its revision; no revision of a run's poses."""
    from calrig.export.formats import exporters

    if run_id is not None and format_ == "csv":
        return _poses_there(client, whole_id_there(client, run_id)), "", None
    if format_ in {exporter.name for exporter in exporters("noise")}:
        of_unit = unit or client.run(whole_id_there(client, run_id or "")).unit
        return client.exported(of_unit, format_), of_unit, None
    of_unit, found = _revision_there(client, run_id, unit)
    if format_ == "csv":
        return _poses_there(client, found.run_id), of_unit, found
    if table is not None:
        from calrig.analysis.certificates import exported_document

        document = json.loads(client.exported(of_unit, "json", found.revision))
        return exported_document(document, table, f"revision {found.revision}"), of_unit, found
    text = client.exported(of_unit, format_, found.revision)
    return text + "\n" * (format_ == "json"), of_unit, found


def _revision_there(client: Client, run_id: str | None, unit: str | None) -> tuple[str, RevisionThere]:
    """Return a unit and its revision at a service: the newest of the run; else in force, else the latest."""
    if unit is not None:
        standing = [one for one in client.calibrations(unit) if one.status != "withdrawn"]
        if not standing:
            raise WorkError(f"unit {unit!r} has no calibration: none was completed, or all were withdrawn")
        return unit, next((one for one in standing if one.status == "in_force"), standing[0])
    run = client.run(whole_id_there(client, run_id or ""))
    for one in client.calibrations(run.unit):
        if one.run_id == run.id:
            return run.unit, one
    raise WorkError(f"run {run.id} gave no calibration")


def _poses_there(client: Client, run_id: str) -> str:
    return client.text(f"/api/runs/{quote(run_id, safe='')}/poses?format=csv")


def _refuse_elsewhere(option: str, server: str | None, db: str | None) -> None:
    """Refuses what is made of the store's file, where a service was named and no store."""
    if is_named(server, db):
        raise InputError(
            f"export: {option} is for the machine that has the store: the service at {server} has its own "
            "key and hands out no store; run it there, or name a store with --db"
        )


def _text(
    store: Store, run_id: str | None, unit: str | None, format_: str, table: CalibrationExporter | None
) -> str:
    """What is printed; standard error has the verdict of a calibration."""
    from calrig.analysis.certificates import exported, exported_noise
    from calrig.analysis.stored_runs import stored_run
    from calrig.export.formats import NoiseExporter, exporter_of

    if run_id is not None and format_ == "csv":
        return _poses(store, run_id)
    exporter = None if format_ in ISSUED else table or exporter_of(format_)
    if isinstance(exporter, NoiseExporter):
        of_unit = unit or stored_run(store, run_id or "").unit
        return exported_noise(store, of_unit, exporter)
    found = _revision_asked_for(store, run_id, unit)
    if format_ == "csv":
        _say_which(found.unit, found.revision, found.status, ())
        return _poses(store, found.run_id)
    _say_which(found.unit, found.revision, found.status, found.verdict["says"])
    return found.text + "\n" if exporter is None else exported(found, exporter)


def _poses(store: Store, run_id: str) -> str:
    from calrig.analysis.stored_runs import counted_poses, labels_of, stored_run
    from calrig.export.poses_csv import write_poses

    run = stored_run(store, run_id)
    return write_poses(counted_poses(store, run.id), labels_of(run))


def _of_file(file: str, format_: str, table: CalibrationExporter | None) -> str:
    from calrig.analysis.certificates import exported_document
    from calrig.export.calibration_document import read_document
    from calrig.export.formats import CalibrationExporter, exporter_of, exporters

    exporter = None if format_ in ISSUED else table or exporter_of(format_)
    if not isinstance(exporter, CalibrationExporter):
        names = ", ".join(one.name for one in exporters("calibration"))
        raise InputError(f"export: {file}: a calibration in a file is given as {names}")
    return exported_document(read_document(file), exporter, file)


def _revision_asked_for(store: Store, run_id: str | None, unit: str | None) -> Revision:
    from calrig.analysis.calibration_in_force import newest_of_run, wanted_revision

    if unit is not None:
        return store.revisions.in_force(unit) or wanted_revision(store, unit, "latest")
    return newest_of_run(store, run_id or "")


def _say_which(unit: str, revision: int, status: str, says: Iterable[str]) -> None:
    """Says on standard error what is exported, where it is not in force, and its verdict."""
    from calrig.cli.output import print_says

    if status != "in_force":
        words = f"revision {revision} of unit {unit!r} is {status}, not in force"
        typer.echo(f"calrig export: {words}", err=True)
    print_says(says)


def _check_target(form: Form, out: Path | None) -> None:
    """Raise InputError for a PDF that would go to a terminal, or a file in a folder that does not exist."""
    if form == "pdf" and out is None and sys.stdout.isatty():
        raise InputError("export: --format pdf is no text: name a file with -o FILE, or pipe it")
    if out is not None and (out.is_dir() or not out.parent.is_dir()):
        raise InputError(f"export: {out}: is a folder, or in one that is not there: name a file to make")


def _put(certificate: bytes, out: Path | None) -> None:
    if out is None:
        sys.stdout.buffer.write(certificate)
        return
    with writable(out):
        out.write_bytes(certificate)


def _certificate_of(
    store: Store, revision: Revision, form: Form, key: Path | None, certificate: Path | None
) -> bytes:
    """Return a revision's certificate, signed with a key and its certificate, or as the settings say."""
    from calrig.analysis.certificates import certificate_dcc, certificate_pdf
    from calrig.settings import load_settings

    if (key is None) != (certificate is None):
        raise InputError("export: --sign KEY.pem and --cert CERT.pem go together")
    if key is not None and form == "pdf":
        raise InputError("export: --sign is for --format dcc: a PDF is not signed here")
    laboratory = load_settings().laboratory
    if key is not None:
        signing = {"signing_key": str(key), "signing_certificate": str(certificate)}
        laboratory = laboratory.model_copy(update=signing)
    return (certificate_pdf if form == "pdf" else certificate_dcc)(store, revision, laboratory)


def _export_archive(there: Client | None, unit: str | None, out: Path | None, db: str | None) -> None:
    from calrig.export.new_file import write_new

    if unit is None or out is None:
        raise InputError("export: an archive is of a unit and goes to a file: --unit SERIAL --out FILE.zip")
    with late_bar(f"writing {out.name}"):
        if there is not None:
            size = there.archive(unit, out)
        else:
            from calrig.analysis.certificates import archive_of

            with open_store(db) as store:
                size = write_new(out, archive_of(store, unit))
    typer.echo(f"{out}: {size / 1e6:.1f} MB" if size >= 1e6 else f"{out}: {size / 1e3:.1f} kB")


def _export_all(folder: Path, db: str | None) -> None:
    from calrig.export.poses_parquet import write_poses

    with open_store(db) as store, late_bar("exporting") as show:
        runs = [run for part in store.fleet.completed_runs() for run in part]
        n_poses = 0

        def pieces() -> Iterator[PackedPoses]:
            nonlocal n_poses
            n_runs = 0
            for piece in store.fleet.packed_poses(runs, with_gyro=True):
                yield piece
                n_runs, n_poses = n_runs + len(piece), n_poses + int(piece.first[-1])
                show(n_runs / len(runs))

        files = write_poses(folder, pieces())
    typer.echo(f"{folder}: {len(runs)} runs, {n_poses} poses in {len(files)} files")
