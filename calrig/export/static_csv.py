"""Static and gravity logs as CSV: one row a sample (CONTRACT section 4), converted to g, deg/s and °C.

A log may have millions of numbers. numpy's parser reads pieces of plain numbers; it does not say where a bad
cell is, and takes some texts for numbers. So any other piece goes through `calrig.export.csv_table`, which is
forty times slower and exact.
"""

import io
import math
import re
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import AXES, STANDARD_GRAVITY_MPS2, FloatArray
from calrig.export.csv_cells import LARGEST
from calrig.export.csv_columns import DID_YOU_MEAN, Column, there_are
from calrig.export.csv_dialect import COMMAS, Dialect
from calrig.export.csv_errors import CsvError
from calrig.export.csv_table import COMMENTS, MAX_ROW_CHARACTERS, Layout, layout_of, read_rows

PIECE_BYTES = 2_000_000
"""Small compared with a log, large compared with the cost of a piece."""
_PLAIN = b"0123456789+-.eE,\nnaNA"
_SIGNED_NAN = (b"-n", b"-N", b"+n", b"+N")


@dataclass(frozen=True, slots=True, eq=False)
class LogTable:
    """The columns of numbers.

    Attributes:
        columns: (N,) each, by place in the header, those that were asked for, in the unit of their name;
            NaN where blank or `nan`.
    """

    layout: Layout
    columns: dict[int, FloatArray]
    _first_rows: list[int]
    _lines: list[Sequence[int]]

    def line_of(self, row: int) -> int:
        """Return the line of a row in the file."""
        piece = bisect_right(self._first_rows, row) - 1
        return self._lines[piece][row - self._first_rows[piece]]


