"""Records of a board that prints text to samples, frozen and empty ones left out."""

from __future__ import annotations

from collections import Counter

import numpy as np

from calrig.instruments.boards.sketch import Sketch
from calrig.instruments.boards.sketch_lines import Record
from calrig.instruments.types import FloatArray, Samples


class SketchSamples:
    """Samples of one board from its start on; feed it the records in the order they came, with their times.

    A record equal to the one before is `frozen` where the sketch sends registers. Where it sends two
    decimals such records are held back until another comes, and are `frozen` if none does within
    `frozen_after_s`: the clock may stand for so long, but no frozen value enters. Registers that are all 0
    are `frozen` at once: nothing answers the board on its bus.

    Attributes:
        frozen_s: for how long the records have been such that none is accepted.
    """

    def __init__(self, sketch: Sketch, faults: Counter[str]) -> None:
        self.frozen_s = 0.0
        self._sketch = sketch
        self._faults = faults
        self._last: Record = ()
        self._changed_s = 0.0
        self._held: list[tuple[float, Record]] = []

    @property
    def reads_zero(self) -> bool:
        """Whether the last record was 0 throughout."""
        return bool(self._last) and not any(self._last[:6])

    def restart(self) -> None:
        """The board began anew."""
        self._last, self._held, self.frozen_s = (), [], 0.0

    def push(self, records: list[tuple[float, Record]]) -> Samples:
        """The valid samples among some records and those held back before.

        Args:
            records: each with its time in s, strictly increasing.
        """
        valid: list[tuple[float, Record]] = []
        for time_s, record in records:
            if record == self._last or self._is_empty(record):
                self._doubt(time_s, record)
            else:
                valid += [*self._held, (time_s, record)]
                self._held, self._changed_s, self.frozen_s = [], time_s, 0.0
            self._last = record
        return self._samples(valid)

    def _doubt(self, time_s: float, record: Record) -> None:
        unchanged_s = time_s - self._changed_s
        self._held.append((time_s, record))
        if self._is_empty(record) or unchanged_s > self._sketch.frozen_after_s:
            self.frozen_s = unchanged_s
            self._faults["frozen"] += len(self._held)
            self._held = []

    def _is_empty(self, record: Record) -> bool:
        return self._sketch.accel is not None and not any(record[:6])

    def _samples(self, records: list[tuple[float, Record]]) -> Samples:
        sketch, n = self._sketch, len(records)
        numbers = np.array([record for _, record in records]).reshape(n, len(sketch.bounds))

        def column(place: int | None) -> FloatArray:
            return np.full(n, np.nan) if place is None else numbers[:, place]

        def axes(channel: tuple[int, float] | None) -> FloatArray:
            if channel is None:
                return np.full((n, 3), np.nan)
            first, unit = channel
            return numbers[:, first : first + 3] * np.float64(unit)

        return Samples(
            time_s=np.array([time_s for time_s, _ in records]),
            accel_g=axes(sketch.accel),
            gyro_dps=axes(sketch.gyro),
            temperature_c=column(sketch.temperature),
            angle_deg=column(sketch.angle),
        )
