"""Back up a store, also while it is written to."""

import contextlib
from dataclasses import dataclass
from pathlib import Path

from calrig.store.database import BUSY_TIMEOUT_S, revisions
from calrig.store.errors import StoreError
from calrig.store.sqlite import copying, file
from calrig.store.sqlite.database import database_path


@dataclass(frozen=True, slots=True)
class BackedUp:
    """What a backup holds.

    Attributes:
        trail_seq, trail_sha256: the newest entry of its audit log; 0 and None of an empty one.
        is_current: whether the store has the layout of this version.
    """

    runs: int
    poses: int
    size_bytes: int
    trail_seq: int
    trail_sha256: str | None
    is_current: bool


def back_up(url: str, target: Path) -> BackedUp:
    """Copies a store of any revision as it is at one instant; its writer goes on meanwhile.

    `url` is as `Store.open` takes it; the target, a store of its own, is there only once it is complete.

    Raises:
        StoreError: `target` exists, or cannot be written; there is no store at `url`, or it is damaged.
    """
    database = database_path(url)
    if not database.is_file():
        raise StoreError(f"{database}: there is no calrig database: name one with --db")
    stored = copying.stored_revision(database, file.reading_uri(database, BUSY_TIMEOUT_S))
    if stored is None:
        raise StoreError(f"{database}: is empty: there is nothing to keep a copy of")
    copying.copy_database(database, target)
    with contextlib.closing(file.connect(target.resolve().as_uri() + file.AS_IT_LIES)) as copy:
        (runs,) = copy.execute("SELECT count(*) FROM run").fetchone()
        (poses,) = copy.execute("SELECT count(*) FROM pose").fetchone()
        has_trail = copy.execute("SELECT 1 FROM sqlite_master WHERE name = 'trail'").fetchone()
        newest = "SELECT seq, sha256 FROM trail ORDER BY seq DESC LIMIT 1"  # older stores have none
        head = copy.execute(newest).fetchone() if has_trail else None
    seq, sha256 = head or (0, None)
    return BackedUp(runs, poses, target.stat().st_size, seq, sha256, is_current=stored == revisions()[-1])
