"""Parcels: what a bench delivers of a run, piece by piece; and the bench's record of orders and deliveries.

Events and their poses come first, then samples, the end of the run last. So a run that has ended at the
centre is complete there. A parcel describes the run as of its last event.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from itertools import accumulate
from typing import Annotated, Literal, NamedTuple

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field
from sqlmodel import Session, col, func, or_, select

from calrig.calibration.poses import Pose
from calrig.model.run import TERMINAL, Status
from calrig.store.bench_tables import DeliveryTable, TakenOrderTable
from calrig.store.convert import iso_utc, pose_of, run_of, run_row
from calrig.store.database import Repository
from calrig.store.event_log import transcripts_of
from calrig.store.records import Document
from calrig.store.tables import EventTable, PoseTable, RunTable, SampleBlockTable

Text = Annotated[str, Field(max_length=10_000)]


class _Delivered(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)  # what a newer bench says more is left unread


class DeliveredWait(_Delivered):
    """How the unit is to be clamped before it goes on."""

    mount_deg: float
    mount_axis: Annotated[str, Field(max_length=2)]


class DeliveredProgress(_Delivered):
    """How far it was, as CONTRACT section 2 has it."""

    poses_done: Annotated[int, Field(ge=0)]
    poses_total: Annotated[int, Field(ge=0)]
    fraction: float
    remaining_s: float | None
    waiting_for: DeliveredWait | None = None


class DeliveredRun(_Delivered):
    """The run as its bench knew it when it packed, without its id."""

    unit: Annotated[str, Field(min_length=1, max_length=100)]
    rig: Annotated[str, Field(min_length=1, max_length=64)]
    status: Status
    plan: Document
    progress: DeliveredProgress
    result: Document | None
    diagnosis: Document | None = None
    """Of a follow-up alone, which diagnoses itself."""
    faults: dict[str, int]
    follows: str | None
    provenance: Document
    operator: Text | None
    note: Text | None
    created_at: AwareDatetime
    started_at: AwareDatetime | None
    finished_at: AwareDatetime | None
    error: Text | None


class DeliveredEvent(_Delivered):
    """An event under the number that the bench gave it."""

    seq: Annotated[int, Field(ge=1, le=2**31 - 1)]
    type: Annotated[str, Field(min_length=1, max_length=64)]
    data: Document
    at: AwareDatetime


class DeliveredPose(_Delivered):
    """A pose: beside these, the columns of `Pose.row()`."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)
    __pydantic_extra__: dict[str, float | int | None]

    index: Annotated[int, Field(ge=0, le=2**31 - 1)]
    excluded: Text | None = None

    def pose(self) -> Pose:
        """The pose itself."""
        return Pose.from_row(self.__pydantic_extra__)


class DeliveredSamples(_Delivered):
    """What the packed block beside the document holds; `number` rises from block to block of a run."""

    number: Annotated[int, Field(ge=1)]
    pose_index: Annotated[int, Field(ge=0, le=2**31 - 1)]
    phase: Literal["move", "dwell"]
    n_samples: Annotated[int, Field(ge=0)]


class ParcelDocument(_Delivered):
    """A parcel's document: the run, and what happened of it that the centre does not know yet."""

    v: Literal[1]
    epoch: Annotated[int, Field(ge=1)]
    run: DeliveredRun
    events: list[DeliveredEvent] = []
    poses: list[DeliveredPose] = []
    transcripts: dict[str, str] | None = None
    samples: DeliveredSamples | None = None


VERSION = 1
EVENTS_A_PARCEL = 500
BLOCKS_AT_ONCE = 32
BYTES_AT_ONCE = 1_000_000
"""Of samples: what is sent, and kept in memory, together."""
RUN_FIELDS = ("id", *(name for name in DeliveredRun.model_fields if name != "diagnosis"))
"""Of `records.Run`: what the bench alone knows. What was diagnosed, voided or limited is the centre's."""


@dataclass(frozen=True, slots=True)
class Delivered:
    """How far a run has been delivered: up to an event's number and a block's, and whether that was all."""

    event_seq: int = 0
    sample_block_id: int = 0
    is_complete: bool = False


@dataclass(frozen=True, slots=True)
class Parcel:
    """A piece of a run; `data` are packed samples, `after` is how far the run is delivered with it."""

    run_id: str
    document: Document
    data: bytes | None
    after: Delivered


