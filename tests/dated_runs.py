"""Histories for tests: completed runs that gave what a test says, on the days that it says."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

from calrig.calibration.poses import Pose
from calrig.calibration.results.result import build_result
from calrig.run_ids import new_run_id
from calrig.store import Run, Store
from calrig.store.convert import figures_of, run_row
from calrig.store.tables import RunTable, UnitTable

FIRST_DAY = datetime(2025, 1, 1, 9, tzinfo=UTC)


def at(day: float) -> datetime:
    """So many days after the first."""
    return FIRST_DAY + timedelta(days=day)


def gave(
    bias_deg: float = 0.8, scale: float | None = 1.0, std: float = 0.002, **given: Any
) -> dict[str, Any]:
    """A result."""
    return {
        "bias_deg": bias_deg,
        "bias_std_deg": std,
        "scale": scale,
        "scale_std": None if scale is None else std / 40,
        "rms_raw_deg": 0.26,
        "rms_calibrated_deg": 0.012,
        "rms_with_effects_deg": None,
        "n_poses": 52,
        "noise_deg": 0.012,
        "temperature_c": {"min": 24.0, "max": 26.0},
        "gyro": {"bias_dps": [None] * 3, "bias_std_dps": [None] * 3, "scale": None, "scale_std": None},
        "reference": None,
        **given,
    }


def lay(store: Store, *runs: tuple[str, float, dict[str, Any], dict[str, Any]]) -> list[str]:
    """Completed calibrations without poses, all at once: unit, day, result, columns of the run; their ids."""
    with store._database.writing() as session:
        rows = []
        for unit, day, result, columns in runs:
            if session.get(UnitTable, unit) is None:
                session.add(UnitTable(serial=unit, created_at=at(day)))
                session.flush()
            followed = columns.get("follows")
            row = RunTable(
                **{"uid": new_run_id(), "unit": unit, "rig": "bench-1", "plan": None}
                | {"kind": "calibration", "status": "completed"}
                | {"progress": {"poses_done": 0, "poses_total": 0, "fraction": 1.0, "remaining_s": 0.0}}
                | {"result": result, "faults": {}, "provenance": {}}
                | {"created_at": at(day), "started_at": at(day), "finished_at": at(day), **columns}
                | {"follows": None if followed is None else run_row(session, followed).id}
            )
            session.add(row)
            rows.append(row)
        session.flush()
        session.add_all(figures_of(row.id, row.result) for row in rows)
        return [row.uid for row in rows]


def ran(
    store: Store,
    unit: str,
    day: float,
    bias_deg: float = 0.8,
    scale: float | None = 1.0,
    *,
    std: float = 0.002,
    stage_std_deg: float | None = None,
    poses: Sequence[Pose] = (),
    **columns: Any,
) -> Run:
    """A completed calibration of a unit that finished on a day, with what poses give where there are some."""
    reference = {"std_deg": 0.3, "kind": "harmonic", "bias_std_deg": stage_std_deg, "scale_std": 0.001}
    result = gave(bias_deg, scale, std, reference=reference if stage_std_deg is not None else None)
    if poses:
        fit = build_result(poses).to_dict()
        result |= {key: fit[key] for key in ("bias_deg", "bias_std_deg", "scale", "scale_std")}
    (run_id,) = lay(store, (unit, day, result, columns))
    run = store.runs.get(run_id)
    assert run is not None
    return run
