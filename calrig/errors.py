"""What the command line says in one line, by the exit status that it leaves with."""

from collections.abc import Iterator
from contextlib import contextmanager


class WorkError(Exception):
    """The work failed (1); the message is the reason."""


class InputError(Exception):
    """Wrong usage or unreadable input (2); the message says where."""


@contextmanager
def readable(file: object) -> Iterator[None]:
    """What the system does not let be read in the block is an InputError that names the file."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror})") from error


@contextmanager
def writable(file: object) -> Iterator[None]:
    """What the system does not let be written in the block is a WorkError that names the file."""
    try:
        yield
    except OSError as error:
        raise WorkError(f"{file}: cannot be written ({error.strerror})") from error


def printable(text: str) -> str:
    """Text from outside that goes to a terminal: what would move the cursor or turn the writing is shown.

    Serial numbers, names of files and ports, and what devices say may hold anything.
    """
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text)
