"""The driver of boards that run a public sketch and print text (CONTRACT 3.2).

`SketchReader` turns bytes into whole records, `SketchSamples` turns records into samples, `SketchBoard` is
the board on its port.
"""

import re
from collections import Counter, deque
from typing import Self

import numpy as np

from calrig.instruments.boards.reader import ReadBoard
from calrig.instruments.boards.sketch import Sketch
from calrig.instruments.cancellation import raise_if_cancelled
from calrig.instruments.device import recognise
from calrig.instruments.drivers import known_devices
from calrig.instruments.errors import BoardError
from calrig.instruments.ports import Port, open_port
from calrig.instruments.types import BoardIdentity, FloatArray, Samples

LONGEST_LINE = 256
STRANGE_KEPT = 20
Record = tuple[float, ...]


class SketchReader:
    """Takes bytes as they come, cut anywhere, and gives the records that are whole.

    A record enters only if each of its lines has the sketch's form to the character, ends CR LF, follows the
    line before, and no number is beyond its bounds. A line that is neither that nor something the sketch
    says is dropped and counted as `unparsed`, once a record has come: before, it may be half a line or a
    banner.

    `sketch` is what the board is said to run; `faults` are counts by kind, a remark of the board's is
    `board_error`.

    Attributes:
        last_words: what it last said of trouble.
        strange: the last lines since a record that are none of the sketch's.
    """

    def __init__(self, sketch: Sketch, faults: Counter[str]) -> None:
        self.last_words = ""
        self._sketch = sketch
        self._faults = faults
        self._tail = b""
        self._numbers: list[float] = []
        self._place = 0  # of the line awaited in its record
        self._in_stream = False
        self.strange: deque[str] = deque(maxlen=STRANGE_KEPT)
        self._since_record = Counter[str]()

    def feed(self, data: bytes) -> list[Record | None]:
        """Return the records completed by `data`, with None where the board was reset between them.

        Raises:
            BoardError: it says that it stops, and why.
        """
        self._since_record["bytes"] += len(data)
        self._since_record["no text"] += sum(byte > 0x7E or byte < 0x09 for byte in data)
        *lines, self._tail = (self._tail + data).split(b"\n")
        found: list[Record | None] = []
        for line in lines:
            if len(line) <= LONGEST_LINE:
                self._take(line.decode("latin-1"), found)
            else:
                self._drop("")
        self._heed_last_words(self._tail.decode("latin-1"))
        if len(self._tail) > LONGEST_LINE:
            self._tail = b""
            self._drop("")
        return found

    def begin_anew(self) -> bool:
        """Drop half a line, in which a reset made the board fall silent; return whether a record had come."""
        if self._tail or self._place:
            self._drop(self._tail.decode("latin-1"))
        self._tail, was_in_stream, self._in_stream = b"", self._in_stream, False
        return was_in_stream

    @property
    def n_strange(self) -> int:
        """How many bytes have come since the last record."""
        return self._since_record["bytes"]

    @property
    def garbled(self) -> bool:
        """Whether what came since the last record is no text."""
        return self._since_record["no text"] * 10 > self._since_record["bytes"]

    def _take(self, line: str, found: list[Record | None]) -> None:
        text = line.removesuffix("\r")
        whole = text != line
        self._heed_last_words(text)
        if whole and self._continues(text):
            if self._place == len(self._sketch.lines):
                found.append(tuple(self._numbers))
                self._begin_record()
                self._in_stream = True
                self.strange.clear()
                self._since_record.clear()
        elif _says(self._sketch.banner, text):
            if self._in_stream:
                found.append(None)
            self._begin_record()
            self._in_stream = False
        elif _says(self._sketch.remarks, text):
            self.last_words = text.strip()
            self._faults["board_error"] += 1
        elif text or self._place:
            self._drop(text)
            if whole:
                self._continues(text)  # as the first of a record, where the one before was cut short

    def _continues(self, text: str) -> bool:
        """Whether the line is the one that comes next; its numbers are kept."""
        matched = self._sketch.lines[self._place].fullmatch(text)
        if matched is None:
            return False
        numbers = [float(number) for number in matched.groups()]
        bounds = self._sketch.bounds[len(self._numbers) :]
        if any(abs(number) > bound for number, bound in zip(numbers, bounds, strict=False)):
            return False
        self._numbers += numbers
        self._place += 1
        return True

    def _drop(self, text: str) -> None:
        self._begin_record()
        if text:
            self.strange.append(text)
        if self._in_stream:
            self._faults["unparsed"] += 1

    def _begin_record(self) -> None:
        self._numbers, self._place = [], 0

    def _heed_last_words(self, text: str) -> None:
        said = self._sketch.stops and self._sketch.stops.search(text)
        if said:
            raise BoardError(
                f"the board says {said[0]!r} and stops: its sensor does not answer, or is a clone whose "
                "WHO_AM_I is not 0x68; check the sensor's wires and chip, then reset the board"
            )


