"""Decide conformity with limits (JCGM 106:2012, ILAC-G8:09/2019) and compute its risk.

Figures as they stand in sentences.

Limits, and whether a result conforms to them, after JCGM 106:2012 and ILAC-G8:09/2019.

The simple rule takes the measured figure for the true one: of units at their limit, half are wrongly
accepted. The guarded rule keeps them away from the limit L by w = guard·U, and has four answers (ILAC-G8,
4.2.3): pass ≤ L − w < conditional pass ≤ L < conditional fail ≤ L + w < fail. What lies within its limit
and has no known uncertainty is undecided.

The probability that a unit conforms to its limits, given what was measured of it: its specific risk.

JCGM 106:2012, 7 and 9.3.2: with no more known beforehand than the measurement says, the true figures scatter
about the measured ones as their uncertainties tell, and what is asked is how many of them lie within the
limits. Errors over a range are correlated, so they are drawn together (JCGM 101:2008, 5 and 7), at fixed
points that fill the space evenly instead of random ones: the same result always has the same risk.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from functools import lru_cache

import numpy as np

from calrig.calibration.uncertainty.budget import reference_part
from calrig.calibration.uncertainty.coverage import COVERAGE, coverage_factor
from calrig.estimation.angles import FloatArray
from calrig.model.result import Distribution, RangeErrors, Reference, ReferenceKind
from calrig.model.verdict import Answer, Interval, Limit


def deg(value: float) -> str:
    """Two significant digits and the sign of a degree, without an exponent where it stays readable."""
    return f"{significant(value)}°"


def significant(value: float) -> str:
    """Two significant digits; a minus sign as one reads it."""
    if value == 0.0 or not 1e-6 <= abs(value) < 1e6:
        return f"{value:.2g}".replace("-", "−", 1)
    return f"{value:.{max(0, 1 - math.floor(math.log10(abs(value))))}f}".replace("-", "−")


def percent(probability: float) -> str:
    """A probability; what rounds to none or all of it is told as a bound."""
    if probability < 5e-5:
        return "less than 0.01 %"
    if probability > 1.0 - 5e-5:
        return "more than 99.99 %"
    return f"{100.0 * probability:.{2 if probability < 0.01 or probability > 0.99 else 1}f} %"


ANSWERS: tuple[Answer, ...] = ("pass", "conditional_pass", "conditional_fail", "undecided", "fail")
"""In the order in which the later one decides over the earlier ones, of several figures."""


def limit_for(limits: Iterable[Limit], unit: str, rig: str | None) -> Limit | None:
    """The first limit that matches a unit, on a rig; None where none does."""
    matching = (one for one in limits if fnmatchcase(unit, one.units) and one.rig in {None, rig})
    return next(matching, None)


def decide(limit: Limit, beyond: float, expanded: float | None, *, known: bool = True) -> Answer:
    """The answer of a limit's rule.

    Args:
        limit: its rule and guard.
        beyond: how far the figure lies beyond its limit; within it, negative or 0.
        expanded: expanded uncertainty U of the figure; None where it is not known.
        known: whether that of the calibrated elevation is: without it nothing passes.
    """
    within = beyond <= 0.0
    if limit.rule == "simple":
        if not within:
            return "fail"
        return "pass" if known and expanded is not None else "undecided"
    if expanded is None or not known:
        return "undecided" if within else "conditional_fail"
    width = limit.guard * expanded
    if within:
        return "pass" if beyond <= -width else "conditional_pass"
    return "conditional_fail" if beyond <= width else "fail"


def worst(answers: Sequence[Answer]) -> Answer:
    """The answer to all of them together, by the order of `ANSWERS`."""
    return max(answers, key=ANSWERS.index)


def beyond_interval(value: float, allowed: Interval) -> float:
    """How far a value lies outside of an interval; within it, minus its distance from the nearer end."""
    return max(allowed[0] - value, value - allowed[1])


def cannot_pass(limit: Limit, reference: Reference | None, theta_deg: FloatArray) -> list[str]:
    """Why no unit can pass a limit on a stage, however good it is: known before anything moves.

    Only what the stage itself contributes is counted, so that these are certain.

    Args:
        limit: that matches the unit.
        reference: what the stage's own angle is worth; None where nobody has said.
        theta_deg: (n,) elevations of the poses to come.
    """
    against = f"limits “{limit.name}”, {limit.rule_in_words}"
    if reference is None:
        return [
            "No unit can pass on this stage: its rig does not say what the stage's angle is worth "
            f"(`reference`), and without an expanded uncertainty nothing passes ({against})."
        ]
    scale = 1.0 if np.ptp(theta_deg) > 0.0 else None
    part = reference_part(theta_deg, scale, reference)
    distribution = "normal" if reference.kind == "setting" else reference.distribution
    k = coverage_factor(0.0, 1.0, 1.0, distribution)
    of_elevation = k * part.elevation_deg
    reasons = []
    if limit.expanded_uncertainty_deg is not None and of_elevation > limit.expanded_uncertainty_deg:
        reasons.append(
            f"U = {deg(of_elevation)} ({100 * COVERAGE:.0f} %) of the stage alone is more than the "
            f"{deg(limit.expanded_uncertainty_deg)} allowed"
        )
    if limit.bias_deg is not None:
        reasons.append("the level is not known, and until it is no limit on the bias can be decided")
    if limit.rule == "guarded":
        room = [("largest error", limit.max_error_deg, of_elevation, "°")]
        if limit.scale is not None and part.scale is not None:
            room.append(("scale", 0.5 * (limit.scale[1] - limit.scale[0]), k * part.scale, ""))
        reasons += [
            f"w = {limit.guard:g}·U with U = {significant(expanded)}{unit} of the stage alone leaves nothing "
            f"of the ±{significant(allowed)}{unit} allowed to the {name}"
            for name, allowed, expanded, unit in room
            if allowed is not None and limit.guard * expanded >= allowed
        ]
    return [f"No unit can pass on this stage: {reason} ({against})." for reason in reasons]


DRAWS = 1 << 14


@lru_cache(maxsize=4096)
def probability_of_conformity(
    limit: Limit, found: RangeErrors, reference: Reference, *, rms_deg: float, level_known: bool
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
    factor = 1.0 if found.scale is None else found.scale
    drawn = _drawn(max(found.freedom, 1), reference.kind, reference.distribution)
    of_stage = _stage_shapes(found, reference, theta_deg)
    own_line = np.zeros((2, 2)) if found.covariance is None else _root(np.array(found.covariance)).T
    of_line = -(own_line[:, :1] + own_line[:, 1:] * theta_deg) / factor
    shapes = np.concatenate([of_line, of_stage])
    if not level_known:
        shapes = shapes - (shapes @ _weights(theta_deg))[:, None]
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


def _inside(values: FloatArray, allowed: tuple[float, float]) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
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
def _drawn(freedom: int, kind: ReferenceKind, distribution: Distribution) -> FloatArray:
    """(4, DRAWS) factors of the shapes that errors have, of variance 1 but for Student's.

    Two of Student's t, with one χ² as a scatter has it, for the line; then two for the stage. Drawn at the
    points of a Kronecker sequence by powers of 2^(1/6), irrational to one another (Niederreiter, Random
    Number Generation and Quasi-Monte Carlo Methods, 1992, 4.1): probabilities come out to 0.001.
    """
    from scipy.special import chdtri, ndtri

    points = (0.5 + np.outer(np.arange(1, DRAWS + 1), 2.0 ** (np.arange(1.0, 6.0) / 6.0))) % 1.0
    t = ndtri(points[:, :2]) * np.sqrt(freedom / chdtri(freedom, points[:, 2:3]))
    first, second = points[:, 3], points[:, 4]
    if kind == "setting" or distribution == "normal":
        of_stage = ndtri(points[:, 3:])
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
    # a line through settings that were each made anew, n of them, spread evenly
    design = np.column_stack([np.ones(n), np.linspace(theta_deg.min(), theta_deg.max(), n)])
    line = _root(reference.std_deg**2 * np.linalg.pinv(design.T @ design)).T
    return np.asarray(line[:, :1] + line[:, 1:] * theta_deg)


def _root(covariance: FloatArray) -> FloatArray:
    """A matrix R with R·Rᵀ = covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))


def _weights(theta_deg: FloatArray) -> FloatArray:
    """(m,) by which smooth errors at the elevations have their mean over the range (trapezoids)."""
    if len(theta_deg) == 1:
        return np.ones(1)
    between_deg = np.diff(theta_deg)
    return np.asarray(0.5 * (np.append(between_deg, 0.0) + np.append(0.0, between_deg)) / between_deg.sum())


def _lines_through(theta_deg: FloatArray, error_deg: FloatArray) -> FloatArray:
    """(2, 2) bias and scale that a fit makes of each of two shapes."""
    if len(theta_deg) == 1:
        return np.column_stack([error_deg[:, 0], np.zeros(2)])
    design = np.column_stack([np.ones(len(theta_deg)), theta_deg])
    return np.asarray(error_deg @ np.linalg.pinv(design).T)
