"""Tables as people have them: any columns, spans, spacings, directions, ties, constants and repeated rows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.poses import Pose

COUNTS = (3, 4, 5, 6, 8, 10, 13, 20, 27, 40, 60, 100, 160, 300, 1000)
OFTEN = 11
"""Of the counts, those drawn in nine of ten tables: the long ones take long."""
SPANS_DEG = (
    (-60.0, 60.0),
    (0.0, 350.0),
    (-180.0, 180.0),
    (0.0, 5.0),
    (-89.0, 89.0),
    (10.0, 10.0),
    (0.0, 1080.0),
)
GRAVITY_TILT_DEG = 0.7
CLOCK_S = 3.3


def elevations_deg(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return (count,) commanded elevations in the order visited."""
    low, high = SPANS_DEG[rng.integers(len(SPANS_DEG))]
    even = np.linspace(low, high, count)
    kind = rng.integers(7)
    if kind == 0:
        return rng.uniform(low, high, count) if high > low else even
    if kind == 1:
        return np.resize(np.concatenate([even[::2], even[::-2]]), count)
    if kind == 2:
        return rng.permutation(even)
    if kind == 3:
        return np.resize(even[:: max(1, count // 5)], count)  # ties: each elevation visited again
    if kind == 4:
        return even[::-1].copy()
    if kind == 5:
        return np.resize(np.concatenate([even, even[::-1]]), count)
    return even


def effect_deg(rng: np.random.Generator, theta_deg: np.ndarray, when_s: np.ndarray) -> np.ndarray:
    """Return (n,) what a cause adds to the readings, or nothing."""
    size_deg = 10.0 ** rng.uniform(-2.0, 1.0)
    kind = rng.integers(8)
    if kind == 0:
        return size_deg * np.sin(np.radians(theta_deg * rng.integers(1, 9)))
    if kind == 1:
        return size_deg * np.sign(np.gradient(theta_deg)) if len(theta_deg) > 1 else 0.0 * theta_deg
    if kind == 2:
        return size_deg * (when_s > np.median(when_s))
    if kind == 3:
        return size_deg * (theta_deg / 90.0) ** 2
    if kind == 4:
        return size_deg * when_s / (np.ptp(when_s) or 1.0)
    if kind == 5:
        return size_deg * np.gradient(theta_deg) / CLOCK_S if len(theta_deg) > 1 else 0.0 * theta_deg
    return 0.0 * theta_deg


VARIED = 10_000
"""Tables from this number on vary in more: those before it keep what they were when some failed."""
ODD_NAMES = ("humidity [%]", "Größe", "a" * 80, "__class__", "time", "1e5", "x y", "azimuth_deg", "mount_deg")
"""Of columns of one's own: of circles and mounts too, and such as attributes have."""


def varied(seed: int, runs: list[list[Pose]]) -> list[list[Pose]]:
    """Return a table with more of what people have.

    Columns under odd names, several effects at once, clocks that stand or go back, constant columns, values
    of any size, a constant target, and several runs, some of other lengths, mounts and units.
    """
    rng = np.random.default_rng([seed, 1])
    poses = [pose for run in runs for pose in run]
    count = len(poses)
    theta = np.array([pose.target_deg for pose in poses])
    spare = 10.0 ** rng.uniform(-2.0, 1.0, 3)
    more = np.zeros(count)
    if rng.random() < 0.4:
        order = rng.choice([1.0, 2.0, 4.0, 12.0, 50.0, rng.uniform(0.5, 200.0)])
        more += spare[0] * np.sin(np.radians(theta * order) + rng.uniform(0.0, 6.0))
    if rng.random() < 0.3:
        velocity_dps = np.gradient(theta) / CLOCK_S if count > 1 else 0.0 * theta
        more -= 0.1 * spare[1] * velocity_dps  # a reading that comes late
    if rng.random() < 0.2:
        more[rng.integers(count)] += 100.0 * spare[2]
    scale = 10.0 ** rng.integers(-6, 7) if rng.random() < 0.1 else 1.0
    own: dict[str, np.ndarray] = {}
    for name in rng.choice(ODD_NAMES, size=rng.integers(0, 4), replace=False).tolist():
        kind = rng.integers(6)
        if name == "mount_deg":
            own[name] = np.array([0.0, 90.0, 180.0])[
                rng.integers(0, 3, count) if kind else np.zeros(count, int)
            ]
        elif kind == 0:
            own[name] = np.full(count, rng.choice([0.0, 1e9, -1e-9]))
        elif kind == 1:
            own[name] = theta.copy()
        elif kind == 2:
            own[name] = (np.arange(count) % 2).astype(float)
        elif kind == 3:
            own[name] = rng.uniform(0.0, 360.0, count)
        else:
            own[name] = rng.standard_normal(count) * 10.0 ** rng.integers(-12, 13)
        if rng.random() < 0.2:
            more += spare[2] * np.nan_to_num(own[name] / (np.abs(own[name]).max() or 1.0))
    clock, constant = rng.integers(8), rng.random() < 0.1
    changed = []
    for k, pose in enumerate(poses):
        time_s = pose.time_s
        if time_s is not None and clock < 4:
            time_s = (0.0, time_s % 20.0, -time_s, 1.7e9 + time_s)[clock]
        new = replace(
            pose,
            target_deg=float(theta[0]) if constant else pose.target_deg * scale,
            reading_deg=(pose.reading_deg + float(more[k])) * scale,
            time_s=time_s,
            covariates={**pose.covariates, **{name: float(values[k]) for name, values in own.items()}},
        )
        if rng.random() < 0.02:
            new = replace(new, accel_y_g=new.accel_y_g and 0.0, accel_z_g=new.accel_z_g and 0.0)
        changed.append(new)
    if count < 6 or rng.random() < 0.7:
        return [changed]
    cuts = np.sort(rng.choice(np.arange(1, count), size=min(count - 1, rng.integers(1, 6)), replace=False))
    return [list(part) for part in np.split(np.array(changed, dtype=object), cuts)]


def table(seed: int) -> list[list[Pose]]:
    """Return the poses of one or several runs."""
    runs = _plain(seed)
    return runs if seed < VARIED else varied(seed, runs)


def _plain(seed: int) -> list[list[Pose]]:
    """Return the poses of one or two runs."""
    rng = np.random.default_rng(seed)
    count = COUNTS[rng.integers(OFTEN if rng.random() < 0.9 else len(COUNTS))]
    theta = elevations_deg(rng, count)
    when = CLOCK_S * np.arange(count) + (rng.uniform(0.0, 1.0, count) if rng.random() < 0.3 else 0.0)
    noise_deg = (0.0, 1e-9, 0.005, 0.05, 1.0)[rng.integers(5)]
    reading = 0.4 + (1.0, 1.01, 0.98, -1.0)[rng.integers(4)] * theta + effect_deg(rng, theta, when)
    reading = reading + noise_deg * rng.standard_normal(count)
    warm = 20.0 + when / 600.0 if rng.random() < 0.7 else np.full(count, 21.5)
    tilt = np.radians(reading + GRAVITY_TILT_DEG)
    exact = rng.random() < 0.2  # |a| is constant to the last digit
    scatter = 0.0 if exact else 1e-3
    accel = np.stack(
        [
            scatter * rng.standard_normal(count),
            np.sin(tilt) + scatter * rng.standard_normal(count),
            np.cos(tilt) + scatter * rng.standard_normal(count),
        ]
    )
    if rng.random() < 0.1:
        accel = np.tile([[0.0], [0.0], [1.0]], (1, count))
    if rng.random() < 0.5:
        reading = (reading + 180.0) % 360.0 - 180.0
    approach = np.where(np.diff(theta, prepend=theta[0] - 1.0) >= 0.0, 1, -1)
    optional: dict[str, np.ndarray] = {
        "sweep": np.cumsum(np.diff(approach, prepend=approach[0]) != 0),
        "approach": approach if rng.random() < 0.8 else np.zeros(count, dtype=int),
        "time_s": when,
        "temperature_c": warm,
        "stage_deg": theta + 0.01 * rng.standard_normal(count),
        "reading_std_deg": np.full(count, max(noise_deg, 1e-6)),
        "reading_stderr_deg": np.full(count, max(noise_deg, 1e-6) / 3.0),
        "n_samples": np.full(count, 400),
        "gyro_move_deg": np.diff(theta, prepend=theta[0]),
        "settle_s": np.full(count, 1.0) if rng.random() < 0.5 else rng.uniform(0.1, 3.0, count),
    }
    given = {name: values for name, values in optional.items() if rng.random() < 0.5}
    if rng.random() < 0.5:
        given |= {"accel_y_g": accel[1], "accel_z_g": accel[2]}
        if rng.random() < 0.7:
            given["accel_x_g"] = accel[0]
    own = {
        name: values
        for name, values in {
            "velocity_dps": np.gradient(theta) / CLOCK_S if count > 1 else 0.0 * theta,
            "humidity_pct": 40.0 + rng.standard_normal(count),
            "supply_v": np.full(count, 5.0),
        }.items()
        if rng.random() < 0.3
    }
    rows = list(range(count))
    if rng.random() < 0.15:
        rows += [int(k) for k in rng.integers(count, size=max(1, count // 4))]  # rows that stand twice
    gaps = rng.random() < 0.15
    poses = []
    for k in rows:
        is_known = {name: not gaps or rng.random() >= 0.1 for name in given}
        known = {name: values[k].item() if is_known[name] else None for name, values in given.items()}
        further: dict[str, float | None] = {name: float(values[k]) for name, values in own.items()}
        poses.append(Pose(float(theta[k]), float(reading[k]), covariates=further, **known))
    if len(poses) >= 12 and rng.random() < 0.15:
        middle = len(poses) // 2
        return [poses[:middle], poses[middle:]]
    return [poses]


def diagnosed(number: int, bootstraps: int) -> dict[str, Any]:
    """Return the diagnosis of a table; DiagnosisError where it is refused."""
    runs = table(number)
    run_ids = [str(k) for k in range(len(runs))]
    return document(diagnose(runs, run_ids, bootstraps=bootstraps), run_ids)
