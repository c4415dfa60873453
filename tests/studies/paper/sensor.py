"""A simulated sensor of the paper's noise, straight from the simulator's physics."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings

STANDARD_GRAVITY_MPS2 = 9.80665
ACCEL_STD_MPS2 = (0.04, 0.06, 0.07)
GYRO_STD_DPS = (0.67, 0.78, 0.12)
"""Of single samples: Table 2's Gaussians."""
RATE_HZ = 100.0
"""The paper states none; of a table of standard deviations nothing depends on it, of the filters all does."""
SETTLED_S = 600.0
COUNTS_PER_G, COUNTS_PER_DPS = 16384.0, 131.0
"""Of ±2 g and ±250 °/s, the sensor's own scales (PS-MPU-6000A, 6.1 and 6.2)."""


def benches(rate_hz: float, seed: int, **parts: Any) -> list[Bench]:
    """Three of one rig, each of whose sensors has the noise of one axis: the simulator's is that of all."""
    root_bandwidth = math.sqrt(0.5 * rate_hz)
    made = []
    for axis in range(3):
        imu = {
            "accel_noise_ug_per_rthz": 1e6 * ACCEL_STD_MPS2[axis] / STANDARD_GRAVITY_MPS2 / root_bandwidth,
            "gyro_noise_dps_per_rthz": GYRO_STD_DPS[axis] / root_bandwidth,
        }
        made.append(Bench(SimulatorSettings.from_options({"seed": seed, **parts, "imu": imu})))
    return made


def log_of(rig: list[Bench], time_s: np.ndarray, rate_hz: float = RATE_HZ) -> dict[str, np.ndarray]:
    """What the three say at some instants, (n,) a channel: g and °/s, by the counts of its registers."""
    channels: dict[str, np.ndarray] = {}
    for axis, (name, bench) in enumerate(zip("xyz", rig, strict=True)):
        counts = bench.counts(time_s, rate_hz).astype(float)
        channels[f"accel_{name}_g"] = counts[:, axis] / COUNTS_PER_G
        channels[f"gyro_{name}_dps"] = counts[:, 4 + axis] / COUNTS_PER_DPS
    return channels
