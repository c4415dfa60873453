"""Every byte to and from a port with its time: the last minute kept, all of it written to a file on request.

A transcript is text, one piece a line, for people and tests:

    # calrig transcript of /dev/ttyUSB0
    0.000000 > 3149443f0d0a    what calrig sent, in hexadecimal, s after the port was opened
    0.013552 < 31494431320d0a  what it received
"""

import struct
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TextIO

from calrig.instruments.clock import WALL, Clock
from calrig.instruments.errors import PortError

KEPT_S = 60.0
KEPT_BYTES = 4_000_000
"""A board at 1 kHz sends 1.5 MB a minute."""
HEADING = "# calrig transcript of "

Direction = Literal[">", "<"]
DIRECTIONS: dict[str, Direction] = {">": ">", "<": "<"}


@dataclass(frozen=True, slots=True)
class Piece:
    """Bytes in one direction: `>` sent by calrig, `<` received, at_s after the port was opened."""

    at_s: float
    direction: Direction
    data: bytes

    def line(self) -> str:
        """The piece as a line of a transcript."""
        return f"{self.at_s:.6f} {self.direction} {self.data.hex()}\n"


HEAD = struct.Struct("<dc")
"""Time and direction of a piece as it is kept; its bytes follow."""


def _unpacked(kept: bytes) -> Piece:
    at_s, direction = HEAD.unpack_from(kept)
    return Piece(at_s, DIRECTIONS[direction.decode()], kept[HEAD.size :])


def _heading(port: str) -> str:
    """One line, whatever the port is called."""
    return f"{HEADING}{' '.join(port.split())}\n"


class Tape:
    """The transcript of one port; reader and writer may note at the same time."""

    def __init__(self, port: str, file: TextIO | None = None, clock: Clock = WALL) -> None:
        self.port = port
        self.clock = clock
        self._lock = threading.Lock()
        self.begin(file)

    def begin(self, file: TextIO | None = None) -> None:
        """Begin, or begin again for a port that was handed over, as if it had just been opened."""
        with self._lock:
            self._file = file
            self._opened_s = self.clock.now_s()
            self._kept: deque[bytes] = deque()  # three objects a piece would take five times its bytes
            self._n_bytes = 0
            if file is not None:
                file.write(_heading(self.port))

    def note(self, direction: Direction, data: bytes) -> None:
        """Takes what was sent or received just now."""
        with self._lock:
            at_s = self.clock.now_s() - self._opened_s
            self._kept.append(HEAD.pack(at_s, direction.encode()) + data)
            self._n_bytes += len(data)
            while HEAD.unpack_from(self._kept[0])[0] < at_s - KEPT_S or self._n_bytes > KEPT_BYTES:
                self._n_bytes -= len(self._kept.popleft()) - HEAD.size
            if self._file is not None:
                self._file.write(Piece(at_s, direction, data).line())

    def last_minute(self) -> str:
        """What is kept, as the text of a transcript."""
        with self._lock:
            kept = list(self._kept)
        return _heading(self.port) + "".join(_unpacked(piece).line() for piece in kept)


@dataclass(frozen=True)
class Tapes:
    """The transcripts of the ports opened inside a `taped` block, in the order they were opened."""

    folder: Path | None
    all: list[Tape]
    _files: ExitStack

    def of(self, port: str, clock: Clock = WALL) -> Tape:
        """A new tape."""
        tape = Tape(port, self._file(port), clock)
        self.all.append(tape)
        return tape

    def take_over(self, tape: Tape) -> None:
        """Has a tape of a port that is open already, from now on."""
        tape.begin(self._file(tape.port))
        self.all.append(tape)

    def _file(self, port: str) -> TextIO | None:
        if self.folder is None:
            return None
        name = "".join(c if c.isalnum() else "-" for c in port).strip("-")[:80]
        path = self.folder / f"{time.strftime('%Y%m%dT%H%M%S')}-{len(self.all)}-{name}.txt"
        return self._files.enter_context(path.open("x", encoding="ascii", errors="replace"))


_current: ContextVar[Tapes | None] = ContextVar("tapes", default=None)


@contextmanager
def taped(folder: Path | None = None) -> Iterator[Tapes]:
    """Record every port that this thread opens inside the block; into files as well if a folder is given.

    Raises:
        PortError: the folder cannot be made.
    """
    with ExitStack() as files:
        if folder is not None:
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise PortError(f"transcripts cannot be written to {folder} ({error.strerror})") from error
        tapes = Tapes(folder, [], files)
        token = _current.set(tapes)
        try:
            yield tapes
        finally:
            _current.reset(token)


def tape_of(port: str, clock: Clock) -> Tape | None:
    """Return a transcript for a port that is being opened; None outside a `taped` block."""
    tapes = _current.get()
    return None if tapes is None else tapes.of(port, clock)


def read_transcript(lines: Iterable[str]) -> list[Piece]:
    """The pieces of a transcript.

    Raises:
        ValueError: a line is none of a transcript; says which.
    """
    pieces = []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            at, direction, data = line.split()
            pieces.append(Piece(float(at), DIRECTIONS[direction], bytes.fromhex(data)))
        except (ValueError, KeyError) as error:
            raise ValueError(f"line {number} is no line of a transcript: {line.strip()[:40]!r}") from error
    return pieces
