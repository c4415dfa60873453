"""Poses as a multi-response regression sees them: the reading and its witnesses, each less what is expected.

The witnesses are responses of the same fit, not tie-breakers afterwards: an offset of 2 mg on z leaves 0.004°
in the reading and 0.34 mg in |accelerometer|.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from calrig.calibration.line import reading_error_deg
from calrig.calibration.poses import (
    DiagnosisError,
    Pose,
    column_of,
    complete,
    covariates_of,
    refuse_what_is_no_elevation,
    refuse_what_is_on_its_way,
)
from calrig.calibration.regression.channels import ANGLE, READING, Channels, add_witnesses, turn_size
from calrig.calibration.regression.motion import (
    Motion,
    approach_of,
    filter_share,
    has_history,
    is_sorted,
    joined,
    motion_of,
    moves_deg,
    stretches_deg,
    travel_deg,
    with_approach,
)
from calrig.calibration.regression.request import AS_USUAL, DiagnosisRequest
from calrig.estimation.angles import BoolArray, FloatArray

FEWEST_POSES = 8
NO_HISTORY = (
    "no column time_s, pass or approach gives the order of the poses: effects of time and of moves were not "
    "looked for; add time_s"
)
"""Noise may be correlated from row to row all the same, unless the rows are sorted: a gate that denied it
would raise false alarms in a table that was measured in its order, and allowing for it names nothing."""


@dataclass(frozen=True, slots=True)
class Change:
    """Between two consecutive runs something began, or ended.

    Attributes:
        run: index of the later one.
        before, after: what the two are called.
    """

    run: int
    before: str
    after: str
    ended: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Responses:
    """n poses with J responses ("channels"), and the covariates that effects are functions of.

    Attributes:
        run: (n,) index of the run that each pose is of, into `run_ids`.
        theta_deg: (n,) elevation that each pose stands for.
        move_deg: (n,) θ less that of the pose before; 0 where it is not known.
        settled: (n,) whether the pose is a dwell after its move: in a stretch of a turn nothing settles.
        stretch_deg: (n,) how far the stage turned while the pose was read; 0 of a dwell.
        travel_deg: (n,) way since the stage last turned; infinite where nothing says that it is short.
        starts: (n,) whether a pose follows on nothing: the first of its run, or any in a table by angle.
        approach, time_s, temperature_c: (n,) or None where not known of every pose.
        motion: of the stage while the readings were taken; None where not known of every pose.
        covariates: (n,) each: columns that calrig has no physics for.
        channels: names of the J responses, the reading first.
        values: (n, J) response less θ (angles, degrees), less 1 g (|accelerometer|, g), less the stage's
            move (gyro, degrees), less target (stage, degrees).
        known: (n, J) False where a response does not exist (the gyro's before the first move).
        base: (n, J, p) columns of bias and scale, and of the first pose of each run.
        base_names: of the p columns, such as `reading.bias`, `gyro_move.gain`, `reading.first`.
        kappa: (n,) share of a gyro scale error times the move that the filter still shows.
        rounding: (J,) what arithmetic alone may leave of each response: below it there is nothing to judge.
        across_g: (n,) acceleration along the stage's axis, where the accelerometer has a third one. It says
            how far askew a unit sits, as each does: no response, for it would name effects that are none.
        known_periods_deg: of the axis, that somebody knows (`DiagnosisRequest`).
        reference_is_good: whether θ is free of error, so that curves of it are the sensor's.
        arc_deg: that the elevations span.
        sense: +1, or −1 where the readings fall while the elevation rises.
        is_delayed: whether `theta_deg` are the elevations that late readings stand for.
    """

    run: npt.NDArray[np.intp]
    run_ids: tuple[str, ...]
    theta_deg: FloatArray
    move_deg: FloatArray
    settled: BoolArray
    stretch_deg: FloatArray
    travel_deg: FloatArray
    starts: BoolArray
    approach: FloatArray | None
    time_s: FloatArray | None
    temperature_c: FloatArray | None
    motion: Motion | None
    covariates: dict[str, FloatArray]
    channels: tuple[str, ...]
    values: FloatArray
    known: BoolArray
    base: FloatArray
    base_names: tuple[str, ...]
    kappa: FloatArray
    rounding: FloatArray
    warnings: tuple[str, ...] = field(default=())
    across_g: FloatArray | None = None
    known_periods_deg: tuple[float, ...] = ()
    reference_is_good: bool = False
    is_delayed: bool = False
    arc_deg: float = field(init=False)
    sense: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "arc_deg", float(np.ptp(self.theta_deg)))
        beside_mean_deg = self.theta_deg - self.theta_deg.mean()
        rises = beside_mean_deg @ (self.theta_deg + self.values[:, 0]) >= 0.0
        object.__setattr__(self, "sense", 1.0 if rises else -1.0)

    def __len__(self) -> int:
        return len(self.theta_deg)

    @property
    def request(self) -> DiagnosisRequest:
        """What a diagnosis of them assumes."""
        return DiagnosisRequest("good" if self.reference_is_good else "stage", self.known_periods_deg)

    def rows(self, chosen: npt.NDArray[np.intp]) -> Responses:
        """Some of the poses, with what their neighbours said of moves and approach."""

        def pick(column: FloatArray | None) -> FloatArray | None:
            return None if column is None else column[chosen]

        run = self.run[chosen]
        return replace(
            self,
            run=run,
            theta_deg=self.theta_deg[chosen],
            move_deg=self.move_deg[chosen],
            settled=self.settled[chosen],
            stretch_deg=self.stretch_deg[chosen],
            travel_deg=self.travel_deg[chosen],
            starts=self.starts[chosen] | (np.diff(run, prepend=run[:1]) != 0),
            approach=pick(self.approach),
            time_s=pick(self.time_s),
            temperature_c=pick(self.temperature_c),
            motion=self.motion and self.motion.rows(chosen),
            covariates={name: column[chosen] for name, column in self.covariates.items()},
            values=self.values[chosen],
            known=self.known[chosen],
            base=self.base[chosen],
            kappa=self.kappa[chosen],
            across_g=pick(self.across_g),
        )

    def columns(self, shares: Mapping[str, FloatArray]) -> FloatArray:
        """(n, J, p) of what an effect adds to each channel, (n,) or (n, p) each; nothing to the others."""
        first = next(iter(shares.values()))
        width = 1 if first.ndim == 1 else first.shape[1]
        stacked = np.zeros((len(self), len(self.channels), width))
        for channel, share in shares.items():
            if channel in self.channels:
                stacked[:, self.channels.index(channel)] = share.reshape(len(self), width)
        return stacked * self.known[:, :, None]

    def with_free(self, own: FloatArray, name: str) -> Responses:
        """Return the responses with free columns (n, p) in the base of the reading and of the accel angle.

        Each is called `name` in `base_names`, after the channel's.
        """
        seen, width = [channel for channel in (READING, ANGLE) if channel in self.channels], own.shape[1]
        freed = np.zeros((len(self), len(self.channels), len(seen) * width))
        for k, channel in enumerate(seen):
            freed[:, self.channels.index(channel), k * width : (k + 1) * width] = own
        names = (f"{channel}.{name}" for channel in seen for _ in range(width))
        base = np.concatenate([self.base, freed], axis=2)
        return replace(self, base=base, base_names=(*self.base_names, *names))

    def steps(self, f: FloatArray) -> FloatArray:
        """Return (n, …) change of f from the pose before, within a run: what the gyro sees of it."""
        change = np.zeros_like(f)
        change[1:] = np.diff(f, axis=0)
        change[self.starts] = 0.0
        return change


def responses_of(
    runs: Sequence[Sequence[Pose]],
    run_ids: Sequence[str] | None = None,
    request: DiagnosisRequest = AS_USUAL,
) -> Responses:
    """Return the poses of one or several runs of a unit as responses.

    Args:
        runs: each run's poses in the order measured (none excluded). All have one bias; |accelerometer| one
            a run, since gains that moved alike leave no trace in the angle.
        run_ids: what the runs are called, in the same order; counted from 0 where they have no names.
        request: what a diagnosis is to assume.

    Raises:
        DiagnosisError: too few poses, or readings that cannot be degrees of elevation.
    """
    given, warnings = complete(runs)
    kept, _ = with_approach(given)
    poses = [pose for run in kept for pose in run]
    if len(poses) < FEWEST_POSES:
        raise DiagnosisError(
            f"{len(poses)} poses are too few to tell an effect from noise: at least {FEWEST_POSES} are needed"
        )
    run_index = np.repeat(np.arange(len(kept)), [len(run) for run in kept])
    starts = (np.diff(run_index, prepend=-1) > 0) | np.concatenate([_alone(run) for run in kept])
    theta = np.array([pose.theta_deg for pose in poses])
    reading = np.array([pose.reading_deg for pose in poses])
    refuse_what_is_no_elevation(theta, reading)
    for run in kept:
        refuse_what_is_on_its_way(*np.array([(pose.theta_deg, pose.reading_deg) for pose in run]).T)
    move = np.nan_to_num(np.concatenate([moves_deg(run) for run in kept]))
    table = Channels(theta, move, starts, run_index)
    error = reading_error_deg(theta, reading)
    if np.ptp(theta + error - reading) > 180.0:
        warnings.append("some readings were taken on another turn, on which they come nearest to the others")
    table.add(READING, error, turn_size(theta, reading), bias_each_run=False, scaled=True)
    add_witnesses(table, poses, theta, move, starts)
    if has_history(poses):
        table.free_first()
    else:
        warnings.append(NO_HISTORY)
    senses = [sense for run in kept if (sense := approach_of(run)) is not None]
    covariates, said = covariates_of(poses, theta, reading)
    approach = np.concatenate(senses) if len(senses) == len(kept) else None
    return Responses(
        run=run_index,
        run_ids=names_of(runs, given, run_ids),
        theta_deg=theta,
        move_deg=move,
        settled=np.array([pose.settled for pose in poses]),
        stretch_deg=np.concatenate([stretches_deg(run) for run in kept]),
        travel_deg=travel_deg(move, approach, starts),
        starts=starts,
        approach=approach,
        time_s=column_of(poses, "time_s"),
        temperature_c=column_of(poses, "temperature_c"),
        motion=joined([motion_of(run) for run in kept]),
        covariates=covariates,
        channels=tuple(table.names),
        values=np.stack(table.values, axis=1),
        known=np.stack(table.known, axis=1),
        base=table.base(),
        base_names=tuple(name for name, _, _ in table.base_columns),
        kappa=filter_share(poses),
        rounding=len(poses) * float(np.finfo(np.float64).eps) * np.array(table.sizes),
        warnings=(*warnings, *said),
        across_g=column_of(poses, "accel_x_g"),
        known_periods_deg=request.periods_deg,
        reference_is_good=request.is_good,
    )


def _alone(run: Sequence[Pose]) -> BoolArray:
    """Return (n,) whether no pose of a run follows on the one before."""
    return np.full(len(run), is_sorted(run))


def names_of(
    runs: Sequence[Sequence[Pose]], kept: Sequence[Sequence[Pose]], run_ids: Sequence[str] | None
) -> tuple[str, ...]:
    """Return what the runs are called that have poses left."""
    given = iter(zip(runs, run_ids or map(str, range(len(runs))), strict=True))
    return tuple(next(name for run, name in given if any(p is left[0] for p in run)) for left in kept)
