"""Poses of all completed runs in pieces, findings of their re-analysis, and studies of imported logs.

Each piece is a transaction of its own over a range of the poses' key, so that no lock is held between pieces.
"""

import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

import numpy as np
import numpy.typing as npt
import sqlalchemy
from sqlmodel import Session, col, select

from calrig.calibration.packed_poses import PackedPoses
from calrig.calibration.poses import COLUMNS, GYRO_MEANS
from calrig.estimation.angles import FloatArray
from calrig.model.base import Model
from calrig.store import checksums
from calrig.store.convert import POSE_NUMBERS
from calrig.store.database import Repository
from calrig.store.errors import Unreadable
from calrig.store.records import Document
from calrig.store.tables import FleetFindingTable, LogStudyTable, PoseTable, RunTable

RUNS_AT_ONCE = 5_000
POSES_AT_ONCE = 100_000
ROWS_AT_ONCE = 10_000
"""Made into numbers together: as objects they take ten times the room."""

_RUN, _POSE = sqlalchemy.inspect(RunTable).local_table.c, sqlalchemy.inspect(PoseTable).local_table.c
_LISTED = (
    _RUN.id,
    _RUN.uid,
    _RUN.unit,
    _RUN.rig,
    _RUN.diagnosis["verdict"].as_string(),
    _RUN.progress["poses_done"].as_integer(),
)
_COUNTS = (_RUN.status == "completed", _RUN.kind != "static", _RUN.voided_reason.is_(None))
_IS_EXCLUDED = sqlalchemy.case((_POSE.excluded_reason.is_(None), 0), else_=1)
_ROW = (_POSE.run_id, _POSE.pose_index, *(_POSE[name] for name in POSE_NUMBERS), _POSE.crc32, _IS_EXCLUDED)
_N_CHECKED = 2 + len(POSE_NUMBERS)
"""Numbers that a pose's checksum is over, the first of `_ROW`."""
_COVARIATES = sqlalchemy.cast(_POSE.covariates, sqlalchemy.String)
_NO_COVARIATES = ("{}", checksums.to_json(checksums.sealed({})))
_n_keys = sqlalchemy.func.length(_COVARIATES) - sqlalchemy.func.length(
    sqlalchemy.func.replace(_COVARIATES, ",", "")
)
_ONLY_GYRO_MEANS = sqlalchemy.and_(
    _COVARIATES.like("{" + "".join(f'"{name}":%,' for name in GYRO_MEANS) + f'"{checksums.KEY}":%}}'),
    _n_keys == len(GYRO_MEANS),
)
"""As nearly all poses have them: told by their text, since reading them takes eight times the rest."""


@dataclass(frozen=True, slots=True)
class ListedRun:
    """A completed run that counts, with the verdict of its last diagnosis (None: it has none).

    `number` is the store's own key, in the order of which runs are read.
    """

    number: int
    id: str
    unit: str
    rig: str | None
    verdict: str | None
    n_poses: int


class Fleet(Repository):
    """What there is of all runs together."""

    def completed_runs(self) -> Iterator[list[ListedRun]]:
        """Every completed run with poses that is not voided, in the order made, some at a time."""
        last = 0
        while True:
            wanted = sqlalchemy.select(*_LISTED).where(*_COUNTS, _RUN.id > last).order_by(_RUN.id)
            with self._database.reading() as session:
                rows = session.connection().execute(wanted.limit(RUNS_AT_ONCE)).all()
            if not rows:
                return
            last = rows[-1][0]
            yield [ListedRun(*row[:-1], n_poses=row[-1] or 0) for row in rows]

    def pieces(self, runs: Sequence[ListedRun]) -> Iterator[Sequence[ListedRun]]:
        """Runs in pieces whose poses `packed_poses` reads together; a run with very many is one by itself."""
        begin, n_poses = 0, 0
        for k, run in enumerate(runs):
            if k > begin and n_poses + run.n_poses > POSES_AT_ONCE:
                yield runs[begin:k]
                begin, n_poses = k, 0
            n_poses += run.n_poses
        if begin < len(runs):
            yield runs[begin:]

    def packed_poses(self, runs: Sequence[ListedRun], *, with_gyro: bool = False) -> Iterator[PackedPoses]:
        """The poses that count of some runs, in the order of `completed_runs`, some runs at a time.

        `with_gyro` tells whether the gyro's means over the dwells are wanted, too, which no screen looks
        into.

        Raises:
            StoreDamagedError: poses are missing, or are not what was stored.
        """
        for some in self.pieces(runs):
            with self._database.reading() as session:
                yield _packed(session, some, with_gyro=with_gyro)


