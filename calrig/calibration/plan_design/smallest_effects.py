"""Compute the smallest effect that a design of poses detects with 80 % power, before anything moves."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from calrig.calibration.diagnosis.candidates import Candidate, candidate_of, candidates_of
from calrig.calibration.effects import EFFECTS
from calrig.calibration.plan_design.layout import Pace, Sweep, Turning
from calrig.calibration.poses import Filtering, Pose
from calrig.calibration.regression.channels import ANGLE, MOVE, NORM, READING
from calrig.calibration.regression.noise_model import NoiseModel, stacked
from calrig.calibration.regression.responses import FEWEST_POSES, Responses, responses_of
from calrig.estimation.angles import FloatArray

SHOWN_BY_MOVING = (
    "backlash",
    "settling",
    "accelerometer_offset",
    "axis_mismatch",
    "stage_eccentricity",
    "stage_periodic",
    "nonlinearity",
    "time_drift",
    "mount_slip",
)
"""Suspects of any rig that a plan can provoke; what temperature does comes as the room likes."""
BY_CHANCE = 6.3e-5
"""Of one shape among all that a search tries, so that the best of them is chance in one run of a hundred."""
POWER_QUANTILE = 0.8416
"""Of the normal distribution: four times in five."""
TAKEN = 22
"""Degrees of freedom that a search takes: its line, correlations and rivals, as diagnoses of 20 to 52 poses
with effects of known size have shown (`python -m tests.studies.plans suspects`)."""
SLOW = 1.6
"""Times as large an effect of time must be, measured the same way: noise that wanders looks like it."""
SHARED = 0.87
"""Correlation of the reading's noise with that of the accelerometer's angle."""
MOST_PARAMETERS = 2
"""Of a form that a plan is to show: a drift that bends is found by more than its straight part."""
MOVE_DEG = 0.02
"""Noise of the gyro's integral over a move."""
UNMEASURED = 1e-7
"""Drawn on imagined witnesses: one that is exact is taken for one that was never measured."""


@dataclass(frozen=True, slots=True)
class Suspect:
    """The smallest size of an effect that would be found four times in five, whatever its phase or place.

    Attributes:
        rms_deg: of what it leaves in calibrated readings, which bias and scale take nothing of; infinite
            where these poses cannot show it.
        parameter, value: the same as its parameter, where it has one alone.
    """

    name: str
    title: str
    rms_deg: float
    parameter: str | None
    unit: str | None
    value: float | None


def suspects(poses: Sequence[Pose], scatter_deg: float, hidden: Collection[str] = ()) -> list[Suspect]:
    """What poses would show of each suspect, by the distance of T-optimality (Atkinson & Fedorov, 1975).

    Of a shape X in units of the noise, less what bias, scale and the witnesses' own take of it, sizes β are
    found where β'X'(I − P)Xβ is as large as `_distance` of these poses.

    Args:
        poses: as a faultless unit would measure them; fewer than eight show nothing.
        scatter_deg: of a reading.
        hidden: effects of `SHOWN_BY_MOVING` that such poses never show.
    """
    if len(poses) < FEWEST_POSES:
        return [_said(name, math.inf, None) for name in SHOWN_BY_MOVING]
    r = responses_of([poses])
    noise = _noise(r, scatter_deg)
    base = np.linalg.qr(stacked(noise, r.starts, r.base))[0]
    found: dict[str, list[tuple[float, float | None]]] = {name: [] for name in SHOWN_BY_MOVING}
    standing = replace(r, stretch_deg=np.zeros(len(r)))
    for candidate in candidates_of(r):
        shown = candidate.name in found and candidate.name not in hidden
        is_one = candidate.beside is None and candidate.changed is None
        if shown and is_one and len(candidate.shape.parameters) <= MOST_PARAMETERS:
            in_dwells = _in_dwells(candidate, standing) if r.stretch_deg.any() else candidate
            found[candidate.name].append(_least(candidate, in_dwells, r, noise, base))
    return [_said(name, *_middle(sizes)) for name, sizes in found.items()]


def _in_dwells(candidate: Candidate, standing: Responses) -> Candidate:
    """The same where the stage stood at every pose; itself where that is another form."""
    shapes = candidate.effect.forms(standing, candidate.shape.at)
    same = [shape for shape in shapes if shape.form == candidate.shape.form]
    return candidate_of(standing, candidate.effect, same[0]) if len(same) == 1 else candidate


def _least(
    candidate: Candidate, in_dwells: Candidate, r: Responses, noise: NoiseModel, base: FloatArray
) -> tuple[float, float | None]:
    """The least RMS beside a line that is found in the worst direction, and the parameter where it is one.

    It is that of readings in dwells at the same elevations, whatever is left of it in the mean of a stretch.
    """
    line = np.linalg.qr(np.column_stack([np.ones(len(r)), r.theta_deg]))[0]
    columns = stacked(noise, r.starts, candidate.columns)
    left = columns - base @ (base.T @ columns)
    seen = left.T @ left
    in_readings = in_dwells.columns[:, 0, :] - line @ (line.T @ in_dwells.columns[:, 0, :])
    size = in_readings.T @ in_readings / len(in_readings)
    values, vectors = np.linalg.eigh(seen)
    if values[0] <= 1e-9 * max(float(np.trace(columns.T @ columns)), 1e-300):
        return math.inf, None
    to_unit = vectors / np.sqrt(values)
    worst = float(np.linalg.eigvalsh(to_unit.T @ size @ to_unit)[-1])
    one = len(values) == 1 and len(candidate.shape.parameters) == 1
    distance = _distance(len(r))
    if EFFECTS[candidate.name].covariate.needs_time:
        distance *= SLOW**2
    return math.sqrt(distance * worst), math.sqrt(distance / float(values[0])) if one else None


