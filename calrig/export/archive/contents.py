"""The archive of a unit: what a store has of it, written as a zip while it is sent, one run at a time.

The same members always give the same bytes; a hash of all of them is at the end.
"""

import hashlib
import json
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

import calrig
from calrig.calibration.poses import Pose
from calrig.canonical_json import sha256_of
from calrig.export.archive import layout
from calrig.export.archive.layout import COMMENT_BYTES
from calrig.export.poses_csv import write_pose_batches
from calrig.export.samples_csv import labelled_samples
from calrig.model.base import Model
from calrig.model.run import AT_REST
from calrig.store import Run, Store
from calrig.store.convert import iso_utc
from calrig.store.issued import Revision
from calrig.store.records import Document
from calrig.store.trail import entry_document

_REGULAR_FILE = 0o100644 << 16
_UNIX = 3


@dataclass(frozen=True, slots=True)
class Member:
    """A file of an archive; `pieces` are asked for once, when it is its turn."""

    name: str
    pieces: Iterable[bytes]


@dataclass(frozen=True, slots=True)
class Packed:
    """A member that has been written."""

    name: str
    size: int
    sha256: str


class _Outlet:
    """What zipfile writes to: nothing in it can be gone back to, as on a wire."""

    def __init__(self) -> None:
        self._held = bytearray()
        self._hash = hashlib.sha256()

    def write(self, data: bytes) -> int:
        self._held += data
        return len(data)

    def flush(self) -> None:
        """Nothing is kept back but by `drained`."""

    def close(self) -> None:
        """Do nothing: the caller has the pieces."""

    def drained(self) -> bytes:
        """What has been written since the last time."""
        data = bytes(self._held)
        self._held.clear()
        self._hash.update(data)
        return data

    def last(self) -> bytes:
        """The end, with the hash of everything before in the place of the comment."""
        del self._held[-COMMENT_BYTES:]
        data = self.drained()
        return data + self._hash.hexdigest().encode()


