"""Benches of a centre: the orders, deliveries and commands between the centre and them.

Only the newest epoch of an order counts. A bench takes an order by one statement, outside the centre's turn
to write. So the centre also uses one statement where it depends on that: the server lets only one be first.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cache
from typing import Any, Literal, NamedTuple, Unpack

from sqlalchemy import and_, delete, not_, text, update
from sqlmodel import Session, col, func, select

from calrig.model.clock_skew import is_refused, said_skew_s, skew_in_words
from calrig.model.run import UNFINISHED, UNTIL_GO
from calrig.run_ids import new_run_id
from calrig.store import event_log, trail
from calrig.store.bench_tables import PROTOCOL, BenchCommandTable, BenchTable, ParcelTable, RunOrderTable
from calrig.store.convert import run_of, run_row
from calrig.store.database import Repository, revisions
from calrig.store.errors import NotFound, Refused
from calrig.store.records import Document, Run, RunColumns
from calrig.store.runs import change, new_row
from calrig.store.tables import EventTable, RunTable
from calrig.store.trail import Act

NOT_BEGUN = "taken back before its bench had begun it"
NOT_TAKEN = and_(col(RunOrderTable.taken_epoch) < col(RunOrderTable.epoch), col(RunOrderTable.wish) != "none")
"""Of an order that its bench may still take."""
IS_HELD = and_(NOT_TAKEN, col(RunOrderTable.held_epoch) >= col(RunOrderTable.epoch))
"""Of an order that its bench takes once somebody has ordered it anew."""
HELD = f"the bench was started anew, or lost its centre, while this run waited: {UNTIL_GO}"


@dataclass(frozen=True, slots=True)
class Bench:
    """A bench that has not been revoked; `seen_ago_s` by the database's clock, None before it was seen.

    `refused` says why it takes no orders, None where it does.
    """

    name: str
    hall: str | None
    last_seen_at: datetime | None
    seen_ago_s: float | None
    said: Document
    refused: str | None


@dataclass(frozen=True, slots=True)
class Order:
    """What a bench is to do with a run; it has begun the run once `taken_epoch` is above 0."""

    run_uid: str
    bench: str
    rig: str
    epoch: int
    wish: str
    taken_epoch: int
    is_revoked: bool
    """Whether the bench is, which then says nothing more of the run."""


RECENT = timedelta(hours=1)
"""Commands are for now: one that found nobody days ago is no trouble of today."""
KEPT = timedelta(days=1)
"""A command that is older is of no use to anybody."""
IN_TIME = timedelta(seconds=5)
"""Within which a bench answers."""


class Waiting(NamedTuple):
    """How many, and the age of the oldest by the database's clock."""

    number: int
    age_s: float


@dataclass(frozen=True, slots=True)
class Backlog:
    """What waits.

    Attributes:
        orders: not taken, by bench and rig.
        parcels: not unpacked, by bench.
        unanswered: commands within the last hour that their bench did not answer in time, by bench.
    """

    orders: dict[tuple[str, str], Waiting] = field(default_factory=dict)
    parcels: dict[str, Waiting] = field(default_factory=dict)
    unanswered: dict[str, int] = field(default_factory=dict)


class Benches(Repository):
    """Benches that have joined a centre and were not revoked."""

    def all(self) -> list[Bench]:
        """Those that are not revoked, by name."""
        wanted = select(BenchTable).where(col(BenchTable.revoked_at).is_(None)).order_by(BenchTable.name)
        with self._database.reading() as session:
            now = now_there(session)
            return [_bench(row, now) for row in session.exec(wanted)]

    def backlog(self) -> Backlog:
        """In one state of the store. Whatever waits to be taken is of a queued run: those are few."""
        orders = (
            select(RunOrderTable.bench, RunOrderTable.rig, func.count(), func.min(RunOrderTable.ordered_at))
            .join(RunTable, col(RunTable.uid) == col(RunOrderTable.run_uid))
            .where(RunTable.status == "queued", NOT_TAKEN)
            .group_by(col(RunOrderTable.bench), col(RunOrderTable.rig))
        )
        parcels = select(ParcelTable.bench, func.count(), func.min(ParcelTable.delivered_at)).group_by(
            col(ParcelTable.bench)
        )
        commands = select(BenchCommandTable.bench, func.count()).group_by(col(BenchCommandTable.bench))
        with self._database.reading() as session:
            now = now_there(session)
            unanswered = commands.where(
                col(BenchCommandTable.answered_at).is_(None),
                col(BenchCommandTable.asked_at) > now - RECENT,
                col(BenchCommandTable.asked_at) < now - IN_TIME,
            )
            return Backlog(
                {(bench, rig): _waiting(n, at, now) for bench, rig, n, at in session.exec(orders)},
                {bench: _waiting(n, at, now) for bench, n, at in session.exec(parcels)},
                dict(session.exec(unanswered).all()),
            )