def next_parcels(session: Session, run: RunTable, epoch: int, before: Delivered) -> list[Parcel]:
    """The next pieces of a run, from one state of the store.

    `epoch` is of the order that it is carried out by, `before` how far it has been delivered.
    """
    wrap = _Wrapping(session, run, epoch)
    events = _events_after(session, run, before)
    if len(events) > EVENTS_A_PARCEL:
        del events[EVENTS_A_PARCEL:]
        after = replace(before, event_seq=events[-1].seq)
        return [wrap.parcel(wrap.run_before(events, after), after, events)]
    has_end = bool(events) and events[-1].type == "state" and events[-1].data["status"] in TERMINAL
    end = events.pop() if has_end else None
    parcels, after = [], before
    if events:
        after = replace(after, event_seq=events[-1].seq)
    said = wrap.run_now() if end is None else wrap.run_before(events, after)
    if events:
        parcels.append(wrap.parcel(said, after, events))
    blocks, are_all = _blocks_after(session, run, before)
    for block in blocks:
        after = replace(after, sample_block_id=block.id)
        parcels.append(wrap.parcel(said, after, block=block))
    if end is not None and are_all:
        after = replace(after, event_seq=end.seq, is_complete=True)
        parcels.append(wrap.parcel(wrap.run_now(), after, [end], transcripts=transcripts_of(session, run)))
    return parcels


def _events_after(session: Session, run: RunTable, before: Delivered) -> list[EventTable]:
    """The next events, one more than fits where there are more."""
    wanted = (
        select(EventTable)
        .where(EventTable.run_id == run.id, EventTable.seq > before.event_seq)
        .order_by(col(EventTable.seq))
        .limit(EVENTS_A_PARCEL + 1)
    )
    return list(session.exec(wanted).all())


def _blocks_after(
    session: Session, run: RunTable, before: Delivered
) -> tuple[Sequence[SampleBlockTable], bool]:
    """The next blocks of samples, as many as go together, and whether none comes after them."""
    number = col(SampleBlockTable.id)
    last_pose = select(SampleBlockTable.pose_index).where(number == before.sample_block_id).scalar_subquery()
    wanted = (
        select(SampleBlockTable.id)
        .where(SampleBlockTable.run_id == run.id, number > before.sample_block_id)
        .where(col(SampleBlockTable.pose_index) >= func.coalesce(last_pose, 0))  # for the index: it rises
        .order_by(number)
        .limit(BLOCKS_AT_ONCE + 1)
    )
    numbers = session.exec(wanted).all()
    if not numbers:
        return [], True
    sizes = session.exec(
        select(func.length(SampleBlockTable.data)).where(number.in_(numbers)).order_by(number)
    ).all()
    fitting = sum(total <= BYTES_AT_ONCE for total in accumulate(sizes))
    some = numbers[: max(1, min(BLOCKS_AT_ONCE, fitting))]
    blocks = session.exec(select(SampleBlockTable).where(number.in_(some)).order_by(number)).all()
    return blocks, len(some) == len(numbers)


class _Wrapping:
    """Makes parcels of one run."""

    def __init__(self, session: Session, run: RunTable, epoch: int) -> None:
        self._session, self._run, self._epoch = session, run, epoch

    def parcel(
        self,
        said: Document,
        after: Delivered,
        events: Sequence[EventTable] = (),
        *,
        block: SampleBlockTable | None = None,
        transcripts: Document | None = None,
    ) -> Parcel:
        document: Document = {
            "v": VERSION,
            "epoch": self._epoch,
            "run": said,
            "events": [
                {"seq": one.seq, "type": one.type, "data": one.data, "at": iso_utc(one.at)} for one in events
            ],
            "poses": self._poses([one.data["index"] for one in events if one.type == "pose"]),
        }
        if transcripts:
            document["transcripts"] = transcripts
        if block is None:
            return Parcel(self._run.uid, document, None, after)
        document["samples"] = {
            "number": block.id,
            "pose_index": block.pose_index,
            "phase": block.phase,
            "n_samples": block.n_samples,
        }
        return Parcel(self._run.uid, document, block.data, after)

    def run_now(self) -> Document:
        run = run_of(self._run)
        said = {name: getattr(run, name) for name in RUN_FIELDS}
        said |= {"progress": self._run.progress, "result": self._run.result}
        if run.follows is not None or "follow_up" in run.provenance:
            said["diagnosis"] = run.diagnosis  # of a follow-up, which diagnoses itself
        for name in ("created_at", "started_at", "finished_at"):
            said[name] = None if said[name] is None else iso_utc(said[name])
        return said

    def run_before(self, events: Sequence[EventTable], after: Delivered) -> Document:
        """The same, less what has happened since the last of these events: it goes on.

        Of its faults and provenance, what is so now.
        """
        states = [event.data for event in events if event.type == "state"]
        begun = {"poses_done": 0, "fraction": 0.0, "remaining_s": None, "waiting_for": None}
        return {
            **self.run_now(),
            "status": states[-1]["status"] if states else "running",
            "error": states[-1]["error"] if states else None,
            "progress": self._progress_at(after.event_seq) or {**self._run.progress, **begun},
            "result": None,
            "finished_at": None,
        }

    def _progress_at(self, seq: int) -> Document:
        wanted = (
            select(EventTable.data)
            .where(EventTable.run_id == self._run.id, EventTable.seq <= seq, EventTable.type == "progress")
            .order_by(col(EventTable.seq).desc())  # there is one after each pose: it is not far to look
            .limit(1)
        )
        return dict(self._session.exec(wanted).first() or {})

    def _poses(self, indices: Sequence[int]) -> list[Document]:
        if not indices:
            return []
        wanted = (
            select(PoseTable)
            .where(PoseTable.run_id == self._run.id, col(PoseTable.pose_index).in_(indices))
            .order_by(col(PoseTable.pose_index))
        )
        found = (pose_of(row, self._run.uid, None) for row in self._session.exec(wanted))
        return [{"index": one.index, **one.pose.row(), "excluded": one.excluded} for one in found]


