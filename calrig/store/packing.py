"""What a bench delivers of a run, in pieces: events with their poses, then samples, its end last of all.

So whoever sees at the centre that a run has ended finds all of it there. A parcel says of the run what was so
when its last event was announced, whatever has happened since.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any

from sqlmodel import Session, col, func, select

from calrig.store.convert import iso_utc, pose_of, run_of
from calrig.store.parcel_document import packed_row
from calrig.store.records import TERMINAL, Document
from calrig.store.tables import EventTable, PoseTable, RunTable, SampleBlockTable, TranscriptTable

VERSION = 1
EVENTS_A_PARCEL = 500
BLOCKS_AT_ONCE = 32
BYTES_AT_ONCE = 1_000_000
"""Of samples: what is sent, and kept in memory, together."""
RUN_FIELDS = (
    "id", "unit", "rig", "status", "plan", "progress", "result", "faults", "follows", "provenance",
    "operator", "note", "created_at", "started_at", "finished_at", "error",
)  # fmt: skip
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

    Args:
        session: of that state.
        run: its row.
        epoch: of the order that it is carried out by.
        before: how far it has been delivered.
    """
    wrap = _Wrapping(session, run, epoch)
    events = _events_after(session, run, before)
    if len(events) > EVENTS_A_PARCEL:
        del events[EVENTS_A_PARCEL:]
        after = replace(before, event_seq=events[-1].seq)
        return [wrap.parcel(wrap.run_before(events, after), after, events)]
    end = events.pop() if events and _is_end(events[-1]) else None
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
        parcels.append(wrap.parcel(wrap.run_now(), after, [end], transcripts=wrap.transcripts()))
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


def _is_end(event: EventTable) -> bool:
    return event.type == "state" and event.data["status"] in TERMINAL


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
        """What the store says of the run."""
        run = run_of(self._run)
        said = {name: getattr(run, name) for name in RUN_FIELDS}
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
        return [packed_row(one.index, one.pose, one.excluded) for one in found]

    def transcripts(self) -> dict[str, Any]:
        """What went over each port before the run failed."""
        wanted = select(TranscriptTable).where(TranscriptTable.run_id == self._run.id)
        return {row.port: zlib.decompress(row.data).decode() for row in self._session.exec(wanted)}
