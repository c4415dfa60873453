"""The calibration document of a run or of a unit, as far as there is one."""

from __future__ import annotations

from typing import Any

from calrig.analysis.errors import Conflict, Unknown
from calrig.export.c_header import c_header
from calrig.export.calibration_json import calibration_document
from calrig.store import Run, Store


def run_in_force(store: Store, serial: str) -> Run:
    """The run that a unit's calibration is from.

    Raises:
        Unknown: the unit is not known, or has no completed, not voided calibration whose scale is known.
    """
    if store.unit(serial) is None:
        raise Unknown(f"there is no unit {serial!r}")
    run = store.latest_calibration_run(serial)
    if run is None:
        raise Unknown(f"unit {serial!r} has no completed calibration that counts and whose scale is known")
    return run


def document_of(store: Store, run: Run) -> dict[str, Any]:
    """CONTRACT section 6 for one run, whether or not a later one is in force.

    Raises:
        Conflict: the run has none: it is voided, did not complete, or does not know its scale.
    """
    if run.voided is not None:
        raise Conflict(f"run {run.id} is voided ({run.voided['reason']}): it gives no calibration")
    if run.status != "completed" or run.result is None or run.result["scale"] is None:
        what = run.status if run.status != "completed" else "completed, but its scale is not known"
        raise Conflict(f"run {run.id} is {what}: it gives no calibration")
    poses = [stored.pose for stored in store.poses(run.id, include_excluded=False)]
    return calibration_document(run, poses, store.effects_in_force(run.unit, run.rig))


def header_of(store: Store, run: Run) -> str:
    """The same as `calibration.h`.

    Raises:
        Conflict: as for `document_of`, or an effect in force cannot be taken out in flight.
    """
    document = document_of(store, run)
    try:
        return c_header(document)
    except ValueError as error:
        raise Conflict(f"the calibration of run {run.id} cannot be put into C: {error}") from error
