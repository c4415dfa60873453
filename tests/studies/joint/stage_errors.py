"""Stages whose error is no short series: a damaged tooth, an unstated gear, orders between visited angles.

`python -m tests.studies.joint.stage_errors [--benches N]` prints the share of the map's points, and of the
unit's elevations, within two stated standard deviations of the truth. Stage, unit and noise are written out
here in numpy; nothing is shared with calrig but the type of a pose.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # inherited by the workers

import numpy as np

from calrig.calibration.poses import Pose
from calrig.calibration.separation.map_validity import checked
from calrig.calibration.separation.pose_table import MountedPoses
from calrig.calibration.separation.report import solution_document
from calrig.calibration.separation.solution import Solution, solve
from calrig.calibration.separation.stage_map import StageMap
from calrig.export.solution_documents import unit_documents

NOISE_DEG = 0.03
MOUNTS_DEG = (0.0, 120.0, 240.0)
NEAR_DEG = 3.0
"""Points of the map within this of a damaged tooth are counted."""
AT_DEG = 0.26
"""A point of the map so near to a pose is a visited angle."""
Curve = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Unit:
    """Offsets in g, gains, skew in rad, square and cubic terms of y and z."""

    offset: np.ndarray
    gain: np.ndarray
    skew: float
    square: np.ndarray
    cubic: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Unit:
        return cls(
            rng.normal(0.0, (0.05, 0.08)),
            rng.normal(0.0, 0.02, 2),
            math.radians(rng.normal(0.0, 0.5)),
            rng.normal(0.0, 0.005, 2),
            rng.normal(0.0, 0.005, 2),
        )

    def measured_g(self, elevation_deg: np.ndarray) -> np.ndarray:
        """(n, 2) y and z of gravity at elevations (n,)."""
        turn = np.radians(elevation_deg)
        true = np.stack([np.sin(turn), np.cos(turn)], axis=1)
        true[:, 0] += math.sin(self.skew) * true[:, 1]  # what acts along an axis that lies askew
        return self.offset + (1.0 + self.gain) * true + self.square * true**2 + self.cubic * true**3


def drawn_waves(rng: np.random.Generator, highest: int, rms_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes and phases of orders 1 to `highest`, together of this RMS over a turn."""
    size = np.abs(rng.normal(size=highest))
    size *= rms_deg * math.sqrt(2.0) / np.linalg.norm(size)
    return size, rng.uniform(0.0, 2.0 * math.pi, highest)


def series(size: np.ndarray, phase: np.ndarray) -> Curve:
    """The curve of these waves."""
    orders = np.arange(1.0, len(size) + 1.0)
    return lambda dial: np.sin(np.radians(dial)[:, None] * orders + phase) @ size


def tooth(shape: str, at_deg: float, height_deg: float = 0.3) -> Curve:
    """A bump 1° wide: `box` and `cosine` between its ends, `bell` with 1° as standard deviation."""

    def curve(dial: np.ndarray) -> np.ndarray:
        off = dial - at_deg
        if shape == "bell":
            return height_deg * np.exp(-0.5 * off**2)
        inside = np.abs(off) <= 0.5
        return height_deg * inside * (1.0 if shape == "box" else np.cos(math.pi * off) ** 2)

    return curve


