"""Calibrate a unit's gyro as `true = matrix·(raw − bias − dps_per_g·a)`, in its accelerometer's frame.

Dwells, while the stage is at rest, give the bias and its sensitivity to gravity:

    mean = bias + per_c·ΔT + D·g + h·n + k·(g × n)

g is gravity's direction, n the stage's axis, both in the unit; h and k are Earth's rate along the axis and
level across it, at most 0.0042 dps each. Earth's rate about the vertical rotates with g and cannot be
distinguished from D: up to 0.0042 dps/g of D's diagonal is Earth's.

Rotations about axes that the accelerometer knows, with the dwells between them, give the matrix:

    ∫(raw − bias) dt = G·n·Δφ + e·T − t·|Δφ|·r

n is the stage's axis in the unit, as the mounts have it; Δφ the table's rotation. A full turn closes on 360°
whatever the stage does; shorter moves need the map and are as uncertain as it is. e is the difference between
a dwell's mean and the move's (Earth's rate across the axis, gravity's influence): it is equal both ways, so
that rotations both ways separate it from G. r is the noise of the two dwells' means, which were taken off as
the bias: the other dwells show it, and how long a move lasts by the rotation, t, is estimated from it. Time
is the board's: a clock that is fast by 1 % is a gyro scale that is 1 % off.
"""

from dataclasses import dataclass

import numpy as np

from calrig.calibration.poses import GYRO_MEANS, GYRO_MOVES, HOST_TIME, Pose
from calrig.calibration.separation.least_squares import IDENTIFIED, Fit
from calrig.calibration.separation.stage_map import basis
from calrig.calibration.separation.unit_results import Accelerometer, slopes_of
from calrig.estimation.angles import FloatArray, Intp
from calrig.estimation.turning import ClockRate, clock_rate

EARTH_DPS = 15.041 / 3600.0
"""IERS Conventions 2010, chapter 1: 7.292115e−5 rad/s."""
LARGEST_BIAS_DPS, LARGEST_DPS_PER_G, LARGEST_DPS_PER_C = 100.0, 1.0, 1.0
"""MPU-6050 data sheet PS-MPU-6000A-00 rev. 3.4, section 6.1: ±20 dps, 0.1 dps/g; several times as much."""
FEWEST_DWELLS = 8
LEAST_DPS = 1e-6
BIAS, PER_G, PER_C, EARTH = slice(0, 3), slice(3, 12), slice(12, 15), slice(15, 17)
WIDTHS = np.repeat([LARGEST_BIAS_DPS, LARGEST_DPS_PER_G, LARGEST_DPS_PER_C, EARTH_DPS], [3, 9, 3, 2])


@dataclass(frozen=True, slots=True, eq=False)
class Dwells:
    """Of a gyro, in the sensor's frame.

    Attributes:
        bias_dps, bias_std_dps: (3,) at no acceleration, and at the unit's reference temperature.
        dps_per_g, dps_per_g_std: (3, 3) of the gyro's axes (rows) by directions of acceleration.
        is_identified: whether the poses identify `dps_per_g` and so the bias.
        left_dps: (poses, 3) what each dwell's mean differs by; 0 of those that have none.
    """

    bias_dps: FloatArray
    bias_std_dps: FloatArray
    dps_per_g: FloatArray
    dps_per_g_std: FloatArray
    is_identified: bool
    left_dps: FloatArray


