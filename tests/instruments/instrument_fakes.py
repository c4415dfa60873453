"""Tiny devices for these tests, written from stages.md and the contract, not from calrig's drivers."""

from __future__ import annotations

import contextlib
import json
import os
import struct
import tty

from virtual_time.clock import VirtualClock, VirtualEvent, VirtualThread
from virtual_time.world import SimWire

from calrig.instruments.types import Samples

CLOCK = VirtualClock()
"""The time of these devices. The test's thread takes part: time stands unless the test waits."""


_senders: list[tuple[VirtualEvent, VirtualThread]] = []


def end_senders() -> None:
    """Ends all that still send: what never ends by itself would have time go on for ever after the tests."""
    while _senders:
        enough, sender = _senders.pop()
        enough.set()
        sender.join()


class Wire:
    """The device's end of a pseudo-terminal; `path` is what the driver opens."""

    def __init__(self):
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._gone = False

    def recv(self) -> bytes:
        try:
            return os.read(self._master, 4096)
        except OSError:
            return b""

    def send(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._master, data)

    def vanish(self) -> None:
        """As if the cable were pulled: the other end sees a hang-up."""
        if not self._gone:
            self._gone = True
            os.close(self._slave)
            os.close(self._master)


class SimulatedEnd:
    """The device's end of a line within this process, in virtual time; `path` is what the driver opens.

    Attributes:
        heard: all that came.
    """

    interval_s = None

    def __init__(self, on_data=lambda data: None):
        self.heard = b""
        self._on_data = on_data
        self._line = SimWire(self, "fake", CLOCK)
        self.path = self._line.url
        self._line.start()

    def receive(self, data: bytes) -> bytes:
        self.heard += data
        self._on_data(data)
        return b""

    def emit(self) -> bytes:
        return b""

    def send(self, data: bytes) -> None:
        self._line.say(data)

    def keep_sending(self, pieces, every_s: float = 0.01):
        """Sends one piece after the other until they, the returned event or the test's end say: enough."""
        return self.play((every_s, piece) for piece in pieces)

    def play(self, timed):
        """The same of pairs: how long after the one before, and the piece."""
        enough = CLOCK.event()

        def send():
            for after_s, piece in timed:
                if enough.wait(after_s):
                    return
                self.send(piece)

        sender = CLOCK.thread(send, "sender")
        sender.start()
        _senders.append((enough, sender))
        return enough

    def vanish(self) -> None:
        """As if the cable were pulled: the other end sees a hang-up."""
        self._line.stop()


class LineDevice:
    """Hands each line received to `on_line` and remembers it with its arrival time."""

    def __init__(self, line_end: bytes):
        self.wire = SimulatedEnd(self._hear)
        self.received: list[str] = []
        self.arrived_s: list[float] = []
        self._line_end = line_end
        self._tail = b""

    @property
    def path(self) -> str:
        return self.wire.path

    def on_line(self, line: str) -> None:
        raise NotImplementedError

    def wait_for(self, line: str, times: int = 1) -> float:
        """When the line first arrived, waiting until it has come so many times."""
        CLOCK.until(lambda: self.received.count(line) >= times, line)
        return self.arrived_s[self.received.index(line)]

    def vanish(self) -> None:
        """As if the cable were pulled."""
        self.wire.vanish()

    def _hear(self, data: bytes) -> None:
        *lines, self._tail = (self._tail + data).split(self._line_end)
        for line in lines:
            self.arrived_s.append(CLOCK.now_s())
            self.received.append(line.decode())
            self.on_line(line.decode())


