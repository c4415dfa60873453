"""Poses so far from what the model says of them that no effect and no noise explains them.

One alone is judged against the model of the other poses, not by its neighbours: a slip moves all poses after
it, an error of angle all near it, and at the ends of a range the neighbours lie on one side (Chen & Liu,
Journal of the American Statistical Association 88, 1993, who part outliers from level shifts by one
likelihood).

What no effect explains yet widens the spread: a gust hides beneath a worm's error, which it hides in turn,
and several outliers hide each other. So a few poses that leave their neighbours and come back are judged
together, by a running median (Tukey, Exploratory Data Analysis, 1977): it follows a wave and keeps the edge
of a slip. It sees no end of a pass, where play and settling begin. What comes again at the same angle stays.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from calrig.calibration.diagnosis.candidates import Candidate, model_columns
from calrig.calibration.line import FAR, GROSS_SHARE, off_robust_line_deg
from calrig.calibration.regression.noise_model import Fit, fit
from calrig.calibration.regression.responses import Responses
from calrig.estimation.angles import FloatArray, robust_std, wrap_deg

CLEAR_STD, CLEAR = 7.0, 2.0
"""Robust standard deviations that are far of what stands clear of all other poses; times the largest of
their residuals, where it does: heavy tails thin out more slowly."""
MOST_SHARE = 0.03
SUSPECTS = 3
REACH = range(2, 6)
"""Poses on either side that a running median takes, fewer near the end of a pass."""
FEWEST_NEIGHBOURED = 30
"""Poses, of a running median those with neighbours, from which their spread is known."""
AGAIN = 0.5
"""Of a pose's distance from its neighbours, what tells elsewhere that it belongs to the angle."""
GROSS_DEG = 60.0
"""From a line; no effect of the catalogue moves some single readings so far."""
OF_ANGLE = 0.25
"""Of the poses at one angle, those that tell that an error belongs to it."""
Intp = npt.NDArray[np.intp]


def most_outliers(n: int) -> int:
    """Return how many of n poses may be left out as outliers; if more are far off, the model is wrong."""
    return max(1, int(MOST_SHARE * n))


def gross_errors(r: Responses) -> Intp:
    """Return the poses whose readings no effect can have made; none where they are more than a tenth.

    They are apart from a robust line, and neither a part of the run nor other poses at their angle are as
    well.
    """
    left_deg = off_robust_line_deg(r.theta_deg, r.values[:, 0])
    far = np.abs(left_deg) > max(FAR * robust_std(left_deg), GROSS_DEG)
    step_deg = float(np.median(np.abs(np.diff(r.theta_deg))))
    alone = [
        k
        for k in np.flatnonzero(far).tolist()
        if not _is_in_stretch(far, r.run, k) and not _is_of_angle(r, left_deg, k, step_deg)
    ]
    return np.array(alone if far.mean() <= GROSS_SHARE else [], dtype=np.intp)


def _is_in_stretch(far: npt.NDArray[np.bool_], run: Intp, k: int) -> bool:
    """Return whether most poses just before or just after one, in its run, are far too."""
    reach = REACH[-1]
    sides = slice(max(k - reach, 0), k), slice(k + 1, k + 1 + reach)
    own = [far[side][run[side] == run[k]] for side in sides]
    return any(2 * side.sum() > len(side) for side in own)


def _is_of_angle(r: Responses, left_deg: FloatArray, k: int, step_deg: float) -> bool:
    """Return whether enough of the poses at the angle of one, taken at other times, are off to its side."""
    near = np.abs(wrap_deg(r.theta_deg - r.theta_deg[k])) <= step_deg
    near &= np.abs(np.arange(len(r)) - k) > REACH[-1]
    along = left_deg[near] * np.sign(left_deg[k]) > AGAIN * abs(left_deg[k])
    return bool(along.sum() > OF_ANGLE * len(along))


def beyond(r: Responses, accepted: Sequence[Candidate], residual_deg: FloatArray) -> Intp:
    """Return the poses that are as far off as outliers from a model, which leaves (n,) of them.

    Many of them turn the model, and widen the spread about it, so that a robust line counts beside it. A few
    that would be left out, were it not for those that have been, are as far.
    """
    off_line_deg = off_robust_line_deg(r.theta_deg, r.values[:, 0])
    both_deg = np.stack([residual_deg - np.median(residual_deg), off_line_deg])
    spread_deg = max(min(map(robust_std, both_deg)), float(r.rounding[0]))
    far = np.flatnonzero(np.abs(both_deg).min(axis=0) > FAR * spread_deg)
    return np.union1d(far, outliers(r, accepted, most_outliers(len(r))))


def outliers(r: Responses, accepted: Sequence[Candidate], most: int, gain_to_beat: float = 0.0) -> Intp:
    """Return the poses, in ascending order, that are best explained as outliers; none is empty.

    `gain_to_beat` is that of the best effect that could enter instead, in −2 log likelihood with penalties.
    """
    none = np.empty(0, dtype=np.intp)
    if most < 1:
        return none
    columns = model_columns(_with_first_poses(r), accepted)
    fitted = fit(r, columns)
    residual_deg = fitted.residuals[:, 0]
    suspects = np.argsort(-np.abs(residual_deg), kind="stable")[: min(SUSPECTS, most)]
    several = [np.array([k]) for k in suspects]  # and those that hide each other
    several += [np.sort(suspects[:count]) for count in range(2, len(suspects) + 1)]
    sets = [those for those in several if _are_far(r, columns, those)]
    brief = briefly_apart(r, residual_deg)
    if 0 < len(brief) <= most:
        sets.append(brief)
    gains = [fitted.criterion - _without(r, columns, those).criterion - _penalty(r, those) for those in sets]
    if not sets or max(gains) <= gain_to_beat:
        return none
    return sets[int(np.argmax(gains))]


