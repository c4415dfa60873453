"""Sweeps on simulated rigs in virtual time, each with what the simulator did."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from virtual_time import virtual_rig
from virtual_time.clock import VirtualClock

from calrig.calibration.poses import Pose
from calrig.plan import Plan
from calrig.runs.service import RunService
from calrig.settings import BoardSettings, ReferenceSettings, RigSettings, StageSettings
from calrig.simulator.config import SimulatorSettings
from calrig.store import Run, Store

BIAS_DEG = 0.8
PLAN = Plan(kind="sweep", sweeps=4)

CASES: dict[str, dict[str, Any]] = {
    "the chip's noise": {},
    "reports 20 ms late, board's filter 13 ms": {"stage": {"report_delay_s": 0.02}, "imu": {"dlpf_cfg": 4}},
    "gyro wrong by 2.5 %": {"imu": {"gyro_scale_error_pct": [2.5, 0.0, 0.0]}},
    "board's clock wrong by 1 %": {"board": {"clock_error_ppm": 10_000.0}},
    "backlash of 0.2°": {"mechanics": {"backlash_deg": 0.2}},
    "worm of 0.05°": {"mechanics": {"worm_deg": 0.05}},
}
SHAKING: dict[str, dict[str, Any]] = {
    "0.02 g, board's filter 94 Hz": {"mechanics": {"vibration_g": 0.02}, "imu": {"dlpf_cfg": 2}},
    "0.1 g, board's filter 94 Hz": {"mechanics": {"vibration_g": 0.1}, "imu": {"dlpf_cfg": 2}},
    "0.3 g, board's filter 94 Hz": {"mechanics": {"vibration_g": 0.3}, "imu": {"dlpf_cfg": 2}},
    "0.1 g, no filter": {"mechanics": {"vibration_g": 0.1}},
    "0.3 g, no filter": {"mechanics": {"vibration_g": 0.3}},
}
MOTOR_STEP_DEG = 0.0187
"""No whole number of steps is a stretch."""


@dataclass(frozen=True, slots=True)
class Swept:
    """A run; (n,) errors of its poses' readings but for the mount, and the senses of its stretches."""

    run: Run
    errors_deg: np.ndarray
    senses: np.ndarray

    @property
    def sense_error_deg(self) -> float:
        """Mean error of the stretches upward less that downward: a delay not solved for, or play."""
        return float(self.errors_deg[self.senses > 0].mean() - self.errors_deg[self.senses < 0].mean())


def swept(options: Mapping[str, Any], seed: int, folder: Path, plan: Plan = PLAN) -> Swept:
    """One run on a rig that differs from the last by its seed."""
    run, poses = carried_out(options, seed, folder, plan)
    errors_deg = np.array([pose.reading_deg - pose.theta_deg - BIAS_DEG for pose in poses])
    senses = np.array([(pose.approach or 0) * (pose.settle_s is None) for pose in poses])
    return Swept(run, errors_deg, senses)


def carried_out(
    options: Mapping[str, Any], seed: int, folder: Path, plan: Plan = PLAN
) -> tuple[Run, list[Pose]]:
    """A plan carried out on a rig of its own, and the poses that it kept."""
    given = {
        **options,
        "stage": {"velocity_dps": 20.0, "acceleration_dps2": 80.0, **options.get("stage", {})},
        "mechanics": {"motor_step_deg": MOTOR_STEP_DEG, **options.get("mechanics", {})},
        "mount": {"offset_deg": BIAS_DEG, **options.get("mount", {})},
        "seed": seed,
    }
    clock = VirtualClock()
    simulated = virtual_rig(SimulatorSettings.from_options(given), clock)
    rig = RigSettings(
        name="bench-1",
        stage=StageSettings(driver=simulated.stage_driver, port=simulated.stage_port),
        imu=BoardSettings(driver=simulated.imu_driver, port=simulated.imu_port),
        reference=ReferenceSettings(std_deg=0.29),
    )
    with clock.taking_part(), simulated, Store.open(f"sqlite:///{folder}/{seed}.db", writer="tests") as store:
        with closing(RunService(store, [rig])) as service:
            run = service.wait(service.start(unit="AS-1", plan=plan).id, 600)
        return run, [stored.pose for stored in store.poses.of(run.id)]
