"""Runs: create, find, change. An import stages its poses in a temporary table first.

A run on a rig stores each pose as it is measured, and must not wait while an import writes row by row.
"""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, Literal, Unpack, get_args

import sqlalchemy
from sqlalchemy import JSON, Column, ColumnElement, Connection, MetaData, Table
from sqlalchemy.orm import Mapped
from sqlmodel import Session, and_, col, func, insert, literal, or_, select, tuple_

from calrig.calibration.poses import Pose
from calrig.model.plan import CALIBRATING
from calrig.model.result import Gyro, Result
from calrig.model.run import TERMINAL, UNFINISHED, Progress, Status
from calrig.run_ids import is_uuid, new_run_id
from calrig.store import checksums, event_log, issued, trail
from calrig.store.convert import POSE_NUMBERS, figures_of, find_run, pose_values, run_of, run_row
from calrig.store.database import Database, Repository
from calrig.store.errors import Refused
from calrig.store.event_log import Announced
from calrig.store.records import Document, Run, RunChanges, RunColumns
from calrig.store.tables import CalibrationTable, PoseTable, RunTable, UnitTable
from calrig.store.trail import What

AT_ONCE = 1000
"""Handed to SQLite together."""
NO_RUN = 0
_POSES = PoseTable.__table__  # type: ignore[attr-defined]
_STAGED = Table(
    "staged_pose", MetaData(), *(Column(c.name, c.type) for c in _POSES.columns), prefixes=["TEMPORARY"]
)


@contextmanager
def staged_poses(database: Database, poses: Sequence[Pose]) -> Iterator[Connection]:
    """The poses, as those of no run yet, on a connection for `Database.writing`; locks nothing."""
    with database.staging() as connection:
        with connection.begin():
            _STAGED.create(connection)
            for first in range(0, len(poses), AT_ONCE):
                some = enumerate(poses[first : first + AT_ONCE], start=first)
                connection.execute(
                    insert(_STAGED), [pose_values(NO_RUN, index, pose) for index, pose in some]
                )
        yield connection


def take_over(session: Session, run_id: int) -> None:
    """Makes what was staged the poses of a run, inside the transaction that makes the run.

    Their checksums have the run's number in them. A CRC is affine over GF(2), so that another number changes
    all of one length by the same bits; and x ^ k is (x | k) - (x & k), since SQLite has no exclusive or.
    """
    rest = [0.0] * (1 + len(POSE_NUMBERS))
    change = checksums.of_numbers([NO_RUN, *rest]) ^ checksums.of_numbers([run_id, *rest])
    crc32 = _STAGED.c.crc32
    anew = {
        "run_id": literal(run_id),
        "crc32": crc32.bitwise_or(change) - crc32.bitwise_and(change),
    }
    names = list(_STAGED.c.keys())
    rows = select(*(anew.get(name, _STAGED.c[name]) for name in names))
    session.execute(insert(PoseTable).from_select(names, rows))


RunKind = Literal["calibration", "sweep", "verification", "static", "follow-up", "import"]
"""What a run is to a person; a follow-up and an import count as that alone."""
_TOLD = ("sweep", "verification", "static")
"""By the kind of their plan."""

_IMPORTED = select(RunTable.id).where(col(RunTable.plan).is_(None))
_FOLLOW_UPS = select(RunTable.id).where(col(RunTable.follows).is_not(None))


