"""The planner and the stepper: what GRBL commands its motors, known at every instant (planner.c, stepper.c).

Up to 15 blocks wait. Consecutive ones are joined at the speed their corner allows, all ramps have the
axis's acceleration. The steps of the next `AHEAD_S` are already on their way: so late a hold begins to
brake, and so much earlier a block makes room for the next.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from calrig.simulator.stages.grbl.eeprom import ACCELERATION, JUNCTION, RATE, STEPS, Eeprom
from calrig.simulator.trajectory import Segment, Trajectory

MOST_BLOCKS = 15
AHEAD_S = 0.048
LAST_STEPS_S = 0.001
"""The last steps of a ramp come later than constant acceleration has them."""
SLICE_S = 0.01
"""The reported rate is that of a slice of motion this long."""
STRAIGHT = 0.999999


@dataclass(frozen=True, eq=False)
class Line:
    """One motion in a straight line, in units and machine coordinates."""

    start: tuple[float, ...]
    target: tuple[float, ...]
    feed: float | None
    """Units per second; None for as fast as the axes allow."""
    is_jog: bool = False

    @property
    def length(self) -> float:
        """From start to target."""
        return math.dist(self.start, self.target)

    @property
    def direction(self) -> tuple[float, ...]:
        """Unit vector."""
        length = self.length
        return tuple((to - start) / length for start, to in zip(self.start, self.target, strict=True))


class Piece(NamedTuple):
    """Constant acceleration along a line."""

    line: Line
    along: Segment


class Motion:
    """What the motors were and will be commanded, of all axes.

    Args:
        drive: takes the way of the turning axis from an instant on, in units.
        index: of the turning axis.

    Attributes:
        stands_s: when the last step that is planned by now will have been made; infinite in the past at rest.
    """

    def __init__(self, eeprom: Eeprom, drive: Callable[[list[Segment]], object], index: int) -> None:
        self._eeprom = eeprom
        self._drive = drive
        self._index = index
        self._lines: list[Line] = []
        self._pieces: list[Piece] = []
        self._line_ends_s: list[float] = []
        self._axes = [Trajectory(0.0) for _ in range(eeprom.n_axes)]
        self.stands_s = -math.inf
        self.feed_share = self.rapid_share = 1.0

    @property
    def is_empty(self) -> bool:
        """Whether no line waits or is under way."""
        return not self._lines

    def place(self, at_s: float) -> list[float]:
        """Machine coordinates at an instant, in units, to a whole step."""
        return [self._to_step(axis, self._axes[axis].state(at_s)[0]) for axis in range(len(self._axes))]

    def rate(self, at_s: float) -> float:
        """Units per second of the slice that is prepared at an instant."""
        found = self._piece(at_s + AHEAD_S)
        if found is None or at_s + AHEAD_S >= self.stands_s:
            return 0.0
        since_s = at_s + AHEAD_S - self._pieces[0].along.start_s
        end_s = self._pieces[0].along.start_s + math.ceil(since_s / SLICE_S) * SLICE_S
        ahead = self._piece(min(end_s, self.stands_s))
        return max(abs(ahead.along.at(min(end_s, self.stands_s))[1]), 0.0) if ahead else 0.0

    def room(self, at_s: float) -> int:
        """How many more lines are taken."""
        return MOST_BLOCKS - len(self._waiting(at_s))

    def has_room_at(self) -> float:
        """When the line that is being made gives room for another."""
        return self._line_ends_s[len(self._lines) - MOST_BLOCKS] - AHEAD_S if self._line_ends_s else math.inf

    def add(self, at_s: float, line: Line) -> None:
        """Put a line behind those that wait; it is not begun."""
        if self._is_made(at_s):
            self._lines, self._pieces, self._line_ends_s = [], [], []
        self._lines.append(line)

    def begin(self, at_s: float) -> None:
        """Make the lines that wait from here on, at their speeds."""
        if not self._lines or self._is_made(at_s):
            return
        along, speed = self._now(at_s)
        self._pieces = self._planned(at_s, along, speed)
        self._send(at_s)

    def brake(self, at_s: float) -> None:
        """Come to rest on the way; the remainder waits for `begin`."""
        begin_s = at_s + AHEAD_S
        if begin_s >= self.stands_s:
            return
        kept = [piece for piece in self._pieces if piece.along.start_s < begin_s]
        last = kept[-1]
        along, speed = last.along.at(begin_s)
        line, braking = last.line, []
        at = begin_s
        while speed > 0:
            slowing = self._acceleration(line)
            left = line.length - along
            if line is self._lines[-1] or speed**2 / (2 * slowing) <= left:
                braking.append(Piece(line, Segment(at, along, speed, -slowing)))
                at += speed / slowing
                along, speed = along + speed**2 / (2 * slowing), 0.0
            else:
                slower = math.sqrt(speed**2 - 2 * slowing * left)
                braking.append(Piece(line, Segment(at, along, speed, -slowing)))
                at += (speed - slower) / slowing
                line, along, speed = self._lines[self._lines.index(line) + 1], 0.0, slower
        self._pieces = [*kept, *braking, Piece(line, Segment(at, min(along, line.length)))]
        self._send(at_s)

    def stop(self, at_s: float) -> None:
        """Make no further step, and forget what waited."""
        places = self.place(at_s)
        self.finish()
        self.set_places(at_s, dict(enumerate(places)))

    def set_places(self, at_s: float, places: dict[int, float]) -> None:
        """Count on from other numbers; no motor moves."""
        for axis, place in places.items():
            self._axes[axis].replace_from(at_s, [Segment(at_s, place)])

    def finish(self) -> None:
        """What was planned has been made: forget the lines."""
        self._lines, self._pieces, self._line_ends_s = [], [], []
        self.stands_s = -math.inf

    def rest_is_left(self) -> bool:
        """Whether a hold has left something of the way."""
        if not self._pieces:
            return bool(self._lines)
        line, along = self._pieces[-1]
        return line is not self._lines[-1] or along.position_deg < line.length - 1e-9

    def _to_step(self, axis: int, place: float) -> float:
        per_unit = self._eeprom.values[STEPS + axis]
        return round(place * per_unit) / per_unit + 0.0

    def _waiting(self, at_s: float) -> list[Line]:
        gone = sum(end_s - AHEAD_S <= at_s for end_s in self._line_ends_s)
        return self._lines[gone:]

    def _piece(self, at_s: float) -> Piece | None:
        found = None
        for piece in self._pieces:
            if piece.along.start_s > at_s:
                break
            found = piece
        return found

    def _now(self, at_s: float) -> tuple[float, float]:
        """How far the first line has come, and how fast; lines that were made are forgotten."""
        piece = self._piece(at_s)
        if piece is None:
            return 0.0, 0.0
        self._lines = self._lines[self._lines.index(piece.line) :]
        along, speed = piece.along.at(at_s)
        if at_s >= self.stands_s:
            speed = 0.0
        if speed == 0.0 and along >= piece.line.length - 1e-9 and len(self._lines) > 1:
            self._lines = self._lines[1:]
            along = 0.0
        return min(along, piece.line.length), speed

    def _is_made(self, at_s: float) -> bool:
        return bool(self._pieces) and at_s >= self.stands_s and not self.rest_is_left()

    def _acceleration(self, line: Line) -> float:
        return self._limited(line, ACCELERATION, 1.0)

    def _limited(self, line: Line, setting: int, share: float) -> float:
        return min(
            self._eeprom.values[setting + axis] * share / abs(part)
            for axis, part in enumerate(line.direction)
            if part
        )

    def _speed(self, line: Line) -> float:
        most = self._limited(line, RATE, 1 / 60)
        if line.feed is None:
            return most * self.rapid_share
        return min(most, line.feed * (1.0 if line.is_jog else self.feed_share))

    def _corner(self, before: Line, after: Line) -> float:
        cosine = -sum(a * b for a, b in zip(before.direction, after.direction, strict=True))
        if cosine > STRAIGHT:
            return 0.0
        most = min(self._speed(before), self._speed(after))
        if cosine < -STRAIGHT:
            return most
        half_sine = math.sqrt(0.5 * (1 - cosine))
        slowing = min(self._acceleration(before), self._acceleration(after))
        return min(most, math.sqrt(slowing * self._eeprom.values[JUNCTION] * half_sine / (1 - half_sine)))

    def _planned(self, at_s: float, along: float, speed: float) -> list[Piece]:
        lines = self._lines
        ways = [line.length for line in lines]
        ways[0] -= along
        entries = [
            speed,
            *(self._corner(a, b) for a, b in pairwise(lines)),
            0.0,
        ]
        for k in range(len(lines) - 1, 0, -1):
            entries[k] = min(
                entries[k], math.sqrt(entries[k + 1] ** 2 + 2 * self._acceleration(lines[k]) * ways[k])
            )
        for k in range(len(lines)):
            entries[k + 1] = min(
                entries[k + 1], math.sqrt(entries[k] ** 2 + 2 * self._acceleration(lines[k]) * ways[k])
            )
        pieces: list[Piece] = []
        for k, line in enumerate(lines):
            begin = along if k == 0 else 0.0
            ramps = _ramps(ways[k], entries[k], entries[k + 1], self._speed(line), self._acceleration(line))
            for duration_s, start_speed, gain in ramps:
                segment = Segment(at_s, begin, start_speed, gain)
                pieces.append(Piece(line, segment))
                at_s += duration_s
                begin = segment.at(at_s)[0]
        pieces.append(Piece(lines[-1], Segment(at_s, lines[-1].length)))
        return pieces

    def _send(self, at_s: float) -> None:
        """Lay out the way of every axis from an instant on, and hand the turning one's to the motor."""
        self.stands_s = self._pieces[-1].along.start_s
        self._line_ends_s = [
            min(
                (p.along.start_s for p in self._pieces if self._lines.index(p.line) > k),
                default=self.stands_s,
            )
            for k in range(len(self._lines))
        ]
        if self.rest_is_left():
            done = self._lines.index(self._pieces[-1].line)
            self._line_ends_s = [end_s if k < done else math.inf for k, end_s in enumerate(self._line_ends_s)]
        pieces = [piece for piece in self._pieces if piece.along.start_s >= at_s]
        if (under_way := self._piece(at_s)) is not None and under_way not in pieces:
            place, speed = under_way.along.at(at_s)
            pieces.insert(
                0, Piece(under_way.line, Segment(at_s, place, speed, under_way.along.acceleration_dps2))
            )
        for axis, trajectory in enumerate(self._axes):
            way = [_of_axis(piece, axis) for piece in pieces]
            trajectory.replace_from(at_s, way)
            if axis == self._index:
                self._drive(way)


def _of_axis(piece: Piece, axis: int) -> Segment:
    line, along = piece
    way = along.scaled(line.direction[axis])
    return way._replace(position_deg=line.start[axis] + way.position_deg)


def _ramps(
    way: float, entry: float, leave: float, most: float, gain: float
) -> Sequence[tuple[float, float, float]]:
    """Durations, speeds at the start and accelerations from one speed to another over a way."""
    peak = max(min(most, math.sqrt(max(gain * way + 0.5 * (entry**2 + leave**2), 0.0))), leave)
    first = gain if peak >= entry else -gain
    up_s, down_s = abs(peak - entry) / gain, (peak - leave) / gain
    cruise = way - 0.5 * (entry + peak) * up_s - 0.5 * (peak + leave) * down_s
    ramps = [(up_s, entry, first), (cruise / peak if peak > 0 else 0.0, peak, 0.0), (down_s, peak, -gain)]
    return [ramp for ramp in ramps if ramp[0] > 1e-12]
