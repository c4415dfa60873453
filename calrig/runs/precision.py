"""How precise readings were in a run: within their dwells, and from pose to pose."""

from __future__ import annotations

from calrig.calibration.plan_design import NOT_MEASURED, Precision, precision_of_run
from calrig.run_ids import short_name
from calrig.settings import RigSettings
from calrig.store import Run, Store

RUNS_LOOKED_AT = 10
FEWEST_POSES = 8


def precision_of(rig: RigSettings, unit: str, store: Store | None) -> Precision:
    """Of dwells: by the unit's last calibration on the rig, else by the rig's last one."""
    if store is None:
        return NOT_MEASURED
    for serial in [unit, None] if unit else [None]:
        runs, _ = store.runs(rig=rig.name, unit=serial, status="completed", limit=RUNS_LOOKED_AT)
        for run in runs:
            dwells = (run.plan or {}).get("kind") == "calibration"
            if dwells and not run.voided and (found := precision_shown(run)) is not None:
                return found
    return NOT_MEASURED


def precision_shown(run: Run) -> Precision | None:
    """By a completed run; None where its dwells had no one length, or its poses are too few."""
    result, plan = run.result, run.plan or {}
    if not result or plan.get("target_std_deg"):
        return None
    left = result["rms_with_effects_deg"] or result["rms_calibrated_deg"]
    n, noise_deg = result["n_poses"], result["noise_deg"]
    if left is None or noise_deg is None or n < FEWEST_POSES:
        return None
    freedom = n - 2
    scatter_deg = left * (n / freedom) ** 0.5
    return precision_of_run(short_name(run.id), plan["dwell_s"], noise_deg, scatter_deg, freedom)
