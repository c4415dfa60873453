"""Tiny devices for these tests, written from stages.md and the contract, knowing nothing of calrig."""

from __future__ import annotations

import contextlib
import json
import os
import select
import struct
import threading
import time
import tty

DEADLINE_S = 5.0


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

    def send_and_see_it_arrive(self, data: bytes) -> None:
        """Returns once the driver's end has something to read: a terminal hands bytes on in its own time."""
        self.send(data)
        assert select.select([self._slave], [], [], DEADLINE_S)[0]

    def vanish(self) -> None:
        """As if the cable were pulled: the other end sees a hang-up."""
        if not self._gone:
            self._gone = True
            os.close(self._slave)
            os.close(self._master)


class LineDevice:
    """Hands each line received to `on_line` and remembers it with its arrival time."""

    def __init__(self, line_end: bytes):
        self.wire = Wire()
        self.received: list[str] = []
        self.answered: list[str] = []
        self.arrived_s: list[float] = []
        self._line_end = line_end
        self._news = threading.Condition()
        self._leave_r, self._leave_w = os.pipe()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def path(self) -> str:
        return self.wire.path

    def on_line(self, line: str) -> None:
        raise NotImplementedError

    def wait_for(self, line: str, times: int = 1) -> float:
        """When the line first arrived, waiting until it has come, and been answered, so many times."""
        with self._news:
            came = self._news.wait_for(lambda: self.answered.count(line) >= times, DEADLINE_S)
            assert came, (line, self.received)
            return self.arrived_s[self.received.index(line)]

    def vanish(self) -> None:
        """As if the cable were pulled."""
        if self._thread.is_alive():
            os.write(self._leave_w, b"x")
            self._thread.join()
            self.wire.vanish()
            os.close(self._leave_r)
            os.close(self._leave_w)

    def _serve(self) -> None:
        tail = b""
        while True:
            ready, _, _ = select.select([self.wire._master, self._leave_r], [], [])
            if self._leave_r in ready:
                return
            tail += self.wire.recv()
            *lines, tail = tail.split(self._line_end)
            for line in lines:
                self.arrived_s.append(time.monotonic())
                self.received.append(line.decode())
                self.on_line(line.decode())
                with self._news:
                    self.answered.append(line.decode())
                    self._news.notify_all()


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
