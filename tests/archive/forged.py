"""Archives that somebody changed, and put right as far as their own words go."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping
from typing import Any

from calrig.canonical_json import sha256_of
from calrig.export.archive import layout
from calrig.export.archive.contents import Member, Packed, packed


def members(archive: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        return {name: opened.read(name) for name in opened.namelist()}


def container(contents: Mapping[str, bytes]) -> bytes:
    """Any files packed as an archive is, the last one where the manifest stands."""
    *others, last = (Member(name, [content]) for name, content in contents.items())
    return b"".join(packed(others, lambda _: last))


def resigned(archive: bytes, **changed: Any) -> bytes:
    """The container made anew, manifest and all, with other members: `{name: bytes or None}`."""
    contents = members(archive)
    manifest = json.loads(contents.pop(layout.MANIFEST))
    contents.update(changed.get("contents", {}))
    kept = [Member(name, [content]) for name, content in contents.items() if content is not None]

    def new_manifest(written: list[Packed]) -> Member:
        files = [{"path": one.name, "size": one.size, "sha256": one.sha256} for one in written]
        document = {**manifest, "files": files, **changed.get("manifest", {})}
        document["sha256"] = sha256_of(document)
        return Member(layout.MANIFEST, [json.dumps(document).encode()])

    return b"".join(packed(kept, new_manifest))


def resealed(zip_bytes: bytes) -> bytes:
    """Any zip with the hash of its bytes for a comment."""
    end = zip_bytes.rindex(b"PK\x05\x06")
    whole = zip_bytes[: end + 20] + layout.COMMENT_BYTES.to_bytes(2, "little")
    return whole + hashlib.sha256(whole).hexdigest().encode()
