"""A unit's archive from a store: what `calrig.export.archive` packs, with its certificates."""

from __future__ import annotations

from collections.abc import Iterator

from calrig.analysis.certificates import certificate_dcc, certificate_pdf
from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.issuing import Issuer
from calrig.errors import WorkError
from calrig.export.archive.contents import unit_archive
from calrig.laboratory import LaboratorySettings
from calrig.store import Store
from calrig.store.issued import Revision


def archive_of(store: Store, serial: str, laboratory: LaboratorySettings) -> Iterator[bytes]:
    """The archive, piece by piece.

    Args:
        store: where the unit is.
        serial: of the unit.
        laboratory: who issues its certificates, as PDF too where that can be made here. They are unsigned:
            not every signature is the same once more.

    Raises:
        Unknown: there is no such unit; at once.
    """
    if store.unit(serial) is None:
        raise Unknown(f"there is no unit {serial!r}")
    unsigned = laboratory.model_copy(update={"signing_key": None, "signing_certificate": None})

    def certificates(revision: Revision) -> Iterator[tuple[str, bytes]]:
        yield "xml", certificate_dcc(store, revision, unsigned)
        try:
            yield "pdf", certificate_pdf(store, revision, unsigned)
        except (WorkError, Conflict):
            return  # no typst here, or no font for a character: the XML says the same

    return unit_archive(store, serial, Issuer(store).listed, certificates)
