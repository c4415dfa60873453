"""Unpack the deliveries of benches into the tables of runs: in order, and each once.

A parcel may arrive twice, or again after days. Events are identified by run and number, poses by run and
index, sample blocks by run and their number at the bench. A parcel that cannot be unpacked is kept, with all
later ones of its run; other runs continue.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, cast, get_args

from pydantic import ValidationError
from sqlalchemy.exc import InterfaceError, OperationalError
from sqlmodel import Session, col, func, insert, select
from sqlmodel.sql.expression import Select

from calrig.model.run import TERMINAL, Status
from calrig.run_ids import is_uuid
from calrig.store import issued, trail
from calrig.store.bench_tables import BenchTable, DeliveryTable, ParcelTable, RunOrderTable
from calrig.store.convert import find_run, pose_values, run_of, unpacked_block
from calrig.store.database import Repository
from calrig.store.errors import Unreadable
from calrig.store.parcels import DeliveredEvent, DeliveredPose, DeliveredSamples, ParcelDocument
from calrig.store.poses import poses_of
from calrig.store.records import Document, Run, RunColumns, StoredPose
from calrig.store.runs import new_row, replace_result
from calrig.store.tables import EventTable, PoseTable, RunTable, SampleBlockTable, TranscriptTable

AT_ONCE = 20
"""Parcels in one transaction: others wait for their turn to write meanwhile."""

Conclusion = tuple[Document | None, issued.Draft | None]
"""Result and draft of a run that a bench has completed."""
Conclude = Callable[[Run, Sequence[StoredPose]], Conclusion]
"""Computes it, by what is in force at the centre; is called in the transaction, and may read the store."""


class _TooSoon(Unreadable):
    """What comes before it has not been unpacked."""


@dataclass(frozen=True, slots=True)
class Kept:
    """Parcels that are not tried: of runs with one that cannot be unpacked, and those that came too soon.

    Attributes:
        stuck: why not, by run.
        early: runs of those that wait for others of their run, by the parcel's number.
    """

    stuck: Mapping[str, str] = field(default_factory=dict)
    early: Mapping[int, str] = field(default_factory=dict)


class Parcels(Repository):
    """The deliveries of benches, at the centre."""

    def are_waiting(self, but: Kept = Kept()) -> bool:
        """Whether there are any to be tried."""
        with self._database.reading() as session:
            return session.exec(_next(but).limit(1)).first() is not None

    def unpack(self, conclude: Conclude, but: Kept = Kept()) -> Kept:
        """Unpacks the oldest parcels, `AT_ONCE` at most; returns which are not to be tried from now on."""
        stuck, early = dict(but.stuck), dict(but.early)
        with self._database.writing() as session:
            for parcel_id, run_uid in session.exec(_next(but).limit(AT_ONCE)).all():
                if run_uid in stuck:
                    continue
                try:
                    with session.begin_nested():
                        _unpack(session, parcel_id, conclude)
                    early = {number: run for number, run in early.items() if run != run_uid}
                except _TooSoon:
                    early[parcel_id] = run_uid
                except (OperationalError, InterfaceError):
                    raise  # of the server: what is in the parcel has nothing to do with it
                except Exception as error:  # noqa: BLE001 (whatever it is, other runs go on)
                    stuck[run_uid] = _in_words(error)
        return Kept(stuck, early)


def _next(but: Kept) -> Select[int, str]:
    """Numbers and runs of the parcels to be tried, in the order delivered."""
    return (
        select(ParcelTable.id, ParcelTable.run_uid)
        .where(
            col(ParcelTable.run_uid).not_in(but.stuck.keys()), col(ParcelTable.id).not_in(but.early.keys())
        )
        .order_by(col(ParcelTable.id))
    )


def _in_words(error: Exception) -> str:
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        return f"{'.'.join(str(part) for part in first['loc'])}: {first['msg']}"
    return " ".join(f"{type(error).__name__}: {error}".split())[:500]


def _unpack(session: Session, parcel_id: int, conclude: Conclude) -> None:
    parcel = session.get_one(ParcelTable, parcel_id)
    delivered = ParcelDocument.model_validate(parcel.document)
    run = _run_of(session, parcel, delivered)
    _add_poses(session, run, delivered.poses)
    news = _news(session, run, delivered.events)
    if news:
        session.execute(insert(EventTable), [{"run_id": run.id, **event.model_dump()} for event in news])
        _update(session, run, delivered, news, conclude)
        if run.status in TERMINAL:
            session.get_one(RunOrderTable, run.uid).wish = "done"  # no bench is in doubt about it any more
    for port, said in (delivered.transcripts or {}).items():
        _add_transcript(session, run, port, said)
    if delivered.samples is not None:
        _add_samples(session, run, delivered.samples, parcel.data)
    session.delete(parcel)


def _run_of(session: Session, parcel: ParcelTable, delivered: ParcelDocument) -> RunTable:
    """The run that a parcel is about; a new one where it began at the bench."""
    run, order = find_run(session, parcel.run_uid), session.get(RunOrderTable, parcel.run_uid)
    if run is None:
        return _begun_at_bench(session, parcel, delivered)
    if order is None or order.bench != parcel.bench:
        raise Unreadable(f"bench {parcel.bench} delivers run {parcel.run_uid}, which is not its own")
    if order.taken_epoch == 0:
        raise Unreadable(f"bench {parcel.bench} delivers run {parcel.run_uid}, which it has not taken")
    return run


def _begun_at_bench(session: Session, parcel: ParcelTable, delivered: ParcelDocument) -> RunTable:
    if not is_uuid(parcel.run_uid):
        raise Unreadable(f"{parcel.run_uid[:80]!r} is no id of a run")
    now, told = datetime.now(UTC), delivered.run
    _require_own(session, parcel.bench, told.rig)
    run = new_row(
        session,
        told.created_at,
        cast(RunColumns, told.model_dump(include={*RunColumns.__annotations__})),
        uid=parcel.run_uid,
        rig=told.rig,
        status="queued",
        poses_total=told.progress.poses_total,
    )
    trail.append(session, trail.act_on("started", run, told.operator), now)
    session.add(
        RunOrderTable(
            run_uid=run.uid,
            bench=parcel.bench,
            rig=told.rig,
            epoch=delivered.epoch,
            wish="local",
            document={},
            taken_epoch=delivered.epoch,
            ordered_at=now,
        )
    )
    session.flush()
    return run


def _require_own(session: Session, bench: str, rig: str) -> None:
    """Raises Unreadable where another bench has a rig of that name: a run of it is for that one to tell."""
    wanted = select(BenchTable).where(col(BenchTable.name) != bench, col(BenchTable.revoked_at).is_(None))
    for other in session.exec(wanted):
        if any(one.get("name") == rig for one in other.said.get("rigs", [])):
            raise Unreadable(f"bench {bench} delivers a run of rig {rig!r}, which bench {other.name} has")


def _news(session: Session, run: RunTable, events: Sequence[DeliveredEvent]) -> list[DeliveredEvent]:
    """The events that are not stored yet."""
    last = session.exec(select(func.max(EventTable.seq)).where(EventTable.run_id == run.id)).one() or 0
    news = [event for event in events if event.seq > last]
    if [event.seq for event in news] != list(range(last + 1, last + 1 + len(news))):
        raise _TooSoon(f"event {last + 1} of run {run.uid} has not been delivered")
    return news


def _update(
    session: Session,
    run: RunTable,
    delivered: ParcelDocument,
    news: Sequence[DeliveredEvent],
    conclude: Conclude,
) -> None:
    """What new events make of a run.

    The bench may have packed a part of the events only: how the run stands is what the last state among
    them says, and what comes with its end counts once that state is the end.
    """
    told, states = delivered.run, [event.data for event in news if event.type == "state"]
    if states:
        if run.status in TERMINAL:
            raise Unreadable(f"run {run.uid} is {run.status} and cannot become {states[-1].get('status')}")
        run.status, run.error = states[-1]["status"], states[-1]["error"]
        if run.status not in get_args(Status):
            raise Unreadable(f"there is no status {run.status!r:.80}")
    n_poses = session.exec(
        select(func.count()).select_from(PoseTable).where(PoseTable.run_id == run.id)
    ).one()
    run.provenance, run.faults, run.started_at = told.provenance, told.faults, told.started_at
    run.progress = {**told.progress.model_dump(), "poses_done": min(n_poses, told.progress.poses_done)}
    if run.status != told.status:
        return
    run.finished_at = told.finished_at
    run.diagnosis = run.diagnosis or told.diagnosis
    if run.status != "completed" or not states:
        return
    if n_poses < told.progress.poses_done:
        raise Unreadable(f"of {told.progress.poses_done} poses of run {run.uid} {n_poses} are there")
    replace_result(session, run, told.result)
    session.flush()
    if run.kind != "static":
        result, draft = conclude(run_of(run), poses_of(session, run))
        replace_result(session, run, result)
        session.flush()
        if draft is not None:
            issued.issue(session, run, draft)


def _add_poses(session: Session, run: RunTable, poses: Sequence[DeliveredPose]) -> None:
    if not poses:
        return
    delivered = [one.index for one in poses]
    wanted = select(PoseTable.pose_index).where(
        PoseTable.run_id == run.id, col(PoseTable.pose_index).in_(delivered)
    )
    known = set(session.exec(wanted))
    rows: list[dict[str, Any]] = [
        {
            **pose_values(run.id, one.index, one.pose()),
            "excluded_reason": one.excluded,
            "excluded_at": None if one.excluded is None else datetime.now(UTC),
        }
        for one in poses
        if one.index not in known
    ]
    if rows:
        session.execute(insert(PoseTable), rows)


def _add_samples(session: Session, run: RunTable, samples: DeliveredSamples, packed: bytes | None) -> None:
    """Adds a block unless it is there: a run's come in order, and the last one's number is kept."""
    so_far = session.get(DeliveryTable, run.uid)
    if so_far is None:
        so_far = DeliveryTable(run_uid=run.uid, event_seq=0, sample_block_id=0, is_complete=False)
        session.add(so_far)
    if samples.number <= so_far.sample_block_id:
        return
    if packed is None or len(unpacked_block(packed)) != samples.n_samples:
        raise Unreadable(f"block {samples.number} of run {run.uid} is not what was sent")
    so_far.sample_block_id = samples.number
    block = samples.model_dump(exclude={"number"})
    session.add(SampleBlockTable(run_id=run.id, **block, data=packed))
    session.flush()


def _add_transcript(session: Session, run: RunTable, port: str, said: str) -> None:
    data = zlib.compress(said.encode())
    same = select(TranscriptTable.id).where(
        TranscriptTable.run_id == run.id, TranscriptTable.port == port, TranscriptTable.data == data
    )
    if session.exec(same).first() is None:
        session.add(TranscriptTable(run_id=run.id, port=port, data=data))