def dwells_of(fit: Fit, unit: int) -> Dwells | None:
    """What a unit's dwells say; None where too few of them have all three means."""
    problem = fit.problem
    means = [[pose.covariates.get(name) for name in GYRO_MEANS] for pose in problem.table.poses]
    known = np.array([None not in mean for mean in means]) & fit.kept & (problem.table.unit == unit)
    rows = np.flatnonzero(known)
    if len(rows) < FEWEST_DWELLS:
        return None
    measured = np.array([means[row] for row in rows], dtype=np.float64)
    mounts = problem.table.mount[rows]
    axes = np.stack([problem.clamped(fit.parameters, k)[:, 0] for k in range(len(problem.table.mounts))])
    up, warmer = problem.directions(fit.parameters)[rows], problem.table.warmer_c[rows]
    design = np.zeros((len(rows), 3, len(WIDTHS)))
    for axis in range(3):
        design[:, axis, BIAS.start + axis] = 1.0
        design[:, axis, PER_G.start + 3 * axis : PER_G.start + 3 * axis + 3] = up
        design[:, axis, PER_C.start + axis] = warmer
    design[:, :, EARTH.start] = axes[mounts]
    design[:, :, EARTH.start + 1] = np.cross(up, axes[mounts])
    flat, response = design.reshape(-1, len(WIDTHS)), measured.ravel()
    variance = LEAST_DPS**2
    for _ in range(3):
        inverse = np.linalg.inv(flat.T @ flat / variance + np.diag(WIDTHS**-2.0))
        values = inverse @ (flat.T @ response) / variance
        left = response - flat @ values
        variance = max(float(left @ left) / max(len(left) - len(WIDTHS), 1), LEAST_DPS**2)
    stds, left_dps = np.sqrt(np.diag(inverse)), np.zeros((len(problem.table), 3))
    left_dps[rows] = left.reshape(-1, 3)
    return Dwells(
        values[BIAS],
        stds[BIAS],
        values[PER_G].reshape(3, 3),
        stds[PER_G].reshape(3, 3),
        bool((stds[PER_G] < IDENTIFIED * LARGEST_DPS_PER_G).all()),
        left_dps,
    )


TURN_DEG, CLOSES_DEG = 360.0, 1.0
SHORTEST_DEG = 10.0
FEWEST_TURNS = 3
LARGEST_OFF = 0.2
"""Largest deviation of a gyro's response from the identity; a measured move that differs more is another."""
SLOW_DPS = 10.0
"""Speed of moves whose time is not known: the slower, the more of Earth's rate is in them."""
ROUNDS = 4
LEAST_DEG = 1e-6
RESPONSE = 9


@dataclass(frozen=True, slots=True, eq=False)
class Turns:
    """A unit's gyro as its moves show it.

    Attributes:
        response: (3, 3) G, of a rate in the sensor's frame.
        covariance: (9, 9) of it, row by row.
        n: how many moves it rests on; `closed` whether those are full turns.
        one_way: whether some mount was turned in one sense only.
        noise_deg: scatter of one full turn.
    """

    response: FloatArray
    covariance: FloatArray
    n: int
    closed: bool
    one_way: bool
    noise_deg: float


@dataclass(frozen=True, slots=True, eq=False)
class _Moves:
    """m moves: rows of the table, degrees by the dial, degrees measured (m, 3), seconds, r (m, 3)."""

    rows: Intp
    dial_deg: FloatArray
    felt_deg: FloatArray
    lasts_s: FloatArray
    dwells_dps: FloatArray
    map_rad: FloatArray
    """(m, map) by how much the map's columns changed."""
    closed: bool


def turns_of(fit: Fit, unit: int, dwells: Dwells | None) -> Turns | None:
    """The response of one unit's gyro; None where its moves do not tell it about three axes."""
    moves = _moves(fit, unit, dwells)
    mounts = np.unique(fit.problem.table.mount[moves.rows])
    axes = {int(k): fit.problem.clamped(fit.parameters, int(k))[:, 0] for k in mounts}
    if len(axes) < FEWEST_TURNS or np.linalg.svd(np.stack(list(axes.values())))[1][-1] < LARGEST_OFF:
        return None
    unexplained = EARTH_DPS + (1.0 if dwells is None else float(np.linalg.norm(dwells.dps_per_g, 2)))
    response, covariance, noise = _solved(fit, moves, mounts, unexplained)
    at = fit.problem.table.mount[moves.rows]
    senses = [len(np.unique(np.sign(moves.dial_deg[at == mount]))) for mount in mounts]
    return Turns(response, covariance, len(moves.rows), moves.closed, min(senses) < 2, noise)


