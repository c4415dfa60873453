"""A form with a file (RFC 7578), read from the disk as it is sent: 100 MB take no memory."""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from shutil import copyfileobj
from tempfile import TemporaryFile
from typing import IO, Self

from calrig.client.given_up import nap
from calrig.errors import InputError

PIECE = 1 << 16
"""Bytes sent at once."""


class Upload:
    """The body of a request: its length and its pieces.

    Args:
        file: sent under its name as the field `file`.
        fields: the others.
        told: the share that is sent, 0 to 1, again and again.

    Raises:
        InputError: the file cannot be read.
    """

    def __init__(self, file: Path, fields: Mapping[str, str], told: Callable[[float], None]) -> None:
        self._name, self._told = str(file), told
        with ExitStack() as stack:
            try:
                self._file: IO[bytes] = stack.enter_context(file.open("rb"))
                if not stat.S_ISREG(os.fstat(self._file.fileno()).st_mode):
                    # a pipe does not know its length, which comes first
                    piped, self._file = self._file, stack.enter_context(TemporaryFile())
                    copyfileobj(piped, self._file)
                self._n_bytes = self._file.seek(0, os.SEEK_END)
            except OSError as error:
                raise InputError(f"{file}: cannot be read ({error.strerror})") from error
            self._opened = stack.pop_all()
        boundary = secrets.token_hex(16)
        self.content_type = f"multipart/form-data; boundary={boundary}"
        head = [
            f'--{boundary}\r\nContent-Disposition: form-data; name="{k}"\r\n\r\n{v}\r\n'
            for k, v in fields.items()
        ]
        name = os.fsencode(file.name).decode("utf-8", "backslashreplace")
        for plain, escaped in (('"', "%22"), ("\r", "%0D"), ("\n", "%0A")):  # as the HTML standard has it
            name = name.replace(plain, escaped)
        head.append(
            f'--{boundary}\r\nContent-Disposition: form-data; name="file"; filename="{name}"\r\n'
            "Content-Type: text/csv\r\n\r\n"
        )
        self._head = "".join(head).encode("utf-8", "surrogateescape")
        self._tail = f"\r\n--{boundary}--\r\n".encode()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def __len__(self) -> int:
        return len(self._head) + self._n_bytes + len(self._tail)

    def __iter__(self) -> Iterator[bytes]:
        yield self._head
        self._file.seek(0)
        left = self._n_bytes
        while left:
            piece = self._file.read(min(PIECE, left))
            if not piece:
                raise InputError(f"{self._name}: has become shorter while it was sent")
            nap()
            yield piece
            left -= len(piece)
            self._told(1.0 - left / self._n_bytes)
        yield self._tail
