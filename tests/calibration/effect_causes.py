"""What is wrong with a rig or a unit, for each effect of the catalogue, and the poses that come of it.

The poses come of vectors and moves (the simulator's accelerometer, the Kalman filter itself), not of the
catalogue's equations.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from calrig.calibration.poses import Pose
from calrig.estimation.kalman import KalmanFilter
from calrig.simulator.bench import Mount
from calrig.simulator.config import ImuOptions, MountOptions
from calrig.simulator.imu import Imu, Surroundings
from calrig.simulator.trajectory import Turn

N_POSES = 80
SETTLE_S, DWELL_S, MOVE_S = 1.0, 2.0, 2.0
NOISE_DEG = 0.01


class Circumstance(NamedTuple):
    """What a rig and a unit are at each pose, (n,) each."""

    theta: np.ndarray
    approach: np.ndarray
    time_s: np.ndarray
    warmer_c: np.ndarray
    move_deg: np.ndarray
    velocity_dps: np.ndarray


def still(_here):
    return np.zeros(N_POSES)


@dataclasses.dataclass(frozen=True)
class Cause:
    """What is wrong: with the table (felt by all), the sensor on it (not by the gyro), the reading alone.

    `y_turns_deg` is by how much an error of a_y alone turns the measured vector. `looks_like` are names that
    no witness parts from the cause: what the filter leaves of a gyro's gain is a share of the move.
    """

    table_deg: object = still
    sensor_deg: object = still
    reading_deg: object = still
    y_turns_deg: object = still
    imu: dict = dataclasses.field(default_factory=dict)
    mount: dict = dataclasses.field(default_factory=dict)
    gyro_gain: float = 0.0
    truth: dict = dataclasses.field(default_factory=dict)
    looks_like: tuple = ()


def steps_of(here):
    return 0.15 * (here.time_s > 300.2)


def heated_c(here, lag_s, step_s=0.05):
    """The temperature of a body that heat reaches through a resistance, in small steps of time."""
    clock_s = np.arange(here.time_s[0], here.time_s[-1] + step_s, step_s)
    around_c = np.interp(clock_s, here.time_s, here.warmer_c)
    body_c = around_c.copy()
    for k in range(1, len(body_c)):
        body_c[k] = body_c[k - 1] + step_s / lag_s * (around_c[k - 1] - body_c[k - 1])
    return np.interp(here.time_s, clock_s, body_c)


def crept_deg(here, deg_per_decade):
    """A joint of springs and dampers under the load of its clamp since the run began."""
    mount = Mount(MountOptions(creep_deg_per_decade=deg_per_decade))
    level = np.zeros(N_POSES)
    return mount.package(Turn(level, level), here.time_s).angle_deg


CAUSES = {
    "backlash": Cause(table_deg=lambda h: -0.04 * h.approach, truth={"backlash_deg": -0.08}),
    "stage_eccentricity": Cause(
        table_deg=lambda h: 0.3 * np.sin(np.radians(h.theta + 40.0)), truth={"amplitude_deg": 0.3}
    ),
    "stage_periodic": Cause(
        table_deg=lambda h: 0.06 * np.sin(np.radians(360.0 / 7.31 * h.theta + 50.0)),
        truth={"amplitude_deg": 0.06, "phase_deg": 50.0},
    ),
    "accelerometer_offset": Cause(imu={"accel_bias_mg": (0.0, 3.0, -4.0)}, truth={"y_mg": 3.0, "z_mg": -4.0}),
    "axis_mismatch": Cause(imu={"accel_gain_error_pct": (0.0, 0.5, 0.0)}, truth={"gain_pct": 0.5}),
    "nonlinearity": Cause(
        y_turns_deg=lambda h: 4e-5 * h.theta**2 + 1e-6 * h.theta**3,
        truth={"deg_per_deg2": 4e-5, "deg_per_deg3": 1e-6},
    ),
    "temperature_bias": Cause(sensor_deg=lambda h: 0.02 * h.warmer_c, truth={"deg_per_c": 0.02}),
    "temperature_curvature": Cause(
        sensor_deg=lambda h: 0.02 * h.warmer_c + 0.006 * h.warmer_c**2, truth={"deg_per_c2": 0.006}
    ),
    "temperature_scale": Cause(sensor_deg=lambda h: 4e-4 * h.warmer_c * h.theta, truth={"per_c": 4e-4}),
    "temperature_offset": Cause(
        imu={"accel_bias_mg_per_c": (0.0, 0.4, -0.7)}, truth={"y_mg_per_c": 0.4, "z_mg_per_c": -0.7}
    ),
    "temperature_gain": Cause(imu={"accel_gain_pct_per_c": (0.0, 0.11, 0.0)}, truth={"gain_pct_per_c": 0.11}),
    "thermal_hysteresis": Cause(
        sensor_deg=lambda h: 0.03 * (h.warmer_c - heated_c(h, 40.0)),
        truth={"deg_per_c": 0.03, "lag_s": 40.0},
    ),
    "time_drift": Cause(sensor_deg=lambda h: 3e-4 * h.time_s, truth={"deg_per_s": 3e-4}),
    "mount_slip": Cause(sensor_deg=steps_of, truth={"step_deg": 0.15}),
    "mount_creep": Cause(sensor_deg=lambda h: crept_deg(h, 0.08), truth={"deg_per_decade": 0.08}),
    "axis_tilt": Cause(
        mount={"yaw_deg": 5.0, "axis_tilt_deg": 2.0},
        truth={"amplitude_deg": math.degrees(math.radians(5.0) ** 2 / 4), "phase_deg": 180.0},
    ),
    "settling": Cause(reading_deg=lambda h: -0.003 * h.move_deg, truth={"fraction": 0.003}),
    "gyro_scale": Cause(gyro_gain=0.05, truth={"gain_pct": 5.0}, looks_like=("settling",)),
    "latency": Cause(sensor_deg=lambda h: -0.02 * h.velocity_dps, truth={"delay_s": 0.02}),
}


def shown_by_the_filter(gyro_gain):
    """What the filter shows more than there is, in the mean over the dwell after a move of 1°."""
    time_s = np.arange(-20.0, MOVE_S + SETTLE_S + DWELL_S, 0.005) + 0.0025  # it begins between two samples
    rate_dps = np.where((time_s > 0.0) & (time_s <= MOVE_S), 1.0 / MOVE_S, 0.0)
    turned_deg = np.clip(time_s / MOVE_S, 0.0, 1.0)
    filtered_deg = KalmanFilter().run(time_s + 21.0, turned_deg, (1.0 + gyro_gain) * rate_dps)
    return float((filtered_deg - turned_deg)[time_s >= MOVE_S + SETTLE_S].mean())


def measured(name, seed):
    """The poses of a rig with one thing wrong, in random order, warming and cooling."""
    cause, rng = CAUSES[name], np.random.default_rng([*name.encode(), seed])
    theta = rng.uniform(-60.0, 60.0, N_POSES)
    move = np.diff(theta, prepend=0.0)
    time_s = (MOVE_S + SETTLE_S + DWELL_S) * np.arange(N_POSES) + MOVE_S + SETTLE_S + 0.5 * DWELL_S
    warmer_c = 4.0 * np.sin(time_s / 60.0 + seed) + 2.0 * np.sin(time_s / 23.0) ** 3
    velocity = np.where(rng.random(N_POSES) < 0.5, 0.0, rng.uniform(-5.0, 5.0, N_POSES))
    here = Circumstance(theta, np.sign(move), time_s, warmer_c, move, velocity)
    table = theta + cause.table_deg(here)
    turned = np.radians(table + cause.sensor_deg(here))
    force = Mount(MountOptions(**cause.mount)).specific_force_g(np.degrees(turned))
    force[:, 1] += (np.tan(turned + np.radians(cause.y_turns_deg(here))) - np.tan(turned)) * np.cos(turned)
    around = Surroundings(25.0 + warmer_c, 25.0 + warmer_c, np.zeros(N_POSES))
    accel = Imu(ImuOptions(reference_c=25.0, **cause.imu)).accel_g(force, around)
    noise = rng.normal(0.0, NOISE_DEG, N_POSES)
    elevation = np.degrees(np.arctan2(accel[:, 1], accel[:, 2]))
    shown_deg = shown_by_the_filter(cause.gyro_gain) * move if cause.gyro_gain else 0.0
    size = np.hypot(accel[:, 1], accel[:, 2]) + rng.normal(0.0, 2e-4, N_POSES)
    reading = elevation + cause.reading_deg(here) + shown_deg + noise
    seen = np.radians(elevation + 0.87 * noise + rng.normal(0.0, 0.5 * NOISE_DEG, N_POSES))
    felt = (1.0 + cause.gyro_gain) * np.diff(table, prepend=0.0) + rng.normal(0.0, 0.02, N_POSES)
    across = accel[:, 0] + rng.normal(0.0, 3e-4, N_POSES)
    extra = {"velocity_dps": velocity} if name == "latency" else {}
    return [
        Pose(
            target_deg=float(theta[k]),
            reading_deg=0.8 + 1.002 * float(reading[k]),
            approach=int(here.approach[k]),
            time_s=float(time_s[k]),
            temperature_c=25.0 + float(warmer_c[k]),
            accel_x_g=float(across[k]),
            accel_y_g=float(size[k] * math.sin(seen[k])),
            accel_z_g=float(size[k] * math.cos(seen[k])),
            gyro_move_deg=float(felt[k]),
            settle_s=SETTLE_S,
            covariates={key: float(column[k]) for key, column in extra.items()},
        )
        for k in range(N_POSES)
    ]
