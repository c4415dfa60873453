"""Test whether a stage map is still valid: a unit's poses now compared with its earlier ones.

A unit's own errors rotate with it, and are equal at one elevation in both runs. Remounting it by Δ moves
its bias, and its curve of errors e(θ) along with it: by e'(θ)·Δ, which is 0.05° for a unit with offsets of 50
mg that is remounted by 1°. A day may change its scale. Every other difference is the stage's, or noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calrig.calibration.poses import Pose
from calrig.calibration.results.verification import whitened
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
CORRELATIONS = tuple(np.arange(0.0, 0.96, 0.05).tolist())
PRIOR_POWER = 0.75
"""As of `correlated_errors`."""
LEAST_VARIANCE_DEG2 = 1e-12
OWN_BIAS_DEG = 0.2
"""By which a unit's bias may change without a remounting, as from temperature."""
LARGEST_DEG = np.array([20.0, 9.0, 9.0, 3.0, 3.0, 0.5, 0.5])
"""Constant and orders 1 to 3 of a unit's error: offsets of 150 mg, gains and curvatures of 5 to 10 %."""
ORDERS = (2, 4, 6)
POWER = 0.9
FAR = 3.0
"""Standard deviations from which on a place is named."""


@dataclass(frozen=True, slots=True)
class MapCheck:
    """The validity of a map.

    Attributes:
        p_value: that noise differs so much or more.
        at_deg: angles of the dial where it is off by more than three standard deviations.
        largest_deg: largest difference, what clamping and scale may do taken off, and `largest_at_deg` where.
        seen_from_deg: size, root mean square, from which such runs show a change of each of `ORDERS`.
    """

    p_value: float
    at_deg: tuple[float, ...]
    largest_deg: float
    largest_at_deg: float
    seen_from_deg: tuple[float, ...] = ()

    @property
    def has_moved(self) -> bool:
        """Whether the differences are significant."""
        return self.p_value < ALARM


