"""The homing cycle: Z first, then X and Y; seek the switch, pull off, locate it slowly, pull off (limits.c).

It is laid out whole when it begins. Each phase counts from 0, which shows where it is broken off.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from calrig.simulator.stages.grbl.eeprom import (
    ACCELERATION,
    DEBOUNCE,
    HOMING_SIDE,
    LOCATE_RATE,
    PULL_OFF,
    RATE,
    SEEK_RATE,
    TRAVEL,
    Eeprom,
)
from calrig.simulator.stages.grbl.reports import NO_SWITCH, SWITCH_STAYS
from calrig.simulator.trajectory import Segment, Trajectory, trapezoid

CYCLES = ((2,), (0, 1))
SEARCH = 1.5
"""Times the travel: as far as it seeks."""
LOCATE = 5.0
"""Times the pull-off: as far as it locates."""
PHASE_S = 0.019
"""What each phase takes beyond its ramps."""


@dataclass(frozen=True)
class _Phase:
    start_s: float
    ways: dict[int, list[Segment]]
    """Of each axis that moves, from 0, in units."""


class HomingCycle:
    """One cycle, from its beginning to its end.

    Args:
        eeprom: rates, pull-off and sides.
        begin_s: when it begins.
        distances: units from each axis to its switch, infinite where none closes.
        closed: axes whose switch is held closed.

    Attributes:
        ends_s: when it has succeeded or failed.
        alarm: why it fails; None where it succeeds.
    """

    def __init__(
        self, eeprom: Eeprom, begin_s: float, distances: Mapping[int, float], closed: set[int]
    ) -> None:
        self._eeprom = eeprom
        self._phases: list[_Phase] = []
        self._homed: list[tuple[float, dict[int, float]]] = []
        self.ends_s = begin_s
        self.alarm: int | None = None
        for axes in CYCLES:
            self._run(axes, distances, closed)
            if self.alarm is not None:
                return
            self._homed.append((self.ends_s, {axis: eeprom.homed(axis) for axis in axes}))

    def way(self, axis: int, start_s: float) -> list[Segment]:
        """The whole way of an axis from its place at the start, in units."""
        segments, place = [Segment(start_s, 0.0)], 0.0
        for phase in self._phases:
            way = phase.ways.get(axis, [])
            segments += [segment._replace(position_deg=segment.position_deg + place) for segment in way]
            place = segments[-1].position_deg
        return segments

    def places(self, at_s: float) -> dict[int, float]:
        """What the axes it has moved count at an instant."""
        places: dict[int, float] = {}
        for phase in self._phases:
            if phase.start_s <= at_s:
                for axis, way in phase.ways.items():
                    path = Trajectory(0.0)
                    path.replace_from(phase.start_s, way)
                    places[axis] = path.state(at_s)[0]
        for since_s, homed in self._homed:
            if since_s <= at_s:
                places |= homed
        return places

    def _run(self, axes: tuple[int, ...], distances: Mapping[int, float], closed: set[int]) -> None:
        values = self._eeprom.values
        pull_off = values[PULL_OFF]
        seek, locate = values[SEEK_RATE] / 60, values[LOCATE_RATE] / 60
        search = SEARCH * max(values[TRAVEL + axis] for axis in axes)
        near = dict.fromkeys(axes, pull_off)
        for to_switch, most, rate in (
            ({axis: distances[axis] for axis in axes}, search, seek),
            (None, pull_off, seek),
            (near, LOCATE * pull_off, locate),
            (None, pull_off, seek),
        ):
            self._phase(axes, to_switch, most, rate, closed)
            if self.alarm is not None:
                return
            self.ends_s += values[DEBOUNCE] / 1000

    def _phase(
        self,
        axes: tuple[int, ...],
        to_switch: Mapping[int, float] | None,
        most: float,
        rate: float,
        closed: set[int],
    ) -> None:
        """Move toward the switches until all are closed, or off them by a fixed way (`to_switch` None)."""
        values = self._eeprom.values
        speed = min(rate, *(values[RATE + axis] / 60 for axis in axes))
        gain = min(values[ACCELERATION + axis] for axis in axes)
        begin_s, ways, end_s = self.ends_s, {}, self.ends_s
        for axis in axes:
            side = -1.0 if int(values[HOMING_SIDE]) >> axis & 1 else 1.0
            if to_switch is None:
                ways[axis] = trapezoid(begin_s, 0.0, -side * most, speed, gain)
            else:
                way = trapezoid(begin_s, 0.0, side * most, speed, gain)
                distance = 0.0 if axis in closed else to_switch[axis]
                if distance <= most:
                    way = _cut(way, side, distance)
                else:
                    self.alarm = NO_SWITCH
                ways[axis] = way
            end_s = max(end_s, ways[axis][-1].start_s)
        if to_switch is None and closed & set(axes):
            self.alarm = SWITCH_STAYS
        self._phases.append(_Phase(begin_s, ways))
        self.ends_s = end_s + PHASE_S


def _cut(way: list[Segment], side: float, distance: float) -> list[Segment]:
    """The way up to where it has gone a distance, where it stops dead."""
    cut: list[Segment] = []
    for segment, following in zip(way, [*way[1:], None], strict=True):
        left = distance - side * segment.position_deg
        if following is None or side * following.position_deg < distance:
            cut.append(segment)
            continue
        speed, gain = side * segment.velocity_dps, side * segment.acceleration_dps2
        root = math.sqrt(max(speed**2 + 2 * gain * left, 0.0))
        hit_s = segment.start_s + (2 * left / (speed + root) if left > 0 else 0.0)
        return [*cut, *([segment] if left > 0 else []), Segment(hit_s, side * distance)]
    return cut
