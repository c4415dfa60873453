"""Table 1 on a gyro whose noise is known: what the simulator was told, and what its log says."""

from __future__ import annotations

import math

import numpy as np

from calrig.noise.analysis import analyse
from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings

from .sensor import COUNTS_PER_DPS, RATE_HZ

DENSITY, WALK = 0.02, 0.004
"""One-sided, °/s/√Hz; and °/s/√s."""
HOURS_S = 4 * 3600.0


def table(seed: int = 7) -> str:
    """White noise and random walk of the rate, as made and as found, with two standard errors."""
    imu = {"gyro_noise_dps_per_rthz": DENSITY, "gyro_walk_dps_per_rts": WALK}
    bench = Bench(SimulatorSettings.from_options({"seed": seed, "imu": imu}))
    time_s = np.arange(int(HOURS_S * RATE_HZ)) / RATE_HZ
    rate = bench.counts(time_s, RATE_HZ)[:, 4] / COUNTS_PER_DPS
    found = analyse({"gyro_x_dps": rate}, time_s).channels["gyro_x_dps"].coefficients
    rows = ["| | made with | found in 4 h |", "| --- | --- | --- |"]
    for words, made, one in (
        ("white N, °/√s: N/√τ", DENSITY / math.sqrt(2.0), found.white),
        ("random walk K, °/s/√s: K·√(τ/3)", WALK, found.random_walk),
    ):
        said = "not found" if one is None else f"{one.value:.5f} ± {2 * one.std:.5f}"
        rows.append(f"| {words} | {made:.5f} | {said} |")
    others = [kind for kind in ("quantisation", "flicker", "ramp") if getattr(found, kind) is not None]
    return "\n".join([*rows, f"| others | none | {', '.join(others) or 'none'} |"])