@cache
def versions_here() -> dict[str, int | str]:
    """What this program tells a centre of itself: it accepts benches that tell the same.

    As of its start, though another version may be installed since.
    """
    return {"protocol": PROTOCOL, "schema_revision": revisions()[-1]}


def now_there(session: Session) -> datetime:
    """The time by the clock that benches are seen by: the server's, this machine's for a file."""
    if session.get_bind().dialect.name != "postgresql":
        return datetime.now(UTC)
    now: datetime = session.connection().execute(text("SELECT clock_timestamp()")).scalar_one()
    return now


def take_back(session: Session, *which: Any) -> None:
    """Takes those orders back that are not taken yet."""
    withdrawn = (
        update(RunOrderTable)
        .where(NOT_TAKEN, *which)
        .values(epoch=RunOrderTable.epoch + 1, wish="none")
        .execution_options(synchronize_session=False)
    )
    session.execute(withdrawn)


def _withdrawn() -> Any:
    """Queued runs whose order was taken back, each with the epoch that its bench had taken before."""
    return (
        select(RunTable, RunOrderTable.taken_epoch)
        .join(RunOrderTable, col(RunOrderTable.run_uid) == col(RunTable.uid))
        .where(RunTable.status == "queued", RunOrderTable.wish == "none")
    )


def _kept_waiting(session: Session) -> list[tuple[RunTable, str | None]]:
    """Queued runs whose order is not taken, and why: a person's word, or the bench; None for its turn."""
    wanted = (
        select(RunTable, RunOrderTable, BenchTable)
        .join(RunOrderTable, col(RunOrderTable.run_uid) == col(RunTable.uid))
        .join(BenchTable, col(BenchTable.name) == col(RunOrderTable.bench))
        .where(RunTable.status == "queued", NOT_TAKEN)
    )
    found = []
    for run, order, bench in session.exec(wanted):
        why, skew_s = refusal(bench), said_skew_s(bench.said.get("clock_skew_s"))
        said = None if why is None else f"bench {bench.name} takes no orders: {why}"
        if said is None and is_refused(skew_s):
            said = f"bench {bench.name}: {skew_in_words(skew_s)}"
        found.append((run, HELD if order.held_epoch >= order.epoch else said))
    return found


def refusal(bench: BenchTable) -> str | None:
    """Why a bench takes no orders, as the database judges it or the bench says; None where it does."""
    trouble = bench.said.get("trouble")
    return bench.refused or (trouble if isinstance(trouble, str) else None)


def _settle(session: Session, error: str | None) -> None:
    for row, taken_epoch in session.exec(_withdrawn()).all():
        if taken_epoch == 0:
            change(session, row, (), {"status": "aborted", "error": error})
        else:
            row.status, row.error = "interrupted", _last_error(session, row)


def _last_error(session: Session, row: RunTable) -> str | None:
    """The reason that came with the run's last state."""
    wanted = select(EventTable.data).where(EventTable.run_id == row.id, EventTable.type == "state")
    last = session.exec(wanted.order_by(col(EventTable.seq).desc()).limit(1)).first()
    return None if last is None else last.get("error")


def _require_free(session: Session, bench: str, rig: str) -> None:
    of_rig = _unfinished().where(RunOrderTable.bench == bench, RunOrderTable.rig == rig)
    busy = session.exec(of_rig.limit(1)).first()
    if busy is not None:
        raise Refused(f'rig {rig!r} is busy with run {busy[2]}: ask with "queue": true to wait for its turn')


def _unfinished() -> Any:
    """Bench, rig and id of unfinished runs, those that go on first, then as they were made."""
    return (
        select(RunOrderTable.bench, RunOrderTable.rig, RunTable.uid)
        .join(RunTable, col(RunTable.uid) == col(RunOrderTable.run_uid))
        .where(col(RunTable.status).in_(UNFINISHED))
        .order_by(col(RunTable.status) == "queued", col(RunTable.created_at), col(RunTable.id))
    )


def _bench(row: BenchTable, now: datetime) -> Bench:
    seen = row.last_seen_at
    ago_s = None if seen is None else (now - seen).total_seconds()
    return Bench(row.name, row.hall, seen, ago_s, row.said, refusal(row))


