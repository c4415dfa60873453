"""Test the joint solution for lack of fit: a mount that does not fit, an unstated gear, a vibrating stage.

Each mount is given terms of its own in addition to the joint fit: waves of the dial, as of another map; time,
as of a clamp that gives; a unit's gains, skew and offsets, as of another unit. What they explain is tested
against noise by an F test of added columns (Seber & Lee, Linear Regression Analysis, 2nd ed., section 3.7),
with Bonferroni's bound over all mounts and terms. Terms that the model has already drop out by their rank.

A gear whose period was not stated repeats many times in a turn, beyond the orders of the map, and raises the
noise. The residuals are tested against every period that the angles resolve; the best period is reported if
noise alone makes the best of them as good in at most 1 % of cases.

Vibration moves the mean of an accelerometer. The stage's map turns a vector and never changes its length, so
residuals along the vector show it whatever the map is. Windows over the dial are tested by the mean of each
mount's residuals there, with Bonferroni's bound over all windows.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calrig.calibration.regression.terms import covered
from calrig.calibration.separation.accelerometer import IN_PLANE, SKEW
from calrig.calibration.separation.least_squares import Fit
from calrig.calibration.separation.normal_equations import whitened
from calrig.calibration.separation.stage_map import (
    HIGHEST_ORDER,
    TURN_DEG,
    highest_identifiable_order,
)
from calrig.estimation.angles import FloatArray, Intp, wrap_deg

Cause = Literal["map", "time", "unit"]
LEVEL = 0.01
"""Chance that noise alone has any mount told of."""
WAVES = (1.0, 2.0, 3.0)
OF_THE_UNIT = np.flatnonzero(np.less(IN_PLANE, SKEW.stop))
"""Offsets, gains and skew."""
LEFT = 1e-3
"""Share of a term that the joint model must leave of it; of less it is the model's own."""
FEWEST_POSES = 8
AS_GOOD = 10.0
"""Of χ²: a mount that explains as much within this may be the one that is wrong."""


@dataclass(frozen=True, slots=True)
class MountTest:
    """What terms of its own explain of one mount.

    Attributes:
        mount: by index.
        cause: whose terms explain it best.
        p_value: the chance that noise explains as much, of any mount by any terms.
        gain: the decrease of χ².
    """

    mount: int
    cause: Cause
    p_value: float
    gain: float


def mount_tests(fit: Fit) -> list[MountTest]:
    """Each mount against the others, where it has poses enough and terms that are not the model's own."""
    found = {
        k: _of_mount(fit, k, rows)
        for k in range(len(fit.problem.table.mounts))
        if len(rows := np.flatnonzero((fit.problem.table.mount == k) & fit.kept)) >= FEWEST_POSES
    }
    tries = sum(len(by_cause) for by_cause in found.values())
    tests = []
    for k, by_cause in found.items():
        if by_cause:
            cause, (gain, p_value) = min(by_cause.items(), key=lambda item: (item[1][1], -item[1][0]))
            tests.append(MountTest(k, cause, min(tries * p_value, 1.0), gain))
    return tests


def misfits(tests: Sequence[MountTest]) -> list[MountTest]:
    """The mount that fits least, and those that may be the wrong one as well; none where all fit."""
    worst = min(tests, key=lambda test: (test.p_value, -test.gain), default=None)
    if worst is None or worst.p_value > LEVEL:
        return []
    return [test for test in tests if test.p_value <= LEVEL and test.gain > worst.gain - AS_GOOD]


def _of_mount(fit: Fit, k: int, rows: Intp) -> dict[Cause, tuple[float, float]]:
    """Decrease of χ² and p-value by each cause."""
    problem, derivatives = fit.problem, fit.normal.derivatives[rows]
    by_angle, terms = derivatives[:, :, problem.n_own - 1, None], {}
    turns = np.radians(problem.table.dial_deg[rows])[:, None] * np.array(WAVES)
    terms["map"] = by_angle * np.concatenate([np.cos(turns), np.sin(turns)], axis=1)[:, None, :]
    if problem.table.in_order:
        since = np.arange(1.0, len(rows) + 1.0)
        terms["time"] = by_angle * np.stack([since / len(rows), np.log(since)], axis=1)[:, None, :]
    terms["unit"] = derivatives[:, :, OF_THE_UNIT]
    left = fit.normal.residuals[rows][:, :, None]
    values = np.concatenate([*terms.values(), derivatives, left], axis=2)
    white, _ = whitened(values, rows, problem.table.source[rows], problem.correlation)
    flat = white.reshape(-1, white.shape[2])
    more = sum(term.shape[2] for term in terms.values())
    inverse = fit.inverse.at(np.concatenate([problem.own[k], np.arange(problem.first_order, problem.size)]))
    return _explained(fit, flat[:, more:-1] @ _root(inverse), flat, terms)


def _root(inverse: FloatArray) -> FloatArray:
    size, turn = np.linalg.eigh(inverse)
    return np.asarray(turn * np.sqrt(np.maximum(size, 0.0)))