class FakeSmc100(LineDevice):
    """Answers like a controller at address 1; tests set what it says and replace answers by `say`."""

    def __init__(self):
        self.state = "0A"
        self.error_bits = "0000"
        self.position = "0"
        self.target = "0"
        self.velocity = "20"
        self.error = "@"
        self.refuse: dict[str, str] = {}
        self.lost: list[str] = []
        self.say: dict[str, list[bytes]] = {}
        self.unknown: set[str] = set()
        self.silent = False
        self.on_command = lambda _: None
        super().__init__(b"\r\n")

    def on_line(self, line: str) -> None:
        command = line.removeprefix("1")
        self.on_command(command)
        if self.silent:
            return
        if command in self.lost:
            self.lost.remove(command)
            return
        if self.say.get(command):
            self.wire.send(self.say[command].pop(0))
            return
        self.error = self.refuse.get(command[:2], self.error)
        if command == "OR":
            self.state = "1E"
        elif command == "MM1" and self.state.startswith("3"):
            self.state = "34"
        refused = self.error != "@"
        if command.startswith("PA") and command != "PA?" and not refused:
            self.target = command[2:]
        elif command.startswith("VA") and command != "VA?" and not refused:
            self.velocity = command[2:]
        answers = {
            "TS": self.error_bits + self.state,
            "TP": self.position,
            "TE": self.error,
            "VE": " SMC100CC 2.1.0",
            "PA?": self.target,
            "VA?": self.velocity,
            "AC?": "80",
            "SL?": "-120",
            "SR?": "130.5",
        }
        if command == "TE":
            self.error = "@"
        if command in answers and command not in self.unknown:
            self.wire.send(f"1{command.rstrip('?')}{answers[command]}\r\n".encode())


def crc16_bit_by_bit(data: bytes) -> int:
    """CRC-16/CCITT-FALSE as its definition reads."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def cobs_encode(data: bytes) -> bytes:
    out = b""
    for block in data.split(b"\0"):
        rest = block
        while len(rest) >= 254:
            out, rest = out + b"\xff" + rest[:254], rest[254:]
        out += bytes([len(rest) + 1]) + rest
    return out


def cobs_decode(frame: bytes) -> bytes | None:
    out, at = b"", 0
    while at < len(frame):
        code = frame[at]
        block = frame[at + 1 : at + code]
        if len(block) != code - 1:
            return None
        at += code
        out += block + (b"\0" if code < 255 and at < len(frame) else b"")
    return out


def packet(kind: int, payload: bytes) -> bytes:
    body = bytes([kind]) + payload
    return cobs_encode(body + struct.pack("<H", crc16_bit_by_bit(body))) + b"\0"


def sample(seq: int, t_us: int, registers: tuple[int, ...] = (0, 0, 16384, -512, 0, 0, 0)) -> bytes:
    return packet(2, struct.pack("<HI7h", seq % 65536, t_us % 2**32, *registers))


IDENTITY = {
    "firmware": "calrig 1.0",
    "serial": "AS-0042",
    "chip": "MPU-6050",
    "accel_range_g": 2,
    "gyro_range_dps": 250,
    "max_rate_hz": 1000,
}


class FakeBoard(LineDevice):
    """Answers commands; sends samples when a test calls `stream`."""

    def __init__(self):
        self.identity = dict(IDENTITY)
        self.ids_to_ignore = 0
        self.starts_to_ignore = 0
        self.refusal: str | None = None
        self.seq = 0
        self.t_us = 1000
        super().__init__(b"\n")

    def on_line(self, line: str) -> None:
        if line == "ID":
            self.ids_to_ignore -= 1
            if self.ids_to_ignore < 0:
                self.say_identity()
        elif line.startswith("START"):
            self.starts_to_ignore -= 1
            if self.refusal:
                self.wire.send(packet(3, self.refusal.encode()))
            elif self.starts_to_ignore < 0:
                self.seq = 0
                self.wire.send(packet(4, line.encode()))
        elif line == "STOP":
            self.wire.send(packet(4, line.encode()))
        else:
            self.wire.send(packet(3, f"unknown command: {line}".encode()))

    def say_identity(self) -> None:
        self.wire.send(packet(1, json.dumps(self.identity).encode()))

    def stream(self, n: int, period_us: int = 5000) -> None:
        """Sends n samples whose x counts up, so that none looks frozen."""
        for _ in range(n):
            self.wire.send(sample(self.seq, self.t_us, (self.seq % 1000 + 1, 0, 16384, -512, 0, 0, 0)))
            self.seq += 1
            self.t_us += period_us


TAKES = 100


def take_n(board, n):
    """The next samples of a board, n or a few more."""
    blocks = []
    for _ in range(TAKES):
        blocks.append(board.take(0.1))
        if sum(map(len, blocks)) >= n:
            return Samples.join(blocks)
    raise AssertionError((sum(map(len, blocks)), board.faults))
