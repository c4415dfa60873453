"""A file that is made piece by piece: whole, or not there."""

from collections.abc import Iterable
from pathlib import Path

from calrig.errors import InputError, WorkError


def write_new(path: Path, pieces: Iterable[bytes]) -> int:
    """Writes a file that is not there yet, and gives how many bytes it has.

    Raises:
        InputError: it is there, or cannot be made.
        WorkError: the disk took only a part of it. It is removed then, and where the pieces raise something.
    """
    try:
        file = path.open("xb")
    except FileExistsError as error:
        raise InputError(f"{path}: exists and is not overwritten: name another file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be made ({error.strerror})") from error
    try:
        with file:
            return sum(map(file.write, pieces))
    except BaseException as error:
        path.unlink()
        if isinstance(error, OSError):
            raise WorkError(f"{path}: cannot be written ({error.strerror})") from error
        raise