def _moves(fit: Fit, unit: int, dwells: Dwells | None) -> _Moves:
    """Return a unit's moves that its gyro measured as the stage made them: full turns, if there are any."""
    table = fit.problem.table
    rows, dial, felt, lasts, columns, noise = [], [], [], [], [], []
    places = {id(pose): row for row, pose in enumerate(table.poses)}
    left_dps = np.zeros((len(table.poses), 3)) if dwells is None else dwells.left_dps
    for row in np.flatnonzero((table.unit == unit) & fit.kept):
        now, before = table.poses[row], table.before[row]
        turned = _felt(now)
        if before is None or turned is None:
            continue
        way = now.dial_deg - before.dial_deg
        if abs(way) < SHORTEST_DEG or abs(np.linalg.norm(turned) / abs(way) - 1.0) > LARGEST_OFF:
            continue
        rows.append(row)
        dial.append(way)
        felt.append(turned)
        lasts.append(_lasts_s(before, now, way))
        came_from = left_dps[places[id(before)]] if id(before) in places else np.zeros(3)
        noise.append(0.5 * (left_dps[row] + came_from))
        angles = np.array([before.dial_deg, now.dial_deg])
        approach = np.array([before.approach or 0, now.approach or 0], dtype=np.float64)
        columns.append(np.diff(basis(angles, approach, fit.problem.orders), axis=0)[0])
    closed = np.array([abs(way / TURN_DEG - round(way / TURN_DEG)) * TURN_DEG < CLOSES_DEG for way in dial])
    taken = np.flatnonzero(closed) if closed.any() else np.arange(len(rows))
    width = 2 * len(fit.problem.orders) + 1
    return _Moves(
        np.array(rows, dtype=np.intp)[taken],
        np.array(dial)[taken],
        np.reshape(felt, (-1, 3))[taken],
        np.array(lasts)[taken],
        np.reshape(noise, (-1, 3))[taken],
        np.reshape(columns, (-1, width))[taken],
        bool(closed.any()),
    )


def _solved(
    fit: Fit, moves: _Moves, mounts: Intp, unexplained_dps: float
) -> tuple[FloatArray, FloatArray, float]:
    """G, its covariance, and the scatter of a full turn, with mounts and map as the fit has them."""
    problem, n_own = fit.problem, RESPONSE + 1 + 3 * len(mounts)
    nuisance = np.concatenate([*(np.r_[problem.tilts_at(int(k))] for k in mounts), np.r_[problem.map_at]])
    free = nuisance[problem.free[nuisance]]
    at = np.searchsorted(mounts, problem.table.mount[moves.rows])
    weight = np.sqrt(TURN_DEG / np.maximum(np.abs(moves.dial_deg), SHORTEST_DEG))[:, None]

    def expected(values: FloatArray) -> FloatArray:
        """(3m,) by the response, t, an unexplained rate of each mount, how mounts and map differ."""
        parameters = fit.parameters.copy()
        parameters[free] += values[n_own:]
        axes = np.stack([problem.clamped(parameters, int(mount))[:, 0] for mount in mounts])
        turned = moves.dial_deg + np.degrees(moves.map_rad @ parameters[problem.map_at])
        felt = turned[:, None] * (axes[at] @ values[:RESPONSE].reshape(3, 3).T)
        felt += moves.lasts_s[:, None] * values[RESPONSE + 1 : n_own].reshape(-1, 3)[at]
        felt -= values[RESPONSE] * np.abs(moves.dial_deg)[:, None] * moves.dwells_dps
        return np.asarray((weight * felt).ravel())

    precision = np.zeros((n_own + len(free), n_own + len(free)))
    precision[RESPONSE:n_own, RESPONSE:n_own] = np.eye(n_own - RESPONSE) / unexplained_dps**2
    precision[RESPONSE, RESPONSE] = SLOW_DPS**2
    precision[n_own:, n_own:] = np.linalg.inv(fit.covariance_at(free))
    values = np.concatenate([np.eye(3).ravel(), np.zeros(len(precision) - RESPONSE)])
    measured = (weight * moves.felt_deg).ravel()
    for _ in range(ROUNDS):
        left = measured - expected(values)
        jacobian = slopes_of(expected, values, np.arange(len(values)))
        spare = max(len(left) - n_own, 1)
        variance = max(float(left @ left) / spare, LEAST_DEG**2)
        inverse = np.linalg.inv(jacobian.T @ jacobian / variance + precision)
        values = values + inverse @ (jacobian.T @ left / variance - precision @ values)
    covariance = np.asarray(inverse[:RESPONSE, :RESPONSE], dtype=np.float64)
    return np.asarray(values[:RESPONSE].reshape(3, 3)), covariance, float(np.sqrt(variance))


