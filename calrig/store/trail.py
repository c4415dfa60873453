"""Audit log (trail): who changed which run, unit or rig, when and why. Entries are only added."""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Any, Literal

import sqlalchemy
from sqlmodel import Session, col, or_, select

from calrig.run_ids import is_number
from calrig.store.checksums import to_json
from calrig.store.database import Repository
from calrig.store.errors import Refused
from calrig.store.records import Document
from calrig.store.tables import CertificateTable, RunTable, TrailTable

What = Literal[
    "started", "paused", "resumed", "aborted", "imported",
    "excluded", "included", "voided", "unvoided", "noted", "moved",
    "accepted", "taken_back", "mended", "drafted", "released", "withdrawn", "certificate_issued",
    "limits_changed", "check_unit_changed", "item_changed", "map_put_in_force", "map_withdrawn",
    "user_added", "user_changed", "unit_removed", "backed_up",
    "bench_added", "bench_enrolled", "bench_revoked", "stop_withdrawn",
]  # fmt: skip

EVERY_ENTRY = 1_000_000
"""More than any trail has: as the limit of a question, all."""
FIRST = "0" * 64
"""What the first entry is chained to."""


@dataclass(frozen=True, slots=True)
class Act:
    """Something that somebody did; `who` is None where nobody is known by name."""

    what: What
    who: str | None = None
    unit: str | None = None
    rig: str | None = None
    run_id: str | None = None
    revision: int | None = None
    reason: str | None = None
    detail: Document = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry(Act):
    """An act in the trail: its number, when it was done, and the hash that chains it to the one before."""

    seq: int
    at: datetime
    sha256: str


def append(session: Session, act: Act, now: datetime | None = None) -> TrailTable:
    """Adds an act, in the transaction of what was done: neither is ever stored without the other."""
    last = session.exec(select(TrailTable).order_by(col(TrailTable.seq).desc()).limit(1)).first()
    seq = 1 if last is None else last.seq + 1
    row = TrailTable(seq=seq, at=now or datetime.now(UTC), **asdict(act), sha256="")
    said = [getattr(row, name) for name in _SAID]
    row.sha256 = chained(FIRST if last is None else last.sha256, said)
    session.add(row)
    session.flush()
    return row


def act_on(what: What, run: RunTable, who: str | None, reason: str | None = None, **detail: Any) -> Act:
    """Return an act on a run, with its unit and rig."""
    return Act(what, who=who, unit=run.unit, rig=run.rig, run_id=run.uid, reason=reason, detail=detail)


