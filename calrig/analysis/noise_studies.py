"""Studies of noise and filters in uploaded logs and stored runs, in any process.

Modules that compute are imported where they are used: the process that only asks needs no scipy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from calrig.analysis.errors import Conflict, Invalid
from calrig.analysis.log_studies import Study, studied
from calrig.analysis.stored_runs import known_unit, stored_run
from calrig.estimation.angles import FloatArray
from calrig.export.samples_csv import COLUMNS, sample_columns
from calrig.export.static_csv import read_static
from calrig.store.records import Document, Run

if TYPE_CHECKING:  # a process for heavy work loads no database
    from calrig.analysis.log_studies import Found
    from calrig.figures.files import Rows
    from calrig.store import Store


Answer = dict[str, Any]
"""The report of a log, and its pictures with their captions."""

MOST_SAMPLES = 2_000_000
"""Of a log; the command line takes longer ones, on the memory of its own machine."""


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
    found = log.channels, log.time_s, rate_hz, log.warnings
    return _answer(study, *studied(study, *found, progress=lambda share: progress((1 + share) / 2)))


def study_samples(study: Study, path: Path, names: Sequence[str], gyro_scale: float) -> Answer:
    """The samples of a run: rows of float64 in a file, `time_s` first; what is never known is left out.

    Raises:
        ValueError: they cannot be studied, and why.
    """
    return _answer(study, *studied(study, *_columns(path, names), gyro_scale=gyro_scale))


def noise_of_samples(path: Path, names: Sequence[str]) -> Answer:
    """The noise document of such a file, without pictures; as `study_samples`."""
    return studied("noise", *_columns(path, names))[0]


def _columns(path: Path, names: Sequence[str]) -> tuple[dict[str, FloatArray], FloatArray]:
    rows = np.fromfile(path).reshape(-1, len(names))
    columns: dict[str, FloatArray] = dict(zip(names, rows.T, strict=True))
    time_s = columns.pop("time_s")
    return {name: column for name, column in columns.items() if not np.isnan(column).all()}, time_s


def _answer(study: Study, report: Answer, draw: Callable[[], Rows]) -> Answer:
    drawn = [{"caption": caption, "figure": figure} for row in draw() for caption, figure in row]
    stated = {"stated": _stated(report)} if study == "noise" else {}
    return {"report": report, "figures": drawn, **stated}


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


NAMES = (*COLUMNS, "angle_deg")
"""Of the columns of `lay_samples`."""


def require_static(run: Run) -> None:
    """Raises Conflict where a run moved its unit, so that its samples are not noise alone."""
    if run.kind != "static":
        raise Conflict(
            f"run {run.id} moved its unit: start a run with a static plan, and its log tells the noise"
        )


def lay_samples(store: Store, run_id: str, file: IO[bytes]) -> None:
    """Writes a run's samples as rows of float64, `NAMES` across; some at a time, however many they are.

    Raises:
        Conflict: there are none, or too many.
    """
    n_samples = 0
    for block in store.samples.blocks_of(run_id):
        n_samples += len(block)
        if n_samples > MOST_SAMPLES:
            raise Conflict(
                f"run {run_id} has more than {MOST_SAMPLES:,} samples: download them as CSV and give them to "
                "`calrig noise` or `calrig filters`"
            )
        columns = sample_columns(block)
        unknown = np.full(len(block), np.nan)
        file.write(np.column_stack([columns.get(name, unknown) for name in NAMES]).tobytes())
    if not n_samples:
        raise _no_samples(run_id)


def noise_of_unit(
    store: Store, unit: str, carried_out: Callable[[Callable[[], Document]], Document]
) -> tuple[Document, Run]:
    """CONTRACT section 7's document of the unit's latest static log, and the run that kept it.

    `carried_out` calls a function, in another process where this one has others to serve.

    Raises:
        Unknown: the unit is not known.
        Conflict: it has no such log, or its samples are gone.
        Invalid: the log cannot be studied.
    """
    known_unit(store, unit)
    run = _latest_static_run(store, unit)
    with NamedTemporaryFile() as file:
        lay_samples(store, run.id, file)
        file.flush()
        try:
            return carried_out(partial(noise_of_samples, Path(file.name), NAMES)), run
        except ValueError as error:
            raise Invalid(f"run {run.id}: {error}") from error


def _latest_static_run(store: Store, unit: str) -> Run:
    cursor = None
    while True:
        runs, cursor = store.runs.page(unit=unit, status="completed", limit=200, cursor=cursor)
        for run in runs:
            if run.voided is None and run.kind == "static":
                return run
        if cursor is None:
            raise Conflict(
                f"of unit {unit!r} no noise was measured: start a run with a static plan of some minutes"
            )


def gyro_scale_of(run: Run) -> float:
    """What a run found the gyro's scale to be; 1 where it does not know."""
    scale = None if run.result is None else run.result.gyro.scale
    return 1.0 if scale is None else scale


def filters_of_run(store: Store, run_id: str) -> Found:
    """The filters side by side on the moves and dwells of a run, with the gyro scale that it found.

    Raises:
        Unknown: there is no such run.
        Conflict: its samples are gone.
        Invalid: no filter can be run over them.
    """
    run = stored_run(store, run_id)
    samples = store.samples.of(run_id)
    if not len(samples):
        raise _no_samples(run_id)
    columns = sample_columns(samples)
    time_s = columns.pop("time_s")
    try:
        return studied("filters", columns, time_s, gyro_scale=gyro_scale_of(run))
    except ValueError as error:
        raise Invalid(f"run {run_id}: {error}") from error


def _no_samples(run_id: str) -> Conflict:
    return Conflict(f"run {run_id} has no samples: it was imported, took none, or they were pruned")
