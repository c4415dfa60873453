"""Readings while a stage turns evenly: where it stood at each sample, and how late its reports come.

The stage's reports are stamped by the host's clock, the samples by the board's. Both clocks run evenly, so
that one straight line takes the host's time to the board's but for a constant; with it come the age of a
report and the delay of the board's own low-pass filter. At a velocity v they shift a reading by v times
their sum, one way upward and the other way downward, as backlash would. The gyro tells them apart: what it
still feels from an instant of the turn to the stand at its end is what the stage still has to turn, and the
play was taken up long before. Gyro and accelerometer of an MPU-6050 are delayed alike (RM-MPU-6000A rev. 4.2,
DLPF_CFG: within 0.5 ms of one another).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.estimation.gains import steady_state_gain
from calrig.estimation.kalman import KalmanNoise

LATE = 6.0
"""Times the median deviation of the reports: what is so far off, a busy machine held up."""
AT_THE_END_S = 0.1
"""Before the stage slows down: a worm of 0.1° and 7.2° changes its slope by 4 % in that time at 5 °/s."""
NEARLY = 0.95
EARLIER = 0.25
"""Of the time that the rate takes to fall: so much sooner than it is seen to, it may have begun."""
STANDS_S = 0.1
"""After the rate has fallen: longer, the gyro's noise and bias add up."""
LOCAL = 20
"""Samples that tell the rate of a turn before it ends."""
FEWEST_REPORTS = 5
AGREE = 4.0
"""Standard deviations within which the delays of two passes are one; a busy machine makes them two."""
RATE_DECIMALS = 6
"""Finer than any chip's step: what differs by less is one value."""


@dataclass(frozen=True, slots=True)
class EvenTurn:
    """The even part of a turn in the board's time: elevation = at_deg + velocity_dps·(time_s − at_s).

    Attributes:
        at_s, at_deg: its middle.
        velocity_dps: signed.
        begins_s, ends_s: of the part that was fitted.
        scatter_deg: RMS of the reports about the line.
    """

    at_s: float
    at_deg: float
    velocity_dps: float
    begins_s: float
    ends_s: float
    scatter_deg: float

    def elevation_deg(self, time_s: FloatArray) -> FloatArray:
        """Return where the stage was by its reports."""
        return np.asarray(self.at_deg + self.velocity_dps * (time_s - self.at_s), dtype=np.float64)

    def time_s(self, elevation_deg: float) -> float:
        """Return when it was there."""
        return self.at_s + (elevation_deg - self.at_deg) / self.velocity_dps


@dataclass(frozen=True, slots=True)
class ClockLine:
    """The board's clock by the host's: board = offset_s + slope·host, but for a constant."""

    slope: float
    offset_s: float

    def board_s(self, host_s: FloatArray) -> FloatArray:
        """Return the board's times for the host's."""
        return np.asarray(self.offset_s + self.slope * host_s, dtype=np.float64)

    def host_s(self, board_s: float) -> float:
        """Return the host's time for one of the board's."""
        return (board_s - self.offset_s) / self.slope


def clock_line(seen_s: FloatArray) -> ClockLine:
    """Return the line that takes times of the host to times of the board, but for a constant.

    No sample is seen before it was taken: the line lies above all pairs, as near to them as it can (Moon,
    Skelly & Towsley, Estimation and removal of clock skew from network delay measurements, INFOCOM 1999).
    What was held up on its way, or waited in a block, moves it nowhere.

    `seen_s` (k, 2) are the host's clock, and the board's at the last sample seen by then.
    """
    from scipy.optimize import linprog

    about_s = seen_s.mean(axis=0)
    host, board = (seen_s - about_s).T
    above = np.column_stack([-host, -np.ones(len(host))])
    line = linprog([0.0, 1.0], A_ub=above, b_ub=-board, bounds=(None, None), method="highs")
    if not line.success:
        raise ValueError("the board's clock does not go on with the host's")
    slope, offset = (float(one) for one in np.asarray(line.x))
    return ClockLine(slope, float(offset + about_s[1] - slope * about_s[0]))


FEWEST_EVENTS = 8
SHORTEST_RUN_S = 20.0
MOST_CLOCK_ERROR = 0.05
"""A ceramic resonator is within 1 %; clocks that differ by more are not meant to be the same time."""


@dataclass(frozen=True, slots=True)
class ClockRate:
    """By how much a clock is fast, as a share, and the standard error of that."""

    error: float
    std: float


def clock_rate(clock_s: Sequence[FloatArray], reference_s: Sequence[FloatArray]) -> ClockRate | None:
    """Least squares line through each run's pairs of times, one slope for all.

    Events that are told late scatter about the line, and the standard error is made of that scatter.

    `clock_s` are of each run (n,) times by the clock that is judged, `reference_s` the same events by the
    other.

    Returns:
        None where the runs are too short or the clocks are not of one time.
    """
    x = np.concatenate([times - times.mean() for times in reference_s])
    y = np.concatenate([times - times.mean() for times in clock_s])
    power, freedom = float(x @ x), len(x) - len(reference_s) - 1
    if len(x) < FEWEST_EVENTS or freedom < 1 or np.ptp(x) < SHORTEST_RUN_S:
        return None
    slope = float(x @ y) / power
    left = y - slope * x
    if abs(slope - 1.0) > MOST_CLOCK_ERROR:
        return None
    return ClockRate(slope - 1.0, math.sqrt(float(left @ left) / freedom / power))