def _says(pattern: re.Pattern[str] | None, text: str) -> bool:
    return pattern is not None and pattern.search(text) is not None


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
        """Continue after a reset of the board."""
        self._last, self._held, self.frozen_s = (), [], 0.0

    def push(self, records: list[tuple[float, Record]]) -> Samples:
        """The valid samples among some records and those held back before.

        `records` have each its time in s, strictly increasing.
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


READ_TIMEOUT_S = 0.004
"""How long a read gathers: so far is a record's time off."""
BACKLOG_BYTES = 1000
"""A read this large waited in the system: its lines, and those right behind, say nothing of the rate."""
LOOK_AGAIN_S = 0.5
MEASURE_S = 1.0
MEASURE_RECORDS = 3
SILENCE_S = 4.0
"""Longer than the 3 s that a board may take from a reset to its first line."""
QUIET_S = 2.0
RESET_S = 0.5
"""No boot loader takes less."""
USELESS_S = 2.0
TICK_S = 1e-6
ANOTHERS_LINES = 3
"""So many lines of another device tell it."""
NO_SENSOR = "all its values are 0: no sensor answers the board; check the wires between them"
FROZEN = "its values do not change: the sensor's bus hangs; switch the board off and on"


class SketchBoard(ReadBoard):
    """One board on a port; a thread reads from the first moment.

    It has no clock, so that a sample's time is that of its arrival: records that come in one read are spread
    evenly between the arrival before and this one. It has no command for a rate or to stop. A reset in the
    middle is counted as `board_reset`; a sketch that takes a new zero then ends the stream.
    """

    def __init__(self, port: Port, sketch: Sketch) -> None:
        super().__init__(port, sketch.driver)
        self._sketch = sketch
        self._reader = SketchReader(sketch, self.faults)
        self._identified = False
        self._samples: SketchSamples | None = None
        self._seen_s: list[float] = []  # arrivals without a break, from which the rate is measured
        self._behind = False
        self._settled_s = 0.0
        self._arrived_s = self._started_s = self._heard_s = self._clock.now_s()
        self._reading.start()

    @classmethod
    def open(cls, url: str, *, sketch: Sketch, baudrate: int | None = None) -> Self:
        """Opens the port (PortError), which resets most boards."""
        return cls(open_port(url, baudrate=baudrate or sketch.baudrate, timeout_s=READ_TIMEOUT_S), sketch)

    def identify(self) -> BoardIdentity:
        """Waits until records have come for a second, and measures their rate.

        Raises:
            BoardError: they do not come; says what comes instead.
            PortError: the port went away.
        """
        with self._news:
            self._identified, self._seen_s = False, []
            deadline_s = self._clock.now_s() + self._sketch.starts_in_s + MEASURE_S
            while not self._measured:
                raise_if_cancelled()
                if self._clock.now_s() > deadline_s or self._looks_like:
                    raise BoardError(f"{self._name} sent no record that can be read: {self._why_none()}")
                if self._sketch.wake and not self._seen_s:
                    self._port.write(self._sketch.wake)
                self._news.wait_for(lambda: self._measured or self._failure, LOOK_AGAIN_S)
                self._raise_failure()
            self._identified = True
            del self.faults["unparsed"]  # of the time before; what the board said of itself stays
            between_s = (self._seen_s[-1] - self._seen_s[0]) / (len(self._seen_s) - 1)
            accel_range_g, gyro_range_dps = self._sketch.ranges
            return BoardIdentity(
                driver=self._sketch.driver,
                firmware=self._sketch.source,
                serial="",
                chip="MPU-6050" if self._sketch.checks_chip else None,
                accel_range_g=accel_range_g,
                gyro_range_dps=gyro_range_dps,
                max_rate_hz=None,
                rate_hz=round(1 / between_s, 2),
                sends_rates=self._sketch.gyro is not None and self._sketch.accel is not None,
            )

    def start(self, rate_hz: int) -> None:  # noqa: ARG002 (it has one rate)
        """Takes its samples from here on, at the rate it has.

        Raises:
            BoardError: not identified.
        """
        with self._news:
            if not self._identified:
                raise BoardError(f"{self._name} must be identified before it is started")
            self._blocks.clear()
            self._samples = SketchSamples(self._sketch, self.faults)
            self._started_s = self._arrived_s = self._clock.now_s()

    def mark(self) -> None:
        """Nothing: it cannot be asked."""

    @property
    def marked(self) -> bool:
        """Always: a sample's time is that of its arrival."""
        return True

    def stop(self) -> None:
        """Takes no more samples; what came before can be taken."""
        with self._news:
            self._samples = None

    @property
    def _looks_like(self) -> str | None:
        """The driver of the device whose lines come instead."""
        if len(self._reader.strange) < ANOTHERS_LINES:
            return None
        devices = known_devices()
        told = [recognise(f"{line}\n".encode("latin-1"), devices) for line in self._reader.strange]
        votes = Counter(sender.device.driver for sender in told if sender)
        del votes[self._sketch.driver]
        driver, count = max(votes.items(), key=lambda vote: vote[1], default=("", 0))
        return driver if count >= ANOTHERS_LINES else None

    @property
    def _measured(self) -> bool:
        seen_s = self._seen_s
        return len(seen_s) >= MEASURE_RECORDS and seen_s[-1] - seen_s[0] >= MEASURE_S

    def _listen(self) -> None:
        while not self._closing.is_set():
            data = self._port.read(65536)
            if data:
                with self._news:
                    self._digest(data, max(self._clock.now_s(), self._arrived_s + TICK_S))
                    self._news.notify_all()

    def _digest(self, data: bytes, now_s: float) -> None:
        silent_s, self._heard_s = now_s - self._heard_s, now_s
        found: list[Record | None] = []
        # After a long silence few bytes are a reset's; many have waited, because this process slept.
        if self._sketch.is_mute_at_reset and silent_s > RESET_S and len(data) < BACKLOG_BYTES:
            found = [None] if self._reader.begin_anew() else []
        try:
            found += self._reader.feed(data)
        except BoardError as error:  # of lines, which know no port
            raise BoardError(f"{self._name}: {error}") from error
        self._behind = len(data) >= BACKLOG_BYTES or (self._behind and len(found) > 1)
        if self._behind:
            self._seen_s.clear()
        if None in found:
            self._begin_anew(now_s)
            self._arrived_s = max(self._arrived_s, now_s - READ_TIMEOUT_S)  # none came in the silence before
            found = found[len(found) - found[::-1].index(None) :]
        records = [record for record in found if record is not None]
        if not records:
            return
        step_s = (now_s - self._arrived_s) / len(records)
        times_s = [self._arrived_s + step_s * (k + 1) for k in range(len(records))]
        self._arrived_s = times_s[-1]
        if not self._identified and not self._behind:
            self._seen_s += times_s
        self._keep(times_s, records)

    def _keep(self, times_s: list[float], records: list[Record]) -> None:
        if self._samples is None or times_s[-1] < self._settled_s:
            return
        since_start_s = [time_s - self._started_s for time_s in times_s]
        block = self._samples.push(list(zip(since_start_s, records, strict=True)))
        if len(block):
            self._blocks.append(block)

    def _begin_anew(self, now_s: float) -> None:
        self._settled_s = now_s + self._sketch.settles_s
        if not self._identified:
            self._seen_s.clear()
            return
        self.faults["board_reset"] += 1
        if self._sketch.zeroes_at_reset:
            raise BoardError(
                f"{self._name} was reset while it streamed, and its sketch takes its zero anew at every "
                "start: what came before and after does not belong together; "
                "check power and cable, then run again"
            )
        if self._samples is not None:
            self._samples.restart()

    def _check_health(self) -> None:
        if self._samples is None:
            return
        silent_s = self._clock.now_s() - self._arrived_s
        frozen_s = self._samples.frozen_s
        if frozen_s > max(USELESS_S, self._sketch.frozen_after_s):
            useless_s, why = frozen_s, NO_SENSOR if self._samples.reads_zero else FROZEN
        elif silent_s > SILENCE_S:
            useless_s, why = silent_s, self._why_none()
        else:
            return
        raise BoardError(f"{self._name} has sent no usable sample for {useless_s:.1f} s: {why}")

    def _why_none(self) -> str:
        sketch, reader = self._sketch, self._reader
        said = f"; its last words were {reader.last_words!r}" if reader.last_words else ""
        if self._clock.now_s() - self._heard_s > QUIET_S or not reader.n_strange:
            mute = f" ({sketch.mute})" if sketch.mute else ""
            return f"it is silent: is it powered, and on this port?{mute}{said}"
        if other := self._looks_like:
            return f"its lines are another device's; it looks like driver {other!r}"
        if reader.garbled:
            return f"what comes is no text: wrong baud rate? As published it sends at {sketch.baudrate} baud"
        return (
            f"{reader.n_strange} bytes came and no whole line of {sketch.source} ({sketch.pace}): "
            f"is another sketch on the board, or the cable bad?{said}"
        )
