"""Other ways to a whole unit, from what the same cube gives on the same stage.

- `calrig gravity`: |a| = 1 g of the same poses, whatever the stage.
- imucal's Ferraris (Ferraris, Grimaldi & Parvis, Sensors and Materials 7, 1995): six positions that are
  believed, and a full turn about each axis that is; both are taken from the poses and turns of the stage.
- imu_tk's method (Tedaldi, Pretto & Menegatti, A robust and easy to implement method for IMU calibration
  without external equipments, ICRA 2014), its two cost functions written from the paper: |a| again, then the
  gyro that carries gravity from one rest to the next.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from concurrent.futures import Executor
from functools import partial
from pathlib import Path

import numpy as np
from repository import SHARED
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calrig.calibration.gravity_fit import EFFECTS, Problem, fit_gravity
from calrig.calibration.poses import Pose
from calrig.calibration.separation.pose_table import MountedPoses
from calrig.calibration.separation.solution import solve
from calrig.calibration.separation.unit_results import accelerometer
from calrig.calibration.static_detector import static_poses
from calrig.calibration.static_segments import StaticPoses
from calrig.export.static_csv import accel_g_of, read_static

from .cube import ACCEL, MEANS, MOVES, CubeBench, Seat, drawn_cube_bench
from .cube_oracle import figures_of, sensor_figures
from .three_axes import FIVE_TURNS, felt_turns, felt_turns_found

Found = tuple[np.ndarray, np.ndarray, np.ndarray | None]
"""Offsets (3,) in g, matrix (3, 3) of true = matrix·(raw − offset), and (3,) as how much of a turn about each
mount's axis the gyro feels one, in whatever direction, or None."""
RATE_HZ = 200.0
MISALIGNED = [effect for effect in EFFECTS if effect.name == "misalignment"]
DATA = Path(os.environ.get("CALRIG_DATA", SHARED / "data"))
COLUMNS = ("offset, mg", "scale, ppm", "angles between axes, mrad", "gyro scale, ppm")


def tables(workers: Executor, seeds: Iterable[int]) -> str:
    """Root mean square errors over benches, of units stated linear and of units that are not."""
    seeds, text = list(seeds), ""
    for title, cubic in (("linear units", False), ("units with square and cube of 5 mg", True)):
        judged = list(workers.map(partial(judge, cubic=cubic), seeds))
        text += (
            f"\n| {title}, {len(seeds)} benches | {' | '.join(COLUMNS)} |\n| --- |{' --- |' * len(COLUMNS)}\n"
        )
        for name in judged[0]:
            rms = np.sqrt(np.mean([one[name] for one in judged], axis=0))
            text += f"| {name} | {' | '.join('' if math.isnan(x) else f'{x:.3g}' for x in rms)} |\n"
    return text


def of_measured_logs() -> str:
    """|a| less 1 g of measured logs in many positions; `calrig solve` needs a stage, and they have none."""
    text = "\n| measured log, no stage | poses | calrig gravity, mg | Tedaldi 2014, mg | calrig solve |\n"
    text += "| --- | --- | --- | --- | --- |\n"
    for file in sorted(DATA.glob("*_multiposition.csv")):
        log = read_static(file.read_bytes())
        poses = static_poses(accel_g_of(log), time_s=log.time_s, gyro_dps=log.axes("gyro", "dps"))
        fit = fit_gravity(Problem.of(poses), MISALIGNED)
        bias, matrix = tedaldi_accelerometer(poses.accel_g)
        left = np.linalg.norm((poses.accel_g - bias) @ matrix.T, axis=1) - 1.0
        rms_mg = [1e3 * math.sqrt(np.mean(np.square(one))) for one in (fit.residual_g, left)]
        text += f"| {file.stem} | {len(poses)} | {rms_mg[0]:.3f} | {rms_mg[1]:.3f} | not applicable |\n"
    return text


def judge(seed: int, *, cubic: bool) -> dict[str, np.ndarray]:
    """Mean squares (4,) of each way's errors on one bench."""
    bench = drawn_cube_bench(seed, cubic=cubic, turns=FIVE_TURNS)
    rng = np.random.default_rng([seed, 1551])
    lots = bench.measured(rng)
    ways = {
        "calrig solve": _solved(lots, linear=not cubic),
        "calrig gravity": _by_gravity(lots),
        "imucal, Ferraris": _by_ferraris(bench, lots, rng),
        "Tedaldi 2014 (imu_tk)": _by_tedaldi(lots),
    }
    return {name: _squares(bench, found) for name, found in ways.items()}


def _squares(bench: CubeBench, found: Found) -> np.ndarray:
    bias, matrix, gyro = found
    _, upper = np.linalg.qr(matrix)
    error = np.concatenate([1e3 * bias, figures_of(upper * np.sign(np.diag(upper))[:, None])])
    error -= sensor_figures(bench.unit)
    scale = np.nan if gyro is None else np.mean((1e6 * (gyro - felt_turns(bench))) ** 2)
    return np.array([np.mean(error[:3] ** 2), np.mean(error[3:6] ** 2), np.mean(error[6:] ** 2), scale])


def _solved(lots: list[MountedPoses], *, linear: bool) -> Found:
    fit = solve(lots, linear=linear).fit
    whole = accelerometer(fit, 0)
    assert whole is not None
    return whole.bias_g, whole.matrix, felt_turns_found(fit)


