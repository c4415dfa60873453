"""G-code as GRBL 1.1h checks it: in its order, with its error numbers (gcode.c, steps 1 to 3).

A line is parsed into a `Block` or refused whole; nothing of a refused one stays in force. Probing (G38)
is refused as unsupported, since no probe is wired; an arc is checked and then taken as its chord.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

MM_PER_INCH = 25.4
MOST_DIGITS = 8
MOST_TOOLS = 255
MOST_LINES = 10_000_000
TLO_AXIS = 2
N_SYSTEMS = 6
GROUPS = {
    **dict.fromkeys((4, 10, 28, 30, 53, 92), 0),
    **dict.fromkeys((0, 1, 2, 3, 80), 1),
    **dict.fromkeys((17, 18, 19), 2),
    **dict.fromkeys((90, 91), 3),
    **dict.fromkeys((93, 94), 5),
    **dict.fromkeys((20, 21), 6),
    40: 7,
    **dict.fromkeys((43, 49), 8),
    **dict.fromkeys(range(54, 60), 12),
    61: 13,
}
"""Modal group of a G word."""
VARIANTS = {**dict.fromkeys((28, 30, 91, 92), (0, 10)), 43: (10,), 61: (0,), 90: (0,)}
"""Decimals, in hundredths, with which some G words are known at all."""
NON_MODAL, DISTANCE, ARC_DISTANCE, UNITS, SYSTEM = 0, 3, 4, 6, 12
M_GROUPS = {**dict.fromkeys((0, 1, 2, 30), 104), **dict.fromkeys((3, 4, 5), 107), 8: 108, 9: 108}
NOT_NEGATIVE = set("FNPTS")
SET_SYSTEM, GO_28, GO_30, SET_28, SET_30, SET_G92, CLEAR_G92 = 10.0, 28.0, 30.0, 28.1, 30.1, 92.0, 92.1
DWELL, MACHINE = 4.0, 53.0


class Refusal(Exception):  # noqa: N818 (an answer of the dialect, caught where it is sent)
    """A line is answered with `error:` and this number."""

    def __init__(self, number: int) -> None:
        self.number = number


def read_number(text: str, start: int) -> tuple[float, int]:
    """Read a number by GRBL's own routine (nuts_bolts.c); return it and the index after it.

    No exponent passes it, and no ninth digit. Leading zeros count as digits. From the ninth on, they are
    zeros before the decimal point, nothing after.

    Raises:
        Refusal: there is no digit (2, bad number format).
    """
    at, sign, digits, exponent, n_digits, after_point = start, 1.0, 0, 0, 0, False
    if text[at : at + 1] in ("-", "+") and text[at : at + 1]:
        sign = -1.0 if text[at] == "-" else 1.0
        at += 1
    while at < len(text):
        if text[at] in "0123456789":
            n_digits += 1
            if n_digits <= MOST_DIGITS:
                exponent -= after_point
                digits = digits * 10 + int(text[at])
            else:
                exponent += not after_point
        elif text[at] == "." and not after_point:
            after_point = True
        else:
            break
        at += 1
    if not n_digits:
        raise Refusal(2)
    return sign * (digits * 10.0**exponent if exponent > 0 else digits / 10.0**-exponent), at


@dataclass(frozen=True)
class Modal:
    """The words that stay in force from one line to the next, by the number of each."""

    motion: int = 0
    system: int = 54
    plane: int = 17
    units: int = 21
    distance: int = 90
    feed: int = 94
    spindle: int = 5
    coolant: int = 9


@dataclass
class ParserState:
    """What a line leaves behind, in units and machine coordinates.

    Attributes:
        position: where the last accepted line leads.
        system: the work coordinate system in force.
        tlo: tool length offset, of Z.
    """

    n_axes: int
    modal: Modal = Modal()
    feed: float = 0.0
    speed: float = 0.0
    tool: int = 0
    tlo: float = 0.0
    position: list[float] = field(default_factory=list)
    system: list[float] = field(default_factory=list)
    g92: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        for place in (self.position, self.system, self.g92):
            place.extend([0.0] * (self.n_axes - len(place)))

    @property
    def offset(self) -> list[float]:
        """Work zero in machine coordinates, as `WCO` tells it."""
        sums = [system + g92 for system, g92 in zip(self.system, self.g92, strict=True)]
        sums[TLO_AXIS] += self.tlo
        return sums


@dataclass
class Block:
    """A line that was accepted, ready to be executed."""

    modal: Modal
    feed: float = 0.0
    speed: float = 0.0
    tool: int = 0
    dwell_s: float = 0.0
    action: float | None = None
    """The non-modal word, such as 28.1."""
    use: str = ""
    """What axis words are for: `motion`, `action`, `tlo`, or nothing."""
    target: list[float] = field(default_factory=list)
    system: list[float] = field(default_factory=list)
    """The coordinate system in force from here on."""
    written: tuple[int, list[float]] | None = None
    """Of G10: which system, and what it becomes."""
    home: list[float] | None = None
    """Of G28 and G30: where the second motion leads."""
    tlo: float | None = None
    flow: int | None = None


class _Words:
    """The words of one line."""

    def __init__(self, modal: Modal, axes: str) -> None:
        self.modal = modal
        self.axes = axes
        self.action: float | None = None
        self.use = ""
        self.tlo: int | None = None
        self.flow: int | None = None
        self.groups: set[int] = set()
        self.values: dict[str, float] = {}

    def read(self, line: str) -> None:
        """Take in the words in their order (Refusal at the first one that is wrong)."""
        at = 0
        while at < len(line):
            letter = line[at]
            if not "A" <= letter <= "Z":
                raise Refusal(1)
            value, at = read_number(line, at + 1)
            if letter == "G":
                self._g(value)
            elif letter == "M":
                self._m(value)
            else:
                self._value(letter, value)

    def axis_values(self) -> dict[int, float]:
        """The numbers after axis letters, by axis."""
        return {index: self.values[letter] for index, letter in enumerate(self.axes) if letter in self.values}

    def _claim(self, use: str) -> None:
        if self.use:
            raise Refusal(24)
        self.use = use

    def _g(self, value: float) -> None:
        number = int(value) & 0xFF
        hundredths = round(100 * (value - int(value)))
        group = GROUPS.get(number)
        if group is None:
            raise Refusal(20)
        group, allowed = self._variant(number, group, hundredths)
        if hundredths != allowed:
            raise Refusal(23)
        if group == NON_MODAL:
            self.action = number + hundredths / 100
        elif group != ARC_DISTANCE:
            names = {1: "motion", 2: "plane", 3: "distance", 5: "feed", 6: "units", 12: "system"}
            if group in names:
                self.modal = replace(self.modal, **{names[group]: number})
        self._once(group)

    def _variant(self, number: int, group: int, hundredths: int) -> tuple[int, int]:
        """Claim the axis words for a G word that uses them; its group, and the decimals that it may have."""
        if (number in (10, 28, 30, 92) and not hundredths) or (group == 1 and number != 80):
            self._claim("action" if group == NON_MODAL else "motion")
        elif group == 8:
            self._claim("tlo")
            self.tlo = number
        if hundredths not in VARIANTS.get(number, (hundredths,)):
            raise Refusal(20)
        if group == DISTANCE and hundredths:
            group = ARC_DISTANCE
        return group, hundredths if number in (28, 30, 43, 49, 91, 92) else 0

    def _m(self, value: float) -> None:
        number = int(value) & 0xFF
        if value != int(value):
            raise Refusal(23)
        if number not in M_GROUPS:
            raise Refusal(20)
        if M_GROUPS[number] == 104:
            self.flow = None if number == 1 else number
        elif M_GROUPS[number] == 107:
            self.modal = replace(self.modal, spindle=number)
        else:
            self.modal = replace(self.modal, coolant=number)
        self._once(M_GROUPS[number])

    def _once(self, group: int) -> None:
        if group in self.groups:
            raise Refusal(21)
        self.groups.add(group)

    def _value(self, letter: str, value: float) -> None:
        if letter == "T" and value > MOST_TOOLS:
            raise Refusal(38)
        if letter not in "FIJKLNPRST" + self.axes:
            raise Refusal(20)
        if letter in self.values:
            raise Refusal(25)
        if letter in NOT_NEGATIVE and value < 0:
            raise Refusal(4)
        self.values[letter] = value


def parse(
    line: str, state: ParserState, offsets: Mapping[int, list[float]], axes: str, *, is_jog: bool
) -> Block:
    """Check a line against what is in force.

    `line` is in upper case, without blanks and comments; of a jog, what follows `$J=`. `offsets` are stored
    coordinate systems (0 to 5) and the places of G28 and G30, `axes` the letters of the axes that there are.

    Raises:
        Refusal: the line is not executed.
    """
    modal = replace(state.modal, motion=1, feed=94) if is_jog else state.modal
    words = _Words(modal, axes)
    words.read(line)
    values, modal = words.values, words.modal
    axis_values = words.axis_values()
    use = words.use or ("motion" if axis_values else "")
    if values.get("N", 0) > MOST_LINES:
        raise Refusal(27)
    block = Block(modal, action=words.action, flow=words.flow, tool=int(values.get("T", 0)))
    inches = MM_PER_INCH if modal.units == 20 else 1.0
    block.feed = _feed(values, state, modal, use, inches, is_jog=is_jog)
    block.speed = values.get("S", state.speed)
    used = set("NF") if is_jog else set("NFST")
    if words.action == DWELL:
        if "P" not in values:
            raise Refusal(28)
        block.dwell_s = values["P"]
        used.add("P")
    axis_values = {axis: value * inches for axis, value in axis_values.items()}
    block.tlo = _tool_length(words.tlo, axis_values)
    block.system = state.system
    if SYSTEM in words.groups and modal.system != state.modal.system:
        block.system = offsets[modal.system - 54]
    if words.action == SET_SYSTEM:
        block.written = _written(values, axis_values, state, modal, offsets)
        used |= {"L", "P"}
    elif words.action == SET_G92:
        if not axis_values:
            raise Refusal(26)
        block.target = _from_here(state, block.system, axis_values, state.g92)
    else:
        use = _aim(block, use, axis_values, state, offsets)
    use = _check_motion(block, use, values, axis_values, state, inches, used)
    if use or words.use == "action":
        used |= set(axes)
    if set(values) - used:
        raise Refusal(36)
    if is_jog and (words.groups - {NON_MODAL, DISTANCE, UNITS} or words.action not in (None, MACHINE)):
        raise Refusal(16)
    block.use = use
    return block


def _tool_length(number: int | None, axis_values: Mapping[int, float]) -> float | None:
    if number is None:
        return None
    if number == 43 and set(axis_values) != {TLO_AXIS}:
        raise Refusal(37)
    return axis_values[TLO_AXIS] if number == 43 else 0.0


def _feed(
    values: Mapping[str, float], state: ParserState, modal: Modal, use: str, inches: float, *, is_jog: bool
) -> float:
    if is_jog:
        if "F" not in values:
            raise Refusal(22)
        return values["F"] * inches
    if modal.feed == 93:
        if use == "motion" and modal.motion not in (0, 80) and "F" not in values:
            raise Refusal(22)
        return values.get("F", 0.0)
    if state.modal.feed == 93:
        return values.get("F", 0.0)
    return values["F"] * inches if "F" in values else state.feed


def _from_here(
    state: ParserState, system: list[float], axis_values: Mapping[int, float], others: list[float]
) -> list[float]:
    """Return the offset that makes the present position read as given; other axes keep theirs."""
    result = list(others)
    for axis, value in axis_values.items():
        result[axis] = state.position[axis] - system[axis] - value
        if axis == TLO_AXIS:
            result[axis] -= state.tlo
    return result


def _written(
    values: Mapping[str, float],
    axis_values: Mapping[int, float],
    state: ParserState,
    modal: Modal,
    offsets: Mapping[int, list[float]],
) -> tuple[int, list[float]]:
    if not axis_values:
        raise Refusal(26)
    if "P" not in values and "L" not in values:  # one of the two passes, as in the firmware
        raise Refusal(28)
    number = int(values.get("P", 0))
    if number > N_SYSTEMS:
        raise Refusal(29)
    kind = int(values.get("L", 0))
    if kind not in (2, 20) or (kind == 2 and "R" in values):
        raise Refusal(20)
    index = number - 1 if number else modal.system - 54
    stored = list(offsets[index])
    if kind == 20:
        return index, _from_here(state, state.g92, axis_values, stored)
    for axis, value in axis_values.items():
        stored[axis] = value
    return index, stored


def _aim(
    block: Block,
    use: str,
    axis_values: Mapping[int, float],
    state: ParserState,
    offsets: Mapping[int, list[float]],
) -> str:
    """Turn axis words into a target in machine coordinates."""
    block.target = list(state.position)
    if use != "tlo":
        for axis, value in axis_values.items():
            if block.action == MACHINE:
                block.target[axis] = value
            elif block.modal.distance == 91:
                block.target[axis] += value
            else:
                block.target[axis] = value + block.system[axis] + state.g92[axis]
                if axis == TLO_AXIS:
                    block.target[axis] += state.tlo
    if block.action in (GO_28, GO_30):
        stored = offsets[int(block.action)]
        block.home = list(stored)
        if not axis_values:
            return ""
        for axis in range(state.n_axes):
            if axis not in axis_values:
                block.home[axis] = state.position[axis]
    elif block.action == MACHINE and block.modal.motion not in (0, 1):
        raise Refusal(30)
    return use


def _check_motion(
    block: Block,
    use: str,
    values: Mapping[str, float],
    axis_values: Mapping[int, float],
    state: ParserState,
    inches: float,
    used: set[str],
) -> str:
    motion = block.modal.motion
    if motion == 80:
        if axis_values:
            raise Refusal(31)
        return use
    if use != "motion":
        return use
    if motion and not block.feed:
        raise Refusal(22)
    if motion in (0, 1):
        return use if axis_values else ""
    _check_arc(block, values, axis_values, state, inches, used)
    return use


def _check_arc(
    block: Block,
    values: Mapping[str, float],
    axis_values: Mapping[int, float],
    state: ParserState,
    inches: float,
    used: set[str],
) -> None:
    if not axis_values:
        raise Refusal(26)
    first, second = {17: (0, 1), 18: (2, 0), 19: (1, 2)}[block.modal.plane]
    if not {first, second} & set(axis_values):
        raise Refusal(32)
    dx = block.target[first] - state.position[first]
    dy = block.target[second] - state.position[second]
    if "R" in values:
        used.add("R")
        if block.target == state.position:
            raise Refusal(33)
        if 2 * abs(values["R"] * inches) < math.hypot(dx, dy):
            raise Refusal(34)
        return
    centre = ["IJK"[first], "IJK"[second]]
    if not set(centre) & set(values):
        raise Refusal(35)
    used |= set("IJK")
    i, j = (values.get(letter, 0.0) * inches for letter in centre)
    radius = math.hypot(i, j)
    missed = abs(math.hypot(dx - i, dy - j) - radius)
    if missed > 0.005 and (missed > 0.5 or missed > 0.001 * radius):
        raise Refusal(33)
