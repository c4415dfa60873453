"""Lack of fit: whether a model leaves more than the pure error, which the poses tell without any model.

The dwells give the standard error of a reading. Poses revisited on the same side give what the rig repeats
to, dwells and all. Both say nothing of a model, so a residual that is much larger is not noise (Draper &
Smith, Applied Regression Analysis, 3rd edition, 1998, section 2.2).

What wanders in time moves revisits apart as well, and would pass for noise. So their error is taken from
differences of poses that follow on each other (von Neumann, Annals of Mathematical Statistics 12, 1941), each
less the mean of its own revisits: neither a function of the elevation nor a slow one of time is in it.

The test takes the whole residual, revisits and all, so that numerator and denominator rise and fall together
and it rejects rather too seldom; tails cost degrees of freedom (Shoemaker, American Statistician 57, 2003).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, reduce
from itertools import pairwise

import numpy as np

from calrig.calibration.effects.stage_periodic import step_deg
from calrig.calibration.effects.unnamed import MORE_KNOTS, POSES_A_KNOT, VISITS, few_places
from calrig.calibration.poses import Pose
from calrig.calibration.regression.motion import approach_of
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.spline import natural_spline
from calrig.estimation.angle_text import angle_text
from calrig.estimation.angles import BoolArray, FloatArray

LEVEL = 0.01
SLOW, STANDARD_ERRORS = 0.3, 4.0
"""Least lag-1 correlation of a slow residual; the same in standard errors of that of white noise."""
WANDERS = 1.5
"""Ratio of two errors from which one counts as larger."""
SEVERAL = 2.0
"""Times the pure error: a residual as large is spoken of also where few poses let no test reject."""
SAME_TARGET_DEG = 0.05
MOST_DECIMALS, OF_PRINTED = 6, 10.0
"""Of readings; and of the step that they are printed to, what the steps of counts exceed."""
FEWEST_FREEDOM = 8.0
VON_NEUMANN_EFFICIENCY = 2.0 / 3.0
"""Of successive differences, as an estimate of variance, over the variance itself."""
WELL_KNOWN = 1e4
"""Degrees of freedom at most: standard errors that are all alike were stated, not measured, by their file."""


@dataclass(frozen=True, slots=True)
class Spread:
    """A standard deviation in degrees, and the degrees of freedom that it is known by."""

    std_deg: float
    freedom: float


@dataclass(frozen=True, slots=True)
class LackOfFit:
    """The residual of a model against the pure error.

    Attributes:
        residual: of the reading, over its degrees of freedom.
        lag1_correlation: of that residual from pose to pose.
        dwell: standard error of a reading, RMS over the poses; None where they do not state it.
        repeat: scatter of poses revisited on the same side, slow changes included; None without revisits.
        pure: the pure error; None where neither dwells nor revisits tell it.
        f: the residual's variance over that of the pure error; None without the latter.
        freedom: of numerator and denominator.
        p_value: of so large an F where the model lacks nothing.
    """

    residual: Spread
    lag1_correlation: float
    dwell: Spread | None
    repeat: Spread | None
    pure: Spread | None
    f: float | None
    freedom: tuple[float, float]
    p_value: float | None

    @property
    def ratio(self) -> float | None:
        """The residual over the pure error; None where that is not known."""
        return self.residual.std_deg / self.pure.std_deg if self.pure else None

    @property
    def rejects(self) -> bool:
        """Whether the residual is more than the pure error, by test or by size."""
        significant = self.p_value is not None and self.p_value < LEVEL
        return significant or (self.ratio is not None and self.ratio >= SEVERAL)

    @property
    def is_slow(self) -> bool:
        """Whether the residual is correlated from pose to pose, far beyond what white noise may be."""
        return self.lag1_correlation >= max(SLOW, STANDARD_ERRORS / math.sqrt(self.residual.freedom))


def lack_of_fit(
    runs: Sequence[Sequence[Pose]],
    residual_deg: FloatArray,
    free: BoolArray,
    *,
    parameters: int,
    lag1_correlation: float,
    rounding_deg: float,
) -> LackOfFit:
    """Test the residual of a model against the pure error.

    Args:
        runs: the poses, in the order measured.
        residual_deg: (n,) of their readings.
        free: (n,) whether the model lets a pose lie where it will: it says nothing.
        parameters: how many the model spent on the other readings.
        lag1_correlation: of the residual from pose to pose.
        rounding_deg: what arithmetic alone leaves of a reading: no error counts as smaller.
    """
    from scipy.special import fdtrc

    judged = residual_deg[~free]
    left = max(len(judged) - parameters, 1.0)
    residual = Spread(math.sqrt(float(judged @ judged) / left), left)
    dwell = _dwell([pose for run in runs for pose in run])
    repeat, pure = _revisits(_groups(runs, free), residual_deg)
    if pure is None or pure.freedom < FEWEST_FREEDOM:
        pure = dwell
    elif dwell is not None:
        pure = _together(dwell, pure)
    if pure is None:
        return LackOfFit(residual, lag1_correlation, dwell, repeat, None, None, (left, 0.0), None)
    pure = Spread(math.hypot(pure.std_deg, rounding_deg), pure.freedom)
    f = (residual.std_deg / pure.std_deg) ** 2
    freedom = left * _share_known(judged), pure.freedom
    p_value = float(fdtrc(*freedom, f))
    return LackOfFit(residual, lag1_correlation, dwell, repeat, pure, f, freedom, p_value)


def _share_known(values: FloatArray) -> float:
    """What tails leave of the degrees of freedom of a variance: 2/(κ − 1), κ the kurtosis, at most 1."""
    squares = (values - values.mean()) ** 2
    power = float(squares.mean())
    kurtosis = float((squares**2).mean()) / power**2 if power > 0.0 else 3.0
    return min(2.0 / (kurtosis - 1.0), 1.0) if kurtosis > 1.0 else 1.0


def _dwell(poses: Sequence[Pose]) -> Spread | None:
    """RMS standard error of the readings; its freedom from how much they differ (Satterthwaite, 1946)."""
    squares = np.array([e * e for p in poses if (e := p.reading_stderr_deg) is not None])
    if 2 * len(squares) < len(poses) or not squares.any():
        return None
    mean, spread = float(squares.mean()), float(squares.var())
    freedom = 2.0 * len(squares) * mean**2 / spread if spread > 0.0 else WELL_KNOWN
    return Spread(math.sqrt(mean), min(freedom, WELL_KNOWN))


def _groups(runs: Sequence[Sequence[Pose]], free: BoolArray) -> list[list[int]]:
    """Return poses of one run at one target, come to or passed from one side, in order; each at least twice.

    Poses of a stroke that lie closer than a target is told apart are no visits of one: it was not left.
    """
    groups: list[list[int]] = []
    first = 0
    targets_deg = [pose.target_deg for run in runs for pose in run]

    def is_revisit(earlier: int, later: int) -> bool:
        way_deg = np.ptp(targets_deg[earlier : later + 1])
        return bool(way_deg > SAME_TARGET_DEG) or targets_deg[later] == targets_deg[earlier]

    for run in runs:
        senses = approach_of(run)
        by_side: dict[float | None, list[int]] = {}
        for k, pose in enumerate(run):
            if not free[first + k]:
                by_side.setdefault(pose.approach if senses is None else float(senses[k]), []).append(k)
        for same_side in by_side.values():
            begins_deg = -math.inf
            for k in sorted(same_side, key=lambda k: run[k].target_deg):
                if run[k].target_deg - begins_deg > SAME_TARGET_DEG:
                    begins_deg = run[k].target_deg
                    groups.append([])
                groups[-1].append(first + k)
        first += len(run)
    in_order = (sorted(group) for group in groups)
    return [group for group in in_order if any(is_revisit(*two) for two in pairwise(group))]


def _revisits(
    groups: Sequence[Sequence[int]], residual_deg: FloatArray
) -> tuple[Spread | None, Spread | None]:
    """Return what revisits scatter by, and the same without what changes slowly."""
    if not groups:
        return None, None
    off = np.full(len(residual_deg), np.nan)
    kept = np.zeros(len(residual_deg))
    for group in groups:
        off[group] = residual_deg[group] - residual_deg[group].mean()
        kept[group] = 1.0 - 1.0 / len(group)
    revisited = np.flatnonzero(np.isfinite(off))
    freedom = float(len(revisited) - len(groups))
    repeat = Spread(math.sqrt(float(off[revisited] @ off[revisited]) / freedom), freedom)
    differences = np.diff(off[revisited])
    expected = kept[revisited][1:] + kept[revisited][:-1]
    of_pose = math.sqrt(float(differences @ differences) / float(expected.sum()))
    return repeat, Spread(of_pose, VON_NEUMANN_EFFICIENCY * freedom * _share_known(off[revisited]))


def _together(dwell: Spread, revisits: Spread) -> Spread:
    """Both pooled where they agree; else, where revisits differ by more, what the rig repeats to."""
    from scipy.special import fdtrc

    ratio = (revisits.std_deg / dwell.std_deg) ** 2
    if fdtrc(revisits.freedom, dwell.freedom, ratio) < LEVEL:
        return revisits
    freedom = dwell.freedom + revisits.freedom
    power = dwell.freedom * dwell.std_deg**2 + revisits.freedom * revisits.std_deg**2
    return Spread(math.sqrt(power / freedom), freedom)


def warning_of(lack: LackOfFit, *, found: bool, temperature: bool, in_order: bool = True) -> str | None:
    """How large and how slow the rest is, and which experiment would show it; None where nothing lacks.

    Unless the rows are `in_order` of time, neighbours are those of a sorted table.
    """
    those = "the effects" if found else "bias and scale"
    if lack.pure is None and lack.is_slow:
        means = _experiment(lack, temperature) if in_order else "repeat elevations, and add time_s"
        return (
            "the noise is unknown: too few poses state a standard error or are revisited. What "
            f"{those} leave is correlated by {lack.lag1_correlation:.2f} from pose to pose "
            f"(RMS {angle_text(lack.residual.std_deg)}): correlated noise, or an effect that these poses "
            f"cannot separate from it; {means}"
        )
    if not lack.rejects or lack.pure is None:
        return None
    rest = f"{those} leave more than the noise of a pose"
    test = f"F = {lack.f:.3g} with {lack.freedom[0]:.0f} and {lack.freedom[1]:.0f} degrees of freedom"
    return (
        f"lack of fit: {rest}: RMS {angle_text(lack.residual.std_deg)}, {lack.ratio:.1f} times the "
        f"pure error of {angle_text(lack.pure.std_deg)} ({test}), correlated by {lack.lag1_correlation:.2f} "
        f"from pose to pose; {_experiment(lack, temperature)}"
    )


def _experiment(lack: LackOfFit, temperature: bool) -> str:
    """Return what to measure, by where the rest shows: in time, over elevation, or from pose to pose."""
    warm = "warm the unit up once more" if temperature else "record the temperature over a warm-up"
    if lack.repeat is not None and lack.pure is not None:
        if lack.repeat.std_deg > WANDERS * lack.pure.std_deg:
            return f"it changes in time: repeat one elevation over the run, and {warm}"
        if lack.repeat.std_deg < lack.residual.std_deg / WANDERS:
            return "it repeats at each elevation: measure between those, and turn the unit on the stage"
    if lack.lag1_correlation >= SLOW:
        return f"it is slow: repeat one elevation, which tells time from angle, and {warm}"
    return "it differs from pose to pose: repeat one elevation from one side, to see what the rig repeats to"


def with_free_curve(r: Responses, visits: float = VISITS) -> Responses | None:
    """Return the responses with a free curve of the elevation for each approach; None with too few poses.

    Of a few places, each visited so often from a side, it is any value at each.
    """
    if (cells := free_cells(r, visits)) is not None:
        return r.with_free(cells, "curve")
    sides = _sides(r)
    enough = [count for count in MORE_KNOTS if len(r) >= POSES_A_KNOT * count * len(sides)]
    if not enough or len(np.unique(r.theta_deg)) <= max(enough) + 1:
        return None
    curve = natural_spline(r.theta_deg, max(enough))
    columns = [(np.column_stack([np.ones(len(r)), curve]).T * side).T for side in sides]
    own = np.concatenate([columns[0][:, 1:], *columns[1:]], axis=1)  # one side has the bias itself
    return r.with_free(own, "curve")


def free_cells(r: Responses, visits: float = VISITS) -> FloatArray | None:
    """Return (n, p) a column for each of a few places and its side; None unless each is visited so often.

    Two are left out, which bias and scale stand for.
    """
    sides = _sides(r)
    places = few_places(r.theta_deg, visits * len(sides))
    if places is None:
        return None
    each = places[:, None] == np.arange(places.max() + 1)
    cells = np.concatenate([(each.T & side).T for side in sides], axis=1)
    return cells[:, cells.any(axis=0)][:, 2:].astype(np.float64)


def _sides(r: Responses) -> list[BoolArray]:
    if r.approach is not None and len(np.unique(r.approach[r.approach != 0.0])) > 1:
        return [r.approach > 0.0, r.approach <= 0.0]
    return [np.ones(len(r), dtype=bool)]


def leaves_more(r: Responses, residual_deg: FloatArray) -> bool:
    """Return whether residuals (n,) are several times the pose-to-pose difference about free curves."""
    free = with_free_curve(r)
    if free is None or r.starts.all():
        return False
    base = free.base[:, 0]
    beside = r.values[:, 0] - base @ np.linalg.lstsq(base, r.values[:, 0], rcond=None)[0]
    differences = np.diff(beside)[~r.starts[1:]]
    noise_deg = np.hypot(np.sqrt(np.mean(differences**2) / 2.0), r.rounding[0])
    return bool(residual_deg.std() > SEVERAL * noise_deg)


def is_of_rounding(r: Responses, residual_deg: FloatArray) -> bool:
    """Return whether residuals (n,) at evenly spaced poses are as large as what rounding the readings leaves.

    The errors of a reading to whole counts, ±q/2, have a mean square of q²/12 (GUM F.2.2.1). At even poses
    they are waves themselves, of which each is certain, and none is of the axis. Readings that leave less are
    not rounded: the stage was moved until they changed.
    """
    if len(r.channels) > 1 or step_deg(r) is None:
        return False
    rounded = np.square(_steps_of_readings_deg(r)) / 12.0
    off = np.abs(np.mean(residual_deg**2) - rounded)  # of which 0.8/n is the relative variance
    return bool((off <= min(STANDARD_ERRORS * math.sqrt(0.8 / len(r)), 0.5) * rounded).any())


@lru_cache(maxsize=8)
def _steps_of_readings_deg(r: Responses) -> tuple[float, ...]:
    """Return the step that readings are printed to and that of the counts behind, without those not found."""
    steps_deg = np.diff(np.unique((r.theta_deg + r.values[:, 0]).round(MOST_DECIMALS)))

    def common_deg(within_deg: float) -> float:
        """The step that all are multiples of, as exactly as they are known; 0 without one."""

        def in_both_deg(one_deg: float, other_deg: float) -> float:  # Euclid's
            while other_deg > OF_PRINTED * within_deg:
                one_deg, other_deg = other_deg, abs(one_deg - other_deg * round(one_deg / other_deg))
            return one_deg

        found_deg = reduce(in_both_deg, steps_deg.tolist(), 0.0)
        counts = np.rint(steps_deg / (found_deg or np.inf))
        found_deg = float(steps_deg.sum() / max(counts.sum(), 1.0))
        off_deg = np.abs(steps_deg - counts * found_deg).max(initial=0.0)
        return found_deg if off_deg <= 2.0 * within_deg else 0.0

    printed_deg = common_deg(0.1**MOST_DECIMALS)
    counts_deg = printed_deg and common_deg(printed_deg)
    return tuple(step for step in (printed_deg, counts_deg) if step)