def _explained(
    fit: Fit, taken: FloatArray, flat: FloatArray, terms: Mapping[str, FloatArray]
) -> dict[Cause, tuple[float, float]]:
    from scipy.special import fdtrc

    found: dict[Cause, tuple[float, float]] = {}
    first, squares = 0, fit.freedom * fit.noise**2
    for cause, term in terms.items():
        own = flat[:, first : first + term.shape[2]]
        first += term.shape[2]
        size = np.sqrt((own * own).sum(axis=0))
        own = own[:, size > 0.0] / size[size > 0.0]
        shared = taken.T @ own
        left, turn = np.linalg.eigh(own.T @ own - shared.T @ shared)
        told = left > LEFT
        if not told.any():
            continue
        gain = float((((turn.T @ (own.T @ flat[:, -1]))[told]) ** 2 / left[told]).sum())
        n_told, freedom = int(told.sum()), fit.freedom - int(told.sum())
        ratio = (gain / n_told) / (max(squares - gain, 1e-12 * squares) / freedom)
        found[cause] = gain / fit.noise**2, float(fdtrc(n_told, freedom, ratio))  # type: ignore[index]
    return found


STEPS_A_WAVE = 2.0
"""Orders tried for each that an arc resolves."""


@dataclass(frozen=True, slots=True)
class Gear:
    """A period on the dial and its amplitude, degrees; `p_value` is of the best among all that were tried."""

    period_deg: float
    amplitude_deg: float
    p_value: float


def unstated_gear(fit: Fit) -> Gear | None:
    """What repeats on the dial beyond the map; None where nothing does, or the angles are too sparse."""
    from scipy.special import fdtrc

    table, rows = fit.problem.table, np.flatnonzero(fit.kept)
    dial_deg = table.dial_deg[rows]
    arc_deg = covered(dial_deg)
    if arc_deg == 0.0:
        return None
    step = TURN_DEG / arc_deg / STEPS_A_WAVE
    orders = np.arange(HIGHEST_ORDER + 1.0, highest_identifiable_order(table.dial_deg), step)
    if not len(orders):
        return None
    by_angle = fit.normal.derivatives[rows][:, :, fit.problem.n_own - 1]
    chain = table.mount[rows] * len(table.sources) + table.source[rows]

    def white(values: np.ndarray) -> np.ndarray:
        return whitened(values, rows, chain, fit.problem.correlation)[0].reshape(2 * len(rows), -1)

    left = white(fit.normal.residuals[rows][:, :, None])[:, 0]
    gains, sizes = np.zeros(len(orders)), np.zeros(len(orders))
    for k, order in enumerate(orders):
        turn = np.radians(order * dial_deg)
        wave = white(by_angle[:, :, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)[:, None, :])
        across = wave.T @ left
        found = np.linalg.lstsq(wave.T @ wave, across, rcond=1e-6)[0]
        gains[k], sizes[k] = across @ found, np.hypot(*found)
    best = int(np.argmax(gains))
    freedom = fit.freedom - 2.0
    ratio = 0.5 * gains[best] / max(fit.freedom * fit.noise**2 - gains[best], 1e-300) * freedom
    p_value = min(len(orders) * float(fdtrc(2.0, freedom, ratio)), 1.0)
    if p_value > LEVEL:
        return None
    return Gear(TURN_DEG / float(orders[best]), math.degrees(sizes[best]), p_value)


WINDOW_DEG, STEP_DEG = 10.0, 2.5
SHAKEN_LEVEL = 1e-3
"""Chance that noise alone has any window told of."""
FEWEST_SHAKEN = 3
"""Of a mount in a window: fewer are outliers, if anything."""


def vibrating_at_deg(fit: Fit) -> float | None:
    """Return the middle of the window that is most improbable; None where noise explains all of them."""
    from scipy.special import chdtrc

    table = fit.problem.table
    if table.is_whole or not table.has_vector.all():
        return None
    upward = table.vector_g[:, 1:] / table.size_g[:, None]
    along = np.einsum("nk,nk->n", fit.normal.residuals, upward) / fit.noise
    rho = fit.problem.correlation
    wider = (1.0 + rho) / (1.0 - rho)
    low, high = table.dial_deg.min(), table.dial_deg.max()
    middles = np.arange(low, high + STEP_DEG, STEP_DEG)
    p_values = []
    for middle in middles:
        inside = fit.kept & (np.abs(wrap_deg(table.dial_deg - middle)) < 0.5 * WINDOW_DEG)
        poses = np.bincount(table.mount[inside], minlength=len(table.mounts))
        sums = np.bincount(table.mount[inside], along[inside], minlength=len(table.mounts))
        told = poses >= FEWEST_SHAKEN
        squares = float((sums[told] ** 2 / poses[told]).sum()) / wider
        p_values.append(float(chdtrc(float(told.sum()), squares)) if told.any() else 1.0)
    best = int(np.argmin(p_values))
    return float(middles[best]) if len(middles) * p_values[best] < SHAKEN_LEVEL else None
