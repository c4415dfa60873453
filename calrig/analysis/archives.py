"""A unit's archive from a store: what `calrig.export.archive` packs, with what only the analysis knows."""

from __future__ import annotations

from collections.abc import Iterator

from calrig.analysis.errors import Unknown
from calrig.analysis.issuing import Issuer
from calrig.export.archive.contents import unit_archive
from calrig.store import Store


def archive_of(store: Store, serial: str) -> Iterator[bytes]:
    """The archive, piece by piece.

    Raises:
        Unknown: there is no such unit; at once.
    """
    if store.unit(serial) is None:
        raise Unknown(f"there is no unit {serial!r}")
    return unit_archive(store, serial, Issuer(store).listed)