@dataclass(frozen=True, slots=True)
class Sought:
    """What a list of runs is narrowed to; None where it does not matter.

    Attributes:
        begins: first characters of the UUID.
        text: stands in the serial number or in the note, in capitals or not; % and _ are text.
        since, before: when the run was made: from the first, up to and without the second.
        follows: the run (its id) that it is a follow-up of.
    """

    unit: str | None = None
    rig: str | None = None
    status: str | None = None
    begins: str | None = None
    text: str | None = None
    since: datetime | None = None
    before: datetime | None = None
    kind: RunKind | None = None
    follows: str | None = None

    def conditions(self) -> list[ColumnElement[bool]]:
        """What holds of the rows."""
        told = self.kind if self.kind in _TOLD else None  # the plan's kind tells nothing of the others
        found = [
            col(column) == value
            for column, value in ((RunTable.unit, self.unit), (RunTable.kind, told))
            if value is not None
        ]
        for column, value in ((RunTable.rig, self.rig), (RunTable.status, self.status)):
            if value is not None:
                # by an index of its own only without a text, which would be looked for row by fat row
                found.append((col(column) if self.text is None else func.coalesce(column, "")) == value)
        if self.begins is not None:
            found.append(beginning(self.begins))
        if self.text is not None:
            texts = (func.lower(RunTable.unit), func.lower(RunTable.note))
            # lowered here: not every PostgreSQL knows the capitals beyond ASCII
            found.append(or_(*(text.contains(self.text.lower(), autoescape=True) for text in texts)))
        if self.since is not None:
            found.append(col(RunTable.created_at) >= self.since)
        if self.before is not None:
            found.append(col(RunTable.created_at) < self.before)
        if self.follows is not None:
            origin = select(RunTable.id).where(RunTable.uid == self.follows)
            found.append(col(RunTable.follows).in_(origin))
        return [*found, *self._of_kind()]

    def _of_kind(self) -> list[ColumnElement[bool]]:
        if self.kind is None:
            return []
        number = col(RunTable.id)
        if self.kind == "import":
            return [number.in_(_IMPORTED)]
        if self.kind == "follow-up":
            return [number.in_(_FOLLOW_UPS)]
        others: list[ColumnElement[bool]] = [number.not_in(_IMPORTED), number.not_in(_FOLLOW_UPS)]
        return [*others, col(RunTable.kind).not_in(_TOLD)] if self.kind == "calibration" else others


def beginning(prefix: str) -> ColumnElement[bool]:
    """Of the UUIDs among the ids."""
    uid = col(RunTable.uid)
    return and_(uid.startswith(prefix, autoescape=True), uid.contains("-"))


VALID_CALIBRATION = (
    col(RunTable.status) == "completed",
    col(RunTable.kind).in_(CALIBRATING),
    col(RunTable.voided_reason).is_(None),
)
"""Of a run that makes a calibration; a follow-up does not, whose `follows` is set."""
IDS_AT_ONCE = 500
"""Ids in one query."""
POSES_AT_ONCE = 1000
"""Read together: an import has a hundred thousand."""
_MADE = col(RunTable.created_at), col(RunTable.id)
NEWEST_FIRST = tuple(column.desc() for column in _MADE)