def _packed(session: Session, runs: Sequence[ListedRun], *, with_gyro: bool) -> PackedPoses:
    numbers = np.array([run.number for run in runs])
    between = _POSE.run_id.between(int(numbers[0]), int(numbers[-1]))
    rows = _numbers(session, between)
    of_run = np.searchsorted(numbers, rows[:, 0])
    rows = rows[numbers[np.minimum(of_run, len(numbers) - 1)] == rows[:, 0]]
    _check(rows, runs, np.searchsorted(numbers, rows[:, 0]))
    rows = rows[rows[:, -1] == 0.0]
    first = np.searchsorted(rows[:, 0], [*numbers, np.inf]).astype(np.intp)
    columns = {name: np.ascontiguousarray(rows[:, 2 + k]) for k, name in enumerate(COLUMNS)}
    told = between if with_gyro else sqlalchemy.and_(between, sqlalchemy.not_(_ONLY_GYRO_MEANS))
    covariates = _covariates(session, told, rows, () if with_gyro else GYRO_MEANS)
    ids, units, rigs = zip(*((run.id, run.unit, run.rig) for run in runs), strict=True)
    return PackedPoses(ids, first, {**columns, **covariates}, units, rigs)


def _numbers(session: Session, between: sqlalchemy.ColumnElement[bool]) -> FloatArray:
    """(N, len(_ROW)) of poses by run and index, NaN where there is no number."""
    wanted = sqlalchemy.select(*_ROW).where(between).order_by(_POSE.run_id, _POSE.pose_index)
    found = session.connection().execute(wanted, execution_options={"yield_per": ROWS_AT_ONCE})
    try:
        parts = [np.array([tuple(row) for row in part], dtype=np.float64) for part in found.partitions()]
    except (TypeError, ValueError) as error:  # SQLite keeps anything in any column
        raise Unreadable(f"a pose is not what was stored: {error}") from error
    return np.concatenate([np.empty((0, len(_ROW))), *parts])


def _check(rows: FloatArray, runs: Sequence[ListedRun], of_run: npt.NDArray[np.intp]) -> None:
    """Raises Unreadable where poses are missing, or are not those stored; older ones have no checksum."""
    missing = np.array([run.n_poses for run in runs]) - np.bincount(of_run, minlength=len(runs))
    for k in np.flatnonzero(missing > 0)[:1]:
        raise Unreadable(f"{missing[k]} poses of run {runs[k].id} are missing")
    stored = rows[:, _N_CHECKED]
    differs = ~np.isnan(stored) & (checksums.of_rows(rows[:, :_N_CHECKED]) != stored)
    for k in np.flatnonzero(differs)[:1]:
        raise Unreadable(f"pose {rows[k, 1]:.0f} of run {runs[of_run[k]].id} is not what was stored")


def _covariates(
    session: Session, between: sqlalchemy.ColumnElement[bool], rows: FloatArray, but: Sequence[str]
) -> dict[str, FloatArray]:
    """(N,) each further column of the poses in these rows, but for some."""
    wanted = (
        sqlalchemy.select(_POSE.run_id, _POSE.pose_index, _POSE.covariates)
        .where(between, _COVARIATES.not_in(_NO_COVARIATES))
        .order_by(_POSE.run_id, _POSE.pose_index)
    )
    found = session.connection().execute(wanted).all()
    places = {key: k for k, key in enumerate(map(tuple, rows[:, :2].tolist()))} if found else {}
    columns: dict[str, FloatArray] = {}
    for run, index, values in found:
        place = places.get((run, index))
        for name, value in values.items() if place is not None else ():
            if name in but:
                continue
            column = columns.setdefault(name, np.full(len(rows), np.nan))
            column[place] = np.nan if value is None else value
    return columns