class Orders(Repository):
    """What each bench is to do with runs. Only the newest epoch of an order counts."""

    def create(
        self,
        *,
        bench: str,
        rig: str,
        poses_total: int,
        who: str | None = None,
        more: Mapping[str, Any] | None = None,
        waits: bool = False,
        **columns: Unpack[RunColumns],
    ) -> Run:
        """Makes a queued run and orders its bench to begin it, all at once or not at all.

        `more` is what the bench needs to know beside the run itself; with `waits` the run waits its turn
        where the rig is busy. The other arguments are those of `Runs.create`.

        Raises:
            Refused: the rig is busy, and with which run.
        """
        now = datetime.now(UTC)
        with self._database.writing() as session:
            if not waits:
                _require_free(session, bench, rig)
            row = new_row(
                session, now, columns, uid=new_run_id(), rig=rig, status="queued", poses_total=poses_total
            )
            event_log.append(session, row, [event_log.state(row)])
            trail.append(session, trail.act_on("started", row, who), now)
            document = {
                **{name: columns.get(name) for name in ("unit", "plan", "operator", "note", "follows")},
                "poses_total": poses_total,
                "provenance": columns["provenance"],
                **(more or {}),
            }
            order = RunOrderTable(
                run_uid=row.uid,
                bench=bench,
                rig=rig,
                epoch=1,
                wish="begin",
                document=document,
                ordered_at=now,
            )
            session.add(order)
            return run_of(row)

    def resume(self, run_id: str, stage_at_deg: float | None = None) -> Run:
        """Orders the bench of an interrupted run to take it up again.

        `stage_at_deg` is a person's word for where a stage without homing stands now; what was said when
        the run was ordered first does not count any more.

        Raises:
            NotFound: there is no such run.
            Refused: it is not interrupted, no bench has it, or its rig is busy.
        """
        with self._database.writing() as session:
            row = run_row(session, run_id)
            order = session.get(RunOrderTable, run_id)
            if row.status != "interrupted":
                raise Refused(f"run {run_id} is {row.status} and cannot be resumed")
            if order is None:
                raise Refused(f"run {run_id} is of no bench of this centre and cannot be resumed")
            _require_free(session, order.bench, order.rig)
            session.execute(
                update(RunOrderTable)
                .where(col(RunOrderTable.run_uid) == run_id)
                .values(
                    epoch=RunOrderTable.epoch + 1,
                    wish="resume",
                    document={**order.document, "stage_at_deg": stage_at_deg},
                    ordered_at=datetime.now(UTC),
                )
            )
            row.status, row.error = "queued", None  # the bench announces it: the numbers are its own
            return run_of(row)

    def of(self, run_id: str) -> Order | None:
        """The order of a run; None of one that no bench has."""
        wanted = select(RunOrderTable, BenchTable.revoked_at).join(
            BenchTable, col(BenchTable.name) == col(RunOrderTable.bench)
        )
        with self._database.reading() as session:
            found = session.exec(wanted.where(RunOrderTable.run_uid == run_id)).first()
            if found is None:
                return None
            row, revoked_at = found
            return Order(
                row.run_uid, row.bench, row.rig, row.epoch, row.wish, row.taken_epoch, revoked_at is not None
            )

    def withdraw(self, run_id: str) -> None:
        """Takes an order back that its bench has not taken, and waits for no other writer."""
        with self._database.writing(in_turn=False) as session:
            take_back(session, col(RunOrderTable.run_uid) == run_id)

    def settle_withdrawn(self, error: str | None = NOT_BEGUN) -> None:
        """Says of the runs whose order was taken back what became of them, where nobody has yet.

        A run that was never begun is `aborted`, one that was to be resumed `interrupted` as before.
        """
        with self._database.reading() as session:
            if session.exec(_withdrawn().limit(1)).first() is None:
                return  # nobody waits for a turn to write nothing
        with self._database.writing() as session:
            _settle(session, error)

    def go(self, run_id: str) -> bool:
        """Orders a run anew that its bench holds back; returns whether it was held."""
        anew = (
            update(RunOrderTable)
            .where(IS_HELD, col(RunOrderTable.run_uid) == run_id)
            .values(epoch=RunOrderTable.epoch + 1, ordered_at=datetime.now(UTC))
            .returning(col(RunOrderTable.run_uid))
            .execution_options(synchronize_session=False)
        )
        with self._database.writing() as session:
            if session.execute(anew).first() is None:
                return False
            run_row(session, run_id).error = None
            return True

    def settle_waiting(self) -> None:
        """Says of the runs that wait for a bench what keeps it from taking them, where nobody has yet."""
        with self._database.reading() as session:
            if not any(row.error != why for row, why in _kept_waiting(session)):
                return
        with self._database.writing() as session:
            for row, why in _kept_waiting(session):
                row.error = why

    def end_orphan(self, run_id: str) -> Run:
        """Aborts a run whose bench was revoked: it says nothing more of it."""
        with self._database.writing() as session:
            row = run_row(session, run_id)
            if row.status in (*UNFINISHED, "interrupted"):
                change(session, row, (), {"status": "aborted", "error": "its bench was revoked"})
            return run_of(row)

    def busy_rigs(self) -> dict[tuple[str, str], str]:
        """The unfinished run of each bench's rig that has one; of several the one that goes on."""
        with self._database.reading() as session:
            found = session.exec(_unfinished())
            return {(bench, rig): uid for bench, rig, uid in reversed(found.all())}


