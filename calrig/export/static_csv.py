"""Static and gravity logs as CSV: one row a sample (CONTRACT section 4), brought to g, deg/s and °C."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.export.cells import Cells, CsvError
from calrig.export.csv_table import read_table

STANDARD_GRAVITY_MPS2 = 9.80665
COUNTS = 32768
"""Full scale of a register of 16 bits is the range (CONTRACT section 3.1)."""
MAX_SAMPLES = 2_000_000
"""Nearly three hours at 200 Hz; the table's bounds on cells and bytes hold as well."""
AXES = "xyz"
TIME, TEMPERATURE = "time_s", "temperature_c"
_SENSOR = re.compile(r"(accel|gyro)_([xyz])_(g|mps2|dps|rps|lsb)")
_UNITS = {"accel": ("g", "mps2", "lsb"), "gyro": ("dps", "rps", "lsb")}


@dataclass(frozen=True, slots=True, eq=False)
class StaticLog:
    """The samples of a log.

    Attributes:
        channels: (N,) each, in the contract's order, by name with its unit: `accel_x_g`, `gyro_x_dps`,
            `temperature_c`; `accel_x_lsb` where the range of counts is not known. NaN where not known.
        time_s: (N,) not decreasing; None where the log has none that can be used.
        warnings: what a person should know about how it was read.
    """

    channels: dict[str, FloatArray]
    time_s: FloatArray | None
    warnings: tuple[str, ...]

    def __len__(self) -> int:
        return len(next(iter(self.channels.values())))

    def axes(self, sensor: str, unit: str) -> FloatArray | None:
        """(N, 3) of `accel` in `g` or `gyro` in `dps`; None unless all three axes are there in this unit."""
        names = [f"{sensor}_{axis}_{unit}" for axis in AXES]
        if not all(name in self.channels for name in names):
            return None
        return np.column_stack([self.channels[name] for name in names])


def read_static(
    data: bytes, *, accel_range_g: float | None = None, gyro_range_dps: float | None = None
) -> StaticLog:
    """Reads a log of samples.

    `_mps2` becomes g (9.80665 m/s²) and `_rps` deg/s; counts (`_lsb`) become g or deg/s by the range given,
    full scale 32768, and keep name and unit without one. A column that is none of the contract's is left
    out with a warning, and so is a `time_s` that goes backwards or is not known throughout.

    Raises:
        CsvError: the file is not such a table; says line and column.
        ValueError: a range is not above 0.
    """
    for name, full_scale in (("accelerometer", accel_range_g), ("gyro", gyro_range_dps)):
        if full_scale is not None and not (math.isfinite(full_scale) and full_scale > 0.0):
            raise ValueError(f"the range of the {name} is {full_scale}; it must be above 0")
    table = read_table(data, (), max_rows=MAX_SAMPLES)
    _refuse_two_units(table.header, table.header_line)
    warnings: list[str] = []
    channels: dict[str, FloatArray] = {}
    time_s: FloatArray | None = None
    for place, name in enumerate(table.header):
        sensor = _SENSOR.fullmatch(name)
        known = sensor is not None and sensor[3] in _UNITS[sensor[1]]
        if not known and name not in (TIME, TEMPERATURE):
            warnings.append(f"column {name or place + 1} is not a channel of a log; left out")
            continue
        values = _numbers(table.column(place))
        if name == TIME:
            time_s, why_not = _usable_time(values, table.lines)
            warnings += [f"{TIME} {why_not}; not used"] if why_not else []
        elif np.isnan(values).all():
            warnings.append(f"column {name} has no values; left out")
        elif sensor is None:
            channels[name] = values
        else:
            full_scale = accel_range_g if sensor[1] == "accel" else gyro_range_dps
            channels.update([_in_unit(sensor[1], sensor[2], sensor[3], values, full_scale)])
    if not channels:
        raise CsvError(
            "there is no channel of a log (accel_x_g, gyro_x_dps, temperature_c, …; also accel_x_mps2, "
            "gyro_x_rps, accel_x_lsb)",
            line=table.header_line,
        )
    return StaticLog({name: channels[name] for name in sorted(channels, key=_order)}, time_s, tuple(warnings))


def accel_g_of(log: StaticLog) -> FloatArray:
    """(N, 3) the log's accelerometer in g.

    Raises:
        CsvError: an axis is not there, or is in counts of a range that nobody gave.
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
    raise CsvError("there is no such column: gravity needs all three axes", column=missing)


def _numbers(cells: Cells) -> FloatArray:
    return np.array([np.nan if value is None else value for value in cells.numbers()], dtype=np.float64)


def _usable_time(time_s: FloatArray, lines: list[int]) -> tuple[FloatArray | None, str]:
    unknown = np.flatnonzero(np.isnan(time_s))
    if len(unknown):
        return None, f"is not known in line {lines[int(unknown[0])]}"
    back = np.flatnonzero(np.diff(time_s) < 0.0)
    if len(back):
        k = int(back[0])
        return None, f"goes back from {time_s[k]:g} to {time_s[k + 1]:g} in line {lines[k + 1]}"
    return time_s, ""


def _in_unit(
    sensor: str, axis: str, unit: str, values: FloatArray, full_scale: float | None
) -> tuple[str, FloatArray]:
    """The channel's name and its values, in g or deg/s where that is known."""
    target = _UNITS[sensor][0]
    if unit == "lsb" and full_scale is None:
        return f"{sensor}_{axis}_lsb", values
    if unit == "lsb":
        values = values * (full_scale or 0.0) / COUNTS
    elif unit == "mps2":
        values = values / STANDARD_GRAVITY_MPS2
    elif unit == "rps":
        values = np.degrees(values)
    return f"{sensor}_{axis}_{target}", values


def _refuse_two_units(header: list[str], line: int) -> None:
    seen: dict[tuple[str, str], str] = {}
    for name in header:
        sensor = _SENSOR.fullmatch(name)
        if sensor is None:
            continue
        if (first := seen.setdefault((sensor[1], sensor[2]), name)) != name:
            raise CsvError(
                f"says the same as {first} in another unit: keep one of them", line=line, column=name
            )


def _order(name: str) -> tuple[int, str]:
    return ("accel", "gyro", "temperature").index(name.partition("_")[0]), name