_FINDING = sqlalchemy.inspect(FleetFindingTable).local_table.c
_LISTED_FINDINGS = (
    _FINDING.run_uid,
    _FINDING.poses_sha256,
    _FINDING.catalogue,
    _FINDING.diagnosis["verdict"].as_string(),
)


@dataclass(frozen=True, slots=True)
class Finding:
    """The verdict on some poses of a run by some catalogue; None where they cannot be diagnosed."""

    poses_sha256: str
    catalogue: str
    verdict: str | None


class Findings(Repository):
    """One finding a run, the last one."""

    def all(self) -> dict[str, Finding]:
        """All of them, by the run's id."""
        with self._database.reading() as session:
            rows = session.connection().execute(sqlalchemy.select(*_LISTED_FINDINGS))
            return {run_id: Finding(*row) for run_id, *row in rows}

    def document(self, run_id: str) -> Document | None:
        """The whole diagnosis; None where there is none."""
        with self._database.reading() as session:
            row = session.get(FleetFindingTable, run_id)
            return None if row is None else row.diagnosis

    def save(
        self,
        run_id: str,
        poses_sha256: str,
        catalogue: str,
        diagnosis: Document | None,
        error: str | None = None,
    ) -> None:
        """Keeps what was found in the place of what was kept before.

        `diagnosis` is None where the poses cannot be diagnosed; `error` says why then.
        """
        row = FleetFindingTable(
            run_uid=run_id,
            poses_sha256=poses_sha256,
            catalogue=catalogue,
            diagnosis=diagnosis,
            error=error,
            at=datetime.now(UTC),
        )
        with self._database.writing() as session:
            session.merge(row)


StudyKind = Literal["noise", "filters"]
MOST_LISTED = 200
_STUDY = sqlalchemy.inspect(LogStudyTable).local_table.c


class LogStudy(Model):
    """A study that was made: of which file, when, and by whom where that is known by name."""

    id: str
    created_at: datetime
    studied_by: str | None
    kind: StudyKind
    file_name: str


class Studies(Repository):
    """The studies there are."""

    def save(
        self, kind: StudyKind, file_name: str, document: Document, *, who: str | None = None
    ) -> LogStudy:
        """Keeps what was found in a log."""
        with self._database.writing() as session:
            row = LogStudyTable(
                id=str(uuid.uuid4()),
                created_at=datetime.now(UTC),
                studied_by=who,
                kind=kind,
                file_name=file_name,
                document=document,
            )
            session.add(row)
            return LogStudy.model_validate(row)

    def newest(self) -> list[LogStudy]:
        """The latest of them, the newest first, without what they found."""
        wanted = sqlalchemy.select(*(_STUDY[name] for name in LogStudy.model_fields))
        wanted = wanted.order_by(_STUDY.created_at.desc(), _STUDY.id.desc())
        with self._database.reading() as session:
            return [
                LogStudy.model_validate(row)
                for row in session.connection().execute(wanted.limit(MOST_LISTED))
            ]

    def get(self, study_id: str) -> tuple[LogStudy, Document] | None:
        """One with what it found; None where there is none of that id."""
        with self._database.reading() as session:
            row = session.exec(select(LogStudyTable).where(col(LogStudyTable.id) == study_id)).first()
            return None if row is None else (LogStudy.model_validate(row), row.document)

    def remove(self, study_id: str) -> bool:
        """Whether there was one."""
        with self._database.writing() as session:
            row = session.get(LogStudyTable, study_id)
            if row is not None:
                session.delete(row)
            return row is not None
