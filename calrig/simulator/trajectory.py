"""Motion known at every instant: pieces of constant acceleration, evaluated analytically."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


class Turn(NamedTuple):
    """An angle over time and its rate, arrays of one shape."""

    angle_deg: FloatArray
    rate_dps: FloatArray


class Segment(NamedTuple):
    """A piece of motion with constant acceleration, valid until the next one starts."""

    start_s: float
    position_deg: float
    velocity_dps: float = 0.0
    acceleration_dps2: float = 0.0

    def at(self, time_s: float) -> tuple[float, float]:
        """Position and velocity at an instant not before the start."""
        dt = time_s - self.start_s
        position = self.position_deg + dt * (self.velocity_dps + 0.5 * self.acceleration_dps2 * dt)
        return position, self.velocity_dps + self.acceleration_dps2 * dt

    def scaled(self, factor: float) -> Segment:
        """The segment with position, velocity and acceleration times a factor."""
        return Segment(self.start_s, *(factor * value for value in self[1:]))

    def reach_s(self, sense: float, way_deg: float) -> float:
        """When it has covered a way, moving in `sense`."""
        speed, gain = sense * self.velocity_dps, sense * self.acceleration_dps2
        root = math.sqrt(max(speed**2 + 2 * gain * way_deg, 0.0))
        return self.start_s + (2 * way_deg / (speed + root) if way_deg > 0 else 0.0)


def trapezoid(
    start_s: float, from_deg: float, to_deg: float, velocity_dps: float, acceleration_dps2: float
) -> list[Segment]:
    """A move from rest to rest: accelerate, cruise where the way is long enough, decelerate, stand."""
    way = abs(to_deg - from_deg)
    sense = math.copysign(1.0, to_deg - from_deg)
    peak = min(velocity_dps, math.sqrt(way * acceleration_dps2))
    ramp_s = peak / acceleration_dps2
    cruise_s = way / peak - ramp_s if peak > 0 else 0.0
    ramp_deg = 0.5 * peak * ramp_s
    segments = []
    if ramp_s > 0:
        segments.append(Segment(start_s, from_deg, 0.0, sense * acceleration_dps2))
        if cruise_s > 0:
            segments.append(Segment(start_s + ramp_s, from_deg + sense * ramp_deg, sense * peak))
        brake_s = start_s + ramp_s + max(cruise_s, 0.0)
        segments.append(Segment(brake_s, to_deg - sense * ramp_deg, sense * peak, -sense * acceleration_dps2))
        start_s = brake_s + ramp_s
    segments.append(Segment(start_s, to_deg))
    return segments


def braking(
    start_s: float, position_deg: float, velocity_dps: float, acceleration_dps2: float
) -> list[Segment]:
    """From a motion under way to rest, as fast as `acceleration_dps2` allows."""
    ramp_s = abs(velocity_dps) / acceleration_dps2
    rest = Segment(start_s + ramp_s, position_deg + 0.5 * velocity_dps * ramp_s)
    if ramp_s == 0:
        return [rest]
    slowing = Segment(start_s, position_deg, velocity_dps, -math.copysign(acceleration_dps2, velocity_dps))
    return [slowing, rest]


class Trajectory:
    """Segments in the order of time; the future may be replaced, the past never changes.

    `position_deg` is at time 0; `relaxation_s` is the time constant of `behind`, infinite unless asked for.
    """

    def __init__(self, position_deg: float, relaxation_s: float = math.inf) -> None:
        self._relaxation_s = relaxation_s
        self._segments = [Segment(0.0, position_deg)]
        self._behind_deg = [0.0]
        self._arrays: FloatArray | None = None

    def replace_from(self, at_s: float, segments: Iterable[Segment]) -> None:
        """Puts `segments`, the first of which starts at `at_s`, in place of everything from then on."""
        keep = max(bisect_left(self._segments, at_s, key=lambda segment: segment.start_s), 1)
        del self._segments[keep:], self._behind_deg[keep:]
        for segment in segments:
            last, behind = self._segments[-1], self._behind_deg[-1]
            if math.isfinite(self._relaxation_s):
                behind = self._relaxed(last, behind, segment.start_s)
            self._segments.append(segment)
            self._behind_deg.append(behind)
        self._arrays = None

    def state(self, at_s: float) -> tuple[float, float]:
        """Position in degrees and velocity in degrees per second at one instant."""
        index = max(bisect_right(self._segments, at_s, key=lambda segment: segment.start_s) - 1, 0)
        return self._segments[index].at(max(at_s, 0.0))

    def at(self, times_s: FloatArray) -> Turn:
        """Position and velocity at any instants; before time 0 it is at rest."""
        segments, dt = self._look_up(times_s)
        _, position, velocity, acceleration, _ = segments
        return Turn(position + dt * (velocity + 0.5 * acceleration * dt), velocity + acceleration * dt)

    def behind(self, times_s: FloatArray) -> Turn:
        """What of the motion a first-order lag of `relaxation_s` is still missing, and its rate.

        With u the position, τ the time constant and d = u − lag(u): d' = u' − d/τ, which within a segment is
        d = τu' − τ²u'' + C·exp(−t/τ).
        """
        segments, dt = self._look_up(times_s)
        _, _, velocity, acceleration, behind = segments
        tau = self._relaxation_s
        excess = (behind - tau * velocity + tau**2 * acceleration) * np.exp(-dt / tau)
        missing = tau * (velocity + acceleration * dt) - tau**2 * acceleration + excess
        return Turn(missing, tau * acceleration - excess / tau)

    def _relaxed(self, segment: Segment, behind_deg: float, at_s: float) -> float:
        tau, dt = self._relaxation_s, at_s - segment.start_s
        velocity, acceleration = segment.velocity_dps, segment.acceleration_dps2
        excess = (behind_deg - tau * velocity + tau**2 * acceleration) * math.exp(-dt / tau)
        return tau * (velocity + acceleration * dt) - tau**2 * acceleration + excess

    def _look_up(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self._arrays is None:
            self._arrays = np.vstack([np.array(self._segments).T, self._behind_deg])
        starts = self._arrays[0]
        index = np.maximum(np.searchsorted(starts, times_s, side="right") - 1, 0)
        return self._arrays[:, index], np.maximum(times_s - starts[index], 0.0)
