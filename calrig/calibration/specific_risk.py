"""The probability that a unit conforms to its limits, given what was measured of it: its specific risk.

JCGM 106:2012, 7 and 9.3.2: with no more known beforehand than the measurement says, the true figures scatter
about the measured ones as their uncertainties tell, and what is asked is how many of them lie within the
limits. Errors over a range are correlated, so they are drawn together (JCGM 101:2008, 5 and 7), at fixed
points that fill the space evenly instead of random ones: the same result always has the same risk.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from calrig.calibration.conformity import Limit
from calrig.calibration.over_range import OverRange
from calrig.calibration.uncertainty import Reference
from calrig.estimation.angles import FloatArray

DRAWS = 1 << 14


@lru_cache(maxsize=4096)
def probability_of_conformity(
    limit: Limit, found: OverRange, reference: Reference, *, rms_deg: float, level_known: bool
) -> float:
    """The probability that all that a limit asks holds of the true figures.

    A calibrated elevation at θ errs by what was left of the poses there, by the error of bias and scale
    (−(δb + θ·δs)/scale, Student's t about 0 by their covariance), and by the stage's own error d(θ), drawn by
    its kind: one constant; A·sin θ + B·cos θ; or a line through settings that were each made anew. While the
    level is not known, the mean over the range is taken off: these poses cannot tell it.

    Args:
        limit: what is asked.
        found: the error over the range, and bias and scale with their covariance.
        reference: what the stage's own angle is worth.
        rms_deg: what is left after everything accepted.
        level_known: whether elevations are absolute; a limit on the bias counts only then.
    """
    theta_deg = np.array(found.elevation_deg)
    low_deg, high_deg = np.array(found.lowest_error_deg), np.array(found.highest_error_deg)
    drawn = _drawn(found.freedom)
    line, of_stage = _line_errors(found, drawn), _stage_errors(found, reference, theta_deg, drawn)
    factor = 1.0 if found.scale is None else found.scale
    error_deg = of_stage - (line[:, :1] + line[:, 1:] * theta_deg) / factor
    if not level_known:
        error_deg = error_deg - _mean_over(theta_deg, error_deg)
        low_deg, high_deg = low_deg - found.mean_error_deg, high_deg - found.mean_error_deg
    conforms = np.ones(DRAWS, dtype=bool)
    if limit.max_error_deg is not None:
        conforms &= (error_deg + high_deg).max(axis=1) <= limit.max_error_deg
        conforms &= (error_deg + low_deg).min(axis=1) >= -limit.max_error_deg
    true_line = line + factor * _line_through(theta_deg, of_stage)
    if limit.bias_deg is not None and level_known:
        conforms &= _inside(found.bias_deg + true_line[:, 0], limit.bias_deg)
    if limit.scale is not None and found.scale is not None:
        conforms &= _inside(found.scale + true_line[:, 1], limit.scale)
    return float(conforms.mean()) * _rms_conforms(limit, rms_deg, found.freedom)


def _inside(values: FloatArray, allowed: tuple[float, float]) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.asarray((values >= allowed[0]) & (values <= allowed[1]))


def _rms_conforms(limit: Limit, rms_deg: float, freedom: int) -> float:
    """That the standard deviation behind an RMS is within its limit: ν·RMS²/σ² is χ² with ν degrees."""
    from scipy.special import chdtrc

    if limit.rms_deg is None:
        return 1.0
    if freedom < 1 or rms_deg == 0.0:
        return float(rms_deg <= limit.rms_deg)
    return float(chdtrc(freedom, freedom * (rms_deg / limit.rms_deg) ** 2))


@lru_cache(maxsize=64)
def _drawn(freedom: int) -> tuple[FloatArray, FloatArray]:
    """(DRAWS, 2) Student's t, both with one χ² as a scatter has it, and (DRAWS, 2) between 0 and 1.

    The points of a Kronecker sequence by powers of 2^(1/6), irrational to one another (Niederreiter, Random
    Number Generation and Quasi-Monte Carlo Methods, 1992, 4.1): probabilities come out to 0.001.
    """
    from scipy.special import chdtri, ndtri

    points = (0.5 + np.outer(np.arange(1, DRAWS + 1), 2.0 ** (np.arange(1.0, 6.0) / 6.0))) % 1.0
    chi2 = chdtri(max(freedom, 1), points[:, 2:3])
    t = ndtri(points[:, :2]) * np.sqrt(max(freedom, 1) / chi2)
    return t, points[:, 3:]


def _line_errors(found: OverRange, drawn: tuple[FloatArray, FloatArray]) -> FloatArray:
    """(DRAWS, 2) errors of bias, degrees, and scale, of type A."""
    if found.covariance is None:
        return np.zeros((DRAWS, 2))
    return np.asarray(drawn[0] @ _root(np.array(found.covariance)).T)


def _root(covariance: FloatArray) -> FloatArray:
    """A matrix R with R·Rᵀ = covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))


