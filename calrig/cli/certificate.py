"""`export --format pdf`: a certificate into a file or a pipe."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    from calrig.store import Store
    from calrig.store.issued import Revision


def write_certificate(store: Store, revision: Revision, out: Path | None) -> None:
    """Makes a revision's certificate and puts it there, or on standard output.

    Raises:
        InputError: it would go to a terminal, or into a folder that is not there.
        WorkError: it cannot be made or written.
    """
    from calrig.analysis.certificates import certificate_pdf
    from calrig.settings import load_settings

    if out is None and sys.stdout.isatty():
        raise InputError("export: --format pdf is no text: name a file with -o FILE, or pipe it")
    if out is not None and (out.is_dir() or not out.parent.is_dir()):
        raise InputError(f"export: {out}: is a folder, or in one that is not there: name a file to make")
    pdf = certificate_pdf(store, revision, load_settings().laboratory)
    if out is None:
        sys.stdout.buffer.write(pdf)
        return
    try:
        out.write_bytes(pdf)
    except OSError as error:
        raise WorkError(f"{out}: cannot be written ({error.strerror})") from error