def packed(members: Iterable[Member], manifest: Callable[[list[Packed]], Member]) -> Iterator[bytes]:
    """The zip, piece by piece.

    `manifest` makes the last member of those before it.
    """
    outlet = _Outlet()
    written: list[Packed] = []
    with zipfile.ZipFile(outlet, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.comment = b"0" * COMMENT_BYTES
        for member in members:
            yield from _write(archive, outlet, member, written)
        yield from _write(archive, outlet, manifest(written), written)
    yield outlet.last()


def _write(
    archive: zipfile.ZipFile, outlet: _Outlet, member: Member, written: list[Packed]
) -> Iterator[bytes]:
    info = zipfile.ZipInfo(member.name)  # of 1980, as every file without a stated time
    info.compress_type = zipfile.ZIP_DEFLATED
    info.create_system, info.external_attr = _UNIX, _REGULAR_FILE
    content, size = hashlib.sha256(), 0
    with archive.open(info, "w", force_zip64=True) as opened:  # a static log of two days has 4 GB
        for piece in member.pieces:
            opened.write(piece)
            content.update(piece)
            size += len(piece)
            if data := outlet.drained():
                yield data
    written.append(Packed(member.name, size, content.hexdigest()))


Listed = Callable[[Sequence[Revision]], list[Document]]
Certificates = Callable[[Sequence[str]], Iterator[tuple[str, bytes]]]
"""Those of some numbers: name of the file and content."""
ENTRIES_AT_ONCE = 400
RUNS_AT_ONCE = 20
MOST_CERTIFICATES = 1_000_000


def unit_archive(
    store: Store, unit: str, listed: Listed, certificates: Certificates = lambda _: iter(())
) -> Iterator[bytes]:
    """The archive of a unit, piece by piece; the same bytes as long as the store has not changed.

    Runs that are going on are left out, and named.

    `listed` gives revisions as CONTRACT section 2 lists them, `certificates` those that were issued.
    """
    contents = _Contents(store, unit, listed, certificates)
    return packed(contents.members(), contents.manifest)


class _Contents:
    """The members, made as they are asked for; the manifest says what came of them."""

    def __init__(self, store: Store, unit: str, listed: Listed, certificates: Certificates) -> None:
        self._store, self._unit = store, unit
        self._listed, self._certificates = listed, certificates
        self._latest: str | None = None
        self._trail: Document = {}
        self._left_out: list[Document] = []
        self._in_force: int | None = None

    def members(self) -> Iterator[Member]:
        """All but the manifest."""
        revisions, newest = _settled(self._store, self._unit)
        head = next(iter(self._store.trail.entries(newest_first=True, limit=1)), None)
        self._trail = {
            "entries": 0,
            "head": None if head is None else {"seq": head.seq, "sha256": head.sha256},
            "broken_at": self._store.trail.broken_link(),
        }
        yield Member(layout.README, [layout.WHAT_IT_IS.encode()])
        yield from self._revisions(revisions)
        issued = self._store.trail.entries(
            unit=self._unit, what=["certificate_issued"], limit=MOST_CERTIFICATES
        )
        numbers = [entry.detail["number"] for entry in issued if entry.seq <= newest]
        for name, content in self._certificates(numbers):
            yield Member(name, [content])
        yield Member(layout.TRAIL, self._entries(newest))
        yield from self._runs({one.run_id for one in revisions})

    def manifest(self, written: list[Packed]) -> Member:
        """What is in the archive, and the hash of this document by the rule of CONTRACT section 6."""
        document: Document = {
            "schema": layout.SCHEMA,
            "calrig": calrig.__version__,
            "unit": self._unit,
            "as_of": self._latest,
            "revision_in_force": self._in_force,
            "trail": self._trail,
            "left_out": self._left_out,
            "files": [{"path": one.name, "size": one.size, "sha256": one.sha256} for one in written],
        }
        return _document(layout.MANIFEST, {**document, "sha256": sha256_of(document)})

    def _revisions(self, revisions: Sequence[Revision]) -> Iterator[Member]:
        listed = []
        for one, shown in zip(revisions, self._listed(revisions), strict=True):
            self._saw(one.issued_at)
            known: Document = {}
            if (number := one.basis.get("solution")) is not None:
                solved = self._store.solutions.get(number).found
                known = {"solution": {"rig": solved.rig, **asdict(solved.basis)}}
            listed.append({**shown, "file": layout.document_name(one.revision), "basis": one.basis, **known})
            if one.status == "in_force":
                self._in_force = one.revision
        yield _document(layout.REVISIONS, listed)
        used = {int(key) for one in revisions for key in one.basis["effects"] if key.isdigit()}
        effects = self._store.effects.by_id(sorted(used))
        yield _document(layout.EFFECTS, [asdict(effect) for effect in effects])
        for one in revisions:
            yield Member(layout.document_name(one.revision), [one.text.encode()])

    def _entries(self, newest: int) -> Iterator[bytes]:
        """The unit's entries of the trail up to a number, a line each, and what each is chained to."""
        after = 0
        while entries := self._store.trail.entries(unit=self._unit, after=after, limit=ENTRIES_AT_ONCE):
            before = self._store.trail.links_before([entry.seq for entry in entries])
            for entry in entries:
                if entry.seq > newest:
                    return
                self._saw(entry.at)
                self._trail["entries"] += 1
                line = {"before": before[entry.seq], **entry_document(entry)}
                yield f"{json.dumps(line, ensure_ascii=False, allow_nan=False)}\n".encode()
            after = entries[-1].seq

    def _runs(self, rested_on: set[str]) -> Iterator[Member]:
        """The unit's, and those of another unit by now that a revision rests on; their list comes last."""
        listed: list[Document] = []
        cursor: str | None = None
        while True:
            runs, cursor = self._store.runs.page(unit=self._unit, limit=RUNS_AT_ONCE, cursor=cursor)
            for run in runs:
                rested_on.discard(run.id)
                yield from self._run(run, listed)
            if cursor is None:
                break
        for run_id in sorted(rested_on):
            if (moved := self._store.runs.get(run_id)) is not None:
                yield from self._run(moved, listed)
        yield _document(layout.RUNS, listed)

    def _run(self, run: Run, listed: list[Document]) -> Iterator[Member]:
        if run.status not in AT_REST:
            self._left_out.append({"run_id": run.id, "why": f"is {run.status}"})
            return
        self._saw(
            run.created_at, run.started_at, run.finished_at, None if run.voided is None else run.voided.at
        )
        document, poses, samples = layout.run_names(run.id)
        indices: list[int] = []
        excluded: dict[int, str] = {}

        def batches() -> Iterator[list[Pose]]:
            indices.clear()
            for batch in self._store.poses.batches_of(run.id):
                indices.extend(stored.index for stored in batch)
                excluded.update((p.index, p.excluded) for p in batch if p.excluded is not None)
                yield [stored.pose for stored in batch]

        yield Member(poses, (text.encode() for text in write_pose_batches(batches)))
        yield Member(samples, labelled_samples(self._store.samples.labelled_blocks(run.id)))
        said = {**_run_document(run), "poses": {"indices": _spans(indices), "excluded": excluded}}
        yield _document(document, said)
        listed.append({"run_id": run.id, "unit": run.unit, "status": run.status, "n_poses": len(indices)})

    def _saw(self, *times: datetime | None) -> None:
        """The archive is as of the last thing that it holds."""
        for time in times:
            if time is not None:
                self._latest = max(self._latest or "", iso_utc(time))


def _settled(store: Store, unit: str) -> tuple[list[Revision], int]:
    """The unit's revisions, and the number of its entry in the trail that tells of their last change."""
    while True:
        newest = _newest(store, unit)
        revisions = store.revisions.of(unit)
        if _newest(store, unit) == newest:
            return revisions, newest


def _newest(store: Store, unit: str) -> int:
    return next((entry.seq for entry in store.trail.entries(unit=unit, newest_first=True, limit=1)), 0)


def _spans(indices: Sequence[int]) -> list[list[int]]:
    """Whole numbers in order as first and last of each stretch without a gap."""
    spans: list[list[int]] = []
    for index in indices:
        if spans and index == spans[-1][1] + 1:
            spans[-1][1] = index
        else:
            spans.append([index, index])
    return spans


_OF_ANSWERS = {"suspect", "calibration"}
"""Of a run, what only an answer of the API has."""


def _run_document(run: Run) -> Document:
    verdict = run.verdict
    names = ["id", "unit", "rig", "status", "plan", *type(run).model_fields]  # in the order of every archive
    return {
        **{name: getattr(run, name) for name in dict.fromkeys(names) if name not in _OF_ANSWERS},
        "limit": None if run.limit is None else run.limit.model_dump(mode="json"),
        "verdict": None if verdict is None else verdict.to_dict(),
    }


def _document(name: str, document: Any) -> Member:
    return Member(name, [layout.written(_plain(document)).encode()])


def _plain(value: Any) -> Any:
    """JSON's own types: times as the API writes them."""
    if isinstance(value, datetime):
        return iso_utc(value)
    if isinstance(value, Model):
        return _plain(value.model_dump(exclude_unset=True))  # the keys that were stored
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value
