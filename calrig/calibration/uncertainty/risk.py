"""Compute the probability that a unit conforms to its limits, given its measurement: the specific risk.

JCGM 106:2012, 7 and 9.3.2: if nothing is known before the measurement, the true figures scatter about the
measured ones as their uncertainties tell. The probability is the share of them that lies within the limits.
Errors over a range are correlated, so they are drawn together (JCGM 101:2008, 5 and 7). The draws are fixed
points that fill the space evenly instead of random ones: equal results have equal risks.
"""

import math
from functools import lru_cache

import numpy as np

from calrig.calibration.uncertainty.budget import trapezoids
from calrig.estimation.angles import FloatArray
from calrig.model.result import Distribution, RangeErrors, Reference, ReferenceKind
from calrig.model.verdict import Interval, Limit

DRAWS = 1 << 14


@lru_cache(maxsize=4096)
def probability_of_conformity(
    limit: Limit, found: RangeErrors, reference: Reference, *, rms_deg: float, level_known: bool
) -> float:
    """Return the probability that the true figures comply with a limit.

    A calibrated elevation at θ errs by what was left of the poses there, by the error of bias and scale
    (−(δb + θ·δs)/scale, Student's t about 0 by their covariance; by `error_steps` with effects), and by the
    stage's own error d(θ), drawn by its kind: one constant; A·sin θ + B·cos θ; or a line through independent
    settings. While the level is unknown, the mean over the range is taken off, because these poses do not
    determine it.

    Args:
        limit: the limit; its name and rule do not matter.
        found: the error over the range, and bias and scale with their covariance.
        reference: standard uncertainty of the stage's angle.
        rms_deg: RMS of the residual after every accepted effect.
        level_known: whether elevations are absolute; a limit on the bias counts only then.
    """
    theta_deg = np.array(found.elevation_deg)
    low_deg, high_deg = np.array(found.lowest_error_deg), np.array(found.highest_error_deg)
    factor = 1.0 if found.scale is None else found.scale
    of_stage = _stage_shapes(found, reference, theta_deg)
    if found.error_steps:
        own_line, of_line = np.split(np.array(found.error_steps), [2], axis=1)
    else:
        own_line = np.zeros((2, 2)) if found.covariance is None else _root(np.array(found.covariance)).T
        of_line = -(own_line[:, :1] + own_line[:, 1:] * theta_deg) / factor
    drawn = _drawn(max(found.freedom, 1), reference.kind, reference.distribution, len(own_line))
    shapes = np.concatenate([of_line, of_stage])
    if not level_known:
        shapes = shapes - (shapes @ trapezoids(theta_deg))[:, None]
        low_deg, high_deg = low_deg - found.mean_error_deg, high_deg - found.mean_error_deg
    conforms = np.ones(DRAWS, dtype=bool)
    if limit.max_error_deg is not None:
        error_deg = shapes.T @ drawn
        conforms &= (error_deg + high_deg[:, None]).max(axis=0) <= limit.max_error_deg
        conforms &= (error_deg + low_deg[:, None]).min(axis=0) >= -limit.max_error_deg
    line = drawn.T @ np.concatenate([own_line, factor * _lines_through(theta_deg, of_stage)])
    if limit.bias_deg is not None and level_known:
        conforms &= _inside(found.bias_deg + line[:, 0], limit.bias_deg)
    if limit.scale is not None and found.scale is not None:
        conforms &= _inside(found.scale + line[:, 1], limit.scale)
    return float(conforms.mean()) * _rms_conforms(limit, rms_deg, found.freedom)


def _inside(values: FloatArray, allowed: Interval) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.asarray((values >= allowed[0]) & (values <= allowed[1]))


