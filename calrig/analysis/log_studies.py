"""Noise and filters in a log, as the API answers them: without a store, in any process.

What computes is imported where it is used: the process that only asks needs no scipy for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.export.static_csv import read_static

Study = Literal["noise", "filters"]
Answer = dict[str, Any]
"""The report of a log, and its pictures with their captions."""

MOST_SAMPLES = 2_000_000
"""Of a log; the command line takes a longer one, on the memory of whoever asks."""


def study_file(
    study: Study,
    path: Path,
    *,
    rate_hz: float | None,
    accel_range_g: float | None,
    gyro_range_dps: float | None,
    progress: Callable[[float], None],
) -> Answer:
    """A log that somebody brought; `progress` is told the share done, reading it being half.

    Raises:
        CsvError: it is no such log; says line and column.
        ValueError: it cannot be studied, and why.
    """
    log = read_static(
        path.read_bytes(),
        accel_range_g=accel_range_g,
        gyro_range_dps=gyro_range_dps,
        max_samples=MOST_SAMPLES,
        progress=lambda share: progress(share / 2),
    )
    if study == "noise":
        found = log.channels, log.time_s, rate_hz, log.warnings
        return _noise(*found, progress=lambda share: progress((1 + share) / 2))
    return _filters(log.channels, log.time_s, rate_hz, warnings=log.warnings)


def study_samples(study: Study, path: Path, names: Sequence[str], gyro_scale: float) -> Answer:
    """The samples of a run: rows of float64 in a file, `time_s` first; what is never known is left out.

    Raises:
        ValueError: they cannot be studied, and why.
    """
    known, time_s = _columns(path, names)
    return _noise(known, time_s) if study == "noise" else _filters(known, time_s, gyro_scale=gyro_scale)


def noise_of_samples(path: Path, names: Sequence[str]) -> Answer:
    """The noise document of such a file, without pictures; as `study_samples`."""
    from calrig.noise.report import report

    return report(*_columns(path, names))


def _columns(path: Path, names: Sequence[str]) -> tuple[dict[str, FloatArray], FloatArray]:
    rows = np.fromfile(path).reshape(-1, len(names))
    columns: dict[str, FloatArray] = dict(zip(names, rows.T, strict=True))
    time_s = columns.pop("time_s")
    return {name: column for name, column in columns.items() if not np.isnan(column).all()}, time_s


def _noise(
    channels: dict[str, FloatArray],
    time_s: FloatArray | None,
    rate_hz: float | None = None,
    warnings: Sequence[str] = (),
    progress: Callable[[float], None] | None = None,
) -> Answer:
    from calrig.figures.noise import noise_figures
    from calrig.noise.analysis import analyse
    from calrig.noise.report import noise_document, said_first

    found = analyse(channels, time_s, rate_hz, progress)
    document = said_first(warnings, noise_document(found))
    return {**_answer(document, noise_figures(found)), "stated": _stated(document)}


def _stated(document: Answer) -> Answer:
    """Each channel's white and flicker noise as data sheets state them, with the unit."""
    from calrig.noise.units import bias_instability, white_density

    words = {"white": white_density, "flicker": bias_instability}
    return {
        name: {
            kind: None if (one := channel["coefficients"][kind]) is None else say(name, one["value"])
            for kind, say in words.items()
        }
        for name, channel in document["channels"].items()
    }


def _filters(
    channels: dict[str, FloatArray],
    time_s: FloatArray | None,
    rate_hz: float | None = None,
    gyro_scale: float = 1.0,
    warnings: Sequence[str] = (),
) -> Answer:
    from calrig.figures.filters import filters_figures
    from calrig.noise.filters import filters_document, study_filters
    from calrig.noise.report import said_first

    found = study_filters(channels, time_s, rate_hz, gyro_scale=gyro_scale)
    return _answer(said_first(warnings, filters_document(found)), filters_figures(found))


def _answer(report: Answer, figures: Sequence[Sequence[tuple[str, Any]]]) -> Answer:
    drawn = [{"caption": caption, "figure": figure} for row in figures for caption, figure in row]
    return {"report": report, "figures": drawn}
