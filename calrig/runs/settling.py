"""How long a designed plan waits after a move, as the gyro of the rig's last run showed it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calrig.calibration.plan_design import GAIN_ERROR, LEAST_S, Gyro, ring_down_s
from calrig.calibration.poses import Filtering
from calrig.estimation.angles import AXES
from calrig.estimation.kalman import KalmanNoise
from calrig.plan import Plan
from calrig.run_ids import short_name
from calrig.settings import RigSettings
from calrig.store import Run, Store

RUNS_LOOKED_AT = 10
SAMPLES_LOOKED_AT = 200_000
"""A quarter of an hour at 200 Hz: moves enough, and read in some hundredths of a second."""


@dataclass(frozen=True, slots=True)
class Settling:
    """What is known of it.

    Attributes:
        least_s: until the stage is at rest.
        said: how that is known, in words.
        gyro: of the filter that is to forget the moves; None where nothing is known of it.
    """

    least_s: float
    said: str
    gyro: Gyro | None


def settling_of(rig: RigSettings, plan: Plan, store: Store | None) -> Settling:
    """As the gyro showed it in the last run on the rig whose samples are there; else the plan's own."""
    if store is not None:
        runs, _ = store.runs(rig=rig.name, status="completed", limit=RUNS_LOOKED_AT)
        for run in runs:
            if not run.voided and (rang_s := _rang_s(store, run)) is not None:
                when = f"later than {rang_s:.2f} s" if rang_s else "once the stage had arrived"
                said = f"in run {short_name(run.id)} the gyro felt nothing of them {when}"
                return Settling(max(LEAST_S, round(rang_s, 2)), said, _gyro(rig, plan, run))
    return Settling(plan.settle_s, "no run on this rig tells when it stands still", None)


def _rang_s(store: Store, run: Run) -> float | None:
    plan = run.plan or {}
    if plan.get("kind") not in ("calibration", "verification") or plan.get("target_std_deg"):
        return None
    time_s, rate_dps = [], []
    axis = AXES.index(plan.get("mount_axis", "x")[-1])
    for block in store.sample_blocks(run.id):
        time_s.append(np.asarray(block.time_s))
        rate_dps.append(np.asarray(block.gyro_dps)[:, axis])
        if sum(map(len, time_s)) > SAMPLES_LOOKED_AT:
            break
    if not time_s:
        return None
    half_s = 0.5 * plan["dwell_s"]
    dwells = [
        (middle_s - half_s - plan["settle_s"], middle_s - half_s, middle_s + half_s)
        for one in store.poses(run.id)
        if (middle_s := one.pose.time_s) is not None
    ]
    return ring_down_s(np.concatenate(time_s), np.concatenate(rate_dps), dwells)


def _gyro(rig: RigSettings, plan: Plan, run: Run) -> Gyro:
    """The rig's filter, and how wrong the gyro was in a run."""
    scale = ((run.result or {}).get("gyro") or {}).get("scale")
    filtering = Filtering(KalmanNoise(**rig.filter.model_dump()), plan.rate_hz)
    return Gyro(filtering, GAIN_ERROR if scale is None else abs(1.0 - scale))
