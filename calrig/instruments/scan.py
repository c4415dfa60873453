"""Who answers on which port: found out without a byte that could move anything.

Each port is opened once, which resets most Arduinos, and listened to before anything is asked. What is asked
(`LOOKS`) is harmless to the device it is meant for, to every other one that may hang there instead, and to
one that hears it at the wrong baud rate:

- `?` asks a GRBL for its status, which it tells even while it moves. To all others it is no command.
- `ID` LF asks a calrig board who it is. To GRBL it is a letter without its number: error:2, nothing is done.
- `/` LF asks every Zaber device whether it is there. GRBL drops the `/`, and an empty line is none.
- `1SL?` CR LF asks an SMC100 for its lower limit, `VE?` CR an ESP301 for its version.
- What is sent twice is so because the first one ends what the device has heard of the questions before, and
  may be refused. None begins with a line end, which would complete a motion command that somebody else has
  left half sent; the letters that come first make a wrong command of it.
- Every motion command of Thorlabs' binary frames has the byte 0x04; no question has it.
- No sketch heeds what it hears, but that `dmp-ypr` starts to measure.
- A device that hears a question at another baud rate hears other bytes. The tests reckon out which: no
  command of any stage's, and none of GRBL's real-time ones, such as the 0x18 (reset) that `1VE` at 57600 baud
  holds for a GRBL. Therefore more is asked (`THEN`) only of a device that is known.
"""

from __future__ import annotations

import errno
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from calrig.instruments.errors import PortError
from calrig.instruments.ports import Port, device_of, open_port
from calrig.instruments.scan_signs import Sign, lines_of, recognise

READ_TIMEOUT_S = 0.02
REST_S = 0.15
"""What a device that is known by now has still to say."""
MOST_HEARD = 8192
SHORTEST_WORDS = 4

Kind = Literal["stage", "board", "unknown", "busy", "no permission"]
NOT_OPENED: dict[int, Kind] = {
    errno.EBUSY: "busy",
    errno.EWOULDBLOCK: "busy",
    errno.EACCES: "no permission",
    errno.EPERM: "no permission",
}


@dataclass(frozen=True, slots=True)
class Look:
    """A question, nothing to listen only, and how long its answer is waited for."""

    baudrate: int
    question: bytes
    listen_s: float


LOOKS = (
    Look(9600, b"", 2.6),  # a reset's silence, and the banners of sketches that then measure for long
    Look(38400, b"", 0.5),
    Look(115200, b"", 1.0),
    Look(115200, b"?", 0.4),
    Look(115200, b"ID\nID\n", 0.5),
    Look(115200, b"/\n", 0.3),
    Look(57600, b"1SL?\r\n1SL?\r\n", 0.5),
    Look(19200, b"VE?\rVE?\r", 0.5),
)
"""Who speaks unasked comes first: who waits to be asked still does so later."""
THEN = {"grbl": b"$I\n", "zaber": b"/get version\n", "smc100": b"1VE\r\n"}
"""What is asked of a device that is known by now: version numbers, which are only read."""


@dataclass(frozen=True, slots=True)
class Found:
    """A port and who answers there.

    Attributes:
        port: its name today.
        kind: `busy` and `no permission` are ports that did not open, `unknown` whatever no driver knows.
        driver: the driver's name in `calrig.toml`; None unless it is a stage or a board.
        identity: who it says it is, or what is known instead, in words.
        axis: the address it answered with; None where it has none.
        baudrate: where it was recognised, on a port that the system lists.
        usb_id: vendor and product of the USB adapter in hexadecimal, `1a86:7523`.
        usb_serial: the adapter's serial number; many have none.
        description: what the system calls it.
    """

    port: str
    kind: Kind
    driver: str | None
    identity: str
    axis: int | None
    baudrate: int | None
    usb_id: str | None
    usb_serial: str | None
    description: str


