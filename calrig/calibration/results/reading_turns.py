"""On which turn a reading is meant (CONTRACT section 6).

A sensor that starts anew after a turn drops 360° of its *reading*; a stage that has gone round once more
adds 360° of *elevation*. Where the scale is not 1 the two are not the same: at 1.01 they are 3.6° apart. The
fit of bias and scale takes readings modulo 360°, so that poses whose readings jump are those of a sensor that
starts anew (`readings_wrap`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from calrig.calibration.line import MIN_SCALE
from calrig.estimation.angles import BoolArray, FloatArray

HALF_TURN_DEG, TURN_DEG = 180.0, 360.0
AT_ITS_END_DEG = 1e-3
"""Beyond an end of the range by no more, an elevation is at that end: a `float` rounds it as it likes."""
OF_NOISE = 3.0
"""RMS errors: two elevations that are no further apart are one, and so far a reading strays at an end."""


def readings_wrap(reading_deg: FloatArray, expected_deg: FloatArray) -> bool | None:
    """Return whether a sensor's readings start anew after a turn; None where its poses do not show it.

    `expected_deg` (n,) are bias + scale·θ, on the turn of most readings.
    """
    if np.rint((reading_deg - expected_deg) / TURN_DEG).any():
        return True
    low, high = float(reading_deg.min()), float(reading_deg.max())
    fits_a_turn = (low >= -HALF_TURN_DEG and high <= HALF_TURN_DEG) or (low >= 0.0 and high <= TURN_DEG)
    return None if fits_a_turn else False


@dataclass(frozen=True, slots=True)
class ReadingTurns:
    """Which of the readings that differ by whole turns, and of the elevations, is the one meant.

    Attributes:
        bias_deg, scale: of the line.
        range_deg: of elevation.
        wrap: whether readings start anew after a turn; None where it is not known.
        rms_deg: of the calibrated readings; 0 where it is not known.
    """

    bias_deg: float
    scale: float
    range_deg: tuple[float, float]
    wrap: bool | None = None
    rms_deg: float = 0.0

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> Self:
        """Return those of a document (CONTRACT section 6)."""
        low_deg, high_deg = document["range_deg"]
        rms_deg = document.get("rms_with_effects_deg")
        if rms_deg is None:
            rms_deg = document.get("rms_calibrated_deg")
        wrap = document.get("readings_wrap")
        return cls(
            float(document["bias_deg"]),
            float(document["scale"]),
            (float(low_deg), float(high_deg)),
            wrap if wrap is None else bool(wrap),
            0.0 if rms_deg is None else float(rms_deg),
        )

    @property
    def width_deg(self) -> float:
        """Elevations that the range holds."""
        return self.range_deg[1] - self.range_deg[0]

    @property
    def middle_deg(self) -> float:
        """Middle of the range."""
        return (self.range_deg[0] + self.range_deg[1]) / 2.0

    @property
    def turn_of_reading_deg(self) -> float:
        """What a turn of the reading is in elevation."""
        return TURN_DEG / max(abs(self.scale), MIN_SCALE)

    @property
    def is_left_alone(self) -> bool:
        """Return whether only unwrapped readings have a meaning: the range is of more than a turn."""
        return self.wrap is not True and self.width_deg > TURN_DEG + 2.0 * AT_ITS_END_DEG

    @property
    def single_deg(self) -> tuple[float, float] | None:
        """Elevations between which a wrapped reading stands for one alone; None where all do.

        Beyond them a whole turn of the reading leads into the range too, at another direction.
        """
        noise_deg = max(OF_NOISE * self.rms_deg, AT_ITS_END_DEG)
        apart_deg = abs(self.turn_of_reading_deg - TURN_DEG)
        overlap_deg = self.width_deg + noise_deg - self.turn_of_reading_deg
        if self.wrap is not True or apart_deg <= noise_deg or overlap_deg <= 0.0:
            return None
        return self.range_deg[0] + overlap_deg, self.range_deg[1] - overlap_deg

    def aim_deg(self, reading_deg: FloatArray) -> FloatArray:
        """Return (n,) reading less bias, on the turn that is meant; NaN where nothing tells which one is.

        The θ inside the range goes first, then the one next to its middle. Readings that are known to start
        anew differ by turns of the reading, those that are known to go on by turns of θ. Where neither is
        known they are taken as wrapped within half a turn, and where that alone leads into the range.
        """
        aim = np.asarray(reading_deg - self.bias_deg, dtype=np.float64)
        if self.is_left_alone:
            return aim
        theta = aim / self.scale
        turns_of_theta = np.ceil((theta - self.middle_deg - HALF_TURN_DEG) / TURN_DEG)
        turns_of_reading = np.ceil((aim - self.scale * self.middle_deg - HALF_TURN_DEG) / TURN_DEG)
        by_reading = aim - TURN_DEG * turns_of_reading
        if self.wrap is True:
            return self._told_apart(by_reading)
        is_wrapped = np.zeros(len(aim), dtype=np.bool_)
        if self.wrap is None:
            is_wrapped = np.abs(reading_deg) <= HALF_TURN_DEG
            if not self.covers_a_turn:
                is_wrapped |= self._is_inside(by_reading / self.scale)
        by_theta = aim - self.scale * TURN_DEG * turns_of_theta
        return np.where(self._is_inside(theta), aim, np.where(is_wrapped, by_reading, by_theta))

    @property
    def covers_a_turn(self) -> bool:
        """Return whether any reading has a turn that leads into the range."""
        return self.width_deg >= self.turn_of_reading_deg

    def _told_apart(self, aim_deg: FloatArray) -> FloatArray:
        if self.single_deg is None:
            return aim_deg
        first_deg, last_deg = self.single_deg
        theta = aim_deg / self.scale
        return np.where((theta < first_deg) | (theta > last_deg), np.nan, aim_deg)

    def _is_inside(self, theta_deg: FloatArray) -> BoolArray:
        low_deg, high_deg = self.range_deg
        is_inside = (theta_deg >= low_deg - AT_ITS_END_DEG) & (theta_deg <= high_deg + AT_ITS_END_DEG)
        return np.asarray(is_inside, dtype=np.bool_)
