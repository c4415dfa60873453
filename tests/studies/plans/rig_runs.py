"""Designs carried out by the program on simulated rigs, over their ports, in virtual time."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from empty_store import lay_empty_store
from virtual_time import virtual_rig
from virtual_time.clock import VirtualClock

from calrig.calibration.diagnosis.tracing import diagnose
from calrig.calibration.plan_design.design_problem import Goals
from calrig.calibration.poses import Pose
from calrig.model.result import Result
from calrig.plan import Plan
from calrig.runs.plan_designs import Designed, DesignRequest, answer, question
from calrig.runs.service import RunService
from calrig.settings import BoardSettings, ReferenceSettings, RigSettings, StageSettings
from calrig.simulator.config import SimulatorSettings
from calrig.store import Store
from tests.studies.blind.layout import Layout

LONGEST_S = 3000.0
TIME_SCALE = 3.0
"""Of rigs whose time is not measured: fewer looks at their ports."""
MAP = ReferenceSettings(std_deg=0.003, kind="harmonic", distribution="normal")


@dataclass(frozen=True)
class Carried:
    """A run: what it took by its clock, its result and its poses."""

    took_s: float
    result: Result
    poses: list[Pose]


@dataclass(frozen=True)
class Bench:
    """A rig in time of its own, and what has been run on it."""

    clock: VirtualClock
    service: RunService
    settings: RigSettings
    time_scale: float

    def run(self, plan: Plan) -> Carried:
        """Carries a plan out."""
        began_s = self.clock.now_s()
        run_id = self.service.start(unit="A", plan=plan).id

        def has_ended() -> bool:
            return self.service.run(run_id).status not in ("queued", "running")

        self.clock.until(has_ended, "end", LONGEST_S)
        run = self.service.run(run_id)
        assert run.status == "completed" and run.result is not None, run.error
        took_s = self.time_scale * (self.clock.now_s() - began_s)
        return Carried(took_s, run.result, [stored.pose for stored in self.service.store.poses.of(run_id)])

    def reached_by(self, plan: Layout) -> Goals:
        """What a plan of dwells is expected to reach, by what the rig's last run showed of its noise."""
        task = question(DesignRequest(Goals(1.0)), Plan(), self.settings, "A", self.service.store, {}).task
        scatter_deg = task.precision.scatter_deg(plan.dwell_s)
        of = task.stated(plan.target_deg.tolist(), plan.dwell_s, math.nan, scatter_deg)
        return Goals(of.expanded_deg, of.bias_std_deg, of.scale_std)

    def designed(self, goals: Goals, *, sweep: bool) -> Designed:
        """The plan that the service would answer."""
        wanted = DesignRequest(goals, sweep=sweep)
        return answer(question(wanted, Plan(), self.settings, "A", self.service.store, {}))


@contextmanager
def bench(seed: int, options: Mapping[str, Any] | None = None, *, time_scale: float = 1.0) -> Iterator[Bench]:
    """An ordinary stage and a board with a data sheet's noise, and what else is wrong with them."""
    made = {
        "seed": seed,
        "time_scale": time_scale,
        "imu": {"gyro_bias_dps": [1.4, -0.6, 0.3]},
        **(options or {}),
    }
    clock = VirtualClock()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "calrig.db"
        lay_empty_store(path)
        rig = virtual_rig(SimulatorSettings.from_options(made), clock)
        settings = RigSettings(
            name="bench",
            stage=StageSettings(driver=rig.stage_driver, port=rig.stage_port),
            imu=BoardSettings(driver=rig.imu_driver, port=rig.imu_port),
            reference=MAP,
        )
        with rig, Store.open(f"sqlite:///{path}", writer="tests") as store:
            service = RunService(store, [settings])
            try:
                yield Bench(clock, service, settings, time_scale)
            finally:
                service.close()
    clock.stop()


def finds(plan: Plan, seed: int, name: str, size: float) -> bool:
    """Whether a run with a cause of that size lists its effect, by itself or among its suspects.

    `name`: `backlash` (degrees), or `mount_slip` (degrees, at any time of its 5th to 95th percent).
    """
    rng = np.random.default_rng(seed)
    sign = 1.0 if rng.integers(2) else -1.0
    options: dict[str, Any] = {"mechanics": {"backlash_deg": size}}
    if name == "mount_slip":
        took_s = len(plan.poses((-90.0, 90.0))) * (plan.dwell_s + 0.1)
        options = {"mount": {"slip_deg": sign * size, "slip_at_s": 6.0 + rng.uniform(0.05, 0.95) * took_s}}
    with bench(seed, options, time_scale=TIME_SCALE) as there:
        poses = there.run(plan).poses
    effects = diagnose([poses], cross_fit=False).findings.found
    return any(name in {c.name for c in (one.candidate, *one.rivals)} for one in effects)
