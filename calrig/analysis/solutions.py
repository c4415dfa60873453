"""Solve stored runs of one rig jointly: gather their poses with the gyro columns, make the solution."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import TYPE_CHECKING

import numpy as np

from calrig.analysis.errors import Conflict, Invalid
from calrig.analysis.stored_runs import counted_poses, ended_run, known_unit, limits_of
from calrig.calibration.poses import GYRO_MEANS, GYRO_MOVES, HOST_TIME, Pose
from calrig.calibration.separation import MapError, MountedPoses, StageMap
from calrig.estimation.angles import FloatArray
from calrig.estimation.gyro import MISSING_PERIODS, moves_about_axes
from calrig.model.run import mount_axis
from calrig.model.solution import Frame
from calrig.run_ids import short_name
from calrig.store.records import Basis, Run, Solved

if TYPE_CHECKING:
    from calrig.store import Store
    from calrig.store.solutions import StoredSolution


def poses_with_gyro(store: Store, run_id: str) -> list[Pose]:
    """The poses that count, each with its dwell's means, its move's turns, and the host's time.

    A run with mounts has the turns in its poses; of one without they are made of its samples while these are
    kept.
    A move is told where neither of its two poses was excluded, and none of its samples is missing.
    """
    stored = store.poses.of(run_id, include_excluded=True)
    poses = [one.pose for one in stored]
    if not any(GYRO_MOVES[0] in pose.covariates for pose in poses):
        poses = _of_samples(store, run_id, poses, [one.index for one in stored])
    announced = store.events.poses_announced_at(run_id)
    after = [None, *stored[:-1]]
    return [
        _told(pose, announced.get(one.index), lost=before is not None and before.excluded is not None)
        for pose, one, before in zip(poses, stored, after, strict=True)
        if one.excluded is None
    ]


def _of_samples(store: Store, run_id: str, poses: list[Pose], indices: Sequence[int]) -> list[Pose]:
    """Return the poses unchanged if their samples are not stored or their clock restarted."""
    whole = store.samples.of(run_id)
    dwells = [store.samples.of(run_id, index) for index in indices]
    if (
        len(whole.time_s) < 2
        or not (np.diff(whole.time_s) > 0.0).all()
        or any(not len(d.time_s) for d in dwells)
    ):
        return poses
    gap_s = MISSING_PERIODS * float(np.median(np.diff(whole.time_s)))
    spans = [(float(dwell.time_s[0]), float(dwell.time_s[-1])) for dwell in dwells]
    turned = moves_about_axes(whole.time_s, whole.gyro_dps, spans, gap_s)
    means = [dwell.gyro_dps.mean(axis=0) for dwell in dwells]
    return [_with(pose, mean, move) for pose, mean, move in zip(poses, means, turned, strict=True)]


def _with(pose: Pose, mean_dps: FloatArray, turned_deg: FloatArray | None) -> Pose:
    columns = dict(zip(GYRO_MEANS, mean_dps.tolist(), strict=True)) if np.isfinite(mean_dps).all() else {}
    if turned_deg is not None:
        columns |= dict(zip(GYRO_MOVES, turned_deg.tolist(), strict=True))
    return replace(pose, covariates={**pose.covariates, **columns})


def _told(pose: Pose, at: datetime | None, *, lost: bool) -> Pose:
    """The pose with the host's time, s: as it was announced, the same while after each dwell's middle."""
    host = {} if at is None else {HOST_TIME: at.timestamp()}
    kept = {k: v for k, v in pose.covariates.items() if not (lost and k in GYRO_MOVES)}
    return replace(pose, covariates={**kept, **host})


MOST_POSES = 40_000
"""Of one solution: a hundred units of four mounts have 29,000."""


@dataclass(frozen=True, slots=True)
class SolutionRequest:
    """What is to be solved together; what is not said here is as of `calrig.store.records.Basis`.

    Attributes:
        runs: ids; without units they are all.
        units: all calibrations that count of these units, beside the runs named.
        rig: the one rig of the runs; alone, all calibrations that count on it.
        limits_deg: of the stage, which advice keeps to; without them those that the last run was made under.
    """

    runs: Sequence[str] = ()
    units: Sequence[str] = ()
    rig: str | None = None
    linear: bool = False
    periods_deg: Sequence[float] = ()
    seat_std_deg: float | None = None
    frame: Frame = "sensor"
    limits_deg: tuple[float, float] | None = None

    def basis(self, runs: Sequence[str], units: Sequence[str]) -> Basis:
        """What the solution of these runs rests on."""
        periods_deg = tuple(self.periods_deg)
        return Basis(tuple(runs), tuple(units), self.linear, periods_deg, self.seat_std_deg, self.frame)


@dataclass(frozen=True, slots=True)
class SolutionInputs:
    """Poses to be solved, here or in another process; advice keeps to the limits."""

    rig: str | None
    basis: Basis
    lots: Sequence[MountedPoses]
    limits_deg: tuple[float, float] | None = None


def question(store: Store, wanted: SolutionRequest) -> SolutionInputs:
    """What stored runs are to be asked.

    Raises:
        Unknown: there is no such run or unit.
        Conflict: a run has not ended, is voided, or is of another rig: each stage has a map of its own.
        Invalid: there is no run to solve, or the poses are too many.
    """
    runs = _runs(store, wanted)
    if not runs:
        raise Invalid(f"{_named(wanted)} no completed calibration that counts", ["runs"])
    n = sum(store.poses.count(run.id) for run in runs)
    if n > MOST_POSES:
        raise Invalid(
            f"a solution takes at most {MOST_POSES:,} poses, and these {len(runs)} runs have {n:,}: name "
            "some of them",
            ["runs"],
        )
    basis = wanted.basis([run.id for run in runs], sorted({run.unit for run in runs}))
    limits_deg = wanted.limits_deg or limits_of(max(runs, key=lambda run: run.created_at))
    return SolutionInputs(runs[0].rig, basis, mounted(store, runs), limits_deg)


def answer(asked: SolutionInputs, progress: Callable[[float], None] = lambda _: None) -> Solved:
    """The solution as it is kept.

    `progress` is told the share that is done.

    Raises:
        DiagnosisError: the poses cannot be solved, and why.
    """
    # a tenth of a second that a service need not start with
    from calrig.calibration.progress import SOLVED, within
    from calrig.calibration.separation import pose_residuals, solution_document, solve
    from calrig.export.solution_documents import stage_map_document, unit_documents

    solving, telling = within(progress, 0.0, SOLVED), within(progress, SOLVED, 1.0)
    basis = asked.basis
    solution = solve(
        asked.lots,
        linear=basis.linear,
        periods_deg=basis.periods_deg,
        seat_std_deg=basis.seat_std_deg,
        progress=solving,
    )
    telling(0.0)
    return Solved(
        rig=asked.rig,
        basis=basis,
        document=solution_document(solution, asked.limits_deg, telling, frame=basis.frame),
        calibrations=unit_documents(solution, basis.frame, asked.rig),
        stage_map=stage_map_document(solution, asked.rig),
        poses=pose_residuals(solution),
    )


def usable_map(solution: StoredSolution) -> StageMap:
    """Return the stage map of a stored solution.

    Raises:
        Conflict: it cannot be used, why, and which mounts would help.
    """
    try:
        return StageMap.from_document(solution.found.stage_map)
    except MapError as error:
        advice = solution.found.document.get("advice") or {}
        helps = f": {advice['says']}" if advice.get("says") else ""
        raise Conflict(f"the map of solution {solution.id} {error}{helps}") from error


def _runs(store: Store, wanted: SolutionRequest) -> list[Run]:
    """Those named, in this order, then those that count of the units or the rig."""
    runs = [ended_run(store, run_id) for run_id in dict.fromkeys(wanted.runs)]
    for serial in wanted.units:
        known_unit(store, serial)
    if wanted.units or not wanted.runs:
        named = {run.id for run in runs}
        counting = store.runs.valid_ids(wanted.rig, wanted.units or None)
        runs += [ended_run(store, run_id) for run_id in counting if run_id not in named]
    for run in runs:
        if run.voided is not None:
            raise Conflict(f"run {run.id} is voided ({run.voided.reason}): leave it out, or unvoid it")
        if wanted.rig is not None and run.rig != wanted.rig:
            raise Conflict(f"run {run.id} is of rig {run.rig!r}, not of {wanted.rig!r}")
        if run.rig != runs[0].rig:
            raise Conflict(
                f"run {run.id} is of rig {run.rig!r}, run {runs[0].id} of rig {runs[0].rig!r}: each stage "
                "has a map of its own, solve them one by one"
            )
    return runs


def _named(wanted: SolutionRequest) -> str:
    units = f"unit {', '.join(wanted.units)} has" if wanted.units else "there is"
    return units if wanted.rig is None else f"on rig {wanted.rig!r} {units}"


def mounted(store: Store, runs: Sequence[Run]) -> list[MountedPoses]:
    """The poses of runs that count, a lot for each clamping."""
    names = {run.id: short_name(run.id) for run in runs}
    if len(set(names.values())) < len(names):
        names = {run_id: run_id for run_id in names}
    whole = any(mount_axis(run.plan, run.provenance)[-1] != "x" for run in runs)
    poses_of = poses_with_gyro if whole else counted_poses
    return [
        lot
        for run in runs
        for lot in MountedPoses.of_run(
            poses_of(store, run.id),
            unit=run.unit,
            run_id=run.id,
            name=names[run.id],
            axis=mount_axis(run.plan, run.provenance),
            planned_deg=(run.plan or {}).get("mounts_deg") or [0.0],
        )
    ]
