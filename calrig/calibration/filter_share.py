"""What the filter still shows, in the dwell, of a gyro scale error over the move before it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calrig.calibration.pose import Filtering, Pose
from calrig.estimation.angles import FloatArray
from calrig.estimation.gains import steady_state_gain
from calrig.estimation.gyro import gyro_scale
from calrig.estimation.kalman import KalmanNoise

SETTLE_S = 1.0
"""Where a pose does not say how long it settled: the default of a plan."""
FORGOTTEN = 1e-9
MOST_SAMPLES = 1_000_000
SHORTEST_MOVE_S = 1e-3
LEAST_GAIN_ERROR = 0.002
"""Of a gyro; below it the share of an error means nothing."""


def filter_share(poses: Sequence[Pose]) -> FloatArray:
    """(n,) κ of each pose: an error of the gyro of 1 % adds κ·1 % of the last move to its reading.

    A gyro that is wrong by g errs by g·rate(t) during the move. With h the steady filter's response from rate
    to angle (`SteadyStateGain`), T the duration of the move, s and d settling and dwell, and the error spread
    evenly:

        κ = 1/(T·d) ∫₀ᵀ dτ ∫ₛ^(s+d) dt h(t + τ)

    How long a move took is told by the stage's velocity and acceleration, and what else lies between two
    dwells belongs to settling: the stage was asked whether it stands, and the board for a fresh sample. Where
    they are not known the move took it all; without times it is a jump. The constants of the filter, rate and
    dwell are those that the poses know (`Pose.filtering`), else the contract's.

    The filter goes on by the newest rate, so that it is ahead by half a sampling interval Δt while the stage
    turns, and shows of that, after the move too,

        λ = Δt/(2·T·d) ∫ₛ^(s+d) dt (h(t + T) − h(t))

    times the move: at 200 Hz as much as of a gyro that is wrong by −0.4 %. Where the poses tell g, κ is that
    of both, κ + λ/g.
    """
    known = [pose.filtering or Filtering() for pose in poses]
    settle_s = np.array([SETTLE_S if pose.settle_s is None else pose.settle_s for pose in poses])
    dwell_s = np.array([_dwell_s(pose, f) for pose, f in zip(poses, known, strict=True)])
    between_s = _between_s(poses, settle_s, dwell_s)
    ways_deg = np.abs(np.diff([pose.theta_deg for pose in poses], prepend=math.nan))
    travel_s = np.array([_travel_s(way, f) for way, f in zip(ways_deg, known, strict=True)])
    move_s = np.maximum(np.minimum(between_s, travel_s), SHORTEST_MOVE_S)
    settle_s = settle_s + np.maximum(between_s - move_s, 0.0)
    share, lead = np.empty(len(poses)), np.empty(len(poses))
    for noise, rate_hz in {(f.noise, f.rate_hz) for f in known}:
        of_filter = np.array([(f.noise, f.rate_hz) == (noise, rate_hz) for f in known])
        share[of_filter], lead[of_filter] = _share_and_lead(
            noise, rate_hz, settle_s[of_filter], dwell_s[of_filter], move_s[of_filter]
        )
    gain_error = _gain_error(poses)
    if abs(gain_error) >= LEAST_GAIN_ERROR:
        share += lead / gain_error
    return np.where([f.remembers for f in known], share, 0.0)


def _dwell_s(pose: Pose, filtering: Filtering) -> float:
    if pose.filtering is not None and pose.n_samples:
        return pose.n_samples / filtering.rate_hz  # a dwell may end early
    return filtering.dwell_s


def _between_s(poses: Sequence[Pose], settle_s: FloatArray, dwell_s: FloatArray) -> FloatArray:
    """(n,) what lies between the dwell before and the settling; 0 where no times are known."""
    times = np.array([np.nan if pose.time_s is None else pose.time_s for pose in poses])
    between = np.diff(times, prepend=np.nan) - settle_s - (dwell_s + np.roll(dwell_s, 1)) / 2.0
    return np.maximum(np.nan_to_num(between, nan=0.0), 0.0)


def _travel_s(way_deg: float, filtering: Filtering) -> float:
    """How long the stage turns so far, by a trapezoid of velocity; inf where that is not known."""
    velocity, acceleration = filtering.velocity_dps, filtering.acceleration_dps2
    if velocity is None or acceleration is None or not way_deg > 0.0:
        return math.inf
    peak = min(velocity, math.sqrt(way_deg * acceleration))
    return way_deg / peak + peak / acceleration


def _gain_error(poses: Sequence[Pose]) -> float:
    """Of the gyro, by its account of the moves; 0 where it gives none."""
    felt_deg = [math.nan if pose.gyro_move_deg is None else pose.gyro_move_deg for pose in poses]
    turned_deg = np.diff([pose.theta_deg for pose in poses], prepend=math.nan)
    found = gyro_scale(turned_deg, felt_deg)
    return 0.0 if found is None else 1.0 / found.scale - 1.0


def _share_and_lead(
    noise: KalmanNoise, rate_hz: float, settle_s: FloatArray, dwell_s: FloatArray, move_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    from scipy.signal import lfilter

    gain = steady_state_gain(noise, 1.0 / rate_hz)
    slowest = max(np.abs(np.roots(gain.denominator)))
    remembered = math.log(FORGOTTEN) / math.log(slowest) if slowest < 1.0 else math.inf
    longest_s = float((settle_s + dwell_s + move_s).max())
    samples = int(min(remembered, longest_s * rate_hz, MOST_SAMPLES)) + 2
    impulse = np.zeros(samples)
    impulse[0] = 1.0 - gain.k_angle
    response = lfilter([1.0, -1.0], gain.denominator, impulse)
    once = np.cumsum(response) / rate_hz
    at = np.arange(1, samples + 1) / rate_hz
    end_s = settle_s + dwell_s

    def over_both(integral: FloatArray) -> FloatArray:
        """Over the dwell and the move, per second of both, by what has been integrated up to each time."""

        def of(t: FloatArray) -> FloatArray:
            return np.interp(t, at, integral, left=0.0)

        area = of(end_s + move_s) - of(end_s) - of(settle_s + move_s) + of(settle_s)
        return np.asarray(area / (move_s * dwell_s), dtype=np.float64)

    return over_both(np.cumsum(once) / rate_hz), over_both(once) / (2.0 * rate_hz)
