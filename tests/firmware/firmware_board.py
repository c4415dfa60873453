"""The sketch on a simulated ATmega328P: a port to talk to, a sensor fed from any physics, and its faults."""

from __future__ import annotations

import itertools
import mmap
import os
import select
import socket
import struct
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import serial
from virtual_time.clock import VirtualClock

from calrig.instruments.boards.calrig.driver import RECORD
from calrig.instruments.boards.calrig.packets import (
    ACKNOWLEDGE,
    ERROR,
    FILTERED_SAMPLE,
    IDENTITY,
    SAMPLE,
    PacketDecoder,
)

Counts = Callable[[float], np.ndarray]
"""The sensor's seven registers at an instant, in seconds since the board was switched on."""
CLOCK = struct.Struct("d")
DEADLINE_S = 120.0
"""A busy machine is no failure."""
JITTER_US = 40
"""An instant may wait for another interrupt to end, no longer."""


class FirmwareBoard:
    """The simulated board, on from `with` to its end; `port` is its pseudo-terminal.

    At speed 0 it does not use that, and runs as far as `run_until` tells it.
    """

    def __init__(self, harness: Path, elf: Path, counts: Counts, speed: float = 1.0) -> None:
        self._counts = counts
        self._physics, theirs = socket.socketpair()
        clock = os.memfd_create("clock of a simulated board")
        os.ftruncate(clock, CLOCK.size)
        self._clock = mmap.mmap(clock, CLOCK.size)
        with theirs, os.fdopen(clock, "rb"):
            self._process = subprocess.Popen(
                [harness, elf, str(theirs.fileno()), str(clock), str(speed)],
                pass_fds=[theirs.fileno(), clock],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        self._thread = threading.Thread(
            target=self._measure, name="physics of the firmware's sensor", daemon=True
        )
        self._thread.start()
        self.port = self._said()

    def clock(self) -> float:
        """The board's own time in seconds; the sensor was never asked for anything later."""
        return float(CLOCK.unpack(self._clock)[0])

    def tell(self, what: str) -> float:
        """Breaks or mends something, such as `silent 1`; gives the board's time when it took effect."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{what}\n")
        self._process.stdin.flush()
        return float(self._said())

    def run_until(self, time_s: float, heard: bytes) -> bytes:
        """Goes on to that time of its own; gives what it sent, and hears `heard` from there on."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"until {time_s:.6f} {heard.hex()}\n")
        self._process.stdin.flush()
        return bytes.fromhex(self._line())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(DEADLINE_S)
        finally:
            self._process.kill()
        self._process.stdout.close()
        self._thread.join()
        self._physics.close()
        self._clock.close()

    def _said(self) -> str:
        stdout = self._process.stdout
        assert stdout is not None
        assert select.select([stdout], [], [], DEADLINE_S)[0], "the harness says nothing"
        return self._line()

    def _line(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, "the harness has ended"
        return line.strip()

    def _measure(self) -> None:
        while asked := self._physics.recv(CLOCK.size):
            counts = self._counts(*CLOCK.unpack(asked))
            self._physics.sendall(np.asarray(counts, "<i2").tobytes())


class InStep:
    """The board as a device of `sim://`, in virtual time: no busy machine makes it late."""

    interval_s = 0.005

    def __init__(self, board: FirmwareBoard, clock: VirtualClock) -> None:
        self._board = board
        self._now_s = clock.now_s
        self._began_s = clock.now_s()

    def receive(self, data: bytes) -> bytes:
        """Takes what came; returns what it has sent up to now."""
        return self._board.run_until(self._now_s() - self._began_s, data)

    def emit(self) -> bytes:
        """What it has sent up to now."""
        return self.receive(b"")


class Line:
    """A host of few words: sends lines, and keeps every packet the board sends."""

    def __init__(self, port: str) -> None:
        self._wire = serial.Serial(port, 115200, timeout=0.02)
        self._decoder = PacketDecoder()
        self._packets: list[bytes] = []

    def close(self) -> None:
        self._wire.close()

    @property
    def damage(self) -> dict[str, int]:
        """What came and was no packet."""
        return dict(self._decoder.faults)

    def send(self, line: str) -> None:
        self._wire.write(f"{line}\n".encode())

    def packets(self, until: Callable[[list[bytes]], object], what: str) -> list[bytes]:
        """The packets that came since the last call, up to and with the first that makes `until` true."""
        taken: list[bytes] = []
        deadline = threading.Event()
        timer = threading.Timer(DEADLINE_S, deadline.set)
        timer.start()
        try:
            while not deadline.is_set():
                while self._packets:
                    taken.append(self._packets.pop(0))
                    if until(taken):
                        return taken
                self._packets += self._decoder.feed(self._wire.read(max(1, self._wire.in_waiting)))
        finally:
            timer.cancel()
        raise AssertionError(f"no {what} within {DEADLINE_S:g} s; the last packets: {taken[-3:]}")

    def next(self, *kinds: int) -> tuple[int, str]:
        """The next packet of these types, as type and text; samples and others before it are passed over."""
        packet = self.packets(lambda taken: taken[-1][0] in kinds, f"packet of type {kinds}")[-1]
        return packet[0], packet[1:].decode()

    def ask(self, command: str) -> tuple[int, str]:
        """Sends a line and gives its answer, as type and text."""
        self.send(command)
        return self.next(IDENTITY, ERROR, ACKNOWLEDGE)

    def start(self, rate_hz: int) -> None:
        """Begins to stream."""
        assert self.ask(f"START {rate_hz}") == (ACKNOWLEDGE, f"START {rate_hz}")

    def samples(self, n: int) -> np.ndarray:
        """The next n samples as records, with `elevation_cdeg` where they are filtered."""
        left = itertools.count(n, -1)
        return _records(self.packets(lambda taken: _is_sample(taken[-1]) and next(left) == 1, f"{n} samples"))


def assert_on_time(samples: np.ndarray, rate_hz: int) -> None:
    """Each instant is where its seq says, without drift."""
    elapsed_us = samples["t_us"].astype(np.int64) - int(samples["t_us"][0])
    nominal_us = (samples["seq"].astype(np.int64) - int(samples["seq"][0])) * 1e6 / rate_hz
    assert np.abs(elapsed_us - nominal_us).max() < JITTER_US


def _records(packets: list[bytes]) -> np.ndarray:
    chosen = [packet for packet in packets if _is_sample(packet)]
    kind = chosen[0][0]
    dtype = RECORD if kind == SAMPLE else np.dtype([*RECORD.descr, ("elevation_cdeg", "<i2")])
    return np.frombuffer(b"".join(packet for packet in chosen if packet[0] == kind), dtype)


def _is_sample(packet: bytes) -> bool:
    return packet[0] in (SAMPLE, FILTERED_SAMPLE)