class Trail(Repository):
    """What was done."""

    def add(self, act: Act) -> None:
        """Add an act that changes no other row."""
        with self._database.writing() as session:
            append(session, act)

    def add_backup(self, seq: int, sha256: str, who: str | None = None) -> Entry:
        """Enter that a backup was made, and its newest entry; return the entry.

        Raises:
            Refused: the trail has no such entry: the backup is of another store.
        """
        with self._database.writing() as session:
            if not self.holds(seq, sha256):
                raise Refused(f"the audit log has no entry {seq} with SHA-256 {sha256}")
            act = Act("backed_up", who, detail={"trail_seq": seq, "trail_sha256": sha256})
            return _entry(append(session, act))

    def entries(
        self,
        *,
        unit: str | None = None,
        what: Sequence[What] = (),
        since: datetime | None = None,
        after: int | None = None,
        newest_first: bool = False,
        limit: int = 1000,
    ) -> list[Entry]:
        """Entries, oldest first: of a unit, of some kinds, from a time on, after a number in this order.

        Of a unit are the entries of runs that were moved away from it, too.
        """
        seq = col(TrailTable.seq)
        wanted = select(TrailTable).order_by(seq.desc() if newest_first else seq)
        if after is not None:
            wanted = wanted.where(seq < after if newest_first else seq > after)
        if unit is not None:
            moved_away = col(TrailTable.detail)["from"].as_string() == unit
            wanted = wanted.where(or_(col(TrailTable.unit) == unit, moved_away))
        if what:
            wanted = wanted.where(col(TrailTable.what).in_(what))
        if since is not None:
            wanted = wanted.where(col(TrailTable.at) >= since)
        with self._database.reading() as session:
            return [_entry(row) for row in session.exec(wanted.limit(limit))]

    def head(self) -> tuple[int, str]:
        """Number and hash of the newest entry; 0 and `FIRST` of an empty trail."""
        newest = self.entries(newest_first=True, limit=1)
        return (newest[0].seq, newest[0].sha256) if newest else (0, FIRST)

    def links_before(self, numbers: Sequence[int]) -> dict[int, str]:
        """Of some entries, what each is chained to: the hash of the one before, of the first `FIRST`."""
        wanted = select(TrailTable.seq, TrailTable.sha256)
        wanted = wanted.where(col(TrailTable.seq).in_([number - 1 for number in numbers]))
        with self._database.reading() as session:
            found = {seq + 1: sha256 for seq, sha256 in session.exec(wanted)}
        return {number: found.get(number, FIRST) for number in numbers}

    def holds(self, seq: int, sha256: str) -> bool:
        """Whether an entry is here as somebody else has it: in a backup, an archive or a certificate."""
        wanted = select(TrailTable.sha256).where(TrailTable.seq == seq)
        with self._database.reading() as session:
            return (session.exec(wanted).first() or FIRST) == sha256 if seq else sha256 == FIRST

    def broken_link(self) -> int | None:
        """Number of the first entry that is not what was written after the one before it; None: all are.

        A certificate proves the newest entry of its time and the entry of its own issue: these and what is
        before them cannot be cut off unseen.
        """
        before, expected = FIRST, 1
        columns = sqlalchemy.select(*(getattr(TrailTable, name) for name in (*_SAID, "sha256")))
        columns = columns.order_by(col(TrailTable.seq))
        wanted = select(CertificateTable.number, CertificateTable.trail_seq, CertificateTable.trail_sha256)
        with self._database.reading() as session:
            issued = session.exec(wanted).all()
            heads = {seq: sha256 for _, seq, sha256 in issued if seq}
            numbers = {number for number, _, _ in issued}
            # columns, not objects of the table: twenty thousand take half the time
            for *said, sha256 in session.connection().execute(columns):
                is_other = sha256 != heads.pop(expected, sha256)
                if said[0] != expected or is_other or sha256 != chained(before, said):
                    return int(said[0])
                if said[3] == "certificate_issued":
                    numbers.discard(said[9]["number"])
                before, expected = sha256, expected + 1
        return expected if heads or numbers else None


_SAID = ("seq", "at", "who", "what", "unit", "rig", "run_id", "revision", "reason", "detail")
"""What an entry says, in the order that it is hashed in."""


def chained(before: str, said: Sequence[Any]) -> str:
    """SHA-256 over the entry before and all that this one says."""
    seq, at, who, what, unit, rig, run_id, *rest = said
    if run_id is not None and is_number(run_id):
        run_id = int(run_id)  # as which it was hashed when runs were counted
    time = at.astimezone(UTC).isoformat(timespec="microseconds")
    text = to_json([before, seq, time, who, what, unit, rig, run_id, *rest])
    return hashlib.sha256(text.encode()).hexdigest()


def entry_document(entry: Entry) -> Document:
    """An entry as JSON that `is_chained` takes."""
    said = asdict(entry)
    at = said.pop("at").astimezone(UTC).isoformat(timespec="microseconds")
    return {"seq": said.pop("seq"), "at": at, **said}


def is_chained(before: str, document: Document) -> bool:
    """Whether an entry's document is what was written after the entry of that hash."""
    said = [document[name] for name in _SAID]
    said[1] = datetime.fromisoformat(document["at"])
    return bool(chained(before, said) == document["sha256"])


def _entry(row: TrailTable) -> Entry:
    return Entry(**{name: getattr(row, name) for name in (*_SAID, "sha256")})