def _waiting(number: int, oldest_at: datetime, now: datetime) -> Waiting:
    return Waiting(number, max(0.0, (now - oldest_at).total_seconds()))


Kind = Literal["stop", "abort", "pause", "resume", "look"]
UNOBEYED = and_(
    col(BenchCommandTable.kind) == "stop",
    col(BenchCommandTable.answered_at).is_(None),
    col(BenchCommandTable.withdrawn_at).is_(None),
)
"""Of a stop that its bench is still to obey, however old it is."""


class Commands(Repository):
    """Commands to benches. None of these waits for other writers: a stop may not."""

    def send(self, bench: str, kind: Kind, *, rig: str | None = None, run_uid: str | None = None) -> int:
        """Asks something of a bench, and returns the command's number; a stop also takes back what waits.

        A look is asked for every few seconds, and nobody waits for its answer: of each rig the last one is
        kept.
        """
        with self._database.writing(in_turn=False) as session:
            if kind == "stop":
                of_rig = col(RunOrderTable.bench) == bench, col(RunOrderTable.rig) == rig
                take_back(session, *of_rig)
            if kind == "look":
                before = (
                    col(BenchCommandTable.bench) == bench,
                    col(BenchCommandTable.rig) == rig,
                    col(BenchCommandTable.kind) == kind,
                )
                session.execute(delete(BenchCommandTable).where(*before))
            row = BenchCommandTable(
                bench=bench, kind=kind, rig=rig, run_uid=run_uid, asked_at=now_there(session)
            )
            session.add(row)
            session.flush()
            return row.id

    def answer(self, command: int) -> Document | None:
        """What a bench answered: `status` as of HTTP, and `detail`; None before it has."""
        with self._database.reading() as session:
            row = session.get(BenchCommandTable, command)
            return None if row is None or row.answered_at is None else row.answer or {}

    def unobeyed(self) -> dict[tuple[str, str], datetime]:
        """Since when a stop has been asked for that the bench has not answered, by bench and rig."""
        wanted = select(BenchCommandTable).where(UNOBEYED).order_by(col(BenchCommandTable.asked_at).desc())
        with self._database.reading() as session:
            return {(row.bench, row.rig or ""): row.asked_at for row in session.exec(wanted)}

    def withdraw_stop(self, rig: str, *, who: str | None = None) -> None:
        """Takes back what is to stop a rig of that name and was not answered, on every bench that has one.

        Raises:
            NotFound: there is no such stop.
        """
        withdrawn = update(BenchCommandTable).where(UNOBEYED, col(BenchCommandTable.rig) == rig)
        benches = withdrawn.returning(col(BenchCommandTable.bench)).execution_options(
            synchronize_session=False
        )
        with self._database.writing() as session:
            now = now_there(session)
            found = session.execute(benches.values(withdrawn_at=now)).scalars().all()
            if not found:
                raise NotFound(f"no stop waits for a bench with rig {rig!r}")
            trail.append(
                session, Act("stop_withdrawn", who=who, rig=rig, detail={"benches": sorted({*found})}), now
            )

    def withdraw(self, command: int) -> bool:
        """Takes a command back that its bench has not taken; returns whether it did."""
        withdrawn = (
            update(BenchCommandTable)
            .where(
                col(BenchCommandTable.id) == command,
                col(BenchCommandTable.taken_at).is_(None),
                col(BenchCommandTable.withdrawn_at).is_(None),
            )
            .returning(col(BenchCommandTable.id))
            .execution_options(synchronize_session=False)
        )
        with self._database.writing(in_turn=False) as session:
            now = now_there(session)
            return session.execute(withdrawn.values(withdrawn_at=now)).first() is not None

    def prune(self) -> None:
        """Deletes those that are over for a day: the trail and the runs tell what came of them."""
        with self._database.writing(in_turn=False) as session:
            old = col(BenchCommandTable.asked_at) < now_there(session) - KEPT
            session.execute(delete(BenchCommandTable).where(old, not_(UNOBEYED)))
