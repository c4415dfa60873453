"""What the stored samples of a run say of the unit's noise, and of the filters."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import IO, TYPE_CHECKING

import numpy as np

from calrig.analysis.errors import Conflict, Invalid, Unknown
from calrig.analysis.log_studies import MOST_SAMPLES, noise_of_samples
from calrig.analysis.stored_runs import stored_run
from calrig.export.samples_csv import COLUMNS, sample_columns
from calrig.store import Run, Store
from calrig.store.records import Document

if TYPE_CHECKING:
    from calrig.noise.filters import FilterStudy

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
    for block in store.sample_blocks(run_id):
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

    Args:
        store: where it is.
        unit: serial number.
        carried_out: calls a function, in another process where this one has others to serve.

    Raises:
        Unknown: the unit is not known.
        Conflict: it has no such log, or its samples are gone.
        Invalid: the log cannot be studied.
    """
    if store.unit(unit) is None:
        raise Unknown(f"there is no unit {unit!r}")
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
        runs, cursor = store.runs(unit=unit, status="completed", limit=200, cursor=cursor)
        for run in runs:
            if run.voided is None and run.kind == "static":
                return run
        if cursor is None:
            raise Conflict(
                f"of unit {unit!r} no noise was measured: start a run with a static plan of some minutes"
            )


def gyro_scale_of(run: Run) -> float:
    """What a run found the gyro's scale to be; 1 where it does not know."""
    scale = ((run.result or {}).get("gyro") or {}).get("scale")
    return 1.0 if scale is None else float(scale)


def filters_of_run(store: Store, run_id: str) -> FilterStudy:
    """The filters side by side on the moves and dwells of a run, with the gyro scale that it found.

    Raises:
        Unknown: there is no such run.
        Conflict: its samples are gone.
        Invalid: no filter can be run over them.
    """
    from calrig.noise.filters import study_filters

    run = stored_run(store, run_id)
    samples = store.samples(run_id)
    if not len(samples):
        raise _no_samples(run_id)
    columns = sample_columns(samples)
    time_s = columns.pop("time_s")
    try:
        return study_filters(columns, time_s, gyro_scale=gyro_scale_of(run))
    except ValueError as error:
        raise Invalid(f"run {run_id}: {error}") from error


def _no_samples(run_id: str) -> Conflict:
    return Conflict(f"run {run_id} has no samples: it was imported, took none, or they were pruned")
