"""Boards in a process of their own that send prepared packets at the real pace: they cost next to nothing.

`python prepared_boards.py N RATE_HZ SECONDS` prints the N ports as JSON and ends when its input does.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

sys.path.insert(0, str(Path(__file__).parent.parent))

from packet_stream import MPU, sample_blocks

from calrig.simulator.board import ACKNOWLEDGE, BLOCK_INTERVAL_S, IDENTITY, packet
from calrig.simulator.wire import Wire, open_port


class PreparedBoard:
    """Answers `ID`, `START` and `STOP`; what it sends after `START` is there already."""

    def __init__(self, packets: list[bytes], rate_hz: int):
        self._packets, self._rate_hz = packets, rate_hz
        self._start_s: float | None = None
        self._sent = 0

    @property
    def interval_s(self) -> float | None:
        return None if self._start_s is None else BLOCK_INTERVAL_S

    def receive(self, data: bytes) -> bytes:
        return b"".join(self._answer(line) for line in data.decode().splitlines())

    def _answer(self, line: str) -> bytes:
        if line == "ID":
            said = {"firmware": MPU.firmware, "serial": MPU.serial, "chip": MPU.chip}
            ranges = {"accel_range_g": MPU.accel_range_g, "gyro_range_dps": MPU.gyro_range_dps}
            return packet(IDENTITY, json.dumps(said | ranges).encode())
        self._start_s, self._sent = (time.monotonic() if line.startswith("START") else None), 0
        return packet(ACKNOWLEDGE, line.encode())

    def emit(self) -> bytes:
        if self._start_s is None:
            return b""
        first = self._sent
        self._sent = int((time.monotonic() - self._start_s) * self._rate_hz)
        return b"".join(self._packets[first : self._sent])


@contextmanager
def prepared_boards(n: int, rate_hz: int, seconds: float) -> Iterator[tuple[psutil.Process, list[str]]]:
    """The process and the ports of its boards, which have samples for so long."""
    command = [sys.executable, __file__, str(n), str(rate_hz), str(seconds)]
    process = psutil.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        yield process, json.loads(process.stdout.readline())
    finally:
        process.communicate(timeout=10)


def _main(n: int, rate_hz: int, seconds: float) -> None:
    packets = [p for block in sample_blocks(int(seconds * rate_hz), rate_hz) for p in block]
    wires = [Wire(PreparedBoard(packets, rate_hz), open_port("pty"), f"board {k}") for k in range(n)]
    for wire in wires:
        wire.start()
    sys.stdout.write(json.dumps([wire.url for wire in wires]) + "\n")
    sys.stdout.flush()
    sys.stdin.read()
    for wire in wires:
        wire.stop()


if __name__ == "__main__":
    _main(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]))