def _by_gravity(lots: list[MountedPoses]) -> Found:
    raw = _vectors(lots)
    poses = StaticPoses(raw, None, None, np.zeros((len(raw), 2), dtype=np.intp))
    fit = fit_gravity(Problem.of(poses), MISALIGNED)
    return fit.bias_g, fit.matrix, None


def _by_ferraris(bench: CubeBench, lots: list[MountedPoses], rng: np.random.Generator) -> Found:
    """Each of six positions as the dial has it: of the two mounts that come by it, both."""
    from imucal import FerrarisCalibration, FerrarisSignalRegions

    regions: dict[str, list[np.ndarray]] = {}
    for lot in lots:
        first = "xyz".index(lot.axis)
        for angle, place, sense in ((0, 2, "p"), (90, 1, "p"), (180, 2, "a"), (-90, 1, "a")):
            axis = "xyz"[(first + place) % 3]
            pose = min(lot.poses[:24], key=lambda pose: abs((pose.stage_deg - angle + 180) % 360 - 180))
            regions.setdefault(f"acc_{axis}_{sense}", []).append(_of(pose, ACCEL))
            regions.setdefault(f"gyr_{axis}_{sense}", []).append(_of(pose, MEANS))
    for lot, seat in zip(lots, bench.seats, strict=True):
        accel, gyro = _turn_samples(bench, lot, seat, rng)
        regions[f"acc_{lot.axis}_rot"], regions[f"gyr_{lot.axis}_rot"] = list(accel), list(gyro)
    signals = FerrarisSignalRegions(**{name: np.array(rows) for name, rows in regions.items()})
    found = FerrarisCalibration(grav=1.0, expected_angle=360).compute(
        signals, RATE_HZ, from_acc_unit="g", from_gyr_unit="deg/s"
    )
    return found.b_a, np.linalg.inv(found.K_a @ found.R_a), np.linalg.norm(found.K_g @ found.R_g, axis=0)


def _turn_samples(
    bench: CubeBench, lot: MountedPoses, seat: Seat, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Samples of one upward turn, the mean of all that were made."""
    lasts_s = 360.0 / bench.velocity_dps
    n = round(lasts_s * RATE_HZ)
    dial = lot.poses[-1].stage_deg + 360.0 * (np.arange(n) + 0.5) / n
    accel = bench.unit.felt_g(bench.up(seat, dial, np.ones(n)))
    dwells = np.mean([_of(pose, MEANS) for pose in lot.poses[-len(FIVE_TURNS) :]], axis=0)
    upward = np.mean([_of(pose, MOVES) for sense, pose in _turns(lot) if sense > 0], axis=0)
    return accel + rng.normal(0.0, 0.005, (n, 3)), np.tile(upward / lasts_s + dwells, (n, 1))


def tedaldi_accelerometer(raw_g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offset (3,) and matrix (3, 3) of vectors (n, 3) at rest: the least of Σ(1 − |T·K·(a − b)|²)²."""

    def matrix_of(p: np.ndarray) -> np.ndarray:
        return np.array([[1.0, -p[0], p[1]], [0.0, 1.0, -p[2]], [0.0, 0.0, 1.0]]) @ np.diag(p[3:6])

    def of_lengths(p: np.ndarray) -> np.ndarray:
        return 1.0 - (((raw_g - p[6:9]) @ matrix_of(p).T) ** 2).sum(axis=1)

    p = least_squares(of_lengths, [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0], method="lm").x
    return p[6:9], matrix_of(p)


def _by_tedaldi(lots: list[MountedPoses]) -> Found:
    """Accelerometer by lengths; gyro: the least of Σ|u_a − u_g|², from one rest to the next."""
    bias, matrix = tedaldi_accelerometer(_vectors(lots))
    before, after, turns = [], [], []
    for lot in lots:
        up = (_vectors([lot]) - bias) @ matrix.T
        up /= np.linalg.norm(up, axis=1)[:, None]
        before.append(up[:-1])
        after.append(up[1:])
        turns.append([_of(pose, MOVES) for pose in lot.poses[1:]])
    at_first, at_last, felt = np.concatenate(before), np.concatenate(after), np.concatenate(turns)

    def of_turns(q: np.ndarray) -> np.ndarray:
        carried = Rotation.from_rotvec(-felt @ q.reshape(3, 3).T, degrees=True).apply(at_first)
        return (carried - at_last).ravel()

    gyro = least_squares(of_turns, np.eye(3).ravel(), method="lm").x.reshape(3, 3)
    felt_along = [np.mean([s * _of(pose, MOVES) for s, pose in _turns(lot)], axis=0) for lot in lots]
    sizes = [np.linalg.norm(felt) / np.linalg.norm(gyro @ felt) for felt in felt_along]
    return bias, matrix, np.array(sizes)


def _vectors(lots: list[MountedPoses]) -> np.ndarray:
    return np.array([_of(pose, ACCEL) for lot in lots for pose in lot.poses])


def _turns(lot: MountedPoses) -> Iterable[tuple[int, Pose]]:
    return zip(FIVE_TURNS, lot.poses[-len(FIVE_TURNS) :], strict=True)


def _of(pose: Pose, names: tuple[str, ...]) -> np.ndarray:
    return np.array([pose.covariates[n] if n in pose.covariates else getattr(pose, n) for n in names])