def read_log_table(
    data: bytes,
    wanted: Collection[str],
    *,
    max_rows: int,
    max_bytes: int,
    progress: Callable[[float], None] | None = None,
) -> LogTable:
    """Read the columns whose names are wanted, as `csv_table.read_tables` and `Cells.numbers` would.

    `wanted` are names of columns whose cells must be numbers and are kept; `progress` gets the share read, 0
    to 1.

    Raises:
        CsvError: as they do; says line and column.
    """
    if len(data) > max_bytes:
        raise CsvError(f"the file has {len(data)} bytes; at most {max_bytes} are read")
    layout = layout_of(data, wanted)
    places = [place for place, column in enumerate(layout.columns) if column.is_known]
    most = data.count(b"\n", layout.begin) + data.count(b"\r", layout.begin) + 1
    cells = len(data) - layout.begin
    most = min(most, max_rows, cells // len(layout.columns) + 1)  # a cell takes a byte with its comma
    values = np.empty((len(places), most))
    n, first_rows, lines = 0, [], []
    with layout.report as report:
        for end, read, at in _read(data, layout, places):
            if n + len(at) > max_rows:
                raise CsvError(f"the file has more than {max_rows} rows", line=at[max_rows - n])
            values[:, n : n + len(at)] = read
            first_rows.append(n)
            lines.append(at)
            n += len(at)
            if progress is not None:
                progress(end / len(data))
        if n == 0 and not report.has_faults:
            raise CsvError("the file has a header and no rows", line=layout.header_line)
    columns = {place: values[k, :n] for k, place in enumerate(places)}
    return LogTable(layout, columns, first_rows, lines)


Read = tuple[int, FloatArray, Sequence[int]]
"""Where it ends in the file, its (columns, rows) numbers, and the line of each row."""


def _read(data: bytes, layout: Layout, places: list[int]) -> Iterator[Read]:
    first, line = layout.begin, layout.first_line
    is_quoted = data.find(b'"', first) >= 0
    if is_quoted or data.count(b"\r") != data.count(b"\r\n"):  # lines may end where no LF is, or not there
        yield from _read_exactly(data, layout, first, line, places)
        return
    converted = [(k, layout.columns[place]) for k, place in enumerate(places)]
    converted = [(k, column) for k, column in converted if column.is_converted]
    has_clock = any(layout.columns[place].is_clock for place in places)
    while first < len(data):
        end = data.rfind(b"\n", first, first + PIECE_BYTES) + 1 or data.find(b"\n", first) + 1 or len(data)
        if end - first > max(PIECE_BYTES, 4 * MAX_ROW_CHARACTERS):  # as bytes of UTF-8
            raise CsvError(f"the row is longer than {MAX_ROW_CHARACTERS} characters", line=line)
        piece = data[first:end]
        rows, comments = _without_comments(piece, layout) if b"#" in piece else (piece, [])
        plain = None if has_clock else _plain(rows, len(layout.columns), layout.dialect)
        if plain is not None:
            read = plain.T[places]
            for k, column in converted:
                read[k] = read[k] * column.factor + column.offset
            at: Sequence[int] = range(line, line + len(plain) + len(comments))
            yield end, read, np.delete(at, comments).tolist() if comments else at
            for place in comments:
                layout.report.count(COMMENTS, f"line {line + place}")
        else:
            for _, read, at in _read_exactly(piece, layout, 0, line, places):
                yield end, read, at
        first = end
        line += piece.count(b"\n")


def _without_comments(piece: bytes, layout: Layout) -> tuple[bytes, list[int]]:
    """A piece without its comments, and which of its lines these are."""
    lines = piece.split(b"\n")
    comments = [
        place
        for place, line in enumerate(lines)
        if line[:1] in {b"#", b" "} and layout.is_comment(line.decode(errors="replace"))
    ]
    left_out = set(comments)
    return b"\n".join(line for place, line in enumerate(lines) if place not in left_out), comments


def _read_exactly(data: bytes, layout: Layout, first: int, line: int, places: list[int]) -> Iterator[Read]:
    for table in read_rows(data, layout, first, line):
        numbers = [table.column(place).numbers(layout.report) for place in places]
        read = np.array(numbers, dtype=np.float64).reshape(len(places), len(table.rows))
        yield len(data), read, table.lines


def _plain(piece: bytes, width: int, dialect: Dialect) -> FloatArray | None:
    """(rows, width) numbers, if the piece is nothing but lines of so many plain numbers and blanks."""
    if dialect != COMMAS:
        if (b"," if dialect.decimal == "." else b".") in piece:
            return None
        piece = piece.replace(b",", b".").replace(dialect.separator.encode(), b",")
    text = piece.replace(b"\r\n", b"\n").removesuffix(b"\n")
    if not text.strip(b"\n") or text.translate(None, _PLAIN) or any(sign in text for sign in _SIGNED_NAN):
        return None
    for _ in range(2):  # of three commas in a row, the middle one is of two pairs
        text = text.replace(b",,", b",nan,")
    text = text.replace(b"\n,", b"\nnan,").replace(b",\n", b",nan\n")
    text = b"nan" * text.startswith(b",") + text + b"nan" * text.endswith(b",")
    try:
        values = np.loadtxt(io.BytesIO(text), delimiter=",", comments=None, ndmin=2, encoding="ascii")
    except ValueError:
        return None
    if values.shape != (text.count(b"\n") + 1, width) or np.nanmax(np.abs(values), initial=0.0) > LARGEST:
        return None
    return values


COUNTS = 32768
"""Full scale of a register of 16 bits is the range (CONTRACT section 3.1)."""
MAX_SAMPLES = 20_000_000
"""More than a day at 200 Hz."""
MAX_BYTES = 1_500_000_000
TIME, TEMPERATURE = "time_s", "temperature_c"
_SENSOR = re.compile(r"(accel|gyro)_([xyz])_(g|mps2|dps|rps|lsb)")
_UNITS = {"accel": ("g", "mps2", "lsb"), "gyro": ("dps", "rps", "lsb")}
_KNOWN = (
    TIME,
    *(f"{sensor}_{axis}_{unit}" for sensor, units in _UNITS.items() for axis in AXES for unit in units),
    TEMPERATURE,
)


@dataclass(frozen=True, slots=True, eq=False)
class StaticLog:
    """The samples of a log.

    Attributes:
        channels: (N,) each, in the contract's order, by name with its unit: `accel_x_g`, `gyro_x_dps`,
            `temperature_c`; `accel_x_lsb` where the range of counts is not known. NaN where not known.
        time_s: (N,) as logged: a clock may wrap in it, and NaN is where it is not known; None without any.
        time_flaw: why that cannot be taken for the time that passed, and in which line; empty if it can.
        warnings: what a person should know about how it was read.
        line_of: line of a sample in the file.
    """

    channels: dict[str, FloatArray]
    time_s: FloatArray | None
    time_flaw: str
    warnings: tuple[str, ...]
    line_of: Callable[[int], int]

    def __len__(self) -> int:
        return len(next(iter(self.channels.values())))

    @property
    def forward_time_s(self) -> FloatArray | None:
        """(N,) known and not decreasing; None where the log's time is not so."""
        return None if self.time_flaw else self.time_s

    def axes(self, sensor: str, unit: str) -> FloatArray | None:
        """(N, 3) of `accel` in `g` or `gyro` in `dps`; None unless all three axes are there in this unit."""
        names = [f"{sensor}_{axis}_{unit}" for axis in AXES]
        if not all(name in self.channels for name in names):
            return None
        return np.column_stack([self.channels[name] for name in names])


def read_static(
    data: bytes,
    *,
    accel_range_g: float | None = None,
    gyro_range_dps: float | None = None,
    max_samples: int = MAX_SAMPLES,
    progress: Callable[[float], None] | None = None,
) -> StaticLog:
    """Reads a log of samples.

    `_mps2` becomes g (9.80665 m/s²) and `_rps` deg/s; counts (`_lsb`) become g or deg/s by the range given,
    full scale 32768, and keep name and unit without one. A column that is none of the contract's is left
    out with a warning. A `time_s` that goes backwards or is not known throughout is kept, with its flaw.

    The ranges are full scales of raw counts, in g and in degrees per second. More than `max_samples` are
    refused; `progress` gets the share of the file that has been read, from 0 to 1.

    Raises:
        CsvError: the file is not such a table; says line and column.
        ValueError: a range is not above 0.
    """
    ranges = {"accel": accel_range_g, "gyro": gyro_range_dps}
    _refuse_no_range(ranges)
    table = read_log_table(data, _KNOWN, max_rows=max_samples, max_bytes=MAX_BYTES, progress=progress)
    _refuse_two_units(table.layout.columns, table.layout.header_line)
    channels, time_s, warnings = _channels_of(table, ranges)
    if not channels:
        raise CsvError(
            "there is no channel of a log (accel_x_g, gyro_x_dps, temperature_c, …; also accel_x_mps2, "
            f"gyro_x_rps, accel_x_lsb){_nearly(warnings)}; {there_are(table.layout.texts)}",
            line=table.layout.header_line,
        )
    sensors = ("accel", "gyro", "temperature")
    names = sorted(channels, key=lambda name: (sensors.index(name.partition("_")[0]), name))
    ordered = {name: channels[name] for name in names}
    flaw = "" if time_s is None else _flaw_of(time_s, table)
    return StaticLog(ordered, time_s, flaw, tuple(warnings), table.line_of)


def _refuse_no_range(ranges: Mapping[str, float | None]) -> None:
    for sensor, full_scale in ranges.items():
        if full_scale is not None and not (math.isfinite(full_scale) and full_scale > 0.0):
            raise ValueError(f"the range of the {sensor} is {full_scale}; it must be above 0")


def _channels_of(
    table: LogTable, ranges: Mapping[str, float | None]
) -> tuple[dict[str, FloatArray], FloatArray | None, list[str]]:
    """(N,) each channel in its unit, (N,) the time where it is there, and what was left out."""
    warnings = table.layout.report.notes()
    channels: dict[str, FloatArray] = {}
    time_s: FloatArray | None = None
    for place, name in enumerate(table.layout.header):
        if place not in table.columns:
            warnings.append(f"column {name or place + 1} is not a channel of a log; left out")
        elif np.isnan(values := table.columns[place]).all():
            warnings.append(f"column {name} has no values; left out")
        elif name == TIME:
            time_s = values
        elif (sensor_of := _SENSOR.fullmatch(name)) is None:
            channels[name] = values
        else:
            sensor, axis, unit = sensor_of.groups()
            channels.update([_in_unit(sensor, axis, unit, values, ranges[sensor])])
    return channels, time_s, warnings


def accel_g_of(log: StaticLog) -> FloatArray:
    """(N, 3) the log's accelerometer in g.

    Raises:
        CsvError: an axis is missing, or is in counts without a stated range.
    """
    accel_g = log.axes("accel", "g")
    if accel_g is not None:
        return accel_g
    for axis in AXES:
        if f"accel_{axis}_lsb" in log.channels:
            raise CsvError(
                "is in counts, and what a count is worth is not known: give --accel-range (2, 4, 8 or 16 g)",
                column=f"accel_{axis}_lsb",
            )
    missing = next(name for axis in AXES if (name := f"accel_{axis}_g") not in log.channels)
    raise CsvError(
        f"there is no such column{_nearly(log.warnings)}: gravity needs all three axes; "
        f"{there_are(list(log.channels))}",
        column=missing,
    )


def _nearly(warnings: Sequence[str]) -> str:
    """What was said of names that are nearly known, for the error of a file that lacks these."""
    return "".join(f"; {warning}" for warning in warnings if DID_YOU_MEAN in warning)


def _flaw_of(time_s: FloatArray, table: LogTable) -> str:
    unknown = np.isnan(time_s)
    if unknown.any():
        return f"is not known in line {table.line_of(int(unknown.argmax()))}"
    back = np.diff(time_s) < 0.0
    if back.any():
        k = int(back.argmax())
        return f"goes back from {time_s[k]:g} to {time_s[k + 1]:g} in line {table.line_of(k + 1)}"
    return ""


def _in_unit(
    sensor: str, axis: str, unit: str, values: FloatArray, full_scale: float | None
) -> tuple[str, FloatArray]:
    """The channel's name and its values, changed in place to g or deg/s where that is known."""
    target = _UNITS[sensor][0]
    if unit == "lsb" and full_scale is None:
        return f"{sensor}_{axis}_lsb", values
    if unit == "lsb":
        values *= (full_scale or 0.0) / COUNTS
    elif unit == "mps2":
        values /= STANDARD_GRAVITY_MPS2
    elif unit == "rps":
        np.degrees(values, out=values)
    return f"{sensor}_{axis}_{target}", values


def _refuse_two_units(columns: Sequence[Column], line: int) -> None:
    seen: dict[tuple[str, str], str] = {}
    for column in columns:
        sensor = _SENSOR.fullmatch(column.name)
        if sensor is None:
            continue
        if (first := seen.setdefault((sensor[1], sensor[2]), column.text)) != column.text:
            what = f"says the same as {first} in another unit: keep one of them"
            raise CsvError(what, line=line, column=column.text)