def scan(ports: Iterable[str] = (), *, ours: Iterable[str] = ()) -> list[Found]:
    """Looks at every port that the system lists, and at those given, side by side; some seven seconds.

    It moves nothing. Opening a port resets most boards, and a GRBL with them, whose angle calrig believes
    only after homing anyway. A port that is in use is not touched. Of SMC100 controllers in a chain the one
    at address 1 is asked, which is the one with the plug.

    Args:
        ports: more of them, such as those configured: `socket://host:port`, `usb:SERIAL`, names.
        ours: those that must stay free to be taken at any moment; listed as busy and not touched.

    Returns:
        One of each port, by name.
    """
    listed = {info.device: info for info in list_ports.comports()}
    names = sorted({*listed, *filter(None, map(_name_of, ports))})
    kept = set(filter(None, map(_name_of, ours)))
    if not names:
        return []
    with ThreadPoolExecutor(len(names)) as beside:
        return list(beside.map(lambda name: _look_at(name, listed.get(name), ours=name in kept), names))


def _name_of(port: str) -> str | None:
    try:
        device = device_of(port)
    except PortError:
        return None  # not plugged in: there is no port to look at
    return str(Path(device).resolve()) if Path(device).is_symlink() else device


def _look_at(name: str, info: ListPortInfo | None, *, ours: bool) -> Found:
    sign: Sign | None = None
    rate: int | None = None
    kind: Kind = "unknown"
    try:
        if ours:
            kind, words = "busy", "a rig of this service: left alone, so that it can be stopped at any moment"
        else:
            with closing(open_port(name, baudrate=LOOKS[0].baudrate, timeout_s=READ_TIMEOUT_S)) as port:
                sign, rate, words = _converse(port)
    except PortError as error:
        words = str(error)
        kind = NOT_OPENED.get(getattr(error.__cause__, "errno", None) or 0, "unknown")
    has_usb = info is not None and info.vid is not None
    return Found(
        port=name,
        kind=sign.kind if sign else kind,
        driver=sign.driver if sign else None,
        identity=sign.identity if sign else words,
        axis=sign.axis if sign else None,
        baudrate=rate if info else None,
        usb_id=f"{info.vid:04x}:{info.pid:04x}" if info and has_usb else None,
        usb_serial=(info.serial_number or None) if info else None,
        description=info.description if info else "",
    )


def _converse(port: Port) -> tuple[Sign | None, int | None, str]:
    """Who it is and at which baud rate, or what was heard instead, in words."""
    heard, rate = b"", LOOKS[0].baudrate
    anything, last_words = False, ""
    for look in LOOKS:
        if look.baudrate != rate:
            port.change_baudrate(look.baudrate)
            heard, rate = b"", look.baudrate
        if look.question:
            port.write(look.question)
        heard = _listen(port, heard, look.listen_s)
        if sign := recognise(heard):
            port.write(THEN.get(sign.driver, b""))
            return recognise(_listen(port, heard, REST_S, to_the_end=True)) or sign, rate, ""
        anything |= bool(heard)
        last_words = next(filter(_is_text, reversed(lines_of(heard))), last_words)
    if last_words:
        return None, None, f"says {last_words[:60]!r}, which no driver knows"
    if anything:
        return None, None, "what it sends is no text at any baud rate tried"
    return None, None, "nothing answers: is the device switched on?"


def _listen(port: Port, heard: bytes, listen_s: float, *, to_the_end: bool = False) -> bytes:
    """What was heard and what comes, until time is up or it tells who sent it."""
    deadline_s = port.clock.now_s() + listen_s
    while port.clock.now_s() < deadline_s:
        data = port.read_some()
        heard = (heard + data)[-MOST_HEARD:]
        if data and not to_the_end and recognise(heard):
            break
    return heard


def _is_text(line: str) -> bool:
    return len(line) >= SHORTEST_WORDS and line.isascii() and line.replace("\t", " ").isprintable()
