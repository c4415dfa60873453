"""How long a rig takes by the clock on the wall: settling and dwelling are counted on its board's."""

from __future__ import annotations

from statistics import median

from calrig.analysis.errors import Invalid
from calrig.plan import Plan
from calrig.runs.planned import estimate
from calrig.settings import RigSettings
from calrig.store import Run, Store

LATEST = 5
"""Of a rig's completed runs, whose median counts: one may have been paused, or its machine busy."""


def wall_pace(rig: RigSettings, store: Store) -> float:
    """Seconds on the wall for one that `estimate` says, over the rig's last runs; before any, as set.

    A run tells where its plan says how long it takes and nobody is waited for: not one that may end early or
    whose dwells do, a wait for a temperature, several mounts, a follow-up, or one that was interrupted.
    """
    latest, _ = store.runs(rig=rig.name, status="completed", limit=LATEST)
    paces = [pace for run in latest if (pace := _pace_of(run, rig, store)) is not None]
    return median(paces) if paces else 1.0 / rig.time_scale


def _pace_of(run: Run, rig: RigSettings, store: Store) -> float | None:
    if run.plan is None or run.follows or run.provenance.get("interruptions"):
        return None
    if run.started_at is None or run.finished_at is None:
        return None
    plan = Plan.model_validate(run.plan)
    if plan.until or plan.target_std_deg or plan.wait_temperature_c is not None or len(plan.mounts_deg) > 1:
        return None
    try:
        said_s = estimate(plan, rig, store).duration_s
    except Invalid:
        return None  # of other limits than today's
    return (run.finished_at - run.started_at).total_seconds() / said_s
