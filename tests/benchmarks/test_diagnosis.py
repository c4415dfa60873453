"""Processor time of a diagnosis: `OPENBLAS_NUM_THREADS=1 pytest tests/benchmarks/test_diagnosis.py`.

Aims: 100 poses named with 999 bootstraps 0.6 s, with cross-fitting 3 s, 400 poses named 4 s. Of several
effects, cross-fitted: the demo rig's 52 poses 1.0 s, 100 poses with three 1.5 s, 500 poses over eleven turns
with every period down to twice their spacing 6 s, 485 poses of an axis with seven orders and a latency 8 s;
all in 250 MB. Beside them in `extra_info` the memory, and how many times as long it takes as a forward search
by BIC, which sees the reading alone and judges no name.
"""

from __future__ import annotations

import math
import random
import resource
import time
from collections.abc import Callable

import pytest
from diagnosed_runs import demo_run, eleven_turns, measured_axis, three_effects
from studies.blind.peers import forward_bic, library

from calrig.calibration.diagnosis.tracing import diagnose
from calrig.calibration.poses import Pose

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


@pytest.mark.parametrize(
    ("run", "found", "with_peer"),
    [
        pytest.param(
            demo_run,
            {"backlash", "stage_eccentricity", "accelerometer_offset", "temperature_offset"},
            True,
            id="52 poses of the demo rig",
        ),
        pytest.param(
            three_effects,
            {"backlash", "stage_periodic", "temperature_bias"},
            True,
            id="100 poses, three effects",
        ),
        pytest.param(
            eleven_turns, {"stage_eccentricity", "stage_periodic"}, False, id="500 poses, eleven turns"
        ),
        pytest.param(
            measured_axis,
            {"latency", "stage_eccentricity", "stage_periodic"},
            False,
            id="485 poses of an axis as real ones are",
        ),
    ],
)
def test_a_diagnosis_of_several_effects_cross_fitted(
    benchmark, run: Callable[[], list[Pose]], found: set[str], with_peer: bool
):
    poses = run()
    diagnosed = benchmark.pedantic(lambda: diagnose([poses]), rounds=3, warmup_rounds=1)
    benchmark.extra_info["memory MB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    if with_peer and benchmark.enabled:
        before_s = time.process_time()
        forward_bic(*library(poses))
        peer_s = time.process_time() - before_s
        benchmark.extra_info["times a forward BIC"] = round(benchmark.stats.stats.min / peer_s, 1)
    assert found <= {
        name for f in diagnosed.findings.found for name in (f.candidate.name, *(c.name for c in f.rivals))
    }
