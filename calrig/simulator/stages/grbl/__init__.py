"""The stage's dialect: GRBL 1.1h and 0.9j on an Arduino with a stepper shield (gnea/grbl, grbl/grbl).

A rig that is not there: its physics are `calrig.simulator.mechanics` and `bench`. Apart from them, this wire
dialect is written from conversations recorded with the unmodified firmware, `../shared/wire/grbl11h-*` and
`grbl09j-*` next to the repository, and from the firmware's behaviour where they are silent. The tests
replay every one of the recordings.

It counts the steps that it commands and never sees the table: what it loses against an obstruction it does
not know. Time is what the clock that it is given says. Opening a pseudo-terminal cannot reset it; `reset`
does. The switch that it homes to acts in homing alone; `set_limit_switch` closes one at any time.
"""

import math
from collections.abc import Callable

import numpy as np

from calrig.simulator.bench import Bench
from calrig.simulator.config import StageOptions
from calrig.simulator.stage import GARBLED, Stage
from calrig.simulator.stages.grbl.eeprom import LETTERS, STEPS, STEPS_PER_DEG
from calrig.simulator.stages.grbl.firmware import Firmware
from calrig.simulator.stages.grbl.reports import State
from calrig.simulator.trajectory import Segment

__all__ = ["STAGE", "Grbl", "State"]

DEAD_STOP_DPS2 = 1e4
AHEAD_S = 0.003
"""A line that has come is executed so soon after its last byte."""
STARTED_S = 0.05
"""So long ago it was switched on when it is made: it has said its banner."""
QUIET_INTERVAL_S, BUSY_INTERVAL_S = 0.01, 0.001


class Grbl(Stage):
    """A controller with one turning axis, fed with bytes, answering in bytes.

    The firmware runs in the time that the clock gives, a few milliseconds ahead of it while it executes what
    has come, so that a motion is commanded before it begins.
    """

    def __init__(self, options: StageOptions, bench: Bench, now: Callable[[], float]) -> None:
        super().__init__(options, bench, now)
        self._index = min(options.axis, len(LETTERS)) - 1
        self._firmware = Firmware(options, self._index, self)
        steps = options.settings.get(STEPS + self._index, STEPS_PER_DEG)
        self._steps_per_deg = STEPS_PER_DEG if options.blank_eeprom else steps
        self._echoed = b""
        self._firmware.switch_on(now() - (0.0 if options.blank_eeprom else STARTED_S), 0.0)

    @property
    def interval_s(self) -> float:
        """Wall time until it may speak unasked."""
        return BUSY_INTERVAL_S if self._firmware.uart.is_sending else QUIET_INTERVAL_S

    @property
    def state(self) -> State:
        """The state it is in now."""
        with self._at_now():
            return self._firmware.state

    def reset(self) -> None:
        """The reset line is pulled, as by opening its port: it counts from 0 at any position."""
        with self._at_now() as now_s:
            self.stop_motor(now_s)
            self._firmware.switch_on(now_s, self._options.boot_s)
            self._firmware.run(now_s)

    def set_limit_switch(self, *, closed: bool) -> None:
        """A limit switch of the turning axis closes or opens; with hard limits on, either is an alarm."""
        with self._at_now() as now_s:
            self._firmware.change_switch(now_s, closed=closed)
            self._firmware.run(now_s)

    def receive(self, data: bytes) -> bytes:
        """Takes what came over the wire; returns what has gone back by now."""
        if self.fault == "hang":
            return b""
        with self._at_now() as now_s:
            if self.fault == "echo":
                self._echoed += data
            heard_s = self._firmware.uart.feed(now_s, data)
            self._firmware.run(max(now_s, heard_s + AHEAD_S))
        return self.emit()

    def emit(self) -> bytes:
        """What has gone out: answers, and what it says unasked."""
        with self._at_now() as now_s:
            said, self._echoed = self._echoed + self._firmware.uart.said(now_s), b""
        if self.fault == "garbage":
            return b"\r\n".join(line.translate(GARBLED) for line in said.split(b"\r\n"))
        return b"" if self.fault == "hang" else said

    def drive(self, way: list[Segment]) -> bool:
        """Turn the motor along a way in units; returns whether it is blocked on it."""
        share = self._degrees_per_unit()
        return self._bench.mechanics.follow([segment.scaled(share) for segment in way]).stalled

    def stop_motor(self, at_s: float) -> None:
        """No further step: the motor stops dead."""
        self._bench.mechanics.halt(at_s, DEAD_STOP_DPS2)

    def to_switch(self, at_s: float, side: float) -> float:
        """Units from the motor to the switch that it homes to, going to one side (1 or -1)."""
        if self._options.switch_deg is None:
            return math.inf
        motor_deg = float(self._bench.mechanics.motor(np.array([at_s])).angle_deg[0])
        switch_deg = self._options.switch_deg + self._bench.mechanics.draw_homing_error_deg()
        return (side * (switch_deg - motor_deg)) % 360.0 / self._degrees_per_unit()

    def _advance(self, now_s: float) -> None:
        self._firmware.run(now_s)

    def _degrees_per_unit(self) -> float:
        return self._firmware.eeprom.values[STEPS + self._index] / self._steps_per_deg


STAGE = Grbl
