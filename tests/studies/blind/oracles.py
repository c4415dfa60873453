"""What could be known at best: the set that the true noise would leave, and the error with the form known."""

from __future__ import annotations

import numpy as np

from calrig.calibration.diagnosis.candidates import Candidate, candidates_of, model_columns
from calrig.calibration.diagnosis.held_out import folds_of
from calrig.calibration.diagnosis.ranking import MARGIN
from calrig.calibration.diagnosis.selection import Findings
from calrig.calibration.diagnosis.sensor_model import fitted_model
from calrig.calibration.regression.noise_model import NoiseModel, stacked
from calrig.calibration.regression.responses import Responses

from .physics import Noise, Truth

NEAR = 500.0
"""Of the criterion, from the best while linear: what bends may come from as far behind."""


def set_size(r: Responses, noise: Noise) -> int:
    """How many names lie within the margin of the best when covariance and correlation are given.

    The best of each name is fitted as the diagnosis does it, through atan2 where it is on the sensor's axes.
    """
    correlation = np.eye(4)
    correlation[0, 1] = correlation[1, 0] = Noise.ANGLE_CORRELATION
    covariance = correlation * np.outer(noise.spread, noise.spread)
    at = [["reading", "accel_angle", "accel_norm", "gyro_move"].index(channel) for channel in r.channels]
    root = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(at, at)])).T
    known = NoiseModel(root, np.full(len(at), noise.rho))
    bic_penalty = float(np.log(len(r)))

    def criterion(seen: Responses, candidate: Candidate) -> float:
        target = known.whiten(seen.values, r.starts).ravel()
        design = stacked(known, r.starts, model_columns(seen, [candidate]))
        left = target - design @ np.linalg.lstsq(design, target, rcond=1e-9)[0]
        return float(left @ left) + bic_penalty * candidate.parameters

    best: dict[str, tuple[float, Candidate]] = {}
    for candidate in candidates_of(r):
        if not candidate.named or candidate.follows:
            continue
        value = criterion(r, candidate)
        if value < best.get(candidate.name, (np.inf, candidate))[0]:
            best[candidate.name] = value, candidate
    least = min(value for value, _ in best.values())
    near = [c for value, c in best.values() if value - least < NEAR]
    models = [fitted_model(r, [c]) for c in near]
    finer = [criterion(model.responses, model.accepted[0]) for model in models]
    return sum(value - min(finer) < MARGIN for value in finer)


def held_out_rms_deg(findings: Findings, truths: list[Truth]) -> float:
    """RMS error of held-out poses, of least squares with every cause's true shape, on the same folds."""
    r = findings.responses
    shapes = [truth.shape_deg[findings.kept] for truth in truths]
    columns = np.column_stack([np.ones(len(r)), r.theta_deg, *shapes])
    fold = folds_of(r)
    errors = np.empty(len(r))
    for k in np.unique(fold):
        seen, unseen = fold != k, fold == k
        beta = np.linalg.lstsq(columns[seen], r.values[seen, 0], rcond=None)[0]
        errors[unseen] = r.values[unseen, 0] - columns[unseen] @ beta
    return float(np.sqrt(np.mean(errors**2)))
