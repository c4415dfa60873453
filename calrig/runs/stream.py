"""A board's samples, filtered as they come, with the stretch kept that the pose in hand is made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calrig.estimation.angles import AXES, along_axis, elevation_deg, wrap_deg
from calrig.estimation.kalman import KalmanFilter
from calrig.instruments.types import Board, FloatArray, Samples
from calrig.store import SampleBlock

Phase = Literal["move", "dwell"]


@dataclass(frozen=True, slots=True)
class Stretch:
    """Samples in a row with what the filter made of them, all (n,)-long.

    Attributes:
        samples: as the board sent them.
        elevation_deg: atan2(accel_y, accel_z) of each, or the angle that the board sends instead; about
            another axis likewise (`along_axis`).
        filtered_deg: the filter's angle after each, continuous; where the board sends no rate to filter with,
            the elevation, which it has filtered itself.
    """

    samples: Samples
    elevation_deg: FloatArray
    filtered_deg: FloatArray

    def between(self, from_s: float, to_s: float) -> Stretch:
        """The part with from_s <= time_s < to_s."""
        first, last = np.searchsorted(self.samples.time_s, (from_s, to_s))
        return Stretch(
            self.samples.between(from_s, to_s), self.elevation_deg[first:last], self.filtered_deg[first:last]
        )

    @classmethod
    def join(cls, parts: list[Stretch]) -> Stretch:
        """The parts one after the other."""
        return cls(
            Samples.join([p.samples for p in parts]),
            np.concatenate([p.elevation_deg for p in parts]) if parts else np.empty(0),
            np.concatenate([p.filtered_deg for p in parts]) if parts else np.empty(0),
        )


class Stream:
    """Takes samples from a started board, runs the filter over them, keeps them since the last cut.

    `begins_s` is the run's time when the board's clock stands at 0; `axis` is the unit's that lies along the
    stage's.
    """

    def __init__(
        self,
        board: Board,
        kalman: KalmanFilter,
        begins_s: float = 0.0,
        count: Callable[[int], None] = lambda _taken: None,
        axis: str = "x",
    ) -> None:
        self._board = board
        self._axis = axis
        self._count = count
        self._begins_s = begins_s
        self._kalman = kalman
        self._kept: list[Stretch] = []
        self._filtered_deg: float | None = None
        self.clock_s = 0.0
        self.reading_deg: float | None = None
        self.temperature_c: float | None = None

    def pump(self, timeout_s: float) -> int:
        """Takes what the board has sent, waiting up to timeout_s for it; returns how many samples came."""
        samples = self._board.take(timeout_s)
        if len(samples) == 0:
            return 0
        samples = replace(samples, time_s=samples.time_s + self._begins_s)
        computed = samples.angle_deg
        elevation = np.where(
            np.isnan(computed), elevation_deg(along_axis(samples.accel_g, self._axis)), computed
        )
        filtered = self._filtered(samples, elevation)
        self._kept.append(Stretch(samples, elevation, filtered))
        self.clock_s = float(samples.time_s[-1])
        self._filtered_deg = float(filtered[-1])
        self.reading_deg = wrap_deg(self._filtered_deg)
        temperature = float(samples.temperature_c[-1])
        self.temperature_c = None if np.isnan(temperature) else temperature
        self._count(len(samples))
        return len(samples)

    def _filtered(self, samples: Samples, elevation: FloatArray) -> FloatArray:
        rate_dps = samples.gyro_dps[:, AXES.index(self._axis[-1])]
        if not np.isnan(rate_dps).any():
            return self._kalman.run(samples.time_s, elevation, rate_dps)
        before = elevation[0] if self._filtered_deg is None else self._filtered_deg
        return np.unwrap(np.append(before, elevation), period=360.0)[1:]

    def reading_at(self, at_s: float) -> float | None:
        """The reading at a time of the board's clock not long ago, between the samples about it."""
        last = Stretch.join(self._kept[-2:])
        if not len(last.samples):
            return self.reading_deg
        return wrap_deg(float(np.interp(at_s, last.samples.time_s, last.filtered_deg)))

    def kept(self) -> Stretch:
        """Everything since the last cut."""
        if len(self._kept) > 1:
            self._kept = [Stretch.join(self._kept)]
        return self._kept[0] if self._kept else Stretch.join([])

    def cut(self, before_s: float) -> None:
        """Forgets the samples before a time of the board's clock."""
        self._kept = [self.kept().between(before_s, np.inf)]


def block_of(index: int, phase: Phase, samples: Samples) -> SampleBlock:
    """The samples as the store takes them, with the board's own angle where it sends one."""
    return SampleBlock(
        index,
        phase,
        samples.time_s,
        samples.accel_g,
        samples.gyro_dps,
        samples.temperature_c,
        None if np.isnan(samples.angle_deg).all() else samples.angle_deg,
    )
