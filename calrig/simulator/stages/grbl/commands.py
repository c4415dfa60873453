"""What lines do: G-code blocks that passed the parser, and the commands that begin with `$` (system.c).

The homing cycle: Z first, then X and Y; seek the switch, pull off, locate it slowly, pull off (limits.c). It
is laid out whole when it begins. Each phase counts from 0, which shows where it is broken off.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from calrig.simulator.stages.grbl import gcode
from calrig.simulator.stages.grbl.eeprom import (
    ACCELERATION,
    DEBOUNCE,
    HOMING,
    INCHES,
    LOCATE_RATE,
    PULL_OFF,
    RATE,
    SEEK_RATE,
    SOFT_LIMITS,
    TRAVEL,
    Eeprom,
)
from calrig.simulator.stages.grbl.gcode import Refusal, read_number
from calrig.simulator.stages.grbl.motion import Line
from calrig.simulator.stages.grbl.reports import (
    DOOR_IN_HOMING,
    NO_SWITCH,
    RESET_IN_HOMING,
    SOFT_LIMIT,
    SWITCH_STAYS,
    State,
)
from calrig.simulator.trajectory import Segment, Trajectory, trapezoid

if TYPE_CHECKING:
    from calrig.simulator.stages.grbl.firmware import Firmware

Run = Generator[float, None, None]
MOST_SETTINGS = 255
EEPROM_S = 0.001
SPINDLE_OFF = 5


class Commands:
    """The commands of one firmware; what must wait yields until it may go on."""

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self._resets_after_answer = False
        self._sleeps_after_answer = False

    def run_startup(self) -> Run:
        """Run the stored lines, as at each start."""
        firmware = self._firmware
        for number, line in enumerate(firmware.eeprom.startup):
            if firmware.eeprom.is_blank:
                firmware.say(f">:{firmware.words.error(7)}")
                firmware.eeprom.startup[number] = ""
            elif line:
                answer = "ok"
                try:
                    yield from self.g_code(line)
                except Refusal as refusal:
                    answer = firmware.words.error(refusal.number)
                firmware.say(f">{line}:{answer}")
        firmware.eeprom.is_blank = False

    def after_answer(self) -> None:
        """Do what was put off until the line was answered."""
        if self._resets_after_answer:
            self._firmware.reset_now()
        if self._sleeps_after_answer:
            self._firmware.flags.add("sleep")
        self._resets_after_answer = self._sleeps_after_answer = False

    def g_code(self, line: str, *, is_jog: bool = False) -> Run:
        """Check and execute a block (Refusal)."""
        firmware = self._firmware
        state, eeprom = firmware.parser, firmware.eeprom
        block = gcode.parse(line, state, eeprom.offsets, firmware.letters, is_jog=is_jog)
        if is_jog:
            yield from self._jog(block)
            return
        old, new = state.modal, block.modal
        checks = firmware.state == State.CHECK
        turns_otherwise = new.spindle != SPINDLE_OFF and block.speed != state.speed
        state.feed, state.speed, state.tool = block.feed, block.speed, block.tool
        changes = (new.spindle, new.coolant) != (old.spindle, old.coolant)
        if not checks and (changes or turns_otherwise):
            yield from firmware.synchronise()
            firmware.accessories = (new.spindle, new.coolant)
            firmware.counters.overrides = 0
        if block.action == gcode.DWELL and not checks:
            yield from firmware.synchronise()
            yield from firmware.delay(block.dwell_s, heeds=True)
        if firmware.is_aborted:
            return
        state.modal = replace(new, motion=old.motion)
        if block.tlo is not None and block.tlo != state.tlo:
            state.tlo = block.tlo
            yield from self._offset_changes()
        if new.system != old.system:
            state.system = list(block.system)
            yield from self._offset_changes()
        yield from self._act(block)
        if firmware.is_aborted:
            return
        state.modal = new
        if block.use == "motion" and new.motion != 80:
            yield from self._line(block.target, block)
            if not firmware.is_aborted:
                state.position = list(block.target)
        if block.flow is not None and not firmware.is_aborted:
            yield from self._flow(block.flow)

    def system(self, line: str) -> Run:
        """Execute a line that begins with `$` (Refusal)."""
        firmware = self._firmware
        kind, rest, is_old = line[1:2], line[2:], firmware.is_old
        if not kind:
            self._list(firmware.words.help())
        elif kind == "J" and not is_old:
            if firmware.state not in (State.IDLE, State.JOG):
                raise Refusal(8)
            if not rest.startswith("="):
                raise Refusal(3)
            yield from self.g_code(rest[1:], is_jog=True)
        elif kind in "$GCX":
            if rest:
                raise Refusal(3)
            self._simple(kind)
        elif firmware.state not in (State.IDLE, State.ALARM):
            raise Refusal(8)
        elif kind == "H":
            yield from self._home(rest)
        else:
            self._stored(kind, rest, line)
            if kind == "N" and "=" in rest:
                number, at = read_number(line, 2)
                yield from self.g_code(line[at + 1 :])
                if int(number) < len(firmware.eeprom.startup):
                    firmware.eeprom.startup[int(number)] = line[at + 1 :]

    def _simple(self, kind: str) -> None:
        firmware = self._firmware
        if kind == "$":
            if firmware.state in (State.RUN, State.HOLD):
                raise Refusal(8)
            self._list(firmware.words.settings())
        elif kind == "G":
            firmware.say(firmware.words.modes(firmware.parser))
        elif kind == "C":
            if firmware.state == State.CHECK:
                self._resets_after_answer = True
                firmware.remark("Disabled")
            elif firmware.state != State.IDLE:
                raise Refusal(8)
            else:
                firmware.state = State.CHECK
                firmware.remark("Enabled")
        elif firmware.state == State.ALARM:
            firmware.remark("Caution: Unlocked")
            firmware.state = State.IDLE

    def _stored(self, kind: str, rest: str, line: str) -> None:
        """Commands that read or write what is stored."""
        firmware = self._firmware
        if kind == "#":
            if rest:
                raise Refusal(3)
            self._list(firmware.words.parameters(firmware.parser))
        elif kind == "S" and not firmware.is_old:
            if rest != "LP":
                raise Refusal(3)
            self._sleeps_after_answer = True
        elif kind == "I":
            self._build(rest)
        elif kind == "R":
            self._restore(rest)
        elif kind == "N":
            self._startup_lines(rest, line)
        else:
            self._write(line)

    def _list(self, texts: Sequence[str]) -> None:
        for text in texts:
            self._firmware.say(text)

    def _build(self, rest: str) -> None:
        firmware = self._firmware
        if not rest:
            self._list(firmware.words.build())
        elif rest.startswith("="):
            firmware.eeprom.build = rest[1:]
        else:
            raise Refusal(3)

    def _startup_lines(self, rest: str, line: str) -> None:
        firmware = self._firmware
        if not rest:
            self._list([f"$N{number}={text}" for number, text in enumerate(firmware.eeprom.startup)])
            return
        if firmware.state != State.IDLE:
            raise Refusal(8)
        _, at = read_number(line, 2)
        if line[at : at + 1] != "=":
            raise Refusal(3)

    def _write(self, line: str) -> None:
        """Store `$number=value`."""
        firmware, eeprom = self._firmware, self._firmware.eeprom
        number, at = read_number(line, 1)
        if line[at : at + 1] != "=":
            raise Refusal(3)
        value, at = read_number(line, at + 1)
        if at < len(line) or number > MOST_SETTINGS:
            raise Refusal(3)
        steps_before = eeprom.steps_per_unit
        eeprom.write(int(number), value)
        if int(number) == INCHES:
            firmware.counters.offset = 0
        if eeprom.steps_per_unit != steps_before:  # the steps that were counted mean other places
            places = firmware.motion.place(firmware.begin_s())
            changed = zip(places, steps_before, eeprom.steps_per_unit, strict=True)
            firmware.motion.set_places(
                firmware.begin_s(),
                {axis: place * before / now for axis, (place, before, now) in enumerate(changed)},
            )

    def _restore(self, rest: str) -> None:
        firmware, eeprom = self._firmware, self._firmware.eeprom
        if rest not in ("ST=$", "ST=#", "ST=*"):
            raise Refusal(3)
        if rest[-1] in "$*":
            eeprom.restore_settings()
        if rest[-1] in "#*":
            eeprom.restore_offsets()
        if rest[-1] == "*":
            eeprom.restore_texts()
        firmware.remark("Restoring defaults")
        self._resets_after_answer = True

    def _offset_changes(self) -> Run:
        """Wait for all motion, and tell the work offset in the next report."""
        if self._firmware.state != State.CHECK:
            yield from self._firmware.synchronise()
        self._firmware.counters.offset = 0

    def _act(self, block: gcode.Block) -> Run:
        """Do what a non-modal word says."""
        firmware = self._firmware
        state, eeprom = firmware.parser, firmware.eeprom
        if block.written is not None:
            index, offset = block.written
            yield from self._offset_changes()
            eeprom.offsets[index] = offset
            if index == state.modal.system - 54:
                state.system = list(offset)
            yield from firmware.delay(EEPROM_S)
        elif block.home is not None:
            if block.use:
                yield from self._line(block.target, replace(block, modal=replace(block.modal, motion=0)))
            yield from self._line(block.home, replace(block, modal=replace(block.modal, motion=0)))
            if not firmware.is_aborted:
                state.position = list(block.home)
                block.use = ""
        elif block.action in (gcode.SET_28, gcode.SET_30):
            eeprom.offsets[int(block.action)] = list(state.position)
        elif block.action in (gcode.SET_G92, gcode.CLEAR_G92):
            yield from self._offset_changes()
            state.g92 = list(block.target) if block.action == gcode.SET_G92 else [0.0] * eeprom.n_axes
            if block.action == gcode.SET_G92:
                block.use = ""

    def _jog(self, block: gcode.Block) -> Run:
        firmware = self._firmware
        if firmware.eeprom.flag(SOFT_LIMITS) and self._is_beyond(block.target):
            raise Refusal(15)
        yield from self._plan(block.target, block.feed / 60, is_jog=True)
        if firmware.is_aborted:
            return
        if firmware.state == State.IDLE and not firmware.motion.is_empty:
            firmware.state = State.JOG
            firmware.motion.begin(firmware.begin_s())
        firmware.parser.position = list(block.target)

    def _line(self, target: list[float], block: gcode.Block) -> Run:
        firmware = self._firmware
        if firmware.eeprom.flag(SOFT_LIMITS) and self._is_beyond(target):
            yield from self._refuse_target()
            return
        if firmware.state == State.CHECK:
            return
        feed: float | None = None
        if block.modal.motion != 0:
            feed = block.feed / 60
            if block.modal.feed == 93:
                feed *= math.dist(firmware.parser.position, target)
        yield from self._plan(target, feed, is_jog=False)

    def _plan(self, target: list[float], feed: float | None, *, is_jog: bool) -> Run:
        firmware = self._firmware
        yield from firmware.wait_for_room()
        line = Line(tuple(firmware.parser.position), tuple(target), feed, is_jog=is_jog)
        least = min(0.5 / steps for steps in firmware.eeprom.steps_per_unit)
        if firmware.is_aborted or line.length < least:
            return
        firmware.motion.add(firmware.begin_s(), line)
        if firmware.moves():
            firmware.motion.begin(firmware.begin_s())

    def _is_beyond(self, target: list[float]) -> bool:
        travels = (self._firmware.eeprom.values[TRAVEL + axis] for axis in range(len(target)))
        return any(place > 0 or place < -travel for place, travel in zip(target, travels, strict=True))

    def _refuse_target(self) -> Run:
        """A target beyond the travel: brake, then alarm, and nothing more until a reset."""
        firmware = self._firmware
        if firmware.state == State.RUN:
            yield from firmware.brake_to_idle()
            if firmware.is_aborted:
                return
        firmware.reset_now()
        firmware.alarm = SOFT_LIMIT
        yield from firmware.realtime()

    def _flow(self, flow: int) -> Run:
        firmware = self._firmware
        yield from firmware.synchronise()
        if firmware.is_aborted:
            return
        if flow == 0:
            if firmware.state != State.CHECK:
                firmware.flags.add("hold")
                yield from firmware.realtime()
            return
        state = firmware.parser
        state.modal = gcode.Modal(motion=1, units=state.modal.units)
        if firmware.state != State.CHECK:
            state.system = list(firmware.eeprom.offsets[0])
            firmware.counters.offset = 0
            firmware.accessories = (5, 9)
        firmware.remark("Pgm End")

    def _home(self, rest: str) -> Run:
        firmware, eeprom = self._firmware, self._firmware.eeprom
        if not eeprom.flag(HOMING):
            raise Refusal(5)
        if rest:
            raise Refusal(3)
        firmware.state = State.HOME
        begin_s = firmware.begin_s()
        distances = dict.fromkeys(range(eeprom.n_axes), eeprom.values[PULL_OFF])
        side = eeprom.homing_side(firmware.index)
        distances[firmware.index] = firmware.motor.to_switch(begin_s, side)
        if math.isinf(distances[firmware.index]):
            distances = dict.fromkeys(distances, math.inf)
        cycle = HomingCycle(eeprom, begin_s, distances, firmware.closed)
        if firmware.motor.drive(cycle.way(firmware.index, begin_s)):
            distances[firmware.index] = math.inf  # it stalls before the switch, and searches on
            cycle = HomingCycle(eeprom, begin_s, distances, firmware.closed)
        yield from firmware.until_reset_or(cycle.ends_s)
        alarm = cycle.alarm
        if firmware.flags & {"door", "reset"}:
            alarm = DOOR_IN_HOMING if "door" in firmware.flags else RESET_IN_HOMING
        firmware.motion.set_places(firmware.begin_s(), cycle.places(firmware.at_s))
        if alarm is not None:
            firmware.alarm = alarm
            firmware.reset_now()
        yield from firmware.realtime()
        if firmware.is_aborted:
            return
        firmware.parser.position = firmware.motion.place(firmware.begin_s())
        firmware.state = State.IDLE
        yield from firmware.delay(firmware.idle_delay_s())
        yield from self.run_startup()


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

    `eeprom` has rates, pull-off and sides. `distances` are units from each axis to its switch, infinite where
    none closes; `closed` are axes whose switch is held closed.

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
            side = self._eeprom.homing_side(axis)
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
        hit_s = segment.reach_s(side, left)
        return [*cut, *([segment] if left > 0 else []), Segment(hit_s, side * distance)]
    return cut