def even_turn(time_s: FloatArray, reported_deg: FloatArray, from_deg: float, to_deg: float) -> EvenTurn:
    """Return the straight line through the reports between two elevations, in the order turned.

    Args:
        time_s: (m,) of the reports, by the board's clock (`clock_line`).
        reported_deg: (m,) elevations.
        from_deg: from here on the stage turns evenly,
        to_deg: and up to here.

    Raises:
        ValueError: fewer than `FEWEST_REPORTS` reports lie between.
    """
    low, high = min(from_deg, to_deg), max(from_deg, to_deg)
    inside = (reported_deg >= low) & (reported_deg <= high)
    if np.count_nonzero(inside) < FEWEST_REPORTS:
        raise ValueError(f"{np.count_nonzero(inside)} reports between {from_deg:g}° and {to_deg:g}°")
    times, angles = time_s[inside], reported_deg[inside]
    at_s = float(times.mean())
    kept = np.ones(len(times), dtype=bool)
    velocity = at_deg = 0.0
    for _ in range(2):
        velocity, at_deg = np.polyfit(times[kept] - at_s, angles[kept], 1)
        off = np.abs(angles - at_deg - velocity * (times - at_s))
        kept = off <= LATE * max(float(np.median(off)), 1e-9)
    scatter = math.sqrt(float(np.mean(off[kept] ** 2)))
    line = EvenTurn(at_s, float(at_deg), float(velocity), 0.0, 0.0, scatter)
    return EvenTurn(at_s, line.at_deg, line.velocity_dps, line.time_s(from_deg), line.time_s(to_deg), scatter)


def hidden_dps(standing_dps: FloatArray, turning_dps: FloatArray) -> float:
    """How far a rate may be from what its samples say in the mean, for the steps that they are told in.

    Noise of half a step and more carries the mean over the steps; less leaves it on one.

    Args:
        standing_dps: (n,) samples of a dwell.
        turning_dps: (m,) samples of a turn from its begin on: coming up to its velocity they show the steps.
    """
    values = np.unique(np.round(turning_dps, RATE_DECIMALS))
    step_dps = float(np.diff(values).min()) if len(values) > 1 else 0.0
    return step_dps / 2.0 if float(np.std(standing_dps)) < step_dps / 2.0 else 0.0


@dataclass(frozen=True, slots=True)
class GyroTurn:
    """What the gyro says of one turn.

    Attributes:
        gain: the rate that it gives over the rate that the stage reports.
        behind_s: by how much the stage's reports are behind the samples; a sample at t belongs to the
            elevation reported for t + behind_s.
        behind_std_s: what the gyro's noise makes of that.
        stands_s: when the turn comes to its stand at the velocity of its last instants.
    """

    gain: float
    behind_s: float
    behind_std_s: float
    stands_s: float


def gyro_turn(time_s: FloatArray, rate_dps: FloatArray, turn: EvenTurn, stands_deg: float) -> GyroTurn:
    """Gain and delay by the gyro's account of a turn and of its end.

    The gain is that between the two ends of the even part. The delay is told by when the turn ends: at the
    rate of its last instants the gyro comes to the stand at one time, and the reports' line at another. No
    more than these instants count, so that no error of the stage along the way enters, a worm's for example,
    and little of the gyro's noise.

    Args:
        time_s: (n,) samples from the begin of the turn to when the stage stands, by the board's clock.
        rate_dps: (n,) about the stage's axis, less the gyro's bias.
        turn: as its reports have it.
        stands_deg: where the stage says it stands afterwards.
    """
    even = np.flatnonzero((time_s >= turn.begins_s) & (time_s <= turn.ends_s))
    first, last = even[0], even[-1]
    turned_deg = float(np.trapezoid(rate_dps[first : last + 1], time_s[first : last + 1]))
    gain = turned_deg / (turn.velocity_dps * (time_s[last] - time_s[first]))
    slows, stands = _slows_and_stands(rate_dps, last)
    slows -= math.ceil(EARLIER * (stands - slows))
    stands = min(int(np.searchsorted(time_s, time_s[stands] + STANDS_S)), len(time_s) - 1)
    begins = int(np.searchsorted(time_s, time_s[slows] - AT_THE_END_S))
    to_come_deg = float(np.trapezoid(rate_dps[begins : stands + 1], time_s[begins : stands + 1]))
    last_dps = float(rate_dps[begins : slows + 1].mean())
    stands_s = float(time_s[begins] + to_come_deg / last_dps)
    noise_dps = float(np.std(np.diff(rate_dps[first : last + 1]))) / math.sqrt(2.0)
    # What is before it slows down counts in the way to come and in the velocity, and all but cancels out.
    behind_std_s = noise_dps * math.sqrt(stands - slows) * float(np.median(np.diff(time_s))) / abs(last_dps)
    return GyroTurn(gain, turn.time_s(stands_deg) - stands_s, behind_std_s, stands_s)