def _stage_errors(
    found: OverRange, reference: Reference, theta_deg: FloatArray, drawn: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """(DRAWS, m) error of the stage's angle at each elevation."""
    from scipy.special import ndtri

    first, second = drawn[1][:, :1], drawn[1][:, 1:]
    if reference.kind == "setting":
        return _setting_errors(found, reference, theta_deg, ndtri(drawn[1]))
    if reference.kind == "common":
        one = ndtri(first) if reference.distribution == "normal" else math.sqrt(3.0) * (2.0 * first - 1.0)
        return np.asarray(reference.std_deg * one * np.ones(len(theta_deg)))
    if reference.distribution == "normal":
        in_phase, across = ndtri(first), ndtri(second)
    else:
        # Each coordinate of a point on a sphere is rectangular (Archimedes), in whichever direction it is
        # taken: so is A·sin θ + B·cos θ at every θ, and no amplitude exceeds the limit.
        height = 2.0 * first - 1.0
        around = math.sqrt(3.0) * np.sqrt(1.0 - height**2)
        in_phase = around * np.cos(2.0 * math.pi * second)
        across = around * np.sin(2.0 * math.pi * second)
    angle = np.radians(theta_deg)
    return np.asarray(reference.std_deg * (in_phase * np.sin(angle) + across * np.cos(angle)))


def _setting_errors(
    found: OverRange, reference: Reference, theta_deg: FloatArray, normal: FloatArray
) -> FloatArray:
    """A line through settings made anew: its covariance is type A's, as u² is to the scatter's s²."""
    n = found.freedom + (1 if found.scale is None else 2)
    evenly_deg = np.linspace(theta_deg.min(), theta_deg.max(), n)
    if found.scale is None:
        return np.asarray(reference.std_deg / math.sqrt(n) * normal[:, :1] * np.ones(len(theta_deg)))
    design = np.column_stack([np.ones(n), evenly_deg])
    covariance = reference.std_deg**2 * np.linalg.pinv(design.T @ design)
    line = normal @ _root(covariance).T
    return np.asarray(line[:, :1] + line[:, 1:] * theta_deg)


def _mean_over(theta_deg: FloatArray, error_deg: FloatArray) -> FloatArray:
    """(DRAWS, 1) mean over the range of errors that are smooth between the elevations (trapezoids)."""
    if len(theta_deg) == 1:
        return error_deg
    between_deg = np.diff(theta_deg)
    weights = 0.5 * (np.append(between_deg, 0.0) + np.append(0.0, between_deg)) / between_deg.sum()
    return np.asarray(error_deg @ weights[:, None])


def _line_through(theta_deg: FloatArray, error_deg: FloatArray) -> FloatArray:
    """(DRAWS, 2) bias and scale that a fit makes of errors of the stage."""
    design = np.column_stack([np.ones(len(theta_deg)), theta_deg])
    if len(theta_deg) == 1:
        return np.column_stack([error_deg[:, 0], np.zeros(len(error_deg))])
    return np.asarray(error_deg @ np.linalg.pinv(design).T)
