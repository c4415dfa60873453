"""calrig's own board (CONTRACT 3.1): commands in, packets out, samples paced by simulated time.

A packet is type, payload, CRC-16/CCITT-FALSE, all encoded by COBS, and one zero byte.
"""

import binascii
import json
import random
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from cobs import cobs  # type: ignore[import-untyped]

from calrig.simulator.bench import Bench
from calrig.simulator.config import BoardFault, BoardOptions, ImuOptions
from calrig.simulator.imu import Counts
from calrig.simulator.trajectory import FloatArray
from calrig.simulator.wire import MOST_WAITING_BYTES

IDENTITY, SAMPLE, ERROR, ACKNOWLEDGE = 0x01, 0x02, 0x03, 0x04
MICROSECONDS = 1e6
SEQUENCE_LENGTH = 1 << 16
CLOCK_LENGTH_US = 1 << 32

_SAMPLE_LAYOUT = np.dtype([("type", "u1"), ("seq", "<u2"), ("t_us", "<u4"), ("counts", "<i2", (7,))])


def packet(kind: int, payload: bytes) -> bytes:
    """One packet as it goes over the wire."""
    return _framed(bytes([kind]) + payload)


def sample_packets(first_seq: int, times_s: FloatArray, counts: Counts) -> list[bytes]:
    """One packet a sample.

    Args:
        first_seq: number of the first sample since `START`; wraps at 16 bits on the wire.
        times_s: (n,) the board's clock; wraps at 32 bits of microseconds.
        counts: (n, 7) ax ay az temp gx gy gz.
    """
    rows = np.empty(len(times_s), dtype=_SAMPLE_LAYOUT)
    rows["type"] = SAMPLE
    rows["seq"] = (first_seq + np.arange(len(times_s))) % SEQUENCE_LENGTH
    rows["t_us"] = np.rint(times_s * MICROSECONDS).astype(np.int64) % CLOCK_LENGTH_US
    rows["counts"] = counts
    block, size = rows.tobytes(), _SAMPLE_LAYOUT.itemsize
    return [_framed(block[start : start + size]) for start in range(0, len(block), size)]


def _framed(body: bytes) -> bytes:
    crc = binascii.crc_hqx(body, 0xFFFF)  # polynomial 0x1021: CRC-16/CCITT-FALSE
    encoded: bytes = cobs.encode(body + crc.to_bytes(2, "little"))
    return encoded + b"\0"


BLOCK_INTERVAL_S = 0.03
"""Wall time between blocks: thirty a second look continuous; each wakes a processor gone cold."""
MOST_SAMPLES_A_BLOCK = 2000
"""No block is larger than what waits for a slow reader, or a busy machine would lose it whole."""
LONGEST_COMMAND = 128
LONGEST_SERIAL = 64
FAULT_EVERY = 10


@dataclass
class _Stream:
    start_s: float
    rate_hz: int
    sent: int = 0


