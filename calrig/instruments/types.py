"""What drivers give and what callers may rely on: samples, identities, and one small Protocol a verb."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


GAP_PERIODS = 8
"""After a gap of so many sample periods the board's rotation is unknown."""


@dataclass(frozen=True, slots=True)
class Samples:
    """A block of n valid samples in the order taken; a channel that the board does not send is NaN.

    Between two samples more than `GAP_PERIODS` apart the sensor's motion is unknown.

    Attributes:
        time_s: (n,) the board's clock since `start`, unwrapped, strictly increasing.
        accel_g: (n, 3) specific force in g along the sensor's x, y, z.
        gyro_dps: (n, 3) angular rate in degrees per second about x, y, z.
        temperature_c: (n,) die temperature.
        angle_deg: (n,) elevation about x as the board computed it; NaN where it sends what it measured.
    """

    time_s: FloatArray
    accel_g: FloatArray
    gyro_dps: FloatArray
    temperature_c: FloatArray
    angle_deg: FloatArray

    def __len__(self) -> int:
        return len(self.time_s)

    @classmethod
    def empty(cls) -> Samples:
        """No samples."""
        return cls(np.empty(0), np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0))

    @classmethod
    def join(cls, blocks: list[Samples]) -> Samples:
        """The blocks one after the other."""
        if not blocks:
            return cls.empty()
        return cls(*(np.concatenate([getattr(block, name) for block in blocks]) for name in cls.__slots__))

    def between(self, from_s: float, to_s: float) -> Samples:
        """The samples with from_s <= time_s < to_s."""
        first, last = np.searchsorted(self.time_s, (from_s, to_s))
        return Samples(*(getattr(self, name)[first:last] for name in self.__slots__))

    def spanning(self, from_s: float, to_s: float) -> Samples:
        """Return the samples between two times, and at both a sample interpolated between its neighbours."""
        inner = self.between(math.nextafter(from_s, math.inf), to_s)
        return Samples.join([self._at(from_s), inner, self._at(to_s)])

    def _at(self, time_s: float) -> Samples:
        after = min(max(int(np.searchsorted(self.time_s, time_s)), 1), len(self) - 1)
        before_s, after_s = self.time_s[after - 1 : after + 1]
        share = min(max((time_s - before_s) / (after_s - before_s), 0.0), 1.0)

        def of(values: FloatArray) -> FloatArray:
            pair = values[after - 1 : after + 1]
            return np.asarray(pair[:1] + share * (pair[1:] - pair[:1]), dtype=np.float64)

        rest = (of(getattr(self, name)) for name in self.__slots__[1:])
        return Samples(np.array([time_s]), *rest)


@dataclass(frozen=True, slots=True)
class BoardIdentity:
    """Who a board says it is; None where it does not say.

    `rate_hz` is the rate of a board that has only one; None where it accepts others. `sends_rates`: and
    accelerations, not only an angle of its own.
    """

    driver: str
    firmware: str | None
    serial: str
    chip: str | None
    accel_range_g: int | None
    gyro_range_dps: int | None
    max_rate_hz: int | None
    rate_hz: float | None = None
    sends_rates: bool = True


@dataclass(frozen=True, slots=True)
class StageIdentity:
    """Who a stage says it is, and what its controller allows, in the stage's own degrees.

    `homes`: it can look for its reference, so that nobody needs to remember where it stands;
    `homes_each_time`: it has to, whenever its port was opened. `warnings`: a sentence for each setting of the
    controller that puts its angles in doubt, with what to set.
    """

    driver: str
    firmware: str | None
    limits_deg: tuple[float, float] | None
    velocity_dps: float | None
    acceleration_dps2: float | None
    homes: bool = True
    homes_each_time: bool = False
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class StageStatus:
    """One look at a stage.

    `state` is `not_referenced`, `homing`, `moving`, `ready`, `disabled` or `configuration` (the
    controller's set-up is being changed); `words` says the same for a person, with the controller's own error
    bits where there are any.
    """

    state: str
    words: str


class Board(Protocol):
    """A sensor board on a port. `faults` counts what was dropped, by kind (CONTRACT section 2)."""

    faults: Counter[str]

    def identify(self) -> BoardIdentity:
        """Asks until the board answers or its time is up (BoardError)."""

    def start(self, rate_hz: int) -> None:
        """Start streaming, at this rate if the board accepts one; a thread of the driver reads."""

    def take(self, timeout_s: float) -> Samples:
        """The valid samples since the last call, waiting up to timeout_s for the first one.

        Raises:
            BoardError: the board has been silent, frozen or unreadable for too long, or went away.
        """

    def mark(self) -> None:
        """Asks for a sign in the stream: what comes after it was measured after this call."""

    @property
    def marked(self) -> bool:
        """Whether the sign has come, or the board gives none; blocks not taken yet may be older than it."""

    def stop(self) -> None:
        """Stops streaming."""

    def close(self) -> None:
        """Tells a streaming board to stop and closes the port; never raises."""


class Stage(Protocol):
    """A rotary stage on a port, in its own degrees. Opening it moves nothing."""

    faults: Counter[str]

    def identify(self) -> StageIdentity:
        """Asks for firmware, limits, velocity and acceleration."""

    def status(self) -> StageStatus:
        """Asks for the state."""

    def position_deg(self) -> float:
        """Return the position at rest: two reads in a row that agree."""

    def glimpse_deg(self) -> float:
        """One read, unchecked: to show a stage on the move, never for a result."""

    def set_velocity(self, velocity_dps: float) -> None:
        """Sets the velocity of the moves that follow."""

    def home(self) -> None:
        """Begins to look for the reference; returns at once."""

    def move(self, target_deg: float) -> None:
        """Begins a move; returns once the controller has accepted it, raises StageError if it refused."""

    def halt(self) -> None:
        """Stops the stage now, from any thread, waiting for no answer; later motion raises Halted."""

    def close(self) -> None:
        """Closes the port; never raises."""
