"""Test whether a stage map is still valid: a unit's poses now compared with its earlier ones.

A unit's own errors rotate with it, and are equal at one elevation in both runs. Remounting it by Δ moves
its bias, and its curve of errors e(θ) along with it: by e'(θ)·Δ, which is 0.05° for a unit with offsets of 50
mg that is remounted by 1°. A day may change its scale. Every other difference is the stage's, or noise.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calrig.calibration.poses import Pose
from calrig.calibration.separation.stage_map import StageMap, dial_of
from calrig.estimation.angles import FloatArray, wrap_deg

PLACE_DEG = 1.0
"""Poses closer than this on the dial are taken for one place."""
FEWEST_PLACES = 6
FEWEST_REPEATS = 8
ALARM = 0.0027
"""One false alarm in 370 checks, as a check unit's chart has them (`control_chart.RIG_CHART`)."""
HIGHEST_ORDER = 3
STEP_DEG = 0.5
FAR = 3.0
"""Standard deviations from which on a place is named."""


@dataclass(frozen=True, slots=True)
class MapCheck:
    """The validity of a map.

    Attributes:
        p_value: that noise, and what the map may be off by its own covariance, differ so much or more.
        at_deg: angles of the dial where it is off by more than three standard deviations.
        largest_deg: largest difference, what clamping and scale may do taken off, and `largest_at_deg` where.
    """

    p_value: float
    at_deg: tuple[float, ...]
    largest_deg: float
    largest_at_deg: float

    @property
    def has_moved(self) -> bool:
        """Whether the differences are significant."""
        return self.p_value < ALARM


def checked(now: Sequence[Pose], before: Sequence[Pose], stage_map: StageMap) -> MapCheck | None:
    """Compare a unit's poses with earlier ones of the same clamping angle.

    With d the differences (K,) of the mean errors at the places of the dial that both visited, by approach,
    their covariance S = σ²·diag(1/n + 1/m) + B·V·Bᵀ (σ² pooled from within the places; V the map's, B its
    columns: what the map was said to be off by is no movement), and X = [1 θ e'(θ)] free,

        q = dᵀ(S⁻¹ − S⁻¹X(XᵀS⁻¹X)⁻¹XᵀS⁻¹)d,    q/(K − 3) ~ F(K − 3, ν)

    with ν the degrees of freedom of σ².

    Args:
        now: of one run that counts.
        before: of an earlier one.
        stage_map: made about then.

    Returns:
        None where they have too few places in common, or no place was visited twice, so that nothing tells
        the noise.
    """
    from scipy.special import fdtrc

    here, there = _by_place(now), _by_place(before)
    places = sorted(here.keys() & there.keys())
    freedom = sum(len(e) - 1 for errors in (here, there) for e in errors.values())
    if len(places) < FEWEST_PLACES or freedom < FEWEST_REPEATS:
        return None
    squares = sum(float(np.var(e)) * len(e) for errors in (here, there) for e in errors.values())
    dial, approach = np.array(places, dtype=np.float64).T
    dial *= PLACE_DEG
    difference = wrap_deg(np.array([np.mean(here[k]) - np.mean(there[k]) for k in places]))
    columns = stage_map.columns(dial, approach)
    covariance = columns @ stage_map.covariance_deg2 @ columns.T
    covariance += np.diag([squares / freedom * (1 / len(here[k]) + 1 / len(there[k])) for k in places])
    design = np.column_stack([np.ones(len(dial)), dial, _slope(before, stage_map, dial)])
    left, q = _without(design, difference, covariance)
    free = len(places) - design.shape[1]
    std = np.sqrt(np.diag(covariance))
    largest = int(np.argmax(np.abs(left)))
    return MapCheck(
        p_value=float(fdtrc(free, freedom, q / free)),
        at_deg=tuple(np.unique(dial[np.abs(left) > FAR * std]).tolist()),
        largest_deg=float(left[largest]),
        largest_at_deg=float(dial[largest]),
    )


def _by_place(poses: Sequence[Pose]) -> dict[tuple[int, int], list[float]]:
    """Errors of the reading by angle of the dial, in steps, and approach."""
    dial, approach = dial_of(poses)
    found: dict[tuple[int, int], list[float]] = defaultdict(list)
    for pose, place, sense in zip(poses, np.rint(dial / PLACE_DEG).tolist(), approach.tolist(), strict=True):
        found[int(place), int(sense)].append(float(wrap_deg(pose.reading_deg - pose.dial_deg)))
    return found


def _slope(poses: Sequence[Pose], stage_map: StageMap, dial_deg: FloatArray) -> FloatArray:
    """(K,) slope of the unit's own errors at angles of the dial, degrees a degree."""
    dial, approach = dial_of(poses)
    reading = np.array([pose.reading_deg for pose in poses])
    error = wrap_deg(reading - dial - stage_map.correction_deg(dial, approach))
    series, *_ = np.linalg.lstsq(_waves(dial), wrap_deg(error - error[0]), rcond=None)
    return np.asarray((_waves(dial_deg + STEP_DEG) - _waves(dial_deg - STEP_DEG)) @ series / (2 * STEP_DEG))


def _waves(dial_deg: FloatArray) -> FloatArray:
    """(n, 7) what offsets, gain, skew and the bent axes of a unit are made of, and a constant."""
    turns = np.radians(dial_deg)[:, None] * np.arange(1.0, HIGHEST_ORDER + 1.0)
    return np.concatenate([np.ones((len(dial_deg), 1)), np.cos(turns), np.sin(turns)], axis=1)


def _without(design: FloatArray, difference: FloatArray, covariance: FloatArray) -> tuple[FloatArray, float]:
    """(K,) what the columns of a design (K, 3) leave at best, and its square by the covariance."""
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, np.column_stack([design, difference]))
    found = np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=None)[0]
    return difference - design @ found, float(np.sum((white[:, -1] - white[:, :-1] @ found) ** 2))
