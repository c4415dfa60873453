"""A board that runs somebody's sketch and prints text: no clock, no commands, real time."""

from __future__ import annotations

import random
from collections.abc import Callable

import numpy as np

from calrig.simulator.bench import Bench
from calrig.simulator.config import BoardFault, BoardOptions, ImuOptions
from calrig.simulator.imu import FULL_SCALE_COUNTS, TEMPERATURE_COUNTS_PER_C, TEMPERATURE_OFFSET_C
from calrig.simulator.sketch import Found, Motion, Sketch

BOOT_S = 0.8
"""The boot loader's silence after a reset."""
LOOP_S = 0.001
"""Reading the sensor and printing into the buffer."""
BITS_A_BYTE = 10
RESET_EVERY_S = 5.0
FAULT_EVERY = 10
LATE_S = 1.0
"""So much behind, it leaves out what it did not print: nobody ran this process."""
AT_REST = Motion((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)


class SketchBoard:
    """A board with one sensor that prints from power-up on, fed with bytes that most sketches ignore.

    Attributes:
        fault: breaks it on purpose, at any time: `silent`, `garbage` (as at a wrong baud rate), `zeros` (no
            sensor on the bus), `clone` (another WHO_AM_I, seen at a start), `frozen` (lines go on, their
            values do not change), `half_lines` (every tenth), `reset` (once, and again every 5 s) or None.
    """

    interval_s = 0.004
    most_waiting_bytes = 256
    """A UART's buffer: what nobody reads is lost, in the middle of a line."""

    def __init__(
        self, sketch: Sketch, options: BoardOptions, imu: ImuOptions, bench: Bench, now: Callable[[], float]
    ) -> None:
        self.fault: BoardFault | None = options.fault
        self.driver = sketch.driver
        self._sketch = sketch
        self._imu = imu
        self._bench = bench
        self._now = now
        self._noise = random.Random(0)  # noqa: S311 (garbage, not a secret)
        self._step: Callable[[], str] | None
        self._waits: bool
        self._reset(now())

    def opened(self) -> None:
        """Nothing: it goes on."""

    def receive(self, data: bytes) -> bytes:
        """Takes what came over the wire; it matters to a sketch that waits for a character."""
        if data and self._waits:
            self._waits, self._step, self._next_s = False, self._set_up, self._now()
        return b""

    def emit(self) -> bytes:
        """What it has printed up to now."""
        now_s = self._now()
        if self.fault == "reset" and now_s - self._reset_s > RESET_EVERY_S:
            self._reset(now_s)
        if now_s - self._next_s > LATE_S:
            self._next_s = now_s
        said = ""
        while self._step is not None and self._next_s <= now_s:
            said += self._step()
        return self._spoken(said.encode("ascii"))

    def _reset(self, at_s: float) -> None:
        self._reset_s, self._next_s = at_s, at_s + BOOT_S
        self._waits, self._step = False, self._begin
        self._count, self._printed = 0, ""

    def _begin(self) -> str:
        prompt = self._sketch.prompt(self._found)
        if not prompt:
            return self._set_up()
        self._waits, self._step = True, None
        return prompt

    def _set_up(self) -> str:
        said, goes_on = self._sketch.setup(self._found, self._motion(self._next_s))
        self._next_s += self._sketch.setup_s + self._lasts_s(said)
        self._last_s = self._next_s
        self._step = self._print if goes_on else None
        return said

    def _print(self) -> str:
        dt_s, self._last_s = self._next_s - self._last_s, self._next_s
        if self.fault != "frozen" or not self._printed:
            self._printed = self._sketch.record(self._motion(self._next_s), dt_s)
        self._count += 1
        self._next_s += self._sketch.pause_s + LOOP_S + self._lasts_s(self._printed)
        return self._damaged(self._printed)

    @property
    def _found(self) -> Found:
        return Found(sensor=self.fault != "zeros", genuine=self.fault != "clone")

    def _motion(self, at_s: float) -> Motion:
        if self.fault == "zeros":
            return AT_REST
        rate_hz = 1 / max(self._sketch.pause_s, 0.01)
        with self._bench.lock:
            counts = self._bench.counts(np.array([at_s]), rate_hz)[0].tolist()
        accel_g = [c * self._imu.accel_range_g / FULL_SCALE_COUNTS for c in counts[:3]]
        gyro_dps = [c * self._imu.gyro_range_dps / FULL_SCALE_COUNTS for c in counts[4:]]
        die_c = counts[3] / TEMPERATURE_COUNTS_PER_C + TEMPERATURE_OFFSET_C
        return Motion((accel_g[0], accel_g[1], accel_g[2]), (gyro_dps[0], gyro_dps[1], gyro_dps[2]), die_c)

    def _lasts_s(self, text: str) -> float:
        return len(text) * BITS_A_BYTE / self._sketch.baudrate

    def _damaged(self, line: str) -> str:
        halved = self.fault == "half_lines" and self._count % FAULT_EVERY == 0
        return line[: len(line) // 2] if halved else line

    def _spoken(self, said: bytes) -> bytes:
        if self.fault == "silent":
            return b""
        return self._noise.randbytes(len(said)) if self.fault == "garbage" else said


def running(
    sketch: Callable[[], Sketch],
) -> Callable[[BoardOptions, ImuOptions, Bench, Callable[[], float]], SketchBoard]:
    """What makes a board that runs a sketch."""
    return lambda options, imu, bench, now: SketchBoard(sketch(), options, imu, bench, now)
