"""A zip that is made as it is sent: the same bytes for the same members, a hash of all at its end."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from calrig.export.archive.layout import COMMENT_BYTES

_REGULAR_FILE = 0o100644 << 16
_UNIX = 3


@dataclass(frozen=True, slots=True)
class Member:
    """A file of an archive; `pieces` are asked for once, when it is its turn."""

    name: str
    pieces: Iterable[bytes]


@dataclass(frozen=True, slots=True)
class Packed:
    """A member that has been written."""

    name: str
    size: int
    sha256: str


class _Outlet:
    """What zipfile writes to: nothing in it can be gone back to, as on a wire."""

    def __init__(self) -> None:
        self._held = bytearray()
        self._hash = hashlib.sha256()

    def write(self, data: bytes) -> int:
        self._held += data
        return len(data)

    def flush(self) -> None:
        """Nothing is kept back but by `drained`."""

    def close(self) -> None:
        """Whoever asked for the pieces has them."""

    def drained(self) -> bytes:
        """What has been written since the last time."""
        data = bytes(self._held)
        self._held.clear()
        self._hash.update(data)
        return data

    def last(self) -> bytes:
        """The end, with the hash of everything before in the place of the comment."""
        del self._held[-COMMENT_BYTES:]
        data = self.drained()
        return data + self._hash.hexdigest().encode()


def packed(members: Iterable[Member], manifest: Callable[[list[Packed]], Member]) -> Iterator[bytes]:
    """The zip, piece by piece.

    Args:
        members: in their order.
        manifest: the last one, made of those before it.
    """
    outlet = _Outlet()
    written: list[Packed] = []
    with zipfile.ZipFile(outlet, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.comment = b"0" * COMMENT_BYTES
        for member in members:
            yield from _write(archive, outlet, member, written)
        yield from _write(archive, outlet, manifest(written), written)
    yield outlet.last()


def _write(
    archive: zipfile.ZipFile, outlet: _Outlet, member: Member, written: list[Packed]
) -> Iterator[bytes]:
    info = zipfile.ZipInfo(member.name)  # of 1980, as every file whose time nobody states
    info.compress_type = zipfile.ZIP_DEFLATED
    info.create_system, info.external_attr = _UNIX, _REGULAR_FILE
    content, size = hashlib.sha256(), 0
    with archive.open(info, "w", force_zip64=True) as opened:  # a static log of two days has 4 GB
        for piece in member.pieces:
            opened.write(piece)
            content.update(piece)
            size += len(piece)
            if data := outlet.drained():
                yield data
    written.append(Packed(member.name, size, content.hexdigest()))