ROOM_BYTES = 1_000_000
"""What a bench must be able to write before it takes an order."""


class TakenOrder(NamedTuple):
    """The newest epoch of a run that the bench has acted on, and what was ordered."""

    epoch: int
    document: Document


@dataclass(frozen=True, slots=True)
class Outbox:
    """What has not been delivered: events and blocks of samples, and when the oldest event was announced."""

    n_events: int
    n_blocks: int
    oldest_at: datetime | None

    @property
    def n_parcels(self) -> int:
        """About as many pieces."""
        return math.ceil(self.n_events / EVENTS_A_PARCEL) + self.n_blocks


class Spool(Repository):
    """What a bench keeps of its dealings with the centre."""

    def take_order(self, run_id: str, epoch: int, document: Document) -> None:
        """Keeps that an order is being acted on."""
        with self._database.writing() as session:
            session.merge(TakenOrderTable(run_uid=run_id, epoch=epoch, document=document))

    def require_room(self) -> None:
        """Writes as much as a run's beginning takes, and removes it again.

        Raises:
            StoreError: it cannot be written, and why.
        """
        with self._database.writing() as session:
            session.merge(TakenOrderTable(run_uid="", epoch=0, document={"room": "0" * ROOM_BYTES}))
        with self._database.writing() as session:
            session.delete(session.get_one(TakenOrderTable, ""))

    def taken_order(self, run_id: str) -> TakenOrder | None:
        """The newest order of a run that was acted on; None of a run that was begun here."""
        with self._database.reading() as session:
            row = session.get(TakenOrderTable, run_id)
            return None if row is None else TakenOrder(row.epoch, row.document)

    def taken_epochs(self) -> dict[str, int]:
        """The newest epoch that was acted on, of each run that was ordered."""
        with self._database.reading() as session:
            return dict(session.exec(select(TakenOrderTable.run_uid, TakenOrderTable.epoch)).all())

    def undelivered(self) -> list[str]:
        """Ids of the runs of which something may be left to deliver, in the order they came here."""
        with self._database.reading() as session:
            return [run.uid for run in _open_runs(session)]

    def next_parcels(self, run_id: str) -> list[Parcel]:
        """What a run is to deliver next, in order and not too much of it; empty where nothing is left now."""
        with self._database.reading() as session:
            row = run_row(session, run_id)
            order, before = session.get(TakenOrderTable, run_id), session.get(DeliveryTable, run_id)
            epoch = 1 if order is None else order.epoch  # a run begun here counts as the first order of it
            if before is None:
                return next_parcels(session, row, epoch, Delivered())
            so_far = Delivered(before.event_seq, before.sample_block_id, before.is_complete)
            return next_parcels(session, row, epoch, so_far)

    def mark_delivered(self, parcels: Sequence[Parcel]) -> None:
        """Keeps that the centre has these, which are all that lay before the last one of each run."""
        last = {parcel.run_id: parcel.after for parcel in parcels}
        with self._database.writing() as session:
            for run_id, after in last.items():
                session.merge(DeliveryTable(run_uid=run_id, **asdict(after)))

    def outbox(self) -> Outbox:
        """How much waits to be delivered, and since when."""
        n_events, n_blocks, waiting_since = 0, 0, []
        with self._database.reading() as session:
            for run in _open_runs(session):
                later = EventTable.run_id == run.id, EventTable.seq > (run.event_seq or 0)
                n, oldest_at = session.exec(select(func.count(), func.min(EventTable.at)).where(*later)).one()
                beyond = SampleBlockTable.run_id == run.id, SampleBlockTable.id > (run.sample_block_id or 0)
                n_events += n
                n_blocks += session.exec(select(func.count()).where(*beyond)).one()
                if oldest_at is not None:
                    waiting_since.append(oldest_at)
        return Outbox(n_events, n_blocks, min(waiting_since, default=None))


class _OpenRun(NamedTuple):
    """A run that is not known to be delivered whole."""

    id: int
    uid: str
    event_seq: int | None
    sample_block_id: int | None


def _open_runs(session: Session) -> list[_OpenRun]:
    """Every such run, in the order they came here; it is asked for often, and so read from indices alone."""
    wanted = (
        select(RunTable.id, RunTable.uid, DeliveryTable.event_seq, DeliveryTable.sample_block_id)
        .outerjoin(DeliveryTable, col(DeliveryTable.run_uid) == col(RunTable.uid))
        .where(or_(col(DeliveryTable.run_uid).is_(None), col(DeliveryTable.is_complete).is_(False)))
    )
    return sorted(_OpenRun(*row) for row in session.exec(wanted))
