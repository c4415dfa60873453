"""A board with a public Arduino sketch that prints text: no clock, no commands, real time."""

import math
import random
from collections import deque
from collections.abc import Callable

import numpy as np

from calrig.simulator.bench import Bench
from calrig.simulator.config import BoardFault, BoardOptions, ImuOptions
from calrig.simulator.imu import FULL_SCALE_COUNTS, TEMPERATURE_COUNTS_PER_C, TEMPERATURE_OFFSET_C
from calrig.simulator.sketches import A_CHARACTER, Found, Motion, Sketch

BOOT_S = 0.8
"""The boot loader's silence after a reset."""
BITS_A_BYTE = 10
PRINTED_BYTES = 64
"""The Arduino's buffer: a sketch that prints more waits until no more than this is left to send."""
RESET_EVERY_S = 5.0
FAULT_EVERY = 10
LATE_S = 1.0
"""So much behind, it leaves out what it did not print: this process was not scheduled."""


class SketchBoard:
    """A board with one sensor that prints from power-up on, fed with bytes that most sketches ignore.

    What it prints leaves byte by byte at its baud rate; a reset loses what is still waiting to be sent.

    Attributes:
        fault: breaks it on purpose, at any time: `silent`, `garbage` (as at a wrong baud rate), `zeros` (no
            sensor on the bus), `clone` (another WHO_AM_I, seen at a start), `frozen` (lines go on, their
            values do not change), `half_lines` (every tenth), `reset` (once, and again every 5 s) or None.
    """

    interval_s = 0.004
    most_waiting_bytes = 256
    """A UART's buffer: what stays unread is lost, in the middle of a line."""

    def __init__(
        self,
        sketch: Callable[[], Sketch],
        options: BoardOptions,
        imu: ImuOptions,
        bench: Bench,
        now: Callable[[], float],
    ) -> None:
        self.fault: BoardFault | None = options.fault
        self._sketches = sketch
        self._next_s: float
        self._sketch: Sketch
        self._imu = imu
        self._bench = bench
        self._now = now
        self._noise = random.Random(0)  # noqa: S311 (garbage, not a secret)
        self._reset(now())
        self.driver = self._sketch.driver
        self._byte_s = BITS_A_BYTE / self._sketch.baudrate

    def opened(self) -> None:
        """Nothing: it goes on."""

    def receive(self, data: bytes) -> bytes:
        """Takes what came over the wire; it matters to a sketch that waits for a character."""
        if data and self._next_s == A_CHARACTER:
            self._next_s = self._now()
        return b""

    def emit(self) -> bytes:
        """What it has sent up to now."""
        now_s = self._now()
        if self.fault == "reset" and now_s - self._reset_s > RESET_EVERY_S:
            self._reset(now_s)
        if now_s - self._next_s > LATE_S:
            self._next_s = now_s
        while self._next_s <= now_s:
            self._step()
        return self._spoken(self._sent(now_s).encode("ascii"))

    def _reset(self, at_s: float) -> None:
        self._reset_s, self._next_s = at_s, at_s + BOOT_S
        self._sketch = self._sketches()
        self._setup = self._sketch.setup(self._found, lambda: self._read(1)[0])
        self._unsent: deque[tuple[float, str]] = deque()  # each with the instant at which it begins to leave
        self._free_s = self._next_s  # when all that was printed has left
        self._count, self._printed = 0, ""

    def _step(self) -> None:
        """One piece of its start, or a record."""
        piece, pause_s = next(self._setup, ("", -1.0))
        if pause_s < 0:
            piece, pause_s = self._record(), self._sketch.pause_s
        starts_s = max(self._free_s, self._next_s)
        self._free_s = starts_s + len(piece) * self._byte_s
        self._unsent.append((starts_s, piece))
        self._next_s = max(self._next_s, self._free_s - PRINTED_BYTES * self._byte_s) + pause_s

    def _record(self) -> str:
        *unprinted, motion = self._read(self._sketch.reads)
        self._next_s = motion.at_s
        for reading in unprinted:
            self._sketch.follow(reading)
        record = self._sketch.record(motion)
        if self.fault != "frozen" or not self._printed:
            self._printed = record
        self._count += 1
        return self._damaged(self._printed)

    @property
    def _found(self) -> Found:
        return Found(sensor=self.fault != "zeros", genuine=self.fault != "clone")

    def _read(self, n: int) -> list[Motion]:
        """What the chip measures from now on, `pause_s` apart."""
        pause_s = self._sketch.pause_s
        times_s = self._next_s + np.arange(n, dtype=np.float64) * pause_s
        if self.fault == "zeros":
            return [Motion((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, float(at_s)) for at_s in times_s]
        with self._bench.lock:
            counts = self._bench.counts(times_s, 1 / max(pause_s, 0.01))
        return [self._motion(float(at_s), row) for at_s, row in zip(times_s, counts.tolist(), strict=True)]

    def _motion(self, at_s: float, counts: list[int]) -> Motion:
        ax, ay, az = (c * self._imu.accel_range_g / FULL_SCALE_COUNTS for c in counts[:3])
        gx, gy, gz = (c * self._imu.gyro_range_dps / FULL_SCALE_COUNTS for c in counts[4:])
        die_c = counts[3] / TEMPERATURE_COUNTS_PER_C + TEMPERATURE_OFFSET_C
        return Motion((ax, ay, az), (gx, gy, gz), die_c, at_s)

    def _damaged(self, line: str) -> str:
        halved = self.fault == "half_lines" and self._count % FAULT_EVERY == 0
        return line[: len(line) // 2] if halved else line

    def _sent(self, until_s: float) -> str:
        sent = ""
        while self._unsent:
            starts_s, text = self._unsent[0]
            n = max(0, math.floor((until_s - starts_s) / self._byte_s + 1e-6))
            sent += text[:n]
            if n < len(text):
                self._unsent[0] = starts_s + n * self._byte_s, text[n:]
                break
            self._unsent.popleft()
        return sent

    def _spoken(self, said: bytes) -> bytes:
        if self.fault == "silent":
            return b""
        return self._noise.randbytes(len(said)) if self.fault == "garbage" else said