def _felt(pose: Pose) -> FloatArray | None:
    """(3,) degrees about x, y, z over the move into a pose; None where not all are known."""
    values = [pose.covariates.get(name) for name in GYRO_MOVES]
    return None if None in values else np.array(values, dtype=np.float64)


def _lasts_s(before: Pose, now: Pose, way_deg: float) -> float:
    """From dwell to dwell: at least as long as the move."""
    if before.time_s is None or now.time_s is None:
        return abs(way_deg) / SLOW_DPS
    return now.time_s - before.time_s


@dataclass(frozen=True, slots=True, eq=False)
class WholeGyro:
    """A gyro by its dwells and moves; None for what they do not identify.

    Attributes:
        dwells, turns: in the sensor's frame.
        matrix: (3, 3) and `matrix_std`, in the accelerometer's frame.
        dps_per_g: (3, 3) and `dps_per_g_std`, in the accelerometer's frame.
        clock: of the board's by the host's, where the poses have both times.
    """

    dwells: Dwells | None
    turns: Turns | None
    matrix: FloatArray | None
    matrix_std: FloatArray | None
    dps_per_g: FloatArray | None
    dps_per_g_std: FloatArray | None
    clock: ClockRate | None


def whole_gyro(fit: Fit, unit: int, accelerometer: Accelerometer | None) -> WholeGyro | None:
    """One unit's gyro; None where it has no columns of one."""
    dwells = dwells_of(fit, unit)
    turns = turns_of(fit, unit, dwells)
    if dwells is None and turns is None:
        return None
    turn = np.eye(3) if accelerometer is None else accelerometer.turn
    matrix = matrix_std = per_g = per_g_std = None
    if turns is not None and accelerometer is not None:
        inverse = np.linalg.inv(turns.response)
        matrix = turn @ inverse
        slopes = -np.kron(matrix, inverse.T)  # d(G⁻¹) = −G⁻¹·dG·G⁻¹, row by row
        variance = np.diag(slopes @ turns.covariance @ slopes.T).reshape(3, 3)
        across = np.sqrt((matrix**2).sum(axis=0) - matrix**2) * accelerometer.turn_std_rad
        matrix_std = np.sqrt(variance + across**2)
    if dwells is not None and dwells.is_identified:
        per_g = dwells.dps_per_g @ turn.T
        per_g_std = np.sqrt(dwells.dps_per_g_std**2 @ (turn.T) ** 2)
    return WholeGyro(dwells, turns, matrix, matrix_std, per_g, per_g_std, _clock(fit, unit))


def _clock(fit: Fit, unit: int) -> ClockRate | None:
    """The board's clock by the host's, over all runs of a unit."""
    table, poses = fit.problem.table, fit.problem.table.poses
    board, host = [], []
    for source in range(len(table.sources)):
        rows = np.flatnonzero((table.source == source) & (table.unit == unit))
        times = [(poses[row].time_s, poses[row].covariates.get(HOST_TIME)) for row in rows]
        both = np.array([pair for pair in times if None not in pair], dtype=np.float64).reshape(-1, 2)
        if len(both):
            board.append(both[:, 0])
            host.append(both[:, 1])
    return clock_rate(board, host) if board else None
