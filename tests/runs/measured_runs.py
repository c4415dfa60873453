"""Completed runs on rigs whose truth is known."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from run_rigs import TruthRig

from calrig.plan import Plan
from calrig.runs.service import RunService
from calrig.store import Run, Store, StoredPose


@dataclass(frozen=True)
class Measured:
    """A completed run with its poses and the rig it was made on."""

    run: Run
    poses: list[StoredPose]
    store: Store

    def column(self, name: str) -> np.ndarray:
        """A column of CONTRACT section 4, (n,)."""
        return np.array([stored.pose.row()[name] for stored in self.poses], dtype=float)


def measure(store: Store, *plans: Plan, rigs: Sequence[TruthRig]) -> list[Measured]:
    """A run of each plan on the rig in its place, side by side; all must complete."""
    with ExitStack() as stack:
        for rig in rigs:
            stack.enter_context(rig.simulated)
        service = stack.enter_context(closing(RunService(store, [rig.settings for rig in rigs])))
        started = [
            service.start(unit="AS-1", rig=rig.settings.name, plan=one)
            for rig, one in zip(rigs, plans, strict=True)
        ]
        runs = [service.wait(run.id, 60) for run in started]
    for run in runs:
        assert run.status == "completed", run.error
    return [Measured(run, store.poses.of(run.id), store) for run in runs]


def measure_one(store: Store, chosen: Plan, **options: Any) -> Measured:
    """A run on a new rig."""
    return measure(store, chosen, rigs=[TruthRig(**options)])[0]
