"""Poses of a unit clamped at several angles of a stage with an eccentricity, as files to import."""

from __future__ import annotations

from typing import Any

import httpx
import numpy as np
from support import imported

from calrig.estimation.angles import FloatArray
from calrig.simulator.config import ImuOptions
from calrig.simulator.imu import Imu, Surroundings

IMU = Imu(ImuOptions(accel_bias_mg=(0.0, 50.0, -30.0), accel_gain_error_pct=(0.0, 2.0, 0.0)))
HEADER = "target_deg,reading_deg,approach,accel_y_g,accel_z_g"


def felt_g(elevation_deg: FloatArray) -> FloatArray:
    """(n, 2) what the unit makes of gravity."""
    turn = np.radians(elevation_deg)
    force = np.stack([np.zeros(len(turn)), np.sin(turn), np.cos(turn)], axis=1)
    still = np.full(len(turn), 25.0)
    return IMU.accel_g(force, Surroundings(still, still, 0.0 * still))[:, 1:]


def rows_of(mount_deg: float, seed: int) -> list[str]:
    """Poses of a unit clamped at an angle of a stage with an eccentricity of 0.3°, as cells."""
    dial = np.linspace(-60.0, 60.0, 40)
    approach = np.where(np.arange(40) % 2, 1, -1)
    table = dial + 0.3 * np.sin(np.radians(dial + 40.0)) - 0.03 * approach
    vector = felt_g(table + mount_deg) + np.random.default_rng(seed).normal(0.0, 3e-4, (40, 2))
    reading = np.degrees(np.arctan2(*vector.T))
    return [
        f"{d:.4f},{r:.5f},{a},{y:.6f},{z:.6f}"
        for d, r, a, (y, z) in zip(dial, reading, approach, vector, strict=True)
    ]


def clamped(client: httpx.Client, unit: str, mount_deg: float, rig: str = "bench-1") -> dict[str, Any]:
    """A run of a unit clamped at an angle."""
    rows = [f"{row},{mount_deg}" for row in rows_of(mount_deg, int(mount_deg))]
    return imported(client, unit, "\n".join([f"{HEADER},mount_deg", *rows]), rig=rig)
