"""What the parts of an archive say of one another: trail, list of revisions, documents."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from calrig.canonical_json import sha256_of
from calrig.export.archive import layout
from calrig.export.archive.opened import DamagedError
from calrig.store.trail import FIRST, is_chained

Read = Callable[[str], bytes | None]
"""Gives a member; None of one that is known to be damaged or missing."""
Problem = tuple[str, str]
"""Where, and what is wrong there."""
Said = dict[int, tuple[str, str]]
"""Of each revision, the hash of its document and its state, as the trail has them."""


def said_by_trail(lines: bytes, manifest: Mapping[str, Any]) -> Said:
    """What the unit's entries of the trail say of its revisions.

    An entry's hash is over the one before it and all that it says. Entries of other units between two of this
    one's are not here, so that the chain is proven within each entry, from one to the next where they follow
    one another, and at the head where that is of this unit; across a gap the store itself can prove it.

    Args:
        lines: an entry each.
        manifest: what it says of the trail.

    Raises:
        DamagedError: an entry is not what was written, or one is missing.
    """
    said: Said = {}
    seq, before = 0, FIRST
    entries = [json.loads(line) for line in lines.splitlines()]
    for entry in entries:
        where = f"{layout.TRAIL}, entry {entry['seq']}"
        follows = entry["seq"] == seq + 1
        if entry["seq"] <= seq or (follows and entry["before"] != before):
            raise DamagedError(where, "does not go on from the entry before it")
        if not is_chained(entry["before"], entry):
            raise DamagedError(where, "is not what was written: its hash is another")
        seq, before = entry["seq"], entry["sha256"]
        _replay(said, entry)
    head = manifest["head"] or {"seq": 0, "sha256": FIRST}
    if len(entries) != manifest["entries"]:
        raise DamagedError(layout.TRAIL, f"has {len(entries)} entries, and had {manifest['entries']}")
    if head["seq"] < seq or (head["seq"] == seq and head["sha256"] != before):
        raise DamagedError(layout.TRAIL, f"does not lead to its head, entry {head['seq']}")
    return said


def _replay(said: Said, entry: Mapping[str, Any]) -> None:
    what, number = entry["what"], entry["revision"]
    if what == "unit_removed":
        said.clear()
    elif what == "drafted":
        said[number] = entry["detail"]["sha256"], "draft"
    elif what == "released":
        for other, (sha256, state) in said.items():
            if state == "in_force":
                said[other] = sha256, "superseded"
        said[number] = said[number][0], "in_force"
    elif what == "withdrawn":
        said[number] = said[number][0], "withdrawn"


def document_problems(
    revisions: Sequence[Mapping[str, Any]], said: Said | None, manifest: Mapping[str, Any], read: Read
) -> Iterator[Problem]:
    """What is wrong with the documents, and with the list of them.

    Args:
        revisions: the list.
        said: by the trail; None where that cannot be read.
        manifest: the archive's.
        read: gives a document.
    """
    in_force = [one["revision"] for one in revisions if one["status"] == "in_force"]
    if in_force != [number for number in [manifest["revision_in_force"]] if number is not None]:
        yield layout.REVISIONS, f"has {in_force} in force, and the manifest {manifest['revision_in_force']}"
    for one in revisions:
        where = layout.document_name(one["revision"])
        if one["file"] != where:
            yield layout.REVISIONS, f"has revision {one['revision']} in {one['file']!r}"
        if (content := read(where)) is None:
            continue
        document = json.loads(content)
        sha256 = sha256_of(document)
        if not sha256 == document["sha256"] == one["sha256"]:
            yield where, "is not what was issued: its SHA-256 is another"
        stated = {name: document[name] for name in ("unit", "revision", "run_id")}
        if stated != {"unit": manifest["unit"], "revision": one["revision"], "run_id": one["run_id"]}:
            yield where, f"is of {stated}, and the list has it otherwise"
        if said is not None and said.get(one["revision"]) != (sha256, one["status"]):
            yield where, f"is {one['status']} by the list, and the trail says otherwise"
    listed = {one["revision"] for one in revisions}
    for number in sorted((said or {}).keys() - listed):
        yield layout.REVISIONS, f"lacks revision {number}, which the trail tells of"
