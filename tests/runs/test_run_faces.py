"""Runs of a unit clamped by three faces in turn, over the wire: its whole accelerometer and gyro."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from run_rigs import TruthRig, begin, pass_time, plan

from calrig.analysis.solutions import SolutionRequest, question
from calrig.calibration.separation.report import solution_document
from calrig.calibration.separation.solution import solve
from calrig.runs.service import RunService
from calrig.store import Store

pytestmark = pytest.mark.statistical
BIAS_MG = [40.0, 30.0, -20.0]
GAIN_PCT = [1.5, -1.0, 0.5]
GYRO_BIAS_DPS = [0.8, -0.5, 0.3]
GYRO_SCALE_PCT = [1.0, -2.0, 0.5]


@pytest.fixture(scope="module")
def document(store: Store) -> dict[str, Any]:
    """Of three runs over ±80°, both ways, on a stage that is off by 0.25° in three orders."""
    waves = [(1, 0.25, 40), (2, 0.2, 200), (4, 0.12, 10)]
    harmonics = [{"order": k, "amplitude_deg": a, "phase_deg": p} for k, a, p in waves]
    imu = {
        "accel_bias_mg": BIAS_MG,
        "accel_gain_error_pct": GAIN_PCT,
        "gyro_bias_dps": GYRO_BIAS_DPS,
        "gyro_scale_error_pct": GYRO_SCALE_PCT,
    }
    bench = TruthRig(
        "cubes",
        mount={"seat_std_deg": 0.3, "axis_tilt_deg": 0.2},
        mechanics={"harmonics": harmonics},
        imu=imu,
    )
    both_ways = {"start_deg": -80, "stop_deg": 80, "step_deg": 32, "sweeps": 2}
    ids = []
    with bench.simulated:
        service = RunService(store, [bench.settings])
        for axis in "xyz":
            with bench.simulated.bench.lock:
                until_s = bench.simulated.bench.clamp(bench.now_s, 0.0, axis)
            pass_time(bench, until_s - bench.now_s + 0.5)
            face = plan(elevations_deg=None, **both_ways, settle_s=0.3, dwell_s=0.4, mount_axis=axis)
            run = service.wait(begin(service, face, "AS-C").id, 60)
            assert run.status == "completed", run.error
            ids.append(run.id)
        service.close()
    return solution_document(solve(question(store, SolutionRequest(ids)).lots, linear=True))


def test_the_accelerometer_is_the_simulated_one(document):
    (unit,) = document["units"]
    found = unit["accelerometer"]
    stds = np.sqrt(np.diag(found["covariance"]))
    assert (np.abs(1e3 * np.array(found["bias_g"]) - BIAS_MG) < 4e3 * stds[:3]).all()
    gain = 1.0 / np.diag(found["matrix"]) - 1.0
    assert (np.abs(gain - np.array(GAIN_PCT) / 100.0) < 4.0 * stds[[3, 7, 11]]).all()
    assert [mount["mount_axis"] for mount in document["mounts"]] == ["x", "y", "z"]
    assert document["stage"]["axis_dip_deg"]["value"] == pytest.approx(
        0.2, abs=4 * document["stage"]["axis_dip_deg"]["std"]
    )


def test_the_gyro_comes_from_the_samples_of_the_moves(document):
    (unit,) = document["units"]
    gyro = unit["gyro"]
    assert gyro["turns"]["n"] > 25
    assert gyro["turns"]["both_ways"]
    scale = 1.0 / np.diag(gyro["matrix"]) - 1.0
    assert (np.abs(scale - np.array(GYRO_SCALE_PCT) / 100.0) < 4.0 * np.diag(gyro["matrix_std"])).all()
    assert np.abs(np.array(gyro["bias_dps"]) - GYRO_BIAS_DPS).max() < 0.02
