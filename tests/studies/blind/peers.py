"""Peers on the same runs: what people use today on the residual of a calibration.

All three get the reading after bias and scale and the textbook columns below, named as causes
are: forward selection by BIC, LASSO (scikit-learn, penalty by cross-validation), and PySINDy's sequentially
thresholded least squares (threshold by BIC).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from calrig.calibration.poses import Pose

Library = list[tuple[str, np.ndarray]]
"""Name and columns (n, p), bias and scale taken out, unit spread."""

MOST_EFFECTS = 5
THRESHOLDS_DEG = (0.003, 0.005, 0.01, 0.015, 0.02, 0.03, 0.05)


def library(poses: list[Pose]) -> tuple[np.ndarray, Library]:
    """The residual (n,) after bias and scale, and every column that a text book would try."""
    theta = np.array([pose.theta_deg for pose in poses])
    line = np.column_stack([np.ones_like(theta), theta])
    time_s = np.array([pose.time_s for pose in poses], dtype=float)
    warmer = np.array([pose.temperature_c for pose in poses], dtype=float)
    approach = np.array([pose.approach for pose in poses], dtype=float)
    moves = np.diff(theta, prepend=theta[0])
    s, c = np.sin(np.radians(theta)), np.cos(np.radians(theta))
    raw: list[tuple[str, list[np.ndarray]]] = [
        ("backlash", [approach]),
        ("temperature_bias", [warmer]),
        ("temperature_scale", [(warmer - warmer.mean()) * theta]),
        ("time_drift", [time_s]),
        ("settling", [moves]),
        ("accelerometer_offset", [s]),
        ("accelerometer_offset", [c]),
        ("stage_eccentricity", [s, c]),
        ("axis_mismatch", [s * c]),
        ("axis_mismatch", [c * c]),
        ("nonlinearity", [theta**2]),
        ("nonlinearity", [theta**3]),
    ]
    raw += [("mount_slip", [(np.arange(len(theta)) >= k).astype(float)]) for k in range(3, len(theta) - 2)]
    for period in 1.0 / np.arange(1.0 / 60.0, 0.25, 1.0 / 360.0):
        turn = 2.0 * np.pi * theta / period
        raw.append(("stage_periodic", [np.sin(turn), np.cos(turn)]))
    for name in poses[0].covariates:
        raw.append((f"unnamed {name}", [np.array([pose.covariates[name] for pose in poses], dtype=float)]))
    columns = [(name, _standard(np.column_stack(parts), line)) for name, parts in raw]
    reading = np.array([pose.reading_deg for pose in poses])
    return _off(reading[:, None], line)[:, 0], [(name, part) for name, part in columns if part.shape[1]]


def _off(columns: np.ndarray, line: np.ndarray) -> np.ndarray:
    return np.asarray(columns - line @ np.linalg.lstsq(line, columns, rcond=None)[0])


def _standard(columns: np.ndarray, line: np.ndarray) -> np.ndarray:
    left = _off(columns, line)
    spread = left.std(axis=0)
    seen = spread > 1e-9 * np.abs(columns).max()
    return np.asarray(left[:, seen] / spread[seen])


def forward_bic(residual: np.ndarray, columns: Library) -> set[str]:
    """Adds what lowers n·log(RSS) + p·log(n) most, until nothing does."""
    chosen, names = np.empty((len(residual), 0)), set[str]()
    best = _bic(residual, 2)
    for _ in range(MOST_EFFECTS):
        trials = [(_bic(_off(residual[:, None], wider)[:, 0], 2 + wider.shape[1]), name, wider)
                  for name, part in columns
                  for wider in [np.column_stack([chosen, part])]]  # fmt: skip
        value, name, wider = min(trials, key=lambda trial: trial[0])
        if value >= best:
            return names
        best, chosen = value, wider
        names.add(name)
    return names


def _bic(left: np.ndarray, parameters: int) -> float:
    return float(len(left) * np.log(left @ left) + parameters * np.log(len(left)))


def lasso(residual: np.ndarray, columns: Library) -> set[str]:
    """The columns that LASSO keeps at the penalty of the least cross-validated error."""
    from sklearn.linear_model import LassoCV

    names, table = _table(columns)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fitted = LassoCV(cv=5, alphas=40, max_iter=5000).fit(table, residual)
    return {names[k] for k in np.flatnonzero(fitted.coef_)}


def sindy(residual: np.ndarray, columns: Library) -> set[str]:
    """PySINDy's STLSQ over the columns, at the threshold of the least BIC."""
    from pysindy.optimizers import STLSQ

    names, table = _table(columns)
    best, kept = _bic(residual, 2), set[str]()
    for threshold in THRESHOLDS_DEG:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            coefficients = STLSQ(threshold=threshold, alpha=0.05).fit(table, residual[:, None]).coef_[0]
        value = _bic(residual - table @ coefficients, 2 + int(np.count_nonzero(coefficients)))
        if value < best:
            best, kept = value, {names[k] for k in np.flatnonzero(coefficients)}
    return kept


def _table(columns: Library) -> tuple[list[str], np.ndarray]:
    names = [name for name, part in columns for _ in range(part.shape[1])]
    return names, np.column_stack([part for _, part in columns])


PEERS: dict[str, Callable[[np.ndarray, Library], set[str]]] = {
    "forward BIC": forward_bic,
    "LASSO": lasso,
    "PySINDy": sindy,
}
