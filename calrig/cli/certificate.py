"""`export --format pdf` and `dcc`: a certificate into a file or a pipe, for people and for programs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    from calrig.store import Store
    from calrig.store.issued import Revision


def write_certificate(
    store: Store,
    revision: Revision,
    form: Literal["pdf", "dcc"],
    out: Path | None,
    key: Path | None = None,
    certificate: Path | None = None,
) -> None:
    """Makes a revision's certificate and puts it there, or on standard output.

    Args:
        store: where the revision is.
        revision: that it is of.
        form: of the certificate.
        out: the file; None for standard output.
        key: PEM file that a DCC is signed with; None as the laboratory's settings have it.
        certificate: of that key.

    Raises:
        InputError: a PDF would go to a terminal, or it into a folder that is not there; key or certificate
            are not both named.
        WorkError: it cannot be made or written.
    """
    from calrig.analysis.certificates import certificate_dcc, certificate_pdf
    from calrig.settings import load_settings

    if form == "pdf" and out is None and sys.stdout.isatty():
        raise InputError("export: --format pdf is no text: name a file with -o FILE, or pipe it")
    if out is not None and (out.is_dir() or not out.parent.is_dir()):
        raise InputError(f"export: {out}: is a folder, or in one that is not there: name a file to make")
    if (key is None) != (certificate is None):
        raise InputError("export: --sign KEY.pem and --cert CERT.pem go together")
    if key is not None and form == "pdf":
        raise InputError("export: --sign is for --format dcc: a PDF is not signed here")
    laboratory = load_settings().laboratory
    if key is not None:
        signing = {"signing_key": str(key), "signing_certificate": str(certificate)}
        laboratory = laboratory.model_copy(update=signing)
    made = (certificate_pdf if form == "pdf" else certificate_dcc)(store, revision, laboratory)
    if out is None:
        sys.stdout.buffer.write(made)
        return
    try:
        out.write_bytes(made)
    except OSError as error:
        raise WorkError(f"{out}: cannot be written ({error.strerror})") from error