class Runs(Repository):
    """The runs there are."""

    def create(
        self,
        *,
        rig: str | None,
        status: Status,
        poses_total: int = 0,
        poses: Sequence[Pose] = (),
        result: Document | None = None,
        draft: issued.Draft | None = None,
        who: str | None = None,
        run_id: str | None = None,
        **columns: Unpack[RunColumns],
    ) -> Run:
        """Makes a run and, where it is the first of its unit, the unit; announces the run's state.

        An import gives `poses`, `result`, the status `completed` and the unit's next revision at once: all is
        stored or nothing. Nobody waits meanwhile for longer than the copying of what was made ready takes.
        The bench that a run began on gives its `run_id`, a UUID; elsewhere a new one is minted here.

        Raises:
            Refused: there is a run of that id.
            ValueError: it is no UUID.
        """
        if run_id is not None and not is_uuid(run_id):
            raise ValueError(f"{run_id!r} is not a UUID, which the id of a new run is")
        now = datetime.now(UTC)
        with ExitStack() as stack:
            staged = stack.enter_context(staged_poses(self._database, poses)) if poses else None
            session = stack.enter_context(self._database.writing(on=staged))
            if run_id is not None and find_run(session, run_id) is not None:
                raise Refused(f"there is a run {run_id} already")
            row = new_row(
                session,
                now,
                columns,
                uid=run_id or new_run_id(),
                rig=rig,
                status=status,
                poses_total=max(poses_total, len(poses)),
                poses_done=len(poses),
            )
            if staged is not None:
                take_over(session, row.id)
            replace_result(session, row, result)
            event_log.append(session, row, [event_log.state(row)])
            what: What = "imported" if row.plan is None else "started"
            trail.append(session, trail.act_on(what, row, who), now)
            if draft is not None:
                issued.issue(session, row, draft)
            return run_of(row)

    def get(self, run_id: str) -> Run | None:
        """The run, or None."""
        with self._database.reading() as session:
            row = find_run(session, run_id)
            return None if row is None else run_of(row)

    def page(
        self,
        *,
        unit: str | None = None,
        rig: str | None = None,
        status: str | None = None,
        limit: int = 50,
        cursor: str | None = None,
    ) -> tuple[list[Run], str | None]:
        """As `search`, by what most programs ask for."""
        return self.search(Sought(unit, rig, status), limit=limit, cursor=cursor)

    def search(
        self, sought: Sought, *, limit: int = 50, cursor: str | None = None
    ) -> tuple[list[Run], str | None]:
        """A page of runs, the newest first, and the cursor of the next page (None after the last).

        The newest is the one made last, wherever that was: it may have been delivered days later. The cursor
        is the id of the last run shown, and stays good while runs are added: none is shown twice or left out.

        Raises:
            ValueError: the cursor is not one that this method gave, or the limit is below 1.
        """
        if limit < 1:
            raise ValueError(f"limit is {limit}; a page holds at least 1 run")
        page = select(RunTable.id).where(*sought.conditions()).order_by(*NEWEST_FIRST).limit(limit + 1)
        with self._database.reading() as session:
            page = page.where(*older_than(session, cursor))
            # first which, from an index alone, then those rows: they are long, and lie apart
            which = col(RunTable.id).in_(page.scalar_subquery())
            rows = select(RunTable).where(which).order_by(*NEWEST_FIRST)
            found = [run_of(row) for row in session.exec(rows)]
        return found[:limit], found[limit - 1].id if len(found) > limit else None

    def update(
        self,
        run_id: str,
        *,
        events: Sequence[Announced] = (),
        draft: issued.Draft | None = None,
        asked: trail.Act | None = None,
        **changes: Unpack[RunChanges],
    ) -> Run:
        """Changes a run and announces `events`, then, where a status was given, the new state.

        `asked` is what somebody asked for that this does; it is entered in the trail as of this run.

        `started_at` is set by the first `running`, `finished_at` by a terminal status; a run that is resumed
        after an interruption loses `finished_at`. `error` stays unless given: clear it when a run is resumed.
        A calibration that is completed gives `draft`, its unit's next revision.
        """
        with self._database.writing() as session:
            row = run_row(session, run_id)
            change(session, row, events, changes)
            if draft is not None:
                issued.issue(session, row, draft)
            if asked is not None:
                trail.append(session, replace(asked, unit=row.unit, rig=row.rig, run_id=row.uid))
            return run_of(row)

    def unfinished(self, rig: str | None = None) -> list[Run]:
        """The runs (on this rig) that are queued, running or paused, the oldest first."""
        oldest_first = (col(RunTable.created_at), col(RunTable.id))
        wanted = select(RunTable).where(col(RunTable.status).in_(UNFINISHED)).order_by(*oldest_first)
        if rig is not None:
            wanted = wanted.where(col(RunTable.rig) == rig)
        with self._database.reading() as session:
            return [run_of(row) for row in session.exec(wanted)]

    def ids_beginning(self, prefix: str, limit: int) -> list[str]:
        """Ids that begin so, numbers not counted, in their own order and no more of them than `limit`."""
        uid = col(RunTable.uid)
        begin = select(uid).where(beginning(prefix))
        with self._database.reading() as session:
            return list(session.exec(begin.order_by(uid).limit(limit)))

    def count_by_status(self) -> dict[str, int]:
        """How many runs there are of each status, those without any as well."""
        wanted = select(RunTable.status, func.count()).group_by(col(RunTable.status))
        with self._database.reading() as session:
            return {**dict.fromkeys(get_args(Status), 0), **dict(session.exec(wanted).all())}

    def valid_ids(self, rig: str | None = None, units: Sequence[str] | None = None) -> list[str]:
        """Ids of the completed, not voided calibrations of some units on a rig, the oldest first."""
        in_order = col(RunTable.created_at), col(RunTable.id)
        query = sqlalchemy.select(col(RunTable.uid)).where(*VALID_CALIBRATION).order_by(*in_order)
        if rig is not None:
            query = query.where(col(RunTable.rig) == rig)
        if units is not None:
            query = query.where(col(RunTable.unit).in_(units))
        with self._database.reading() as session:
            return list(session.connection().execute(query).scalars())

    def latest_calibration(self, serial: str, *, follow_ups: bool = False) -> Run | None:
        """The latest completed, not voided calibration (or import) whose scale is known, or None.

        `follow_ups` counts those as well, as stores did before there were revisions.
        """
        wanted = (
            select(RunTable)
            .join(CalibrationTable)
            .where(RunTable.unit == serial, *VALID_CALIBRATION, col(CalibrationTable.scale).is_not(None))
            .order_by(col(RunTable.finished_at).desc(), col(RunTable.id).desc())
            .limit(1)
        )
        if not follow_ups:
            wanted = wanted.where(col(RunTable.follows).is_(None))
        with self._database.reading() as session:
            row = session.exec(wanted).first()
            return None if row is None else run_of(row)

    def reference_figures(self, run_ids: Sequence[str]) -> dict[str, tuple[float, float | None]]:
        """What the stage is worth in the bias (deg) and scale of runs that know it: type B, by run."""
        stated = sqlalchemy.type_coerce(col(RunTable.result)["reference"], JSON())  # the whole takes 1 ms
        worth = ((run_id, one) for run_id, one in self._of(stated, run_ids) if one is not None)
        return {run_id: (one["bias_std_deg"], one["scale_std"]) for run_id, one in worth}

    def gyros(self, run_ids: Sequence[str]) -> dict[str, Gyro]:
        """What runs with a result say of the gyro, by run."""
        results = self._of(col(RunTable.result), run_ids)
        return {uid: Gyro.model_validate(result["gyro"]) for uid, result in results if result is not None}

    def _of(
        self, what: Mapped[Any] | ColumnElement[Any], run_ids: Sequence[str]
    ) -> Iterator[tuple[str, Any]]:
        """Something of runs, by run."""
        with self._database.reading() as session:
            for begin in range(0, len(run_ids), IDS_AT_ONCE):
                some = run_ids[begin : begin + IDS_AT_ONCE]
                yield from session.exec(select(RunTable.uid, what).where(col(RunTable.uid).in_(some)))


