"""A correction table: what to add to a reading, at even steps of the reading, for linear interpolation.

The rows cover the calibrated range: the first and the last lie at its ends or up to a step beyond. Readings
are not wrapped in it; those of another turn are brought into it by whole turns.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from calrig.calibration.regression import TEMPERATURE, ApplyError, Circumstances
from calrig.calibration.results import (
    Application,
    effects_on_reading_deg,
    felt_elevation_deg,
    reference_temperature_c,
)
from calrig.estimation.angles import FloatArray
from calrig.export.formats import CalibrationExporter

STEP_DEG = 1.0
SMALLEST_STEP_DEG, LARGEST_STEP_DEG = 1e-6, 90.0
MOST_ROWS = 100_000
BETWEEN = np.linspace(0.0, 1.0, 9)[1:-1]
"""Places between two rows at which the interpolation is compared with the calibration."""
NOT_KNOWN = ""
ENDLESS_DEG = (-math.inf, math.inf)
PLACES = 721
"""Of the range, at which the readings are found that it spans."""


def refuse_steps(step_deg: float, lsb_deg: float | None) -> None:
    """Refuse steps that no table can have.

    Raises:
        ValueError: says which.
    """
    for option, given_deg in (("--step", step_deg), ("--lsb", lsb_deg)):
        if given_deg is not None and not SMALLEST_STEP_DEG <= given_deg <= LARGEST_STEP_DEG:
            raise ValueError(f"{option} is {given_deg:g}°: it must lie between 1e-6° and 90°")


def correction_table(
    document: Mapping[str, Any], step_deg: float = STEP_DEG, lsb_deg: float | None = None
) -> str:
    """Return the table of a calibration document as CSV, its first line a comment.

    Args:
        document: CONTRACT section 6.
        step_deg: from row to row, of the reading.
        lsb_deg: instead of degrees, integers of this step in all columns; the step from row to row is then
            the whole number of them that comes nearest.

    Raises:
        ApplyError: the calibration cannot be applied to readings alone, at one temperature.
        ValueError: the table would be too long, or a step is not between 1e-6° and 90°.
    """
    refuse_steps(step_deg, lsb_deg)
    application = Application.of_document(document)
    if application.accelerometer is not None:
        raise ApplyError("its elevations follow from accelerations, not from readings; take c-header")
    for name in application.columns:
        if name != TEMPERATURE.name:
            raise ApplyError(f"effects follow {name}; a table is of the reading alone")
    celsius = reference_temperature_c(document, application.effects)
    if lsb_deg is not None:
        step_deg = max(round(step_deg / lsb_deg), 1) * lsb_deg
    reading_deg = _rows(application, celsius, step_deg)
    elevation_deg = _unwrapped_deg(application, reading_deg, celsius)
    correction_deg = elevation_deg - reading_deg
    temperature_c = None if celsius is None else np.full(len(reading_deg), celsius)
    std_deg = application.std_deg(np.clip(elevation_deg, *application.range_deg), temperature_c)
    columns: list[list[str]]
    if lsb_deg is None:
        suffix = "deg"
        columns = [
            [f"{value:.10g}" for value in reading_deg],
            [_in_deg(value) for value in correction_deg],
            [_in_deg(value) for value in std_deg],
        ]
    else:
        suffix = "lsb"
        columns = [
            [_in_lsb(value, lsb_deg) for value in one] for one in (reading_deg, correction_deg, std_deg)
        ]
        correction_deg = np.rint(correction_deg / lsb_deg) * lsb_deg
    off_deg = _interpolation_error_deg(application, reading_deg, correction_deg, celsius)
    return "\n".join(
        [
            _comment(document, celsius, step_deg, lsb_deg, off_deg),
            ",".join(f"{name}_{suffix}" for name in ("reading", "correction", "correction_std")),
            *map(",".join, zip(*columns, strict=True)),
            "",
        ]
    )


def _rows(application: Application, celsius: float | None, step_deg: float) -> FloatArray:
    """Return (n,) readings at multiples of the step that enclose the range."""
    theta = np.linspace(*application.range_deg, PLACES)
    felt_deg = felt_elevation_deg(theta, application.bias_deg, application.scale)
    given = Circumstances(temperature_c=None if celsius is None else np.full(len(theta), celsius))
    reading = felt_deg + effects_on_reading_deg(application.effects, theta, given, felt_deg)
    first, last = math.floor(reading.min() / step_deg), math.ceil(reading.max() / step_deg)
    if last - first >= MOST_ROWS:
        raise ValueError(
            f"{last - first + 1} rows at a step of {step_deg:g}°; at most {MOST_ROWS} are allowed"
        )
    return np.asarray(np.arange(first, max(last, first + 1) + 1) * step_deg, dtype=np.float64)


def _unwrapped_deg(application: Application, reading_deg: FloatArray, celsius: float | None) -> FloatArray:
    """Return (n,) elevations of readings that go on beyond a turn; ApplyError where a reading has several."""
    temperature_c = None if celsius is None else np.full(len(reading_deg), celsius)
    endless = replace(application, turns=replace(application.turns, range_deg=ENDLESS_DEG, wrap=None))
    elevation_deg = endless.elevation_deg(reading_deg, temperature_c)
    if np.isnan(elevation_deg).any():
        first_deg = reading_deg[np.isnan(elevation_deg)][0]
        raise ApplyError(f"a reading of {first_deg:g}° stands for many elevations")
    return elevation_deg


def _interpolation_error_deg(
    application: Application, reading_deg: FloatArray, correction_deg: FloatArray, celsius: float | None
) -> float:
    """Return the largest difference between the table, interpolated linearly, and the calibration."""
    between = (reading_deg[:-1, None] + np.diff(reading_deg)[:, None] * BETWEEN).ravel()
    exact = _unwrapped_deg(application, between, celsius) - between
    return float(np.abs(np.interp(between, reading_deg, correction_deg) - exact).max())


def _in_deg(value: float) -> str:
    return NOT_KNOWN if math.isnan(value) else f"{value:.9f}"


def _in_lsb(value: float, lsb_deg: float) -> str:
    return NOT_KNOWN if math.isnan(value) else f"{round(value / lsb_deg)}"


def _comment(
    document: Mapping[str, Any], celsius: float | None, step_deg: float, lsb_deg: float | None, off_deg: float
) -> str:
    at = "reference temperature not known" if celsius is None else f"reference temperature {celsius:.6g} °C"
    parts = [
        f"{at}",
        f"unit {document['unit']}, run {document['run_id']}, {document['calibrated_at']}",
        f"elevation = reading + correction, linear between rows within {off_deg:.2g}°",
        f"step {step_deg:.10g}°",
    ]
    if lsb_deg is not None:
        parts.append(f"integers of 1 LSB = {lsb_deg:.10g}°")
    text = "".join(sign if sign.isprintable() else " " for sign in "; ".join(parts))
    return f"# {' '.join(text.split())}"


EXPORTER = CalibrationExporter(
    name="table",
    title="Correction table",
    file_name="correction-table.csv",
    media_type="text/csv",
    contents="what to add to a reading, in rows of 1° or `--step DEG`, at the reference temperature; "
    "`--lsb DEG`: integers of this step",
    about_one_axis="all of it",
    write=correction_table,
)