def checked(now: Sequence[Pose], before: Sequence[Pose], stage_map: StageMap) -> MapCheck | None:
    """Compare a unit's poses with earlier ones of the same clamping angle.

    With d the differences (K,) of the mean errors at the places of the dial that both visited, by approach,
    C their covariance (of noise of σ², pooled from within the places), and X = [1 + e'(θ)  θ] free,

        q = dᵀ(C⁻¹ − C⁻¹X(XᵀC⁻¹X)⁻¹XᵀC⁻¹)d,    q/(K − 2) ~ F(K − 2, ν)

    with ν the degrees of freedom of σ². A remounting by Δ moves the bias by Δ and the curve by e'·Δ. C also
    holds what a bias that changed by itself (`OWN_BIAS_DEG`) and the error of e' make of that. The map's own
    error is not in C: the stage is compared with itself, and whatever the map is off by cancels. The noise of
    a run is a first-order autoregression of correlation ρ; the p-value is its mean over ρ, weighted by the
    restricted likelihood and a prior that falls as (1 − ρ)^0.75.

    Args:
        now: of one run that counts.
        before: of an earlier one.
        stage_map: made about then.

    Returns:
        None where they have too few places in common, or no place was visited twice, so that nothing tells
        the noise.
    """
    from scipy.special import fdtrc

    runs = [_of_places(now), _of_places(before)]
    shared = sorted(set(runs[0].places) & set(runs[1].places))
    freedom = sum(len(run.error_deg) - len(run.places) for run in runs)
    if len(shared) < FEWEST_PLACES or freedom < FEWEST_REPEATS:
        return None
    dial = PLACE_DEG * np.array([place for place, _ in shared], dtype=np.float64)
    noise_deg2 = sum(_means(run, 0.0).squares for run in runs) / freedom  # within the places, uncorrelated
    slope, of_slope = _slope(before, stage_map, dial, noise_deg2)
    design = np.column_stack([1.0 + slope, dial])
    free = len(shared) - design.shape[1]
    weights, p_values, fits = [], [], []
    for rho in CORRELATIONS:
        here, there = (_means(run, rho) for run in runs)
        difference = wrap_deg(here.mean_deg[_at(runs[0], shared)] - there.mean_deg[_at(runs[1], shared)])
        spread = sum(
            means.covariance[np.ix_(_at(run, shared), _at(run, shared))]
            for means, run in ((here, runs[0]), (there, runs[1]))
        )
        moved = float(difference.mean())
        by_slope = OWN_BIAS_DEG**2 * np.outer(slope, slope) + moved**2 * of_slope
        variance = max((here.squares + there.squares) / freedom, LEAST_VARIANCE_DEG2)
        covariance = variance * np.asarray(spread) + by_slope
        left, q = _without(design, difference, covariance)
        p_values.append(float(fdtrc(free, freedom, q / free)))
        weights.append(
            PRIOR_POWER * np.log1p(-rho)
            - 0.5 * (here.log_determinant + there.log_determinant + freedom * np.log(variance))
        )
        fits.append((left, covariance))
    weight = np.exp(np.array(weights) - max(weights))
    left, covariance = fits[int(np.argmax(weight))]
    std = np.sqrt(np.diag(covariance))
    largest = int(np.argmax(np.abs(left)))
    return MapCheck(
        p_value=float(weight @ p_values / weight.sum()),
        at_deg=tuple(np.unique(dial[np.abs(left) > FAR * std]).tolist()),
        largest_deg=float(left[largest]),
        largest_at_deg=float(dial[largest]),
        seen_from_deg=_seen_from_deg(design, dial, covariance, freedom),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """A run's errors (n,) in the order measured, its places, and (n, places) which pose stands at which."""

    error_deg: FloatArray
    places: tuple[tuple[int, int], ...]
    design: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Means:
    """Mean of each place (K,), covariance (K, K) and weighted squares left over the noise's variance."""

    mean_deg: FloatArray
    covariance: FloatArray
    squares: float
    log_determinant: float


def _of_places(poses: Sequence[Pose]) -> _Run:
    """Errors of the reading, and the places: angle of the dial, in steps, and approach."""
    dial, approach = dial_of(poses)
    rounded = np.rint(dial / PLACE_DEG).astype(int).tolist()
    of_pose = list(zip(rounded, approach.astype(int).tolist(), strict=True))
    places = tuple(sorted(set(of_pose)))
    design = np.zeros((len(of_pose), len(places)))
    design[np.arange(len(of_pose)), [places.index(place) for place in of_pose]] = 1.0
    error = wrap_deg(np.array([pose.reading_deg for pose in poses]) - dial)
    # whole turns between the poses of a place would be its scatter
    return _Run(np.asarray(error[0] + wrap_deg(error - error[0])), places, design)


def _at(run: _Run, shared: Sequence[tuple[int, int]]) -> list[int]:
    return [run.places.index(place) for place in shared]


def _means(run: _Run, rho: float) -> _Means:
    """Generalised least squares of the places' means in noise of this correlation."""
    design, error = whitened(run.design, rho), whitened(run.error_deg, rho)
    information = design.T @ design
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    mean = covariance @ (design.T @ error)
    left = error - design @ mean
    logs = (len(error) - 1) * np.log1p(-(rho**2)) + np.linalg.slogdet(information)[1]
    return _Means(mean, covariance, float(left @ left), float(logs))


def _seen_from_deg(
    design: FloatArray, dial_deg: FloatArray, covariance: FloatArray, freedom: int
) -> tuple[float, ...]:
    """Size, root mean square, from which a change of each of `ORDERS` is seen in `POWER` of cases."""
    from scipy.special import fdtri, ncfdtrinc

    free = len(dial_deg) - design.shape[1]
    limit = float(fdtri(free, freedom, 1.0 - ALARM))
    needed = float(ncfdtrinc(free, freedom, 1.0 - POWER, limit))
    sizes = []
    for order in ORDERS:
        turn = np.radians(order * dial_deg)
        gains = [_without(design, wave, covariance)[1] for wave in (np.cos(turn), np.sin(turn))]
        sizes.append(float(np.sqrt(needed / max(sum(gains), np.finfo(np.float64).tiny))))
    return tuple(sizes)


def _slope(
    poses: Sequence[Pose], stage_map: StageMap, dial_deg: FloatArray, noise_deg2: float
) -> tuple[FloatArray, FloatArray]:
    """(K,) slope of the unit's own errors at angles of the dial, degrees a degree, and (K, K) covariance.

    A Bayesian fit: the largest errors of available parts are known before the data.
    """
    dial, approach = dial_of(poses)
    reading = np.array([pose.reading_deg for pose in poses])
    error = wrap_deg(reading - dial - stage_map.correction_deg(dial, approach))
    of_pose = max(noise_deg2, LEAST_VARIANCE_DEG2) + np.mean(stage_map.stds_deg(dial, approach) ** 2)
    waves = _waves(dial)
    covariance = np.linalg.inv(waves.T @ waves / of_pose + np.diag(1.0 / LARGEST_DEG**2))
    series = covariance @ (waves.T @ wrap_deg(error - error[0])) / of_pose
    by_series = (_waves(dial_deg + STEP_DEG) - _waves(dial_deg - STEP_DEG)) / (2 * STEP_DEG)
    return np.asarray(by_series @ series), np.asarray(by_series @ covariance @ by_series.T)


def _waves(dial_deg: FloatArray) -> FloatArray:
    """(n, 7) what offsets, gain, skew and the bent axes of a unit are made of, and a constant."""
    turns = np.radians(dial_deg)[:, None] * np.arange(1.0, HIGHEST_ORDER + 1.0)
    return np.concatenate([np.ones((len(dial_deg), 1)), np.cos(turns), np.sin(turns)], axis=1)


def _without(design: FloatArray, difference: FloatArray, covariance: FloatArray) -> tuple[FloatArray, float]:
    """(K,) what the columns of a design (K, 2) leave at best, and its square by the covariance."""
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, np.column_stack([design, difference]))
    found = np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=None)[0]
    return difference - design @ found, float(np.sum((white[:, -1] - white[:, :-1] @ found) ** 2))