def _with_first_poses(r: Responses) -> Responses:
    """Return the responses with the first pose of each run bound to the model like any other."""
    bound = [k for k, name in enumerate(r.base_names) if not name.endswith(".first")]
    return replace(r, base=r.base[:, :, bound], base_names=tuple(r.base_names[k] for k in bound))


def _penalty(r: Responses, those: Intp) -> float:
    return len(those) * float(np.log(len(r))) * (len(r.channels) + 2)


def _without(r: Responses, columns: FloatArray, those: Intp) -> Fit:
    """Return the fit with a free value in each channel of some poses, as if they had not been taken."""
    channels = len(r.channels)
    freed = np.zeros((len(r), channels, len(those) * channels))
    for place, k in enumerate(those):
        freed[k, :, place * channels : (place + 1) * channels] = np.diag(r.known[k].astype(float))
    return fit(r, np.concatenate([columns, freed], axis=2))


def _are_far(r: Responses, columns: FloatArray, those: Intp) -> bool:
    """Return whether each of some poses is far from the model of the others, by their spread about it."""
    without = _without(r, columns, those)
    left_deg = np.delete(without.residuals[:, 0], those)
    spread_deg = max(robust_std(left_deg), float(r.rounding[0]))
    nearest_deg = float(np.abs(without.beta[columns.shape[2] :: len(r.channels)]).min())
    is_clear = len(left_deg) >= FEWEST_NEIGHBOURED and nearest_deg > CLEAR * np.abs(left_deg).max()
    return nearest_deg > (CLEAR_STD if is_clear else FAR) * spread_deg


def briefly_apart(r: Responses, residual_deg: FloatArray) -> Intp:
    """Return the poses that are far from those before and after them, which agree, and at this angle only.

    `residual_deg` (n,) are of their readings.
    """
    order, passes = _passes(r)
    apart_deg, beside_deg = np.full((2, len(r)), np.nan)
    for one in passes:
        apart_deg[one], beside_deg[one] = _from_neighbours(residual_deg[one])
    seen = np.flatnonzero(~np.isnan(apart_deg))
    if len(seen) < FEWEST_NEIGHBOURED:
        return np.empty(0, dtype=np.intp)
    spread_deg = max(robust_std(beside_deg[seen]), float(r.rounding[0]))
    far = seen[np.abs(apart_deg[seen]) > FAR * spread_deg]
    step_deg = float(np.median(np.abs(np.diff(r.theta_deg[order]))))
    return np.array([k for k in far if not _comes_again(r, apart_deg, k, step_deg, passes)], dtype=np.intp)


def _passes(r: Responses) -> tuple[Intp, list[Intp]]:
    """Return the poses in the order they were taken, and the same in parts of one direction and run.

    In a table by angle the order is that of the elevations, side by side.
    """
    order = np.arange(len(r))
    starts = r.starts
    if starts.all():
        approach = np.zeros(len(r)) if r.approach is None else r.approach
        order, starts = np.lexsort((order, r.theta_deg, approach)), np.zeros(len(r), dtype=bool)
    turns = np.sign(np.diff(r.theta_deg[order]))
    moved = np.flatnonzero(turns)
    turned = moved[1:][turns[moved[1:]] != turns[moved[:-1]]] + 1
    cuts = np.union1d(np.flatnonzero(starts), turned)
    return order, np.split(order, cuts[cuts > 0])


def _from_neighbours(residual_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (n,) distance of each pose of a pass from a running median, and from that of the others alone.

    Both are NaN at its ends. The first keeps edges; the second has the spread of noise, where the first is
    often 0: the pose is the median.
    """
    apart_deg, beside_deg = np.full((2, len(residual_deg)), np.nan)
    for reach in REACH:
        if len(residual_deg) > 2 * reach:
            middle = slice(reach, len(residual_deg) - reach)
            windows = sliding_window_view(residual_deg, 2 * reach + 1)
            apart_deg[middle] = residual_deg[middle] - np.median(windows, axis=1)
            beside_deg[middle] = residual_deg[middle] - np.median(np.delete(windows, reach, axis=1), axis=1)
    return apart_deg, beside_deg


def _comes_again(
    r: Responses, apart_deg: FloatArray, k: int, step_deg: float, passes: Sequence[Intp]
) -> bool:
    """Return whether another pass, or turn, is apart at the same angle too, to the same side."""
    own = next(one for one in passes if k in one)
    near = np.abs(wrap_deg(r.theta_deg - r.theta_deg[k])) <= step_deg
    near[own] &= np.abs(r.theta_deg[own] - r.theta_deg[k]) > 180.0
    return bool((apart_deg[near] * np.sign(apart_deg[k]) > AGAIN * abs(apart_deg[k])).any())