def _rms_conforms(limit: Limit, rms_deg: float, freedom: int) -> float:
    """That the standard deviation behind an RMS is within its limit: ν·RMS²/σ² is χ² with ν degrees."""
    from scipy.special import chdtrc

    if limit.rms_deg is None:
        return 1.0
    if freedom < 1 or rms_deg == 0.0:
        return float(rms_deg <= limit.rms_deg)
    ratio = rms_deg / limit.rms_deg
    return float(chdtrc(freedom, freedom * ratio * ratio))  # a square by ** raises where this is infinite


@lru_cache(maxsize=64)
def _drawn(freedom: int, kind: ReferenceKind, distribution: Distribution, own: int) -> FloatArray:
    """(own + 2, DRAWS) factors of the shapes that errors have, of variance 1 but for Student's.

    `own` of Student's t, with one χ² as a scatter has it, for the line; then two for the stage. Drawn at the
    points of a Kronecker sequence by powers of 2^(1/6), or of as much finer a root of 2, irrational to one
    another (Niederreiter, Random Number Generation and Quasi-Monte Carlo Methods, 1992, 4.1): for a line,
    probabilities come out to 0.001.
    """
    from scipy.special import chdtri, ndtri

    points = (0.5 + np.outer(np.arange(1, DRAWS + 1), 2.0 ** (np.arange(1.0, own + 4.0) / (own + 4.0)))) % 1.0
    t = ndtri(points[:, :own]) * np.sqrt(freedom / chdtri(freedom, points[:, own : own + 1]))
    first, second = points[:, own + 1], points[:, own + 2]
    if kind == "setting" or distribution == "normal":
        of_stage = ndtri(points[:, own + 1 :])
    elif kind == "common":
        of_stage = np.column_stack([math.sqrt(3.0) * (2.0 * first - 1.0), np.zeros(DRAWS)])
    else:
        # Each coordinate of a point on a sphere is rectangular (Archimedes), in whichever direction it is
        # taken: so is A·sin θ + B·cos θ at every θ, and no amplitude exceeds the limit.
        around = np.sqrt(3.0 * (1.0 - (2.0 * first - 1.0) ** 2))
        angle = 2.0 * math.pi * second
        of_stage = np.column_stack([around * np.cos(angle), around * np.sin(angle)])
    return np.ascontiguousarray(np.concatenate([t, of_stage], axis=1).T)


def _stage_shapes(found: RangeErrors, reference: Reference, theta_deg: FloatArray) -> FloatArray:
    """(2, m) what the stage's two factors do at each elevation, degrees."""
    one, none = np.ones(len(theta_deg)), np.zeros(len(theta_deg))
    if reference.line_covariance is not None:
        line = _root(np.array(reference.line_covariance)).T
        return np.asarray(line[:, :1] + line[:, 1:] * theta_deg)
    if reference.kind == "common":
        return reference.std_deg * np.array([one, none])
    if reference.kind == "harmonic":
        angle = np.radians(theta_deg)
        return reference.std_deg * np.array([np.sin(angle), np.cos(angle)])
    n = found.freedom + (1 if found.scale is None else 2)
    if found.scale is None:
        return reference.std_deg / math.sqrt(n) * np.array([one, none])
    # a line through n independent settings, spread evenly
    design = np.column_stack([np.ones(n), np.linspace(theta_deg.min(), theta_deg.max(), n)])
    line = _root(reference.std_deg**2 * np.linalg.pinv(design.T @ design)).T
    return np.asarray(line[:, :1] + line[:, 1:] * theta_deg)


def _root(covariance: FloatArray) -> FloatArray:
    """A matrix R with R·Rᵀ = covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))


def _lines_through(theta_deg: FloatArray, error_deg: FloatArray) -> FloatArray:
    """(2, 2) bias and scale that a fit makes of each of two shapes."""
    if len(theta_deg) == 1:
        return np.column_stack([error_deg[:, 0], np.zeros(2)])
    design = np.column_stack([np.ones(len(theta_deg)), theta_deg])
    return np.asarray(error_deg @ np.linalg.pinv(design).T)
