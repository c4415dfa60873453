"""What `export` puts into files: certificates, archives, all poses."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from calrig.cli.progress import late_bar
from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    from calrig.calibration.fleet_screen import PackedPoses
    from calrig.client import Client
    from calrig.store import Store
    from calrig.store.issued import Revision

Form = Literal["pdf", "dcc"]


def check_target(form: Form, out: Path | None) -> None:
    """Refuses a PDF that would go to a terminal, and a file in a folder that is not there.

    Raises:
        InputError: so it is.
    """
    if form == "pdf" and out is None and sys.stdout.isatty():
        raise InputError("export: --format pdf is no text: name a file with -o FILE, or pipe it")
    if out is not None and (out.is_dir() or not out.parent.is_dir()):
        raise InputError(f"export: {out}: is a folder, or in one that is not there: name a file to make")


def put(certificate: bytes, out: Path | None) -> None:
    """Writes a certificate into a file, or to standard output."""
    if out is None:
        sys.stdout.buffer.write(certificate)
        return
    try:
        out.write_bytes(certificate)
    except OSError as error:
        raise WorkError(f"{out}: cannot be written ({error.strerror})") from error


def certificate_of(
    store: Store, revision: Revision, form: Form, key: Path | None, certificate: Path | None
) -> bytes:
    """A revision's certificate.

    Args:
        store: where the revision is.
        revision: that it is of.
        form: of the certificate.
        key: PEM file that a DCC is signed with; None as the laboratory's settings have it.
        certificate: of that key.

    Raises:
        InputError: key or certificate are not both named.
        WorkError: it cannot be made.
    """
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


def export_archive(there: Client | None, unit: str | None, out: Path | None, db: str | None) -> None:
    """Writes the archive of a unit, of a service or a store, to a file that is not there yet.

    Raises:
        InputError: no unit or file is named, or it cannot be made.
        WorkError: the disk took only a part of it, which is removed.
    """
    from calrig.export.new_file import write_new

    if unit is None or out is None:
        raise InputError("export: an archive is of a unit and goes to a file: --unit SERIAL --out FILE.zip")
    with late_bar(f"writing {out.name}"):
        if there is not None:
            size = there.archive(unit, out)
        else:
            from calrig.analysis.archives import archive_of
            from calrig.settings import load_settings, store_url
            from calrig.store import Store

            with Store.open(store_url(db), writer=None) as store:
                size = write_new(out, archive_of(store, unit, load_settings().laboratory))
    typer.echo(f"{out}: {size / 1e6:.1f} MB")


def export_all(folder: Path, db: str | None) -> None:
    """Writes the poses of all completed runs of a store as Parquet files."""
    from calrig.export.poses_parquet import write_poses
    from calrig.settings import store_url
    from calrig.store import Store

    with Store.open(store_url(db), writer=None) as store, late_bar("exporting") as show:
        runs = [run for part in store.completed_runs() for run in part]
        n_poses = 0

        def pieces() -> Iterator[PackedPoses]:
            nonlocal n_poses
            n_runs = 0
            for piece in store.packed_poses(runs, with_gyro=True):
                yield piece
                n_runs, n_poses = n_runs + len(piece), n_poses + int(piece.first[-1])
                show(n_runs / len(runs))

        files = write_poses(folder, pieces())
    typer.echo(f"{folder}: {len(runs)} runs, {n_poses} poses in {len(files)} files")
