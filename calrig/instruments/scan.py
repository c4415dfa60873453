"""Identification of the devices on the ports, without a byte that could move anything (the rules: `device`).

Each port is opened once, which resets most Arduinos, and listened to before any query is sent. `stanza` gives
the result as text for `calrig.toml`.
"""

import errno
import json
from collections.abc import Callable, Container, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Literal

from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from calrig.instruments.device import AnyDevice, Probe, Recognised, lines_of, recognise
from calrig.instruments.drivers import BOARDS, known_devices
from calrig.instruments.errors import PortError
from calrig.instruments.ports import USB, Port, device_of, open_port

READ_TIMEOUT_S = 0.02
RESET_S = 2.0
"""So long most boards are silent once their port was opened."""
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

    It moves nothing. Opening a port resets most boards, and a GRBL with them, whose angle calrig trusts
    only after homing anyway. A port that is in use is not touched. Of SMC100 controllers in a chain the one
    at address 1 is asked, which is the one with the plug.

    `ports` are more of them, such as those configured: `socket://host:port`, `usb:SERIAL`, names; `ours` must
    stay free to be taken at any moment, are listed as busy and not touched.

    Returns:
        One of each port, by name.
    """
    listed = {info.device: info for info in list_ports.comports()}
    names = sorted({*listed, *filter(None, map(_name_of, ports))})
    kept = set(filter(None, map(_name_of, ours)))
    if not names:
        return []
    devices = known_devices()
    with ThreadPoolExecutor(len(names)) as beside:
        return list(
            beside.map(lambda name: _look_at(name, listed.get(name), devices, ours=name in kept), names)
        )


def probes(devices: Iterable[AnyDevice]) -> list[Probe]:
    """What is tried on a port, in order: it is listened to at all rates before anything is asked.

    Who speaks unasked comes first, for who waits to be asked still does so later; slow boards before fast
    ones, for they tell who they are after a reset and then measure for long. Queries begin at the rate
    listened at last, the quickest to answer first.
    """
    wanted = {probe for device in devices for probe in device.probes}
    longest = {(p.baudrate, p.query): p for p in sorted(wanted, key=lambda p: p.listen_s)}.values()
    listens = sorted((p for p in longest if not p.query), key=lambda p: p.baudrate)
    asks = sorted((p for p in longest if p.query), key=lambda p: (-p.baudrate, p.listen_s, p.query))
    listens[:1] = [replace(first, listen_s=RESET_S + first.listen_s) for first in listens[:1]]
    return listens + asks


def _name_of(port: str) -> str | None:
    try:
        device = device_of(port)
    except PortError:
        return None  # not plugged in: there is no port to look at
    return str(Path(device).resolve()) if Path(device).is_symlink() else device


def _look_at(name: str, info: ListPortInfo | None, devices: Sequence[AnyDevice], *, ours: bool) -> Found:
    found: Recognised | None = None
    rate: int | None = None
    kind: Kind = "unknown"
    try:
        if ours:
            kind, words = "busy", "a rig of this service: left alone, so that it can be stopped at any moment"
        else:
            rate = probes(devices)[0].baudrate
            with closing(open_port(name, baudrate=rate, timeout_s=READ_TIMEOUT_S)) as port:
                found, rate, words = converse(port, devices)
    except PortError as error:
        words = str(error)
        kind = NOT_OPENED.get(getattr(error.__cause__, "errno", None) or 0, "unknown")
    has_usb = info is not None and info.vid is not None
    return Found(
        port=name,
        kind=found.device.kind if found else kind,
        driver=found.device.driver if found else None,
        identity=found.identity.words if found else words,
        axis=found.identity.axis if found else None,
        baudrate=rate if info and found else None,
        usb_id=f"{info.vid:04x}:{info.pid:04x}" if info and has_usb else None,
        usb_serial=(info.serial_number or None) if info else None,
        description=info.description if info else "",
    )


def converse(port: Port, devices: Sequence[AnyDevice]) -> tuple[Recognised | None, int, str]:
    """Who it is and at which baud rate, or what was heard instead, in words.

    `port` is open at the rate of the first of `probes`; `devices` are whom it may be.

    Raises:
        PortError: the port went away.
    """
    tries = probes(devices)
    heard, rate = b"", tries[0].baudrate
    anything, last_words = False, ""
    for probe in tries:
        if probe.baudrate != rate:
            port.change_baudrate(probe.baudrate)
            heard, rate = b"", probe.baudrate
        if probe.query:
            port.write(probe.query)
        heard = _listen(port, heard, probe.listen_s, lambda heard: bool(recognise(heard, devices)))
        if found := recognise(heard, devices):
            if found.device.version_query:
                port.write(found.device.version_query)
            heard = _listen(port, heard, REST_S, lambda _: False)
            return recognise(heard, devices) or found, rate, ""
        anything |= bool(heard)
        last_words = next(filter(_is_text, reversed(lines_of(heard))), last_words)
    if last_words:
        return None, rate, f"says {last_words[:60]!r}, which no driver knows"
    if anything:
        return None, rate, "what it sends is no text at any baud rate tried"
    return None, rate, "nothing answers: is the device switched on?"


def _listen(port: Port, heard: bytes, listen_s: float, enough: Callable[[bytes], bool]) -> bytes:
    """What was heard and what comes, until time is up or that is enough."""
    end_s = port.clock.now_s() + listen_s
    while port.clock.now_s() < end_s:
        data = port.read_some()
        heard = (heard + data)[-MOST_HEARD:]
        if data and enough(heard):
            break
    return heard


def _is_text(line: str) -> bool:
    return len(line) >= SHORTEST_WORDS and line.isascii() and line.replace("\t", " ").isprintable()


CHECK = "# before the first run: check limits_deg, and on the stage itself zero_deg and sign"
NO_BOARD = '# imu = { driver = "calrig", port = "…" }   # no board was found'


def stanza(found: Sequence[Found], taken: Container[str] = ()) -> str:
    """A `[[rig]]` for each stage found, ready to be pasted; "" where there is none.

    One stage and one board are taken for a pair. Otherwise each board stands in each rig as a comment, of
    which one is to be chosen.

    `found` is what `scan` gave; `taken` are names that rigs already have.
    """
    stages = [one for one in found if one.kind == "stage"]
    boards = [_imu(one, found) for one in found if one.kind == "board"]
    if len(stages) > 1 or len(boards) > 1:
        boards = [f"# {line}   # its board? then take the # away" for line in boards]
    names = (name for n in count(1) if (name := f"bench-{n}") not in taken)
    return "\n".join(
        "\n".join(
            [
                "[[rig]]",
                f'name = "{next(names)}"',
                "limits_deg = [-90.0, 90.0]",
                _stage(stage, found),
                *(boards or [NO_BOARD]),
                CHECK,
                "",
            ]
        )
        for stage in stages
    )


def _stage(stage: Found, all_found: Iterable[Found]) -> str:
    axis = 1 if stage.axis is None else stage.axis
    turn = f"axis = {axis}, zero_deg = 0.0, sign = 1, ratio = 1.0"
    return f"stage = {{ {_device(stage, all_found)}, {turn} }}"


def _imu(board: Found, all_found: Iterable[Found]) -> str:
    device = BOARDS.get(board.driver or "")
    usual = (None, device and device.baudrate)
    rate = "" if board.baudrate in usual else f", baudrate = {board.baudrate}"
    return f"imu = {{ {_device(board, all_found)}{rate} }}"


def _device(one: Found, all_found: Iterable[Found]) -> str:
    sharing = [other for other in all_found if other.usb_serial == one.usb_serial]
    bound = one.usb_serial is not None and len(sharing) == 1  # some adapters all have the same number
    port = f"{USB}{one.usb_serial}" if bound else one.port
    return f'driver = "{one.driver}", port = {json.dumps(port, ensure_ascii=False)}'
