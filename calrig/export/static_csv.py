"""Static and gravity logs as CSV: one row a sample (CONTRACT section 4), brought to g, deg/s and °C."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import AXES, STANDARD_GRAVITY_MPS2, FloatArray
from calrig.export.cells import CsvError
from calrig.export.csv_table import there_are
from calrig.export.log_table import LogTable, read_log_table

COUNTS = 32768
"""Full scale of a register of 16 bits is the range (CONTRACT section 3.1)."""
MAX_SAMPLES = 20_000_000
"""More than a day at 200 Hz."""
MAX_BYTES = 1_500_000_000
TIME, TEMPERATURE = "time_s", "temperature_c"
_SENSOR = re.compile(r"(accel|gyro)_([xyz])_(g|mps2|dps|rps|lsb)")
_UNITS = {"accel": ("g", "mps2", "lsb"), "gyro": ("dps", "rps", "lsb")}


@dataclass(frozen=True, slots=True, eq=False)
class StaticLog:
    """The samples of a log.

    Attributes:
        channels: (N,) each, in the contract's order, by name with its unit: `accel_x_g`, `gyro_x_dps`,
            `temperature_c`; `accel_x_lsb` where the range of counts is not known. NaN where not known.
        time_s: (N,) as logged: a clock may wrap in it, and NaN is where it is not known; None without any.
        time_flaw: why that cannot be taken for the time that passed, and in which line; empty if it can.
        warnings: what a person should know about how it was read.
    """

    channels: dict[str, FloatArray]
    time_s: FloatArray | None
    time_flaw: str
    warnings: tuple[str, ...]

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

    Args:
        data: the file's content.
        accel_range_g: full scale of the accelerometer's counts, in g.
        gyro_range_dps: full scale of the gyro's counts, in degrees per second.
        max_samples: more are refused.
        progress: told the share of the file that has been read, from 0 to 1.

    Raises:
        CsvError: the file is not such a table; says line and column.
        ValueError: a range is not above 0.
    """
    ranges = {"accel": accel_range_g, "gyro": gyro_range_dps}
    _refuse_no_range(ranges)
    table = read_log_table(data, _is_known, max_rows=max_samples, max_bytes=MAX_BYTES, progress=progress)
    _refuse_two_units(table.header, table.header_line)
    channels, time_s, warnings = _channels_of(table, ranges)
    if not channels:
        raise CsvError(
            "there is no channel of a log (accel_x_g, gyro_x_dps, temperature_c, …; also accel_x_mps2, "
            f"gyro_x_rps, accel_x_lsb); {there_are(table.header)}",
            line=table.header_line,
        )
    ordered = {name: channels[name] for name in sorted(channels, key=_order)}
    flaw = "" if time_s is None else _flaw_of(time_s, table)
    return StaticLog(ordered, time_s, flaw, tuple(warnings))


def _refuse_no_range(ranges: Mapping[str, float | None]) -> None:
    for sensor, full_scale in ranges.items():
        if full_scale is not None and not (math.isfinite(full_scale) and full_scale > 0.0):
            raise ValueError(f"the range of the {sensor} is {full_scale}; it must be above 0")


def _channels_of(
    table: LogTable, ranges: Mapping[str, float | None]
) -> tuple[dict[str, FloatArray], FloatArray | None, list[str]]:
    """(N,) each channel in its unit, (N,) the time where it is there, and what was left out."""
    warnings: list[str] = []
    channels: dict[str, FloatArray] = {}
    time_s: FloatArray | None = None
    for place, name in enumerate(table.header):
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
    raise CsvError(
        f"there is no such column: gravity needs all three axes; {there_are(list(log.channels))}",
        column=missing,
    )


def _is_known(name: str) -> bool:
    sensor = _SENSOR.fullmatch(name)
    return name in (TIME, TEMPERATURE) if sensor is None else sensor[3] in _UNITS[sensor[1]]


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
