"""Benches beyond the joint model: offsets or a map of each mount, a fourth power, seats askew, a shake.

`python -m tests.studies.joint.beyond [--runs N] [--first-seed S]` prints the table of
`calrig/docs/validation/error-separation.md`. Plain numpy: nothing here is calrig's but the container of poses
and the document that is judged.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from calrig.calibration.poses import Pose
from calrig.calibration.results.correction import calibrated_elevation_deg
from calrig.calibration.separation import MountedPoses, Solution, solve
from calrig.export.solution_documents import effects_of

GRID_DEG = np.linspace(-60.0, 60.0, 121)
NOISE_DEG = 0.03
POSES = 72
ARC = (-60.0, 60.0)


@dataclass(frozen=True)
class Sensor:
    """Offsets, gains, squares, cubes and fourth powers of y and z, g; and the skew of y, rad."""

    offset: np.ndarray
    gain: np.ndarray
    skew: float
    powers: np.ndarray
    """(3, 2): of the square, the cube and the fourth power along each axis."""

    def felt(self, force: np.ndarray, more_offset: np.ndarray | float = 0.0) -> np.ndarray:
        """(n, 2) what y and z make of a specific force (n, 3), g."""
        along = np.column_stack([force[:, 1] + self.skew * force[:, 2], force[:, 2]])
        bent = sum(self.powers[k] * along ** (k + 2) for k in range(3))
        return np.asarray(self.offset + more_offset + (1.0 + self.gain) * along + bent)


@dataclass(frozen=True)
class Wrong:
    """What is beyond the model, as standard deviations or sizes."""

    offset_mg: float = 0.0
    """Of each mount's own offsets of y and z."""
    quartic_mg: float = 0.0
    askew_deg: float = 0.0
    """Of each seat about the vertical and about the horizontal across the axis."""
    moved_deg: float = 0.0
    """Root mean square of what orders 1 and 2 of the map change by from mount to mount."""
    shake_mg: float = 0.0
    """By how much a shake at one angle of the dial moves the mean of each axis."""
    shake_noise: float = 1.0
    """Times the noise, there."""
    correlation: float = 0.0


@dataclass(frozen=True)
class Judged:
    """Share of ±60° within two standard errors, mean square error and stated variance, deg²."""

    within_two: float
    square: float
    stated: float
    refused: bool
    warned: bool