def _distance(n_poses: int) -> float:
    """Noncentrality at which four of five effects are found, the noise being found from the same poses."""
    from scipy.special import stdtrit

    freedom = n_poses - TAKEN
    if freedom < 1:
        return math.inf
    critical = float(stdtrit(freedom, 1.0 - 0.5 * BY_CHANCE))
    return float((critical + POWER_QUANTILE * math.sqrt(1.0 + 0.5 * critical**2 / freedom)) ** 2)


def least_slow_deg(n_poses: int, scatter_deg: float) -> float:
    """The least RMS of an effect of time that so many poses show, however they are laid out.

    Reading and accelerometer's angle both show the whole of it, and bias and scale take nothing of it.
    """
    seen = 2.0 * n_poses / (1.0 + SHARED)
    return scatter_deg * SLOW * math.sqrt(_distance(n_poses) / seen)


def _middle(sizes: list[tuple[float, float | None]]) -> tuple[float, float | None]:
    """Of forms and places the middle one: the search tries them all, and the effect has one of them."""
    ordered = sorted(sizes, key=lambda size: size[0])
    return ordered[len(ordered) // 2] if ordered else (math.inf, None)


def _said(name: str, rms_deg: float, value: float | None) -> Suspect:
    effect = EFFECTS[name]
    parameter = effect.parameters[0] if value is not None and math.isfinite(value) else None
    if parameter is None:
        return Suspect(name, effect.title, rms_deg, None, None, None)
    return Suspect(name, effect.title, rms_deg, parameter.name, parameter.unit, value)


def _noise(r: Responses, scatter_deg: float) -> NoiseModel:
    """White noise, most of the reading's shared with the accelerometer's angle."""
    spread = {READING: scatter_deg, ANGLE: scatter_deg, NORM: math.radians(scatter_deg), MOVE: MOVE_DEG}
    covariance = np.diag([spread.get(name, scatter_deg) ** 2 for name in r.channels])
    if ANGLE in r.channels:
        k = r.channels.index(ANGLE)
        covariance[0, k] = covariance[k, 0] = SHARED * scatter_deg**2
    rotation = np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)).T, dtype=np.float64)
    return NoiseModel(rotation, np.zeros(len(r.channels)))


def imagined_dwells(elevations_deg: Sequence[float], dwell_s: float, pace: Pace) -> list[Pose]:
    """The dwells of a design as a faultless unit would measure them, each with every witness."""
    moves_deg = [0.0, *(after - before for before, after in pairwise(elevations_deg))]
    stops_s = [pace.travel_s(abs(move)) + pace.settle_s + pace.questions_s + dwell_s for move in moves_deg]
    ends_s = np.cumsum(stops_s)
    settled_s = [pace.settle_s] * len(elevations_deg)
    return _imagined(elevations_deg, (ends_s - 0.5 * dwell_s).tolist(), settled_s)


def imagined_sweep(sweep: Sweep, pace: Pace, turning: Turning, seed: int) -> list[Pose]:
    """Return the stretches and dwells of a sweep as a faultless unit would measure them."""
    planned = sweep.poses(seed)
    settled_s = [None if pose.stretch_deg else pace.settle_s for pose in planned]
    poses = _imagined([pose.target_deg for pose in planned], sweep.times_s(pace, turning), settled_s)
    filtering = Filtering(dwell_s=sweep.stretch_s, remembers=False)
    samples = round(sweep.stretch_s * filtering.rate_hz)
    return [replace(pose, filtering=filtering, n_samples=samples) for pose in poses]


def _imagined(
    elevations_deg: Sequence[float], times_s: Sequence[float], settled_s: Sequence[float | None]
) -> list[Pose]:
    rng = np.random.default_rng(0)
    moves = [0.0, *(after - before for before, after in pairwise(elevations_deg))]
    poses, approach = [], 0
    for elevation, move, time_s, settle_s in zip(elevations_deg, moves, times_s, settled_s, strict=True):
        approach = int(np.sign(move)) or approach
        across, along, felt = UNMEASURED * rng.standard_normal(3)
        poses.append(
            Pose(
                target_deg=elevation,
                reading_deg=elevation,
                approach=approach,
                time_s=time_s,
                stage_deg=elevation,
                accel_x_g=0.0,
                accel_y_g=math.sin(math.radians(elevation)) + across,
                accel_z_g=math.cos(math.radians(elevation)) + along,
                gyro_move_deg=move + felt,
                settle_s=settle_s,
            )
        )
    return poses