class Board:
    """A board with one sensor, fed with bytes, answering in bytes and streaming on command.

    Attributes:
        fault: breaks it on purpose, at any time: `silent`, `garbage`, `corrupt` (every tenth packet's bytes),
            `gaps` (every tenth packet lost), `frozen` (registers that no longer change) or None.
    """

    driver = "calrig"
    most_waiting_bytes = MOST_WAITING_BYTES

    def __init__(
        self, options: BoardOptions, imu: ImuOptions, bench: Bench, now: Callable[[], float]
    ) -> None:
        self.fault: BoardFault | None = options.fault
        self._options = options
        self._imu = imu
        self._serial = options.serial
        self._bench = bench
        self._now = now
        self._tail = b""
        self._stream: _Stream | None = None
        self._unsaid = [self._identity()]
        self._last: Counts | None = None
        self._heard: list[str] = []
        self._is_reset = self._is_behind = False
        self._began_s = 0.0  # its clock counts from here
        self._clock_rate = 1.0 + 1e-6 * options.clock_error_ppm
        self._noise = random.Random(0)  # noqa: S311 (garbage, not a secret)

    @property
    def interval_s(self) -> float | None:
        """Wall time until it may have more to say; None while it only listens."""
        return BLOCK_INTERVAL_S if self._stream or self._unsaid else None

    def opened(self) -> None:
        """Its port was opened, which resets it where it boots."""
        if self._options.boot_s:
            self.reset()

    def reset(self) -> None:
        """Reset it at the next block: it sends its identity, counts time from there, and stops streaming."""
        self._is_reset = True

    def receive(self, data: bytes) -> bytes:
        """Takes what came over the wire; returns what goes back, after the samples that were due."""
        if self._is_booting():
            return b""
        *lines, self._tail = (self._tail + data).split(b"\n")
        heard = (line.removesuffix(b"\r").decode("utf-8", "replace") for line in lines)
        self._heard += filter(None, heard)
        said = self._answers()
        if len(self._tail) > LONGEST_COMMAND:
            self._tail = b""
            said.append(packet(ERROR, b"command too long"))
        return self._spoken(said)

    def emit(self) -> bytes:
        """The samples of all instants up to now that were not sent yet."""
        if self._is_booting():
            return b""
        said = self._answers()
        return self._spoken(said if self._heard else said + self._due_samples())

    def _answers(self) -> list[bytes]:
        """Answers, each after the samples due before it, with which a busy machine may have to catch up."""
        said, self._unsaid = self._unsaid, []
        while self._heard:
            said += self._due_samples()
            if self._is_behind:
                break
            said.append(self._answer(self._heard.pop(0)))
        return said

    def _is_booting(self) -> bool:
        """Whether it takes no commands; it begins again if it was reset."""
        if self._is_reset:
            self._is_reset, self._is_behind, self._stream, self._tail = False, False, None, b""
            self._heard.clear()
            self._began_s, self._unsaid = self._now() + self._options.boot_s, [self._identity()]
        return self._now() < self._began_s

    def _answer(self, command: str) -> bytes:
        word, _, argument = command.partition(" ")
        if command == "ID":
            return self._identity()
        if command == "STOP":
            self._stream = None
        elif word == "START" and (not argument or re.fullmatch(r"\d{1,5}", argument)):
            rate_hz = int(argument or self._options.default_rate_hz)
            if not 1 <= rate_hz <= self._options.max_rate_hz:
                return _error(f"{command}: the rate must be 1 to {self._options.max_rate_hz} Hz")
            self._stream = _Stream(self._now(), rate_hz)
        elif word == "SERIAL" and len(argument.encode()) <= LONGEST_SERIAL:
            self._serial = argument
        else:
            return _error(f"unknown command: {command[:LONGEST_COMMAND]}")
        return packet(ACKNOWLEDGE, command.encode())

    def _identity(self) -> bytes:
        identity = {
            "firmware": self._options.firmware,
            "serial": self._serial,
            "chip": "MPU-6050",
            "accel_range_g": self._imu.accel_range_g,
            "gyro_range_dps": self._imu.gyro_range_dps,
            "max_rate_hz": self._options.max_rate_hz,
        }
        text = json.dumps(identity, ensure_ascii=False, separators=(",", ":"))
        return packet(IDENTITY, text.encode())

    def _due_samples(self) -> list[bytes]:
        stream = self._stream
        self._is_behind = False
        if stream is None:
            return []
        with self._bench.lock:
            rate_hz = stream.rate_hz * self._clock_rate
            due = int((self._now() - stream.start_s) * rate_hz) + 1
            count = min(due - stream.sent, MOST_SAMPLES_A_BLOCK)
            self._is_behind = count < due - stream.sent
            if count <= 0:
                return []
            times_s = stream.start_s + np.arange(stream.sent, stream.sent + count) / rate_hz
            counts = self._bench.counts(times_s, stream.rate_hz)
        if self.fault == "frozen" and self._last is not None:
            counts = np.repeat(self._last, count, axis=0)
        self._last = counts[-1:]
        packets = sample_packets(stream.sent, (times_s - self._began_s) * self._clock_rate, counts)
        if self.fault in {"corrupt", "gaps"}:
            packets = [self._damaged(p, stream.sent + k) for k, p in enumerate(packets)]
        stream.sent += count
        return packets

    def _damaged(self, whole: bytes, number: int) -> bytes:
        if number % FAULT_EVERY != FAULT_EVERY - 1:
            return whole
        return b"" if self.fault == "gaps" else whole[:8] + bytes([whole[8] ^ 0x80]) + whole[9:]

    def _spoken(self, packets: list[bytes]) -> bytes:
        said = b"".join(packets)
        if self.fault == "silent":
            return b""
        return self._noise.randbytes(len(said)) if self.fault == "garbage" else said


def _error(text: str) -> bytes:
    return packet(ERROR, text.encode())
