"""Processor time of a diagnosis: `OPENBLAS_NUM_THREADS=1 pytest tests/benchmarks/test_diagnosis.py`.

Aims: 100 poses named with 999 bootstraps 0.6 s, with cross-fitting 3 s, 400 poses named 4 s.
"""

from __future__ import annotations

import math
import random
import time

import pytest

from calrig.calibration.diagnosis import diagnose
from calrig.calibration.pose import Pose

pytestmark = pytest.mark.benchmark(timer=time.process_time)


def poses_of_a_stage_with_backlash(sweeps: int) -> list[Pose]:
    """25 elevations a sweep with every witness; the table lags by 0.08° behind its motor."""
    rng = random.Random(1)
    poses: list[Pose] = []
    stood: float | None = None
    for sweep in range(sweeps):
        approach = 1 if sweep % 2 == 0 else -1
        for elevation in range(-60 * approach, 61 * approach, 5 * approach):
            table = elevation - 0.04 * approach
            shared = rng.gauss(0.0, 0.03)
            seen = math.radians(table + shared + rng.gauss(0.0, 0.015))
            poses.append(
                Pose(
                    target_deg=elevation,
                    reading_deg=table + shared,
                    sweep=sweep,
                    approach=approach,
                    time_s=4.0 * len(poses),
                    temperature_c=25.0 + len(poses) / 20.0 + rng.gauss(0.0, 0.02),
                    stage_deg=elevation,
                    accel_x_g=0.0,
                    accel_y_g=math.sin(seen) * (1.0 + rng.gauss(0.0, 3e-4)),
                    accel_z_g=math.cos(seen) * (1.0 + rng.gauss(0.0, 3e-4)),
                    gyro_move_deg=None if stood is None else table - stood + rng.gauss(0.0, 0.02),
                )
            )
            stood = table
    return poses


@pytest.mark.parametrize(
    ("sweeps", "cross_fit"),
    [
        pytest.param(4, False, id="100 poses named"),
        pytest.param(4, True, id="100 poses, cross-fitted"),
        pytest.param(16, False, id="400 poses named"),
    ],
)
def test_a_diagnosis(benchmark, sweeps, cross_fit):
    poses = poses_of_a_stage_with_backlash(sweeps)
    found = benchmark.pedantic(lambda: diagnose([poses], cross_fit=cross_fit), rounds=3, warmup_rounds=1)
    assert found.findings.found[0].candidate.name == "backlash"
