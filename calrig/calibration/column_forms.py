"""What a column that calrig has no physics for may act as: an angle, a rate, a delay, a factor."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from calrig.calibration.channels import BoolArray
from calrig.calibration.column_units import TIMES, is_circle
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray

LEAST_ARC_DEG = 90.0
"""Over less of a circle its sines are what a smooth curve is."""
DELAYS = 5
MOST_FACTORS = 6
"""Columns of which all products are looked at."""


def standardised(column: FloatArray) -> FloatArray:
    """A column less its mean, over its standard deviation."""
    return np.asarray((column - column.mean()) / column.std(), dtype=np.float64)


def circle(column_deg: FloatArray, orders: int) -> FloatArray:
    """(n, 2·orders) sines and cosines of an angle's multiples."""
    angles = np.radians(column_deg)[:, None] * np.arange(1, orders + 1)
    waves = np.stack([np.sin(angles), np.cos(angles)], axis=2)
    return np.asarray(waves.reshape(len(column_deg), -1), dtype=np.float64)


def arc_deg(column_deg: FloatArray) -> float:
    """How much of a circle the angles of a column cover: all of it but the widest gap between them."""
    around = np.sort(np.mod(column_deg, 360.0))
    return 360.0 - float(np.diff(around, append=around[0] + 360.0).max())


def rate(r: Responses, name: str) -> FloatArray | None:
    """(n,) change of a column per second; None without times that advance within each run."""
    column, runs = _continuous(r, name), _runs(r)
    if runs is None:
        return None
    return np.concatenate([np.gradient(column[run], runs_time_s) for run, runs_time_s in runs])


def delays_s(r: Responses) -> FloatArray:
    """Time constants worth trying: from two poses to a third of a run."""
    runs = _runs(r)
    if runs is None:
        return np.empty(0)
    shortest = 2.0 * float(np.median(np.concatenate([np.diff(time_s) for _, time_s in runs])))
    longest = max(float(np.ptp(time_s)) for _, time_s in runs) / 3.0
    return np.geomspace(shortest, longest, DELAYS) if longest > shortest else np.empty(0)


def delayed(r: Responses, name: str, lag_s: float) -> FloatArray | None:
    """(n,) a column behind a first-order lag: y' = (z − y)/lag, z straight between poses, y = z at first.

    None without times that advance within each run.
    """
    column, runs = _continuous(r, name), _runs(r)
    if runs is None:
        return None
    behind = np.array(column)
    for run, time_s in runs:
        z = column[run]
        step_s = np.diff(time_s)
        kept = np.exp(-step_s / lag_s)
        slope = np.diff(z) / step_s
        for k in range(1, len(z)):  # exact for a straight z: y − (z − slope·lag) decays
            first = run.start + k
            off = behind[first - 1] - (z[k - 1] - slope[k - 1] * lag_s)
            behind[first] = z[k] - slope[k - 1] * lag_s + off * kept[k - 1]
    return behind


def products(r: Responses) -> Iterator[tuple[str, tuple[str, str], FloatArray]]:
    """Name, factors and (n, p) columns of products of two columns; one may be temperature or elevation."""
    known = {"temperature_c": r.temperature_c, "target_deg": r.theta_deg}
    factors = {name: column for name, column in known.items() if column is not None and np.ptp(column) > 0.0}
    factors.update(r.covariates)
    if len(r.covariates) > MOST_FACTORS:
        return
    for one, other in combinations(factors, 2):
        if one in r.covariates or other in r.covariates:
            a, b = _as_factor(one, factors), _as_factor(other, factors)
            yield f"{one}{TIMES}{other}", (one, other), (a[:, :, None] * b[:, None, :]).reshape(len(r), -1)


def _as_factor(name: str, columns: Mapping[str, FloatArray]) -> FloatArray:
    column = columns[name]
    if name != "target_deg" and is_circle(name) and arc_deg(column) >= LEAST_ARC_DEG:
        return circle(column, 1)
    return standardised(column)[:, None]


def _continuous(r: Responses, name: str) -> FloatArray:
    """A column whose steps are what happened: an angle does not jump by a turn."""
    column = r.covariates[name]
    return np.degrees(np.unwrap(np.radians(column))) if is_circle(name) else column


def _runs(r: Responses) -> list[tuple[slice, FloatArray]] | None:
    """Each run and its times; None where they are not known or do not advance."""
    if r.time_s is None:
        return None
    ends = [*np.flatnonzero(_firsts(r.starts))[1:], len(r)]
    runs, first = [], 0
    for end in ends:
        time_s = r.time_s[first:end]
        if len(time_s) < 2 or (np.diff(time_s) <= 0.0).any():
            return None
        runs.append((slice(first, int(end)), time_s))
        first = int(end)
    return runs


def _firsts(starts: BoolArray) -> BoolArray:
    """Where runs begin; the first pose that is left of some begins one too."""
    return np.asarray(np.append(True, starts[1:]), dtype=np.bool_)
