"""What is known of a device before its port is open: its name, how it is opened, how a scan recognises it.

Each folder under `stages` and `boards` declares one as `DEVICE`. A scan opens ports that anything may hang
on, so all that a device wants asked is held to these rules, here and in the tests:

- No query begins with a line end, which would complete a command that another program left half sent. Its
  first letters make a wrong command of that one, so each is safe whichever comes first.
- No query has a byte that some controller takes for a command of its own, line or no line: GRBL's
  real-time bytes (resume, reset, jog cancel, overrides), and the 0x04 that every motion command of Thorlabs'
  binary frames has.
- A device that hears a query at another baud rate hears other bytes. The tests compute which: no motion
  command of any stage's and none of GRBL's real-time ones, such as the 0x18 (reset) that `1VE` at 57600 baud
  holds for a GRBL. What would break this may be a `version_query`: asked of a device that is known.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol

if TYPE_CHECKING:  # numpy is not needed to know what there is
    from calrig.instruments.types import Board, Stage

LINE_ENDS = re.compile(rb"[\r\n]+")
NOT_OF_LINES = b"\x00\x11\x13"
"""A NUL byte says that motor power was cut; XON and XOFF belong to the wire."""
NEVER_SENT = frozenset(b"\x04\x18~!") | frozenset(range(0x80, 0x100))


@dataclass(frozen=True, slots=True)
class Probe:
    """One attempt of a scan to hear from a device.

    Attributes:
        baudrate: at which.
        listen_s: how long is listened: a device that speaks unasked has told who it is by then, counted from
            when it is up; one that is asked has answered.
        query: what is asked; b"" where it speaks unasked.
        harmless: why the query changes nothing at the device it is meant for, nor at any other.
    """

    baudrate: int
    listen_s: float
    query: bytes = b""
    harmless: str = ""

    def __post_init__(self) -> None:
        if self.query and not self.harmless:
            raise ValueError(f"query {self.query!r} does not say why it is harmless")
        if self.query[:1] in (b"\r", b"\n"):
            raise ValueError(f"query {self.query!r} begins with a line end")
        if refused := NEVER_SENT & set(self.query):
            raise ValueError(f"query {self.query!r} has {bytes(refused)!r}, which may be a command")


@dataclass(frozen=True, slots=True)
class Identity:
    """Who it says it is, in words, and the address it answered with, None where it has none."""

    words: str
    axis: int | None = None


class OpenStage(Protocol):
    """Opens a stage's port; moves nothing. Without a baudrate the driver's own is used."""

    def __call__(self, url: str, *, axis: int, baudrate: int | None) -> Stage: ...  # noqa: D102


class OpenBoard(Protocol):
    """Opens a board's port. Without a baudrate the driver's own is used."""

    def __call__(self, url: str, *, baudrate: int | None) -> Board: ...  # noqa: D102


def opened_by(module: str) -> Callable[..., Any]:
    """Opens by the `OPENS` of a driver's module, which is imported only then: no scan needs numpy."""
    return lambda url, **how: import_module(module).OPENS(url, **how)


def lines_of(heard: bytes) -> list[str]:
    """The lines in it that have come to their end, but for empty ones."""
    *whole, _ = LINE_ENDS.split(heard.translate(None, NOT_OF_LINES))
    return [line.decode("latin-1") for line in whole if line]


@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """A kind of device.

    Attributes:
        driver: its name in `calrig.toml`.
        title: what it is, in words.
        baudrate: bits per second unless the configuration says otherwise.
        probes: how a scan hears from it.
        matches: whether a message is this device's to the letter.
        identity: who it is, from the messages that only it says, in the order heard.
        version_query: what is asked once it is known, b"" for nothing; it only reads.
        messages: bytes to messages; lines unless it frames them otherwise.
    """

    driver: str
    title: str
    baudrate: int
    probes: tuple[Probe, ...]
    matches: Callable[[str], bool]
    identity: Callable[[Sequence[str]], Identity]
    version_query: bytes
    messages: Callable[[bytes], list[str]] = lines_of

    def __post_init__(self) -> None:
        missing = [part for part in ("driver", "title", "baudrate", "probes") if not getattr(self, part)]
        if missing:
            raise ValueError(f"device {self.driver!r} has no {', no '.join(missing)}")


@dataclass(frozen=True, slots=True, kw_only=True)
class StageDevice(Device):
    """A kind of stage controller, and how one is opened."""

    kind: ClassVar[Literal["stage"]] = "stage"
    opens: OpenStage


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardDevice(Device):
    """A kind of sensor board, and how one is opened.

    Attributes:
        opens: opens one.
        may_stay_open: whether a run may go on with a port that was opened for a look before, which saves
            another reset; not where the board takes a zero when it starts.
    """

    kind: ClassVar[Literal["board"]] = "board"
    opens: OpenBoard
    may_stay_open: bool = False


AnyDevice = StageDevice | BoardDevice


@dataclass(frozen=True, slots=True)
class Recognised:
    """A kind of device, and which one of it."""

    device: AnyDevice
    identity: Identity


def recognise(heard: bytes, devices: Iterable[AnyDevice]) -> Recognised | None:
    """Who sent this, None where nothing in it is any device's to the letter.

    What several could have said tells nothing: sketches share some of what they say at their start.
    """
    said = [(device, [m for m in device.messages(heard) if device.matches(m)]) for device in devices]
    senders = Counter(message for _, messages in said for message in set(messages))
    own = [(device, [m for m in messages if senders[m] == 1]) for device, messages in said]
    device, messages = max(own, key=lambda one: len(one[1]), default=(None, []))
    return Recognised(device, device.identity(messages)) if device and messages else None
