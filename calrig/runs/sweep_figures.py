"""Whether a rig may turn without stopping, by what its runs have shown, and how precise stretches are."""

from __future__ import annotations

from dataclasses import dataclass

from calrig.calibration.plan_design import Precision, Sweeping, Turning
from calrig.plan import Plan
from calrig.run_ids import short_name
from calrig.runs.precision import precision_shown
from calrig.runs.rig_pace import RigPace
from calrig.settings import RigSettings
from calrig.store import Run, Store

RUNS_LOOKED_AT = 50
REFUSED = "take a plan of dwells"
"""What a sweep ends with that stage, board or motor vibration does not let be (`runs.sweeping`)."""


@dataclass(frozen=True, slots=True)
class MaySweep:
    """`sweeping` where a rig may, else `because`: both None where the plan asks for what no sweep does."""

    sweeping: Sweeping | None = None
    because: str | None = None


def may_sweep(
    rig: RigSettings, plan: Plan, store: Store | None, pace: RigPace, dwelling: Precision
) -> MaySweep:
    """Unless a sweep of the rig was refused and none has succeeded since, or its board sends no rates.

    Args:
        rig: where it is to run.
        plan: what is kept of it.
        store: has the earlier runs.
        pace: of the rig.
        dwelling: how precise dwells are: stretches too, where no sweep tells.
    """
    if plan.kind not in ("calibration", "sweep") or plan.asks_for_mounts:
        return MaySweep()
    runs = [] if store is None else store.runs(rig=rig.name, limit=RUNS_LOOKED_AT)[0]
    if (silent := _without_rates(runs)) is not None:
        return MaySweep(
            because=f"a sweep needs rates, and the board sent none in run {short_name(silent.id)}"
        )
    precision = dwelling
    for run in runs:
        if (run.plan or {}).get("kind") != "sweep" or run.voided:
            continue
        if run.status == "failed" and REFUSED in (run.error or ""):
            return MaySweep(because=f"sweep {short_name(run.id)} was refused: {run.error}")
        if run.status == "completed":
            precision = precision_shown(run) or dwelling
            break
    most_dps = pace.velocity_dps
    if plan.kind != "sweep" and plan.velocity_dps is not None:
        most_dps = min(most_dps, plan.velocity_dps)
    return MaySweep(Sweeping(Turning(most_dps, pace.acceleration_dps2), precision))


def _without_rates(runs: list[Run]) -> Run | None:
    """The last completed run on the rig, if its result knows of no gyro."""
    for run in runs:
        if run.status == "completed" and run.result is not None:
            gyro = run.result.get("gyro") or {}
            return run if None in gyro.get("bias_dps", [None]) else None
    return None