def jittered(
    rng: np.random.Generator, n: int = 36, jitter_deg: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Dial angles over ±60° up and down, jittered by half a step; and approaches."""
    up = np.linspace(-60.0, 60.0, n)
    half = 0.5 * (up[1] - up[0]) if jitter_deg is None else jitter_deg
    dial = np.concatenate([up, up[::-1]])
    dial = np.clip(dial + rng.uniform(-half, half, len(dial)), -62.0, 62.0)
    return dial, np.repeat([1.0, -1.0], n)


@dataclass(frozen=True)
class Case:
    """One row of the study.

    Attributes:
        design: dial angles and approaches of one mount.
        extra: what the stage has beside its series.
        highest: order of the series.
    """

    design: Callable[[np.random.Generator], tuple[np.ndarray, np.ndarray]]
    extra: Callable[[np.random.Generator], tuple[Curve, float | None]]
    highest: int = 6
    noise_deg: float = NOISE_DEG


def nothing(_rng: np.random.Generator) -> tuple[Curve, None]:
    return (lambda dial: np.zeros(len(dial))), None


def damaged(rng: np.random.Generator, shape: str, height_deg: float = 0.3) -> tuple[Curve, float]:
    at_deg = float(rng.uniform(-50.0, 50.0))
    return tooth(shape, at_deg, height_deg), at_deg


def geared(
    rng: np.random.Generator, amplitude_deg: float = 0.03, period_deg: float = 7.2
) -> tuple[Curve, None]:
    phase = rng.uniform(0.0, 2.0 * math.pi)
    return (lambda dial: amplitude_deg * np.sin(2.0 * math.pi * dial / period_deg + phase)), None


def grid(_rng: np.random.Generator, step_deg: float = 10.0, sweeps: int = 4) -> tuple[np.ndarray, np.ndarray]:
    up = np.arange(-60.0, 60.0 + step_deg / 2, step_deg)
    sweep = [up if k % 2 == 0 else up[::-1] for k in range(sweeps)]
    return np.concatenate(sweep), np.repeat(np.resize([1.0, -1.0], sweeps), len(up))


def evenly(_rng: np.random.Generator, n: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """One sweep, half of its poses on the way up and half on the way down between them."""
    dial = np.linspace(-60.0, 60.0, n)
    return np.concatenate([dial[::2], dial[1::2][::-1]]), np.repeat([1.0, -1.0], [(n + 1) // 2, n // 2])


def full_turn(_rng: np.random.Generator, n: int = 72) -> tuple[np.ndarray, np.ndarray]:
    up = np.linspace(-180.0, 180.0, n // 2, endpoint=False)
    return np.concatenate([up, (up + 180.0 / len(up))[::-1]]), np.repeat([1.0, -1.0], n // 2)


def twice(_rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """36 elevations up, and half a step beside them down: the same dial angles in each mount."""
    up = np.linspace(-60.0, 60.0, 36)
    return np.concatenate([up, (up + 60.0 / 35.0)[::-1]]), np.repeat([1.0, -1.0], 36)


CASES: Mapping[str, Case] = {
    "six orders, jittered": Case(jittered, nothing),
    "twelve orders, jittered": Case(jittered, nothing, 12),
    "twelve orders, full turn": Case(full_turn, nothing, 12),
    "tooth of 0.3°, box": Case(jittered, partial(damaged, shape="box")),
    "tooth of 0.3°, cosine": Case(jittered, partial(damaged, shape="cosine")),
    "tooth of 0.3°, bell": Case(jittered, partial(damaged, shape="bell")),
    "tooth of 0.3°, bell, same angles": Case(twice, partial(damaged, shape="bell")),
    "tooth of 0.3°, box, same angles": Case(twice, partial(damaged, shape="box")),
    "tooth of 0.3°, bell, twelve orders": Case(jittered, partial(damaged, shape="bell"), 12),
    "tooth of 0.3°, box, jitter ±1°": Case(partial(jittered, jitter_deg=1.0), partial(damaged, shape="box")),
    "tooth of 0.1°, bell": Case(jittered, partial(damaged, shape="bell", height_deg=0.1)),
    "gear of 0.03° every 7.2°": Case(jittered, geared),
    "gear of 0.03° every 7.2°, same angles": Case(twice, geared),
    "grid of 10°, twelve orders": Case(grid, nothing, 12),
    "12 poses, twelve orders": Case(evenly, nothing, 12),
    "12 poses jittered, twelve orders": Case(partial(jittered, n=6), nothing, 12),
    "grid of 10°, six orders": Case(grid, nothing, 6),
}


@dataclass(frozen=True)
class Counted:
    """Points of the map and of the unit's elevations: how many, how many within two.

    Attributes:
        points, within: of the map; near the tooth where there is one.
        visited, visited_within: of the map at visited angles.
        unknown: points of the map that are null.
        elevations_within: share of the unit's.
        worst: in standard deviations.
        unit_error_deg, unit_std_deg: root mean squares.
        map_std_deg: median over the dial.
        told: codes of what the warnings name.
    """

    points: int
    within: int
    visited: int
    visited_within: int
    unknown: int
    elevations_within: float
    worst: float
    unit_error_deg: float
    unit_std_deg: float
    map_std_deg: float
    told: frozenset[str]


WORDS = {
    "region": "off together",
    "gear": "repeats every",
    "between": "not determined between",
    "outliers": "outliers were left out",
}


def bench(case: Case, seed: int) -> tuple[list[MountedPoses], Unit, Curve, float | None, np.ndarray]:
    """The poses of one bench with its truth: unit, stage, place of a tooth, and angles visited."""
    rng = np.random.default_rng([seed, 28])
    unit, smooth = Unit.drawn(rng), series(*drawn_waves(rng, case.highest, 0.29))
    extra, at_deg = case.extra(rng)

    def stage(dial: np.ndarray) -> np.ndarray:
        return smooth(dial) + extra(dial)

    lots, visited = [], []
    for nominal in MOUNTS_DEG:
        dial, approach = case.design(rng)
        elevation = dial + stage(dial) + nominal + rng.normal(0.0, 0.8)
        vector = unit.measured_g(elevation) + rng.normal(0.0, math.radians(case.noise_deg), (len(dial), 2))
        reading = np.degrees(np.arctan2(vector[:, 0], vector[:, 1]))
        poses = [
            Pose(
                target_deg=float(dial[k]),
                reading_deg=float(reading[k]),
                approach=int(approach[k]),
                time_s=10.0 * k,
                stage_deg=float(dial[k]),
                accel_y_g=float(vector[k, 0]),
                accel_z_g=float(vector[k, 1]),
            )
            for k in range(len(dial))
        ]
        lots.append(MountedPoses("U", f"m{nominal:g}", nominal, "bench", poses))
        visited.append(dial)
    return lots, unit, stage, at_deg, np.concatenate(visited)


def count(case: Case, seed: int) -> Counted:
    """One bench measured, solved and compared with the truth."""
    lots, unit, stage, at_deg, visited = bench(case, seed)
    solution = solve(lots)
    document = solution_document(solution)
    found = document["stage"]["map"]
    dial = np.array(found["stage_deg"], dtype=np.float64)
    error, std = (np.array(found[key], dtype=np.float64) for key in ("error_deg", "std_deg"))
    known = np.isfinite(error)
    truth = stage(dial)
    # a constant belongs to the mounts: over the points away from the tooth
    far = known & (np.abs(dial - (1e9 if at_deg is None else at_deg)) > 5.0)
    off = error - truth
    off -= np.average(off[far], weights=std[far] ** -2.0) if far.any() else 0.0
    z = np.abs(off) / std
    counted = known if at_deg is None else known & (np.abs(dial - at_deg) <= NEAR_DEG)
    nearest = np.abs(dial[:, None] - visited).min(axis=1)
    at_pose = known & (nearest < AT_DEG)
    unit_z, unit_error, unit_std = _unit(solution, unit)
    return Counted(
        int(counted.sum()),
        int((z[counted] < 2.0).sum()),
        int(at_pose.sum()),
        int((z[at_pose] < 2.0).sum()),
        int((~known).sum()),
        float(np.mean(unit_z < 2.0)),
        float(z[counted].max(initial=0.0)),
        unit_error,
        unit_std,
        float(np.median(std[known])) if known.any() else math.nan,
        frozenset(
            code for code, words in WORDS.items() if any(words in said for said in document["warnings"])
        ),
    )


def _unit(solution: Solution, unit: Unit) -> tuple[np.ndarray, float, float]:
    """Error over standard deviation of the unit's elevation less its mean, and both as root mean squares."""
    (document,) = unit_documents(solution).values()
    known = solution.uncertainties[0]
    elevation = known.elevation_deg
    expected = _undone(document, unit.measured_g(elevation))
    error = expected - elevation
    error -= error.mean()
    z = np.abs(error) / known.std_deg
    return z, float(np.sqrt(np.mean(error**2))), known.rms_deg


def _undone(document: Mapping[str, object], vector: np.ndarray) -> np.ndarray:
    """Elevations that the calibration gives for these vectors, by bisection of its own formulae."""
    parameters = {
        name: value
        for effect in document["effects"]  # type: ignore[attr-defined]
        for name, value in effect["parameters"].items()
    }
    reading = np.degrees(np.arctan2(vector[:, 0], vector[:, 1]))

    def angle(elevation: np.ndarray) -> np.ndarray:
        turn = np.radians(elevation)
        y, z = np.sin(turn), np.cos(turn)
        gain, skew = 1.0 + 0.01 * parameters["gain_pct"], math.radians(parameters["skew_deg"])
        u = y + z * math.sin(skew)
        own_y = gain * u + 1e-3 * (
            parameters["y_mg"] + parameters["y_mg_per_g2"] * u**2 + parameters["y_mg_per_g3"] * u**3
        )
        own_z = z + 1e-3 * (
            parameters["z_mg"] + parameters["z_mg_per_g2"] * z**2 + parameters["z_mg_per_g3"] * z**3
        )
        return np.degrees(np.arctan2(own_y, own_z))

    low, high = reading - 20.0, reading + 20.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = (angle(middle) - reading + 180.0) % 360.0 - 180.0 < 0.0
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return 0.5 * (low + high)


def totals(counted: Sequence[Counted]) -> str:
    """One row: shares within two of points, visited angles and elevations, and what was told."""

    def share(inside: str, of: str) -> str:
        n = sum(getattr(one, of) for one in counted)
        return f"{sum(getattr(one, inside) for one in counted) / n:.2f}" if n else "none"

    told = ", ".join(
        f"{code} {sum(code in one.told for one in counted)}"
        for code in WORDS
        if any(code in one.told for one in counted)
    )
    error, std = (
        math.sqrt(np.mean([getattr(one, name) ** 2 for one in counted]))
        for name in ("unit_error_deg", "unit_std_deg")
    )
    return (
        f"{len(counted)} | {share('within', 'points')} | {max(one.worst for one in counted):.1f} | "
        f"{share('visited_within', 'visited')} | {np.median([one.map_std_deg for one in counted]):.4f}° | "
        f"{sum(one.unknown for one in counted) / len(counted):.0f} | "
        f"{np.mean([one.elevations_within for one in counted]):.2f} | {error:.4f}° | {std:.4f}° | {told}"
    )


HEADINGS = (
    "case",
    "benches",
    "map within two",
    "worst",
    "at visited angles",
    "stated",
    "null",
    "elevations within two",
    "unit's error",
    "stated",
    "told",
)


@dataclass(frozen=True)
class Change:
    """What the stage does between two runs of seven angles four times, and the noise of both.

    Attributes:
        order: whose wave of `rms_deg` comes up at a phase drawn at random; None of no change.
        correlation: of the noise from one pose to the next.
    """

    order: int | None
    noise_deg: float
    rms_deg: float = 0.1
    correlation: float = 0.0
    step_deg: float = 20.0


CHANGES: Mapping[str, Change] = {
    **{f"nothing, noise {noise}°": Change(None, noise) for noise in (0.012, 0.03)},
    **{f"nothing, noise 0.03° correlated by {r}": Change(None, 0.03, correlation=r) for r in (0.3, 0.6)},
    "nothing, 13 angles, noise 0.03°": Change(None, 0.03, step_deg=10.0),
    "nothing, 13 angles, noise 0.03° correlated by 0.6": Change(None, 0.03, correlation=0.6, step_deg=10.0),
    **{
        f"order {order} of 0.1° RMS, noise {noise}°": Change(order, noise)
        for noise in (0.012, 0.03)
        for order in range(2, 7)
    },
}


def alarm(change: Change, seed: int) -> bool:
    """Whether the guard takes the stage's map for changed."""
    rng = np.random.default_rng([seed, 29])
    unit, waves, wrong = Unit.drawn(rng), drawn_waves(rng, 6, 0.29), drawn_waves(rng, 6, MAP_ERROR_DEG)
    stage = series(*waves)
    size, phase = (
        change.rms_deg * math.sqrt(2.0) * (change.order is not None),
        rng.uniform(0.0, 2.0 * math.pi),
    )
    dial, approach = grid(rng, change.step_deg)
    runs = []
    for share in (0.0, 1.0):
        wave = share * size * np.sin((change.order or 0) * np.radians(dial) + phase)
        drawn = rng.normal(0.0, math.radians(change.noise_deg), (len(dial), 2))
        for before, now in pairwise(drawn):
            now[:] = change.correlation * before + math.sqrt(1.0 - change.correlation**2) * now
        vector = unit.measured_g(dial + stage(dial) + wave + rng.normal(0.0, 0.8)) + drawn
        reading = np.degrees(np.arctan2(vector[:, 0], vector[:, 1]))
        runs.append(
            [
                Pose(target_deg=float(d), stage_deg=float(d), reading_deg=float(r), approach=int(a))
                for d, r, a in zip(dial, reading, approach, strict=True)
            ]
        )
    found = checked(runs[1], runs[0], _map_of(waves, wrong))
    return found is not None and found.has_moved


MAP_ERROR_DEG = 0.006


def _map_of(*curves: tuple[np.ndarray, np.ndarray]) -> StageMap:
    """The map of the sum of these curves."""
    pairs = sum(np.stack([size * np.sin(phase), size * np.cos(phase)], axis=1) for size, phase in curves)
    coefficients = np.append(np.ravel(pairs), 0.0)
    covariance = np.diag(np.r_[np.full(len(coefficients) - 1, MAP_ERROR_DEG**2 / 6.0), 0.0])
    orders = tuple(np.arange(1.0, len(coefficients) // 2 + 1.0).tolist())
    return StageMap(orders, coefficients, covariance, np.linspace(-60.0, 60.0, 61), "")


def main() -> None:
    """Print one row a case."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.joint.stage_errors", description=__doc__)
    parser.add_argument("--benches", type=int, default=40)
    parser.add_argument("--only", default="", help="cases with these words")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--guard", action="store_true", help="the check of a map instead")
    wanted = parser.parse_args()
    if wanted.guard:
        with ProcessPoolExecutor(wanted.workers) as workers:
            for name, change in CHANGES.items():
                seen = sum(workers.map(partial(alarm, change), range(wanted.benches), chunksize=50))
                sys.stdout.write(f"| {name} | {seen} of {wanted.benches} |\n")
        return
    sys.stdout.write(f"| {' | '.join(HEADINGS)} |\n|{' --- |' * len(HEADINGS)}\n")
    with ProcessPoolExecutor(wanted.workers) as workers:
        for name, case in CASES.items():
            if wanted.only in name:
                found = list(workers.map(partial(count, case), range(wanted.benches)))
                sys.stdout.write(f"| {name} | {totals(found)} |\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main()