def turn_between(
    time_s: FloatArray,
    rate_dps: FloatArray,
    first_s: tuple[float, float],
    second_s: tuple[float, float],
    bias_std_dps: float,
) -> tuple[float, float]:
    """Return the turn from the mean of one span to the mean of a later one, and its standard error.

    White noise of a one-sided density 2·N², integrated, makes the two means differ with a variance of
    N²·(first/3 + gap + second/3): the integral of the squared weight that each instant's rate has.

    Args:
        time_s: (n,) samples from the begin of the first span to the end of the second.
        rate_dps: (n,) less its bias; its noise is that of the second span, in which nothing turns.
        first_s: begin and end of the one,
        second_s: and of the other.
        bias_std_dps: standard error of the bias.
    """
    from scipy.integrate import cumulative_trapezoid

    angle_deg = cumulative_trapezoid(rate_dps, time_s, initial=0)
    before, after = time_s <= first_s[1], time_s >= second_s[0]
    first, gap, second = first_s[1] - first_s[0], second_s[0] - first_s[1], second_s[1] - second_s[0]
    density = float(np.var(np.diff(rate_dps[after]))) / 2.0 * float(np.median(np.diff(time_s)))
    walk_deg = math.sqrt(density * (first / 3.0 + gap + second / 3.0))
    drift_deg = bias_std_dps * (first / 2.0 + gap + second / 2.0)
    turn_deg = float(angle_deg[after].mean() - angle_deg[before].mean())
    return turn_deg, math.hypot(walk_deg, drift_deg)


def common_delay_s(stands_s: FloatArray, clocks: ClockLine, std_s: float) -> float:
    """By how much the stage's reports are behind the samples, by all passes that agree with the last.

    An error of it shifts a pass upward by as much as one downward the other way: what both have in common
    leaves the bias alone, what each had of its own would not, and no scatter of the poses would show it.

    Args:
        stands_s: (k, 2) of each pass when it came to its stand: by the reports, in the host's time
            (`ClockLine.host_s`), and by the gyro, in the board's (`GyroTurn.stands_s`).
        clocks: as they are known by now.
        std_s: of one (`GyroTurn.behind_std_s`).
    """
    behind_s = clocks.board_s(stands_s[:, 0]) - stands_s[:, 1]
    agree = np.abs(behind_s - behind_s[-1]) <= AGREE * math.sqrt(2.0) * std_s
    return float(behind_s[agree].mean())


def _slows_and_stands(rate_dps: FloatArray, even: int) -> tuple[int, int]:
    """Indices at which the rate begins its last fall, and at which it has fallen, from the even part on."""
    before_dps = rate_dps[max(0, even - LOCAL) : even + 1].mean()
    share = rate_dps[even:] / before_dps
    slows = int(np.flatnonzero(share > NEARLY)[-1]) if (share > NEARLY).any() else 0
    stands = np.flatnonzero(share[slows:] < 1.0 - NEARLY)
    return even + slows, even + slows + (int(stands[0]) if len(stands) else len(share) - slows - 1)


def filter_lag_deg(
    time_s: FloatArray, rate_dps: FloatArray, gain_error: float, noise: KalmanNoise
) -> FloatArray:
    """Return what a gyro wrong by a share of the rate adds to the filtered angle, until it is taken for bias.

    `time_s` (n,) runs from a stand on; `rate_dps` (n,) is as the gyro gives it, less its bias; `gain_error`
    is `GyroTurn.gain` − 1.
    """
    from scipy.signal import lfilter

    steady = steady_state_gain(noise, float(np.median(np.diff(time_s))))
    numerator = steady.dt_s * (1.0 - steady.k_angle) * np.array([1.0, -1.0])
    error_dps = rate_dps * (gain_error / (1.0 + gain_error))
    return np.asarray(lfilter(numerator, steady.denominator, error_dps), dtype=np.float64)


def turned_back(accel_g: FloatArray, turn_deg: FloatArray) -> FloatArray:
    """Return (n, 3) specific force of a sensor that turns about its x, as at the middle of the turn.

    The mean over an arc is shorter than gravity; the mean of what is turned back is not.

    Args:
        accel_g: (n, 3).
        turn_deg: (n,) elevation of each sample less that of the middle.
    """
    x, y, z = accel_g.T
    cosine, sine = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    return np.stack([x, y * cosine - z * sine, z * cosine + y * sine], axis=1)


def scatter_g(accel_g: FloatArray) -> float:
    """How much an accelerometer scatters: RMS of all axes, g, by second differences, which see no slow turn.

    Args:
        accel_g: (n, 3) specific force.
    """
    return math.sqrt(float(np.mean(np.diff(accel_g, 2, axis=0) ** 2)) / 2.0)