def bench(
    wrong: Wrong,
    seed: int,
    mounts_deg: tuple[float, ...] = (0.0, 120.0, 240.0),
    orders: int = 6,
    with_x: bool = False,
    arc: tuple[float, float] = ARC,
) -> tuple[Sensor, list[MountedPoses]]:
    """A unit, and its poses on one stage; its offsets are those of its first mount."""
    rng = np.random.default_rng([seed, 28])
    sensor = Sensor(
        rng.normal(0.0, (0.05, 0.08)),
        rng.normal(0.0, 0.02, 2),
        math.radians(rng.normal(0.0, 0.5)),
        np.vstack(
            [rng.normal(0.0, 0.005, (2, 2)), 1e-3 * wrong.quartic_mg * rng.choice([-1.0, 1.0], (1, 2))]
        ),
    )
    waves = rng.normal(size=(orders, 2))
    waves *= math.radians(0.29) / math.sqrt(0.5 * float((waves**2).sum()))
    up = np.linspace(*arc, POSES // 2, endpoint=arc[1] < 180.0)
    dial = np.concatenate([up, (up + 0.5 * (up[1] - up[0]))[::-1]])
    approach = np.repeat([1.0, -1.0], POSES // 2)
    shaken_at = rng.uniform(-50.0, 50.0)
    shift = 1e-3 * wrong.shake_mg * rng.choice([-1.0, 1.0], 2)
    skew_x = np.radians(rng.normal(0.0, 0.5, 2))
    lots, first_own = [], np.zeros(2)
    for k, nominal in enumerate(mounts_deg):
        moved = rng.normal(size=(2, 2)) * math.radians(wrong.moved_deg) / math.sqrt(2.0)
        own = 1e-3 * wrong.offset_mg * rng.normal(size=2)
        first_own = own if k == 0 else first_own
        table = np.radians(dial) + _map(waves, dial) + _map(moved, dial)
        turn = table + math.radians(nominal + rng.normal(0.0, 0.8))
        up_there = np.column_stack([np.zeros(POSES), np.sin(turn), np.cos(turn)])
        force = up_there @ _askew(np.radians(rng.normal(0.0, wrong.askew_deg, 2))).T
        shaken = np.abs(dial - shaken_at) < 5.0
        noise = math.radians(NOISE_DEG) * _noise(rng, wrong.correlation, 3)
        noise *= np.where(shaken, wrong.shake_noise, 1.0)[:, None]
        felt = sensor.felt(force, own) + shaken[:, None] * shift + noise[:, :2]
        felt_x = 0.03 + 1.01 * force[:, 0] + force[:, 1:] @ skew_x + noise[:, 2]
        lots.append(_lot(f"m{k}", nominal, dial, approach, felt, felt_x if with_x else None))
    return replace(sensor, offset=sensor.offset + first_own), lots


def _map(waves: np.ndarray, dial_deg: np.ndarray) -> np.ndarray:
    order = np.arange(1, len(waves) + 1)
    turn = np.radians(dial_deg)[:, None] * order
    return np.asarray(np.cos(turn) @ waves[:, 0] + np.sin(turn) @ waves[:, 1])


def _askew(angles: np.ndarray) -> np.ndarray:
    """(3, 3) about z, then y."""
    (a, b), eye = angles, np.eye(3)
    about_z, about_y = eye.copy(), eye.copy()
    about_z[:2, :2] = [[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]]
    about_y[::2, ::2] = [[math.cos(b), -math.sin(b)], [math.sin(b), math.cos(b)]]
    return np.asarray(about_y @ about_z)


def _noise(rng: np.random.Generator, correlation: float, width: int) -> np.ndarray:
    drawn = rng.normal(size=(POSES, width))
    for k in range(1, POSES):
        drawn[k] = correlation * drawn[k - 1] + math.sqrt(1.0 - correlation**2) * drawn[k]
    return drawn


def _lot(
    name: str,
    nominal: float,
    dial: np.ndarray,
    approach: np.ndarray,
    felt: np.ndarray,
    felt_x: np.ndarray | None,
) -> MountedPoses:
    angle = np.degrees(np.arctan2(felt[:, 0], felt[:, 1]))
    poses = [
        Pose(
            target_deg=float(dial[k]),
            stage_deg=float(dial[k]),
            reading_deg=float(angle[k]),
            approach=int(approach[k]),
            time_s=10.0 * k,
            accel_x_g=None if felt_x is None else float(felt_x[k]),
            accel_y_g=float(felt[k, 0]),
            accel_z_g=float(felt[k, 1]),
        )
        for k in range(len(dial))
    ]
    return MountedPoses("U0", name, nominal, "rig", poses, "x")


def error_deg(sensor: Sensor, solution: Solution) -> np.ndarray:
    """(121,) of the calibration over ±60°, its mean removed."""
    turn = np.radians(GRID_DEG)
    felt = sensor.felt(np.column_stack([np.zeros(len(turn)), np.sin(turn), np.cos(turn)]))
    effects = [(effect["name"], effect["parameters"]) for effect in effects_of(solution, 0)]
    found = calibrated_elevation_deg(np.degrees(np.arctan2(felt[:, 0], felt[:, 1])), 0.0, 1.0, effects)
    return np.asarray(found - GRID_DEG - np.mean(found - GRID_DEG))


def judge(wrong: Wrong, seed: int, **how) -> Judged:
    sensor, lots = bench(wrong, seed, **how)
    solution = solve(lots)
    error, known = error_deg(sensor, solution), solution.uncertainties[0]
    std = np.interp(GRID_DEG, known.elevation_deg, known.std_deg)
    return Judged(
        float(np.mean(np.abs(error) < 2.0 * std)),
        float(np.mean(error**2)),
        float(np.mean(std**2)),
        not solution.is_separable(0),
        bool(any(t.p_value < 0.01 for t in solution.mount_tests)),
    )


TURN = (-180.0, 180.0)
CASES: dict[str, tuple[Wrong, tuple[float, float]]] = {
    "none": (Wrong(), ARC),
    "none, noise correlated by 0.6": (Wrong(correlation=0.6), ARC),
    "quartic terms of 2 mg": (Wrong(quartic_mg=2.0), ARC),
    "offsets differ by 0.5 mg between mounts": (Wrong(offset_mg=0.5), ARC),
    "the same, full turn": (Wrong(offset_mg=0.5), TURN),
    "the map differs by 0.05° between mounts": (Wrong(moved_deg=0.05), ARC),
    "seats askew by 2°": (Wrong(askew_deg=2.0), ARC),
    "seats askew by 1°": (Wrong(askew_deg=1.0), ARC),
    "vibration shifts the mean by 2 mg over 10° of the dial": (Wrong(shake_mg=2.0), ARC),
    "vibration shifts the mean by 5 mg over 10° of the dial": (Wrong(shake_mg=5.0), ARC),
}


def table_row(name: str, judged: Sequence[Judged]) -> str:
    """One fault: coverage with its standard error over benches, RMS error, RMS stated, benches refused."""
    within = np.array([one.within_two for one in judged])
    achieved, stated = (
        math.sqrt(np.mean([getattr(one, of) for one in judged])) for of in ("square", "stated")
    )
    error = float(within.std(ddof=1)) / math.sqrt(len(within))
    coverage = f"{100 * within.mean():.1f} ± {100 * error:.1f} %"
    refused = sum(one.refused for one in judged)
    return f"| {name} | {coverage} | {achieved:.4f}° | {stated:.4f}° | {refused} of {len(judged)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.joint.beyond", description=__doc__)
    parser.add_argument("--runs", type=int, default=200, help="benches of each fault")
    parser.add_argument("--first-seed", type=int, default=0)
    asked = parser.parse_args()
    sys.stdout.write("| fault | coverage, k = 2 | achieved | stated | not separable |\n")
    sys.stdout.write("| --- | --- | --- | --- | --- |\n")
    for name, (wrong, arc) in CASES.items():
        seeds = range(asked.first_seed, asked.first_seed + asked.runs)
        sys.stdout.write(table_row(name, [judge(wrong, seed, arc=arc) for seed in seeds]) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
