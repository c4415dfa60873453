"""Boards that run a public sketch and print text: what calrig needs to know of one, as a record.

The facts come from the sketches' own sources (repository and path in `source`). Serial.print gives a float
two decimals, so a line's form is known to the character; println ends it CR LF. `public_sketches` has one
record of each, which `board_device` turns into a device; `sketch_board` is the driver of all of them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from calrig.instruments.device import BoardDevice, Identity, Probe

if TYPE_CHECKING:
    from calrig.instruments.boards.sketch_board import SketchBoard

STANDARD_GRAVITY_MPS2 = 9.80665
I16 = r"(0|-?[1-9]\d{0,4})"
FLOAT = r"(-?(?:0|[1-9]\d{0,4})\.\d\d)"
FROZEN_AFTER_S = 3.0
"""Two decimals repeat honestly, but not all of a line's numbers for so long."""


@dataclass(frozen=True, slots=True)
class Sketch:
    """One sketch. Numbers of a record count from 0, through all of its lines.

    Attributes:
        driver: its name in `calrig.toml`.
        source: where it is published.
        baudrate: what it sends at as published.
        pace: how fast it is, in words.
        lines: the lines of one record, each to match wholly, without its CR LF.
        bounds: of each number, how large it can be either way; a larger one shows damage.
        accel, gyro: number of the x axis (y and z follow) and what one unit is in g, in degrees per second.
        temperature: number of the die temperature in °C.
        angle: number of the elevation about x in degrees, filtered on the board.
        ranges: full scale it sets, ±g and ±°/s.
        banner: what its setup prints, found anywhere in a line: the board was reset.
        stops: what it says and then sends nothing, also without an end of line.
        remarks: what it says and goes on.
        mute: why it may send nothing at all.
        is_mute_at_reset: its setup prints nothing that surely tells a reset: a silence as long as a boot
            loader's is taken for one.
        settles_s: how long after such a reset its own filter needs, whose angle is excluded until then.
        checks_chip: it goes on only with the WHO_AM_I of an MPU-6050.
        frozen_after_s: how long equal records may be honest; 0 where two in a row never are.
        zeroes_at_reset: it takes a new zero when it starts, so that what it sends before and after a reset
            does not belong together.
        wake: what it waits for before it starts.
        starts_in_s: from reset to its first record at the latest.
        heard_within_s: how soon a scan that listens has a line of it.

    Raises:
        ValueError: lines, bounds and channels do not fit together; names the driver.
    """

    driver: str
    source: str
    baudrate: int
    pace: str
    lines: tuple[re.Pattern[str], ...]
    bounds: tuple[float, ...]
    accel: tuple[int, float] | None = None
    gyro: tuple[int, float] | None = None
    temperature: int | None = None
    angle: int | None = None
    ranges: tuple[int, int] = (2, 250)
    banner: re.Pattern[str] | None = None
    stops: re.Pattern[str] | None = None
    remarks: re.Pattern[str] | None = None
    mute: str = ""
    is_mute_at_reset: bool = False
    settles_s: float = 0.0
    checks_chip: bool = False
    frozen_after_s: float = FROZEN_AFTER_S
    zeroes_at_reset: bool = False
    wake: bytes = b""
    starts_in_s: float = 6.0
    heard_within_s: float = 0.5

    def __post_init__(self) -> None:
        n_numbers = sum(form.groups for form in self.lines)
        if not n_numbers:
            raise self._refused("its lines have no number")
        if len(self.bounds) != n_numbers:
            raise self._refused(f"its lines have {n_numbers} numbers, and bounds has {len(self.bounds)}")
        if self.accel is None and self.angle is None:
            raise self._refused("neither accel nor angle is given: no elevation follows from its lines")
        for channel, first, count in (
            ("accel", self.accel and self.accel[0], 3),
            ("gyro", self.gyro and self.gyro[0], 3),
            ("temperature", self.temperature, 1),
            ("angle", self.angle, 1),
        ):
            if first is not None and not 0 <= first <= n_numbers - count:
                raise self._refused(
                    f"{channel} takes {count} from number {first} on; its lines have 0 to {n_numbers - 1}"
                )

    def _refused(self, why: str) -> ValueError:
        return ValueError(f"sketch {self.driver!r}: {why}")

    def prints(self, line: str) -> bool:
        """Whether a line is one of its record, or has words that its setup prints."""
        if any(form.fullmatch(line) for form in self.lines):
            return True
        has_words = any(character.isalpha() for character in line)  # anybody may draw a line of `=`
        return has_words and self.banner is not None and self.banner.search(line) is not None


def line_forms(*lines: str) -> tuple[re.Pattern[str], ...]:
    """Return the patterns of lines in which `#` is an i16 and `%` a float."""
    return tuple(
        re.compile(re.escape(line).replace(r"\#", I16).replace("%", FLOAT), re.ASCII) for line in lines
    )


def board_device(sketch: Sketch) -> BoardDevice:
    """The device that a board with this sketch is. It speaks unasked, and is asked nothing."""

    def opens(url: str, *, baudrate: int | None) -> SketchBoard:
        from calrig.instruments.boards.sketch_board import SketchBoard

        return SketchBoard.open(url, sketch=sketch, baudrate=baudrate)

    def identity(_: Sequence[str]) -> Identity:
        return Identity(sketch.source)

    return BoardDevice(
        driver=sketch.driver,
        title=sketch.source,
        baudrate=sketch.baudrate,
        opens=opens,
        may_stay_open=not sketch.zeroes_at_reset,
        probes=(Probe(sketch.baudrate, sketch.heard_within_s),),
        matches=sketch.prints,
        identity=identity,
        version_query=b"",
    )
