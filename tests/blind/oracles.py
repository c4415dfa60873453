"""What could be known at best: the set that the true noise would leave, and the error with the form known."""

from __future__ import annotations

import numpy as np

from calrig.calibration.candidates import candidates_of
from calrig.calibration.cross_validation import folds_of
from calrig.calibration.model import model_columns
from calrig.calibration.noise_model import NoiseModel, stacked
from calrig.calibration.ranking import MARGIN
from calrig.calibration.responses import Responses

from .physics import Noise, Truth


def set_size(r: Responses, noise: Noise) -> int:
    """How many names lie within the margin of the best when covariance and correlation are given."""
    correlation = np.eye(4)
    correlation[0, 1] = correlation[1, 0] = Noise.ANGLE_CORRELATION
    covariance = correlation * np.outer(noise.spread, noise.spread)
    at = [["reading", "accel_angle", "accel_norm", "gyro_move"].index(channel) for channel in r.channels]
    root = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(at, at)])).T
    known = NoiseModel(root, np.full(len(at), noise.rho))
    target = known.whiten(r.values, r.starts).ravel()
    bic_penalty = float(np.log(len(r)))
    best: dict[str, float] = {}
    for candidate in candidates_of(r):
        if not candidate.named or candidate.follows:
            continue
        design = stacked(known, r.starts, model_columns(r, [candidate]))
        left = target - design @ np.linalg.lstsq(design, target, rcond=1e-9)[0]
        criterion = float(left @ left) + bic_penalty * candidate.parameters
        best[candidate.name] = min(best.get(candidate.name, np.inf), criterion)
    least = min(best.values())
    return sum(value - least < MARGIN for value in best.values())


def held_out_rms_deg(r: Responses, truths: list[Truth]) -> float:
    """RMS error of held-out poses, of least squares with every cause's true shape, on the same folds."""
    columns = np.column_stack([np.ones(len(r)), r.theta_deg, *[truth.shape_deg for truth in truths]])
    fold = folds_of(r)
    errors = np.empty(len(r))
    for k in np.unique(fold):
        seen, unseen = fold != k, fold == k
        beta = np.linalg.lstsq(columns[seen], r.values[seen, 0], rcond=None)[0]
        errors[unseen] = r.values[unseen, 0] - columns[unseen] @ beta
    return float(np.sqrt(np.mean(errors**2)))