def older_than(session: Session, cursor: str | None) -> list[ColumnElement[bool]]:
    """What holds of the runs after a cursor, the id of the last one shown; nothing without one.

    Raises:
        ValueError: no run has that id.
    """
    if cursor is None:
        return []
    last = find_run(session, cursor)
    if last is None:
        raise ValueError(f"cursor {cursor!r} is not one that this list gave")
    return [tuple_(*_MADE) < (last.created_at, last.id)]


def new_row(
    session: Session,
    now: datetime,
    columns: RunColumns,
    *,
    uid: str,
    rig: str | None,
    status: Status,
    poses_total: int,
    poses_done: int = 0,
) -> RunTable:
    """The row of a new run and, where it is the first of its unit, the unit's; nobody is told of it yet."""
    if session.get(UnitTable, columns["unit"]) is None:
        session.add(UnitTable(serial=columns["unit"], created_at=now))
        session.flush()
    follows = columns.get("follows")
    told: Document = {**columns, "follows": None if follows is None else run_row(session, follows).id}
    kind = (columns["plan"] or {}).get("kind", "calibration")
    progress = {
        "poses_done": poses_done,
        "poses_total": poses_total,
        "fraction": poses_done / poses_total if poses_total else 0.0,
        "remaining_s": 0.0 if status in TERMINAL else None,
    }
    row = RunTable(
        uid=uid, rig=rig, kind=kind, status=status, progress=progress, faults={}, created_at=now, **told
    )
    _stamp(row, now)
    session.add(row)
    session.flush()
    return row


def change(session: Session, row: RunTable, events: Sequence[Announced], changes: RunChanges) -> list[int]:
    """Makes the changes, announces `events` and then, where a status was given, the new state.

    Inside a transaction that somebody else has begun; returns the events' numbers.
    """
    unknown = changes.keys() - RunChanges.__annotations__.keys()
    if unknown:
        raise TypeError(f"a run has no {', '.join(sorted(unknown))} to change")
    for name, value in changes.items():
        if name == "progress":
            row.progress = Progress.model_validate(value).model_dump()
        elif name != "result":
            setattr(row, name, value)
    if "result" in changes:
        replace_result(session, row, changes["result"])
    state = []
    if "status" in changes:
        _stamp(row, datetime.now(UTC))
        state = [event_log.state(row)]
    return event_log.append(session, row, [*events, *state])


def replace_result(session: Session, row: RunTable, given: Result | Document | None) -> None:
    """Gives a run its result and the figures that stand for it in comparisons, likewise."""
    result = row.result = given.to_dict() if isinstance(given, Result) else given
    figures = session.get(CalibrationTable, row.id)
    if figures is not None:
        session.delete(figures)
        session.flush()
    if result is not None:
        session.add(figures_of(row.id, result))


def _stamp(row: RunTable, now: datetime) -> None:
    if row.status in {"running", "completed"} and row.started_at is None:
        row.started_at = now
    row.finished_at = now if row.status in TERMINAL else None
