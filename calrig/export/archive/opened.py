"""A zip from anywhere, opened with suspicion: bounded in size, every name one that an archive has."""

import hashlib
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from calrig.errors import InputError
from calrig.export.archive import layout

CHUNK = 1 << 18
UNREADABLE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    OSError,
    OverflowError,
    RuntimeError,  # a password, a method of compression that Python does not know
    ValueError,
    KeyError,
    IndexError,
)
"""What zipfile raises of bytes that are no zip."""
_BEGINNING = b"PK\x03\x04"
_END = struct.Struct("<4s4H2LH")
_END_64, _LOCATOR_BYTES = struct.Struct("<4sQ2H2L4Q"), 20
_ZIP64_EXTRA = b"\x01\x00"


class DamagedError(Exception):
    """An archive is not as it was written; the message says what of it, `where` which part."""

    def __init__(self, where: str, what: str) -> None:
        super().__init__(what)
        self.where, self.what = where, what


class Opened:
    """The members of an archive by name; nothing is unpacked to a disk."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._infos = {info.filename: info for info in archive.infolist()}
        self.names = tuple(self._infos)

    def size(self, name: str) -> int:
        """Bytes of a member, as the zip's directory says."""
        return self._infos[name].file_size

    def pieces(self, name: str) -> Iterator[bytes]:
        """What is in a member.

        Raises:
            DamagedError: it cannot be unpacked, or is not what its checksum was made of.
        """
        try:
            with self._archive.open(self._infos[name]) as member:
                while piece := member.read(CHUNK):
                    yield piece
        except UNREADABLE as error:
            raise DamagedError(name, f"cannot be unpacked ({error or type(error).__name__})") from error

    def read(self, name: str) -> bytes:
        """All that is in a member that is read as a whole.

        Raises:
            DamagedError: as `pieces`; there is none, or it is too large for that.
        """
        if name not in self._infos:
            raise DamagedError(name, "is missing")
        if self.size(name) > layout.LARGEST_READ:
            raise DamagedError(name, f"has more than {layout.LARGEST_READ} bytes")
        return b"".join(self.pieces(name))


@contextmanager
def opened(path: Path) -> Iterator[tuple[Opened, list[DamagedError]]]:
    """An archive and what is wrong with its bytes as a whole.

    Raises:
        InputError: it is no zip file, or cannot be read.
        DamagedError: it is too far from an archive for its members to be looked at.
    """
    try:
        is_file = stat.S_ISREG(path.stat().st_mode)
        file = path.open("rb") if is_file else None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', error)})") from error
    if file is None:
        raise InputError(f"{path}: is no file")
    with file:
        if file.read(len(_BEGINNING)) != _BEGINNING:
            raise InputError(f"{path}: is no zip file, as every archive is")
        wrong = _whole(file)
        try:
            archive = zipfile.ZipFile(file)
        except UNREADABLE as error:
            raise DamagedError("its directory", f"cannot be read ({error})") from error
        with archive:
            _check_directory(archive.infolist(), file.seek(0, 2))
            yield Opened(archive), wrong


def _whole(file: IO[bytes]) -> list[DamagedError]:
    """Holds the hash at the end against every byte before it, once the directory is known to be bounded."""
    size = file.seek(0, 2)
    _check_end(file, size)
    found, left = hashlib.sha256(), size - layout.COMMENT_BYTES
    file.seek(0)
    while left > 0 and (piece := file.read(min(CHUNK, left))):
        found.update(piece)
        left -= len(piece)
    if file.read() == found.hexdigest().encode():
        return []
    return [DamagedError("the file", "does not have the SHA-256 at its end: some byte of it was changed")]


def _check_end(file: IO[bytes], size: int) -> None:
    """The end record is where calrig puts it, and the directory before it of a size to be read."""
    at = size - layout.COMMENT_BYTES - _END.size
    end = _END.unpack(_at(file, at, _END.size)) if at > 0 else (b"",)
    if end[0] != b"PK\x05\x06" or end[-1] != layout.COMMENT_BYTES:
        raise DamagedError(
            "its end", "is not where it belongs: the file was cut off, or packed by something else"
        )
    members, directory = int(end[4]), int(end[5])
    if members == 0xFFFF or directory == 0xFFFFFFFF:
        at -= _LOCATOR_BYTES + _END_64.size
        wide = _END_64.unpack(_at(file, at, _END_64.size)) if at > 0 else (b"",)
        if wide[0] != b"PK\x06\x06":
            raise DamagedError("its end", "lacks the record of a large zip")
        members, directory = int(wide[7]), int(wide[8])
    if members > layout.MOST_MEMBERS or directory > layout.LARGEST_DIRECTORY:
        raise DamagedError(
            "its directory", f"names {members} files in {directory} bytes: more than any archive"
        )


def _at(file: IO[bytes], place: int, n_bytes: int) -> bytes:
    file.seek(place)
    return file.read(n_bytes)


def _check_directory(infos: list[zipfile.ZipInfo], size: int) -> None:
    """Raises DamagedError for the first that no archive has; before a byte is unpacked."""
    seen: set[str] = set()
    if len(infos) > layout.MOST_MEMBERS:
        raise DamagedError("its directory", f"names {len(infos)} files: more than any archive")
    for info in infos:
        if (why := _why_not(info)) is not None:
            raise DamagedError(info.orig_filename[:100], why)
        if info.filename in seen:
            raise DamagedError(info.filename, "is there twice")
        seen.add(info.filename)
    total = sum(info.file_size for info in infos)
    if total > min(layout.LARGEST_TOTAL, layout.LARGEST_RATIO * size):
        raise DamagedError("the file", f"of {size} bytes would unpack to {total}: nothing of it is unpacked")


def _why_not(info: zipfile.ZipInfo) -> str | None:
    mode = info.external_attr >> 16
    if not layout.is_member_name(info.orig_filename) or info.filename != info.orig_filename:
        return "is no name of a file of an archive"
    if mode and not stat.S_ISREG(mode):
        return "is no regular file but a link or something else"
    if info.compress_type != zipfile.ZIP_DEFLATED or info.flag_bits & 0x1:
        return "is packed or locked in another way than calrig does"
    if info.extra and (info.extra[:2] != _ZIP64_EXTRA or len(info.extra) != 4 + info.extra[2]):
        return "has a second name or other extra data"
    return None
