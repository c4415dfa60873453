"""What the stored samples of a run say of the unit's noise, and of the filters."""

from __future__ import annotations

from calrig.analysis.errors import Conflict, Invalid
from calrig.analysis.stored_runs import stored_run
from calrig.estimation.angles import FloatArray
from calrig.export.samples_csv import sample_columns
from calrig.noise.analysis import Noise, analyse
from calrig.noise.filters import FilterStudy, study_filters
from calrig.store import Store


def noise_of_run(store: Store, run_id: str) -> Noise:
    """The noise in the log of a static run.

    Raises:
        Unknown: there is no such run.
        Conflict: it is not a static one, or its samples are gone.
        Invalid: its log is too short.
    """
    run = stored_run(store, run_id)
    if (run.plan or {}).get("kind") != "static":
        raise Conflict(
            f"run {run_id} moved its unit: start a run with a static plan, and its log tells the noise"
        )
    columns = _columns(store, run_id)
    time_s = columns.pop("time_s")
    try:
        return analyse(columns, time_s)
    except ValueError as error:
        raise Invalid(f"run {run_id}: {error}") from error


def filters_of_run(store: Store, run_id: str) -> FilterStudy:
    """The filters side by side on the moves and dwells of a run, with the gyro scale that it found.

    Raises:
        Unknown: there is no such run.
        Conflict: its samples are gone.
        Invalid: no filter can be run over them.
    """
    scale = ((stored_run(store, run_id).result or {}).get("gyro") or {}).get("scale")
    columns = _columns(store, run_id)
    time_s = columns.pop("time_s")
    try:
        return study_filters(columns, time_s, gyro_scale=1.0 if scale is None else scale)
    except ValueError as error:
        raise Invalid(f"run {run_id}: {error}") from error


def _columns(store: Store, run_id: str) -> dict[str, FloatArray]:
    samples = store.samples(run_id)
    if not len(samples):
        raise Conflict(f"run {run_id} has no samples: it was imported, took none, or they were pruned")
    return sample_columns(samples)
